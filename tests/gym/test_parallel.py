"""A team through PettingZoo's own tests, and beside the simulation."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.rejections import assert_rejected
from helpers.worlds_of_detections import HALL

pettingzoo = pytest.importorskip("pettingzoo")
from pettingzoo.test import parallel_api_test, parallel_seed_test  # noqa: E402

from foveate.gym.parallel import TeamEnv  # noqa: E402
from foveate.scenario.agent import DifferentialDrive  # noqa: E402
from foveate.scenario.kinds import RobotSettings  # noqa: E402
from foveate.scenario.scenario import Scenario  # noqa: E402
from foveate.scenario.scenes import SceneSettings  # noqa: E402
from foveate.scenario.team import RadioSettings, TeamSettings  # noqa: E402

SCENARIO = Scenario(
    scenes=SceneSettings(targets_min=2, targets_max=3, steps=4),
    team=TeamSettings(agents=3, radio=RadioSettings(range_m=5.0, loss=0.3, memory_steps=2)),
)


@pytest.fixture(scope="module")
def env():
    return TeamEnv(SCENARIO)


def test_the_api_of_pettingzoo(env):
    parallel_api_test(env, num_cycles=10)


def test_a_seed_gives_the_same_episodes():
    parallel_seed_test(lambda: TeamEnv(SCENARIO), num_cycles=4)


def test_rewards_sum_to_the_growth_of_the_score(env):
    """Of robots without a radio a robot's own score is what it began with, until it sees a target."""
    seen, infos = env.reset(seed=3)
    first = infos["robot_0"]["score"]
    assert all(info["score"] == pytest.approx(first) for info in infos.values())
    assert seen["robot_1"]["mates"].shape == (2, 3)
    np.testing.assert_allclose(seen["robot_1"]["mates"][:, 2], 1.0)
    total, steps = 0.0, 0
    while env.agents:
        actions = {name: np.zeros(2, np.float32) for name in env.agents}
        seen, rewards, terminated, truncated, infos = env.step(actions)
        assert len(set(rewards.values())) == 1
        total, steps = total + rewards["robot_0"], steps + 1
    assert steps == 4
    assert all(truncated.values())
    assert not any(terminated.values())
    # What all have measured together is worth at least what any of them knows.
    assert first + total >= max(info["score"] for info in infos.values()) - 1e-4
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_robots_of_different_kinds_move_by_their_own_limits():
    """At full speed ahead each is as far as its own limit allows, as the others see it by an unlimited radio."""
    kinds = tuple(RobotSettings(agent=DifferentialDrive(v_max_m_s=speed)) for speed in (1.0, 4.0))
    scenes = replace(SCENARIO.scenes, agent_half_side_m=(0.0, 0.0), agent_centre_m=(0.0, 0.0))
    env = TeamEnv(replace(SCENARIO, scenes=scenes, team=TeamSettings(agents=3, robots=kinds)))
    env.reset(seed=1)
    ahead = {name: np.array([1.0, 0.0], np.float32) for name in env.agents}
    seen = env.step(ahead)[0]
    depth_m = SCENARIO.view.depth_m
    # All start at one place: robot_0 is 1 m from there along its own axis, and the others 4 m and 1 m along theirs.
    distances = np.linalg.norm(depth_m * seen["robot_0"]["mates"][:, :2] + [1.0, 0.0], axis=-1)
    np.testing.assert_allclose(distances, [4.0, 1.0], atol=1e-5)


def test_what_is_missing_is_said(env):
    env.reset(seed=0)
    assert_rejected(lambda: env.step({"robot_0": np.zeros(2)}), "actions: none for robot_1")
    assert_rejected(lambda: TeamEnv(replace(SCENARIO, team=None)), "scenario.team: expected a team")
    assert_rejected(lambda: TeamEnv(replace(HALL, team=TeamSettings(agents=2))), "scenario.detections: expected none")
