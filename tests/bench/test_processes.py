"""Processes of their own: how long they take, and what they end with."""

import pytest

from foveate.bench import processes


def test_the_second_of_two_trainings_uses_the_compilation_cache(monkeypatch):
    calls, seconds = [], iter((30.0, 10.0))
    monkeypatch.setattr(
        processes, "process_time", lambda *words, cache=None: calls.append((words, cache)) or next(seconds)
    )
    cold, warm = processes.whole_training()
    assert (cold.key, cold.value) == ("train_process_cold_s", 30.0)
    assert (warm.key, warm.value) == ("train_process_warm_s", 10.0)
    (first, cache), (second, same) = calls
    assert cache == same is not None
    assert first[-1] != second[-1], "another run folder"
    assert "paper" in first


def test_starting_is_timed_a_few_times(monkeypatch):
    calls = []
    monkeypatch.setattr(processes, "process_time", lambda *words: calls.append(words))
    assert [metric.key for metric in processes.starting(9)] == ["help_s", "import_s"]
    assert len(calls) == 2 * (5 + 1), "no more than five, and a warm-up"


def test_a_process_is_timed_to_its_end():
    assert processes.process_time("-c", "import time; time.sleep(0.4)") >= 0.4
    assert processes.process_time("-c", "import os; assert os.environ['JAX_COMPILATION_CACHE_DIR'] == 'x'", cache="x")


def test_a_process_that_fails_is_an_error():
    with pytest.raises(ValueError, match="ended with 1: NameError"):
        processes.process_time("-c", "nothing")
