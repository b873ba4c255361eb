"""Heuristics and planners on beliefs of one's own: they decide, step by step, as in a simulation."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers.episodes import training_episode
from helpers.rejections import assert_rejected

import foveate
from foveate.names import HEURISTICS
from foveate.planning.named import heuristic_policy
from foveate.planning.receding import Receding
from foveate.planning.shooting import ONLINE
from foveate.simulation.records import TRUE
from foveate.simulation.rollout import rollout

SCENARIO = foveate.Scenario(scenes=foveate.SceneSettings(targets_min=2, targets_max=8, steps=5))
"""Padded to 8 targets, as decisions are."""
NOW = foveate.Belief([[3.0, 1.0], [-2.0, 4.0]], covariance=[0.2 * np.eye(2), 1.5 * np.eye(2)])


def check_as_simulated(policy: foveate.RobotPolicy, seed: int = 3) -> int | None:
    """Compare commands on the beliefs of an episode, with its known inputs, with those of the episode, twice.

    Returns the number of its map.
    """
    problem, key = policy.problem, jax.random.key(seed)
    episode = training_episode(problem, policy.scenario.scenes, key, True)
    trace = jax.jit(lambda episode, key: rollout(problem, policy.network, episode, TRUE, key))(
        episode, jax.random.key(policy.seed)
    )
    expected = np.asarray(jax.vmap(problem.agent.control)(trace.action))
    number = None if episode.map_number is None else int(episode.map_number)
    for _ in range(2):
        for k, right in enumerate(expected):
            now = foveate.Belief(trace.mean[k], information=trace.information[k], present=trace.present[k])
            coming = policy.predict(now, episode.inputs[k], k)
            command = policy(coming, trace.pose[k], len(expected) - k, map_number=number)
            np.testing.assert_allclose(command, right, rtol=0, atol=1e-5)
        policy.reset()
    assert policy.name == "still" or np.ptp(expected, axis=0).max() > 1e-3, "decisions must differ"
    return number


@pytest.mark.parametrize("name", HEURISTICS)
def test_a_heuristic_decides_as_in_the_simulation(name: str):
    policy = foveate.heuristic(name, SCENARIO, seed=4)
    assert policy.axes == ("vx", "wz")
    check_as_simulated(policy)


@pytest.mark.parametrize("name", HEURISTICS)
def test_padding_does_not_matter(name: str):
    """Padding is at the origin, straight ahead and soon in view."""
    policy, pose = foveate.heuristic(name, SCENARIO), [-3.0, 0.0, 0.0]
    plain = policy(NOW, pose)
    policy.reset()
    np.testing.assert_allclose(policy(NOW.padded(20), pose), plain, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_planner_decides_as_in_the_simulation():
    """With the memory of its last plan, and of the inputs so far."""
    policy = foveate.planner(SCENARIO, starts=2, iterations=3, window=4)
    settings = replace(ONLINE["true"], starts=2, iterations=3)
    expected = Receding(problem=SCENARIO.problem(), settings=settings, window=4)
    assert isinstance(policy.network, Receding)
    assert (policy.network.settings, policy.network.window, policy.name) == (settings, 4, "icr-2")
    assert jax.tree.structure(policy.network) == jax.tree.structure(expected)
    check_as_simulated(policy)
    assert foveate.planner(SCENARIO).network.window == 5, "of the longest episode"


@pytest.mark.slow
def test_a_planner_refines_a_policy():
    """Without ascent: its actions are the policy's."""
    trained = foveate.load("paper")
    policy = foveate.planner(trained, refine=1, window=2)
    policy = replace(
        policy, network=replace(policy.network, settings=replace(policy.network.settings, iterations=0, starts=1))
    )
    assert policy.name == "refine-1"
    np.testing.assert_allclose(policy(NOW, [0, 0, 0]), trained(NOW, [0, 0, 0]), atol=1e-5)


def test_a_heuristic_is_taken_in_place_of_a_trained_policy():
    scene = foveate.Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((3.0, 1.0),), drift=((0.0, 0.0),), horizon=3)
    options = {"protocol": "true", "progress": False}
    found = foveate.evaluate(foveate.heuristic("nearest", SCENARIO), [scene], **options)
    network = heuristic_policy("nearest", SCENARIO.problem(), 2.0)
    expected = foveate.evaluate(network, [scene], scenario=SCENARIO, **options)
    assert [row.score for row in found.rows] == [row.score for row in expected.rows]


def test_a_policy_says_that_it_runs_at_another_period():
    policy, tracker = foveate.heuristic("nearest", SCENARIO), foveate.Tracker(SCENARIO)
    tracker.add("a", [3.0, 1.0])
    for dt_s in (None, SCENARIO.tau_s, 1.1 * SCENARIO.tau_s):
        tracker.predict(dt_s)
        policy(tracker.belief(), [0.0, 0.0, 0.0])  # any warning fails the test
    tracker.predict(0.3 * SCENARIO.tau_s)
    with pytest.warns(UserWarning, match=r"nearest: decides for a step of .* predicted over"):
        policy(tracker.belief(), [0.0, 0.0, 0.0])


def test_sources_and_words(tmp_path: Path):
    policy = foveate.heuristic("lawnmower", "quadrotor", box=[[0, 0, 1], [4, 4, 2]])
    assert repr(policy) == (
        "RobotPolicy('lawnmower': quadrotor, frustum view of 6 m, a command [vx, vy, vz, wz] every 0.5 s)"
    )
    (tmp_path / "own.toml").write_text("[scenario]\ntau_s = 0.25\n")
    assert foveate.heuristic("post", tmp_path / "own.toml").scenario.tau_s == 0.25
    assert foveate.planner("paper").scenario == foveate.PRESETS["paper"].scenario


def test_the_box_is_that_of_the_sweep():
    policy = foveate.heuristic("lawnmower", SCENARIO, box=[[10, 10], [20, 20]])
    v, w = policy(NOW, [0.0, 0.0, np.pi / 4])
    assert v > 3.9, "to the first corner, straight ahead"
    assert abs(w) < 0.6


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: foveate.heuristic("nearst", SCENARIO), "method 'nearst': expected one of random, still"),
        (lambda: foveate.heuristic("policy", SCENARIO), "method 'policy': expected one of random, still"),
        (lambda: foveate.heuristic("post", "nobody"), r"nobody: expected a preset"),
        (lambda: foveate.heuristic("post", SCENARIO, box=[[0, 0]]), r"box = \[\[0.0, 0.0\]\]: expected the low and"),
        (lambda: foveate.heuristic("post", SCENARIO, box=[[0, 2], [1, 1]]), "box = .*: expected the low and"),
        (lambda: foveate.heuristic("random", SCENARIO, seed=-1), "seed -1: expected"),
        (lambda: foveate.planner(SCENARIO, starts=0), "starts 0: expected >= 1"),
        (lambda: foveate.planner(SCENARIO, refine=5), "refine = 5: expected a policy"),
        (lambda: foveate.planner("nobody", refine=5), "nobody: no such run folder"),
        (lambda: foveate.heuristic("nearest", SCENARIO)(NOW, [0, 0]), "pose = "),
        (lambda: foveate.heuristic("nearest", SCENARIO)(NOW, [0, 0, 0], 0), "steps_left = 0: expected"),
    ],
)
def test_errors_name_the_argument(call, complaint: str):
    with pytest.raises(foveate.InputError, match=complaint):
        call()


def test_a_decision_is_in_the_map_of_the_robot():
    rooms = foveate.RoomObstacles(maps=4, test_maps=0)
    scenes = replace(SCENARIO.scenes, centre_m=(8.0, 8.0), half_side_per_target_m=0.0, half_side_m=(6.0, 6.0))
    policy = foveate.heuristic("nearest", replace(SCENARIO, obstacles=rooms, scenes=scenes))
    assert check_as_simulated(policy) != 0, "the first map is that of a policy that is not told"
    for wrong in (4, -1):
        with pytest.raises(foveate.InputError, match=f"map_number = {wrong}: expected 0 to 3, a map of the scenario"):
            policy(NOW, [8.0, 8.0, 0.0], map_number=wrong)
    with pytest.raises(foveate.InputError, match="map_number = 0: expected None without obstacles"):
        foveate.heuristic("nearest", SCENARIO)(NOW, [0.0, 0.0, 0.0], map_number=0)


def test_every_robot_of_a_team_has_a_policy_of_its_own():
    """The heuristic of a robot of a team decides as that of its own scenario; that of all robots decides for none."""
    far = foveate.RobotSettings(view=foveate.TriangleView(depth_m=6.0), agent=foveate.DifferentialDrive(v_max_m_s=1.0))
    team = replace(SCENARIO, team=foveate.TeamSettings(agents=3, robots=(foveate.RobotSettings(), far)))
    policy, pose = foveate.heuristic("window", team), [-3.0, 0.0, 0.0]
    commands = []
    for number in range(3):
        own, alone = policy.for_robot(number), foveate.heuristic("window", team.of_robot(number))
        commands.append(own(NOW, pose))
        np.testing.assert_allclose(commands[-1], alone(NOW, pose), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(commands[0], commands[2])
    assert np.abs(commands[0] - commands[1]).max() > 0.1
    assert_rejected(lambda: policy(NOW, pose), "scenario.team.robots: expected the scenario of one robot")
    assert_rejected(lambda: foveate.Tracker(team), "scenario.team.robots: expected the scenario of one robot")
    assert_rejected(lambda: policy.for_robot(3), "robot = 3: expected 0 to 2")
