"""Training for GOSPA in a small world without ids, and what is rejected."""

import warnings
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode
from helpers.worlds_of_detections import HALL

import foveate
from foveate.errors import InputError
from foveate.evaluation.verdict import read_verdict
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings, TrainingSettings
from foveate.learning.windows import cut
from foveate.names import HEURISTICS, SEARCHERS
from foveate.policies.pointer_settings import PointerSettings

SMALL = replace(
    HALL, scenes=replace(HALL.scenes, steps=4), detections=replace(HALL.detections, cells=(4, 4), undetected=0.5)
)
LEARNER = ActorCriticSettings(objective="gospa", epochs=1, episodes=8, held_out=4, minibatches=2, check_every=1)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_training_ends_with_the_verdict_on_gospa(tmp_path, monkeypatch):
    monkeypatch.setattr("foveate.evaluation.verdict.EPISODES", 16)
    monkeypatch.setattr("foveate.evaluation.verdict.LEAST_EPISODES", 16)
    experiment = Experiment(scenario=SMALL, policy=PointerSettings(), training=LEARNER)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a policy without a clear lead, which 16 episodes may show or not
        policy = foveate.train(experiment, out=tmp_path / "run", progress=False)
    verdict = read_verdict(tmp_path / "run")
    assert verdict.objective == "gospa"
    assert {row.method for row in verdict.rows if row.kind == "heuristic"} == {*HEURISTICS, *SEARCHERS}
    assert all(-20.0 < row.mean < 0.0 for row in verdict.rows)
    found = foveate.evaluate(policy, scenes="own", progress=False)
    assert all(row.objective == -row.gospa for row in found.rows)


@pytest.mark.parametrize(
    ("scenario", "training", "words"),
    [
        (SMALL, TrainingSettings(), "training.algorithm = 'policy-gradient': expected 'actor-critic'"),
        (SMALL, replace(LEARNER, objective="mean"), "training.objective = 'mean': expected 'gospa' with"),
        (replace(SMALL, detections=None), LEARNER, "training.objective = 'gospa': expected one for targets with ids"),
    ],
)
def test_objective_and_learner_must_fit(scenario, training, words):
    with pytest.raises(InputError) as caught:
        Experiment(scenario=scenario, policy=PointerSettings(), training=training).require_learner()
    assert words in str(caught.value)


def test_a_window_has_its_part_of_the_scans():
    episode = training_episode(SMALL.problem(), SMALL.scenes, jax.random.key(0), noise=True)
    window = eqx.filter_jit(cut)(episode, jnp.array(1), 2)
    np.testing.assert_array_equal(window.scans.alive, episode.scans.alive[1:4])
    np.testing.assert_array_equal(window.scans.detection, episode.scans.detection[1:3])
    np.testing.assert_array_equal(window.scans.order, episode.scans.order[1:3])
    np.testing.assert_array_equal(window.truth.state, episode.truth.state[1:4])
