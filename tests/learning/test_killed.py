"""Killed at random moments, also within a write, a training goes on to the very same files as one left alone.

Death is played by a disk that stops: the operation under way is done by half, all later ones not at all, not even
cleaning up. `make kill` does it with SIGKILL and whole processes; `test_signals.py` does it to one.
"""

import builtins
import functools
import json
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import foveate.checkpoint as checkpoint
import foveate.files as files
from foveate.checkpoint import BEST, CONFIG, LAST, load_run
from foveate.learner_settings import ActorCriticSettings
from foveate.learning import training
from foveate.learning.judging import METRICS
from foveate.learning.learner import train
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer import PointerSettings
from foveate.scenario import Scenario, SceneSettings
from foveate.settings import Experiment, TrainingSettings

KILLS = 20
KINDS = ("write .jsonl", "write .tmp", "fsync", "replace")
"""What is done to the disk. The first deaths are one of each kind, the others as it comes."""
MODEL = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=4, drift_m_s=(0.1, 0.1))),
    policy=AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,)),
    training=TrainingSettings(epochs=40, episodes=8, learning_rate=1e-2, held_out=16, check_every=2),
)
TRYING = replace(
    MODEL,
    policy=PointerSettings(
        kind="pointer", target_widths=(8, 8), heads=2, context_widths=(8,), mode_widths=(8,), modes=1
    ),
    training=ActorCriticSettings(
        algorithm="actor-critic", epochs=40, episodes=8, minibatches=2, held_out=16, check_every=2
    ),
)


class Killed(BaseException):
    pass


class Disk:
    """Counts what is done to it, and stops."""

    def __init__(self, rng):
        self.rng, self.left, self.kind, self.dead, self.moments = rng, np.inf, None, False, []

    def live(self, left, kind=None):
        """Until so many operations, of one kind if it is given, are done."""
        self.left, self.kind, self.dead = left, kind, False

    def step(self, what, whole, half=lambda: None):
        """One operation: all of it, or when its time has come nothing, a part, or all of it, and then death."""
        if self.dead:
            raise Killed
        self.left -= self.kind in (None, what)
        if self.left > 0:
            return whole()
        self.dead = True
        self.moments.append(what)
        [lambda: None, half, whole][self.rng.integers(3)]()
        raise Killed

    def open(self, path, mode="r", *rest, **options):
        file = builtins.open(path, mode, *rest, **options)  # noqa: SIM115 (whoever asked for it closes it)
        return self.File(self, file, path) if set(mode) & set("xwa") else file

    class File:
        def __init__(self, disk, file, path):
            self.disk, self.file, self.path = disk, file, path

        def __getattr__(self, name):
            return getattr(self.file, name)

        def __enter__(self):
            return self

        def __exit__(self, *exception):
            self.file.close()

        def write(self, data):
            part = data[: self.disk.rng.integers(len(data) + 1)]
            suffix = Path(self.path).suffix
            self.disk.step(f"write {suffix}", lambda: self.file.write(data), lambda: self.file.write(part))
            self.file.flush()


def mortal(monkeypatch):
    """From here on all that is written is written to a disk that may stop."""
    disk = Disk(np.random.default_rng(8))
    monkeypatch.setattr(files, "open", disk.open, raising=False)
    monkeypatch.setattr(Path, "open", lambda path, *mode, **options: disk.open(path, *mode, **options))
    unlink = Path.unlink
    monkeypatch.setattr(Path, "unlink", lambda path, **options: None if disk.dead else unlink(path, **options))
    real = dict(vars(os))
    for name in ("fsync", "replace"):
        real[name] = lambda *given, name=name: disk.step(name, lambda: getattr(os, name)(*given))
    monkeypatch.setattr(files, "os", SimpleNamespace(**real))
    return disk


@pytest.fixture
def one_program(monkeypatch):
    """A training that goes on would trace its programs anew: 20 times are too many."""
    programs, episodes, jit, held_out = {}, [], training.eqx.filter_jit, training.held_out_episodes
    monkeypatch.setattr(training.eqx, "filter_jit", lambda f: programs.setdefault(f.__qualname__, jit(f)))

    def once(*arguments):
        if not episodes:
            episodes.append(held_out(*arguments))
        return episodes[0]

    monkeypatch.setattr(training, "held_out_episodes", once)
    monkeypatch.setattr(checkpoint, "digest", functools.cache(checkpoint.digest))


def arrays(path):
    with np.load(path) as found:
        return {name: found[name].tobytes() for name in found.files if name != "header"}


def told(run):
    lines = [json.loads(line) for line in (run / METRICS).read_text().splitlines()]
    return [{k: v for k, v in line.items() if k not in ("elapsed_s", "epochs_per_s")} for line in lines]


@pytest.mark.parametrize("experiment", [MODEL, TRYING], ids=["policy-gradient", "actor-critic"])
def test_killed_at_random_moments_it_ends_the_same(experiment, one_program, tmp_path, monkeypatch):
    undisturbed = train(experiment, tmp_path / "a", seed=3)
    disk = mortal(monkeypatch)
    out, outcome = tmp_path / "b", None
    while outcome is None:
        if (killed := len(disk.moments)) < KILLS:
            disk.live(int(disk.rng.integers(1, 14)), KINDS[killed] if killed < len(KINDS) else None)
        else:
            disk.live(np.inf)
        before = {path: arrays(out / path) for path in (BEST, LAST) if (out / path).exists()}
        try:
            outcome = train(experiment, out, seed=3, resume=(out / CONFIG).exists())
        except Killed:
            for path in before:
                assert arrays(out / path), "what was there before is there, or what replaced it"
    assert len(disk.moments) == KILLS
    assert {*disk.moments} == set(KINDS)
    assert outcome == undisturbed
    assert (out / BEST).read_bytes() == (tmp_path / "a" / BEST).read_bytes()
    assert arrays(out / LAST) == arrays(tmp_path / "a" / LAST)
    assert (out / CONFIG).read_bytes() == (tmp_path / "a" / CONFIG).read_bytes()
    assert told(out) == told(tmp_path / "a")
    assert not list(out.rglob("*.tmp")), "and nothing lies about"
    assert load_run(out)[0] == experiment
    assert jax.tree.all(jax.tree.map(lambda x: np.isfinite(x).all(), load_run(out)[1]))
