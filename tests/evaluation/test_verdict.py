"""The verdict of a training: paired differences, words, file, and a run that is judged."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from helpers.commands import check_contract
from scipy import stats

from foveate.evaluation import verdict as verdicts
from foveate.evaluation.verdict import (
    judge_run,
    judged_episodes,
    planner_size,
    read_verdict,
    verdict_of,
    write_verdict,
)
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import BEST, VERDICT
from foveate.names import HEURISTICS
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings

RNG = np.random.default_rng(0)
POLICY = RNG.normal(5.0, 2.0, 40)
SCORES = {
    "policy": POLICY,
    "still": POLICY - 3.0 + RNG.normal(0.0, 0.5, 40),  # clearly worse
    "nearest": POLICY - 0.1 + RNG.normal(0.0, 2.0, 40),  # about as good
    "uncertain": POLICY + 0.5 + RNG.normal(0.0, 0.1, 40),  # better
}
PLANNED = {"icr-16": POLICY[:8] + 0.2}
PAPER = PRESETS["paper"]


def test_differences_are_paired():
    found = verdict_of(PAPER, SCORES, PLANNED)
    assert [row.method for row in found.rows] == ["policy", "uncertain", "nearest", "still", "icr-16"]
    assert (found.objective, found.protocol) == ("terminal", "surrogate")
    for row in found.rows:
        theirs = {**SCORES, **PLANNED}[row.method]
        assert row.episodes == len(theirs)
        assert row.mean == pytest.approx(theirs.mean())
        assert row.se == pytest.approx(stats.sem(theirs))
        if row.method == "policy":
            assert row.difference is row.difference_se is None
            continue
        lead = POLICY[: len(theirs)] - theirs
        assert row.difference == pytest.approx(lead.mean())
        assert row.difference_se == pytest.approx(stats.sem(lead), abs=1e-12)


def test_words_name_heuristics_that_are_not_clearly_beaten():
    found = verdict_of(PAPER, SCORES, PLANNED)
    assert found.unbeaten == ("uncertain", "nearest"), "a planner is no heuristic"
    assert found.winner == "uncertain"
    assert found.sentences == ("The policy has no clear lead (2 standard errors) over: uncertain, nearest.",)
    beaten = verdict_of(PAPER, {name: SCORES[name] for name in ("policy", "still")}, {}, "it has no time")
    assert (beaten.winner, beaten.unbeaten) == ("policy", ())
    assert beaten.sentences == (
        "No planner: it has no time.",
        "The policy leads every heuristic clearly, by 2 standard errors or more.",
    )


def test_a_policy_that_is_better_with_assigned_targets_is_named():
    better = {"policy+greedy": POLICY + 0.5 + RNG.normal(0.0, 0.1, 40), "policy+auction": POLICY + 0.1}
    found = verdict_of(PAPER, {**SCORES, **better}, PLANNED)
    assert [row.method for row in found.rows[:3]] == ["policy", "policy+greedy", "policy+auction"]
    assert [row.kind for row in found.rows[:4]] == ["policy"] * 3 + ["heuristic"]
    assert found.sentences[0].startswith("With assigned targets the policy is better: policy+greedy, by 0.5")
    for same in (POLICY - 0.5, POLICY):
        assert verdict_of(PAPER, {**SCORES, "policy+greedy": same}, PLANNED).sentences[0].startswith("The policy")
    unclear = {"policy+hungarian": POLICY + RNG.normal(2.0, 20.0, 40)}
    found = verdict_of(PAPER, {**SCORES, **better, **unclear}, PLANNED)
    assert found.sentences[0].startswith("With assigned targets the policy is better: policy+greedy")


def test_equal_scores_are_not_beaten():
    found = verdict_of(PAPER, {"policy": POLICY, "twin": POLICY}, {})
    assert (found.winner, found.unbeaten) == ("policy", ("twin",))
    single = verdict_of(PAPER, {"policy": POLICY[:1], "still": POLICY[:1] - 1.0}, {})
    assert (single.rows[0].se, single.rows[1].difference_se) == (0.0, 0.0)


@pytest.mark.parametrize("objective", ["terminal", "mean", "seen"])
def test_the_table_fits_80_columns(objective: str):
    found = replace(verdict_of(PAPER, {**SCORES, "a-long-heuristic": -999 * POLICY}, PLANNED), objective=objective)
    lines = repr(found).splitlines()
    assert max(map(len, lines)) <= 80
    digits = 3 if objective == "seen" else 2
    assert any(f"{POLICY.mean():.{digits}f} ± {stats.sem(POLICY):.{digits}f}" in line for line in lines)
    assert "<p>The policy has no clear lead" in found._repr_html_()


def test_a_file_of_a_verdict(tmp_path):
    found = verdict_of(PAPER, SCORES, PLANNED)
    assert read_verdict(tmp_path) is None
    write_verdict(tmp_path, found)
    assert read_verdict(tmp_path) == found
    check_contract("verdict", tmp_path / VERDICT)
    text = (tmp_path / VERDICT).read_text()
    (tmp_path / VERDICT).write_text(text.replace('"rows"', '"lines"').replace('"digest"', '"digits"'))
    with pytest.raises(ValueError, match=r"verdict\.json: rows: is missing"):
        read_verdict(tmp_path)
    (tmp_path / VERDICT).write_text(text.replace('"method": "policy"', '"method": 3').replace('"digest"', '"digits"'))
    with pytest.raises(ValueError, match=r"verdict\.json: rows\[0\]\.method = 3: expected a text"):
        read_verdict(tmp_path)
    with pytest.raises(ValueError, match="rows: expected at least one, and the policy first"):
        replace(found, rows=found.rows[1:])


def with_steps(steps: int, most: int) -> Experiment:
    scenes = SceneSettings(targets_max=most, steps=steps)
    return replace(PAPER, scenario=replace(PAPER.scenario, scenes=scenes))


def test_a_long_horizon_has_a_smaller_planner():
    assert planner_size(with_steps(10, 4))[0] == 16
    assert planner_size(with_steps(10, 4))[1].starts == 16
    sizes = [planner_size(with_steps(steps, 20)) for steps in (10, 100, 1000)]
    work = [episodes * settings.starts for episodes, settings in sizes]
    assert work == sorted(work, reverse=True)
    assert work[0] > work[2]
    assert min(episodes for episodes, _ in sizes) >= 4


def test_long_episodes_are_fewer():
    assert [judged_episodes(with_steps(steps, 5)) for steps in (10, 200, 400, 1000)] == [128, 100, 50, 32]


TINY = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=3, drift_m_s=(0.1, 0.1))),
    policy=AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)),
)


def untrained(run, experiment: Experiment):
    (run / BEST).parent.mkdir(parents=True)
    write_config(run, experiment)
    policy = experiment.policy.policy(experiment.scenario.problem(), jax.random.key(0))
    save_tree(run / BEST, policy, experiment, "policy", {})
    return run


@pytest.mark.slow
def test_a_run_is_judged_beside_all_methods(tmp_path, monkeypatch):
    monkeypatch.setattr(verdicts, "EPISODES", 12)
    monkeypatch.setattr(verdicts, "PLANNER_SIZES", ((4, 2),))
    run = untrained(tmp_path / "run", TINY)
    found = judge_run(run, quiet=True)
    assert found == read_verdict(run)
    assert [row.method for row in found.rows][:: len(HEURISTICS) + 1] == ["policy", "icr-2"]
    assert {row.method for row in found.rows if row.kind == "heuristic"} == set(HEURISTICS)
    assert [row.episodes for row in found.rows] == [12] * (1 + len(HEURISTICS)) + [4]
    assert found == judge_run(run, quiet=True), "the same episodes and noise every time"


def test_a_scenario_with_a_schedule_is_judged_without_a_planner(tmp_path, monkeypatch):
    monkeypatch.setattr(verdicts, "EPISODES", 3)
    scenario = replace(TINY.scenario, schedule=ScheduleSettings(tau_s=(1.0, 0.5)))
    found = judge_run(untrained(tmp_path / "run", replace(TINY, scenario=scenario)), quiet=True)
    assert [row.kind for row in found.rows] == ["policy"] + ["heuristic"] * len(HEURISTICS)
    assert found.no_planner.startswith("the scenario has a schedule")
    assert found.sentences[0].startswith("No planner: the scenario has a schedule")
