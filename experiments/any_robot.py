"""Compare the policy for any robot with every heuristic, for random robots that did not train it.

    python experiments/any_robot.py [RUN] [--robots 14] [--episodes 16] [--seed 1]
    python experiments/any_robot.py [RUN] --factors [--episodes 64]

The second form changes the paper's robot in one thing at a time. The first prints for each world of
`foveate.learning.worlds`, over so many robots: the mean score of the policy and of each heuristic by the world's
objective, with the same scenes and noise for all, and the mean of the policy's lead over the best heuristic *of each
robot*.
"""

import argparse
import warnings
from dataclasses import fields, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from jaxtyping import Key as Keys

from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import ACTOR_CRITIC
from foveate.experiment.resolve import load
from foveate.learning.devices import use_cores
from foveate.learning.learner import objective_score
from foveate.learning.worlds import World, informed, worlds_of
from foveate.names import HEURISTICS
from foveate.planning.named import heuristic_policy
from foveate.policies.pointer import PointerPolicy
from foveate.scenario.scenario import Scenario
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE
from foveate.simulation.robots import RobotFactors, RobotRanges, draw_robot, with_robot
from foveate.simulation.rollout import rollout

RANDOM = replace(ACTOR_CRITIC, worlds="random")


METHODS = [name for name in HEURISTICS if name not in ("random", "still")]
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
ANGLES_DEG = (30.0, 60.0, 90.0, 120.0, 150.0)


def scores(
    world: World, policy: PointerPolicy, method: str, robots: RobotFactors, keys: Keys[Array, "robots e"]
) -> np.ndarray:
    """Scores (robots, episodes) of a method, or of the policy, for a batch of robots."""
    policy = informed(policy, world, RANDOM)

    def play(robot, key):
        problem = with_robot(world.problem, robot)
        decides = policy
        if method != "policy":
            decides = heuristic_policy(method, problem, problem.sensor.view.extent.ahead_m)
        scene_key, policy_key = jax.random.split(key)
        episode = training_episode(problem, world.scenes, scene_key, noise=True, test=True)
        return objective_score(rollout(problem, decides, episode, TRUE, policy_key), episode, world.objective)

    return np.asarray(eqx.filter_jit(jax.vmap(jax.vmap(play, (None, 0))))(robots, keys))


def one_factor_at_a_time(policy: PointerPolicy, episodes: int, seed: int) -> None:
    """Print a row for each value of each factor, in the paper's world with 3 to 8 targets, and with 20."""
    paper = Scenario()
    plain = dict.fromkeys((field.name for field in fields(RobotRanges)), 1.0)
    plain |= {"reverse": 0.0, "angle_deg": float(paper.view.angle_deg)}
    varied = [("depth", "speed", "turn", "sensor_std", "process_std"), FACTORS]
    rows = [(name, value) for name in varied[0] for value in varied[1]] + [("angle_deg", x) for x in ANGLES_DEG]
    numbers = [{**plain, name: value} for name, value in rows]
    robots = RobotFactors(**{name: jnp.array([each[name] for each in numbers]) for name in plain})
    crowd = replace(paper.scenes, targets_min=20, targets_max=20)
    one = jax.tree.map(lambda x: x[:1], RobotFactors(**{name: jnp.array([value]) for name, value in plain.items()}))
    for scenes, batch, labels in ((paper.scenes, robots, rows), (crowd, one, [("targets", 20)])):
        world = World(problem=paper.problem(), scenes=scenes, objective="terminal", robots=RobotRanges())
        # The same scenes for all values.
        keys = jax.random.split(jax.random.key(seed), (1, episodes))
        keys = jax.random.wrap_key_data(jnp.repeat(jax.random.key_data(keys), len(labels), axis=0))
        found = {name: scores(world, policy, name, batch, keys) for name in ("policy", *METHODS)}
        means = np.array([found[name].mean(axis=1) for name in METHODS])
        for i, (name, value) in enumerate(labels):
            best = METHODS[int(means[:, i].argmax())]
            lead = found["policy"][i] - found[best][i]
            numbers = f"{found['policy'][i].mean():.2f} | {best} {means[:, i].max():.2f}"
            print(f"{name} {value:g} | {numbers} | {lead.mean():+.2f} +- {lead.std(ddof=1) / np.sqrt(len(lead)):.2f}")


def main() -> None:
    """Print a row for each world, or each value of a factor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", nargs="?", default="any")
    parser.add_argument("--robots", type=int, default=14)
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--factors", action="store_true")
    options = parser.parse_args()
    use_cores()
    # A depth that is drawn stands where a number is expected.
    warnings.filterwarnings("ignore", "A JAX array is being set as static")
    policy = load(options.run)[1]
    assert isinstance(policy, PointerPolicy), "a run of the actor-critic"
    if options.factors:
        one_factor_at_a_time(policy, options.episodes, options.seed)
        return
    leads = {"nat": [], "seen": []}
    print("world", "objective", "policy", *METHODS, "lead over the best of each robot", sep=" | ")
    for i, world in enumerate(worlds_of(Experiment(training=RANDOM))):
        robot_key, key = jax.random.split(jax.random.key(options.seed + 10 * i))
        robots = jax.vmap(lambda key: draw_robot(RobotRanges(), key))(jax.random.split(robot_key, options.robots))
        keys = jax.random.split(key, (options.robots, options.episodes))
        found = {name: scores(world, policy, name, robots, keys) for name in ("policy", *METHODS)}
        means = {name: each.mean(axis=1) for name, each in found.items()}
        lead = means["policy"] - np.max([means[name] for name in METHODS], axis=0)
        leads["seen" if world.objective == "seen" else "nat"].append(lead)
        error = lead.std(ddof=1) / np.sqrt(len(lead))
        numbers = [f"{each.mean():.2f}" for each in means.values()]
        wins = f"{(lead > 0).sum()} of {len(lead)}"
        print(i, world.objective, *numbers, f"{lead.mean():+.3f} +- {error:.3f}, {wins}", sep=" | ", flush=True)
    for unit, each in leads.items():
        lead = np.concatenate(each)
        error = lead.std(ddof=1) / np.sqrt(len(lead))
        print(f"{len(lead)} robots [{unit}]: {lead.mean():+.3f} +- {error:.3f}, least {lead.min():+.3f}")


if __name__ == "__main__":
    main()
