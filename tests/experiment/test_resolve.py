"""A policy in another scenario: for another robot, by `NAME@SOURCE`, and as the beginning of a training."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import foveate
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.experiment.presets import ACTOR_CRITIC, PAN, PRESETS, QUADROTOR, for_scenario
from foveate.experiment.resolve import in_scenario, scenes_of, subject_of
from foveate.io.toml import save_toml
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

SMALL = PointerSettings(kind="pointer", target_widths=(8,), heads=2, context_widths=(8,), mode_width=8)
FOR_ANY = Experiment(policy=SMALL, training=replace(ACTOR_CRITIC, worlds="random"))
LONG = replace(PAN, scenes=replace(PAN.scenes, steps=200))
BELIEF = foveate.Belief([[3.0, 4.0, 0.0, 0.0]], covariance=np.eye(4))


def made(experiment: Experiment, seed: int = 0) -> foveate.TrainedPolicy:
    network = experiment.new_policy(jax.random.key(seed))
    return foveate.TrainedPolicy(name="made", experiment=experiment, network=network, facts={})


def test_a_policy_decides_for_another_robot_of_its_space():
    """A vehicle's network turns a camera, which has no other axis, towards the only target: to the left."""
    policy = made(FOR_ANY).for_scenario(PAN)
    assert policy.axes == ("wz",)
    assert policy(BELIEF, [0.0, 0.0, 0.0]) == pytest.approx([1.0], abs=0.1)
    with pytest.raises(InputError, match="scenario: has 3 dimensions: expected 2 dimensions"):
        made(FOR_ANY).for_scenario(QUADROTOR)


@pytest.mark.parametrize(
    ("scenario", "objective", "expected"),
    [(PAN, None, ("terminal", True)), (LONG, None, ("mean", False)), (LONG, "seen", ("seen", False))],
)
def test_a_policy_for_any_robot_is_told_what_for(scenario, objective, expected):
    network = made(FOR_ANY).for_scenario(scenario, objective).network
    assert (network.objective, network.tells_time) == expected


def test_a_policy_of_one_robot_keeps_its_objective():
    one = replace(FOR_ANY, training=replace(ACTOR_CRITIC, objective="seen"))
    assert made(one).for_scenario(LONG).network.objective == "seen"
    with pytest.raises(InputError, match="states of 4 numbers and 1 of a command: expected 2 dimensions, states of 2"):
        in_scenario(PRESETS["paper"], PAN)


def test_a_name_at_a_file_is_the_policy_in_its_scenario(tmp_path):
    made(FOR_ANY).save(tmp_path / "run")
    experiment = Experiment(scenario=LONG, policy=SMALL, training=replace(ACTOR_CRITIC, objective="seen"))
    save_toml(experiment, tmp_path / "camera.toml", "A camera.")
    name = f"{tmp_path / 'run'}@{tmp_path / 'camera.toml'}"
    policy = foveate.load(name)
    assert policy.scenario == LONG
    assert (policy.network.objective, policy.network.tells_time) == ("seen", False)
    assert policy(BELIEF, [0.0, 0.0, 0.0]) == pytest.approx([1.0], abs=0.1)
    subject = subject_of(name)
    assert (subject.experiment, subject.objective) == (policy.experiment, "seen")
    with pytest.raises(InputError, match=r"nothing\.toml"):
        foveate.load(f"{tmp_path / 'run'}@nothing.toml")


def test_an_evaluation_in_another_scenario_tells_the_policy_so():
    network = subject_of(made(FOR_ANY), LONG).network()
    assert (network.objective, network.tells_time) == ("mean", False)


def test_a_scenario_is_trained_like_any_from_its_weights():
    experiment = for_scenario(Scenario(scenes=SceneSettings(targets_max=4)), "any")
    assert experiment.begins_with == "any"
    assert isinstance(experiment.training, ActorCriticSettings)
    assert experiment.training.epochs < ACTOR_CRITIC.epochs
    assert experiment.training.worlds == "own"


ELSEWHERE = replace(PAN, scenes=replace(PAN.scenes, targets_max=5))


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [
        (PRESETS["true-view"].scenario, "table1"),
        (PRESETS["search"].scenario, "table1"),  # only its first beliefs differ
        (Scenario(view=SectorView(depth_m=5.0)), "table1"),
        (PAN, "own"),
        (ELSEWHERE, "own"),
        (QUADROTOR, "own"),
        (PRESETS["rooms"].scenario, "own"),
    ],
)
def test_scenes_are_those_of_the_scenario_unless_they_are_the_papers(scenario, expected):
    name, scenes = scenes_of(None, 2023, Experiment(scenario=scenario))
    assert name == expected
    if expected == "own" and scenario.dimension == 2:
        assert max(len(scene.targets) for scene in scenes) == scenario.scenes.targets_max
