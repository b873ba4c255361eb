"""Measure teams: in scalableMARL's world, of different kinds, the consistency of fused beliefs, and what a step costs.

    JAX_ENABLE_X64=1 python experiments/teams.py [--agents 4] [--radios always lossy never] [--run RUN] [--episodes 20]
    JAX_ENABLE_X64=1 python experiments/teams.py --kinds [--radios always never] [--run any] [--episodes 100]
    JAX_ENABLE_X64=1 python experiments/teams.py --consistency
    python experiments/teams.py --cost

The first form plays `benchmarks/worlds/set-tracking.toml` with as many robots as targets, and scores it as published:
the sum over 200 steps of the mean log det of the information, of all measurements and of the worst robot's own beliefs.
`NAME@DEPTH` is a heuristic that stops at half of this depth [m]. `lossy`: a range of 15 m, half of the messages lost.
The second has the mean log det of all measurements over the steps of `examples/scouts.toml`, of its team of two kinds,
and of teams of either kind alone. The third has the NEES of every robot's own beliefs after 30 steps of 1,000 episodes
with linear measurements, also of robots whose sensors differ. The fourth times a step of a team over that of one robot,
batched, with the heuristic `nearest`.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

import foveate
from foveate.evaluation.metrics import chi_square_band
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import load
from foveate.io.toml import load_toml
from foveate.planning.named import assigned_in, heuristic_in, heuristic_policy
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import VelocityTarget
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE, Policy, Trace
from foveate.simulation.rollout import rollout

WORLD = Path(__file__).parents[1] / "benchmarks" / "worlds" / "set-tracking.toml"
SCOUTS = Path(__file__).parents[1] / "examples" / "scouts.toml"
YARD_M = 25.5
RADIOS = {
    "always": RadioSettings(),
    "lossy": RadioSettings(range_m=15.0, loss=0.5),
    "never": RadioSettings(loss=1.0),
}
KINDS_METHODS = ("window", "uncertain", "uncertain+greedy", "uncertain+hungarian", "uncertain+auction")
METHODS = ("uncertain", "uncertain+greedy", "uncertain@4+greedy", "uncertain@4+hungarian", "uncertain@4+auction")
PLAIN = Scenario(
    tau_s=0.5,
    view=SectorView(depth_m=6.0, angle_deg=120.0),
    sensor=SensorSettings(std_m=0.3),
    target=VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.1, initial_velocity_variance_m2_s2=0.2),
    scenes=SceneSettings(
        targets_min=2, targets_max=2, half_side_m=(5.0, 5.0), half_side_per_target_m=0.0, drift_m_s=(0.3, 0.3),
        steps=30, initial_error="consistent",
    ),
)  # fmt: skip
CONSISTENCY = {
    "always": RadioSettings(),
    "range 6 m, half lost, memory of 8": RadioSettings(range_m=6.0, loss=0.5),
    "range 6 m, half lost, memory of 2": RadioSettings(range_m=6.0, loss=0.5, memory_steps=2),
    "range 6 m, 70 % lost, memory of 1": RadioSettings(range_m=6.0, loss=0.7, memory_steps=1),
    "range 6 m, half lost, 3 steps late": RadioSettings(range_m=6.0, loss=0.5, delay_steps=3, memory_steps=4),
    "never": RadioSettings(loss=1.0),
}


def world(agents: int, radio: RadioSettings) -> Scenario:
    """scalableMARL's world with as many targets as robots."""
    scenario = load_toml(Experiment, WORLD).scenario
    team = TeamSettings(agents=agents, half_side_m=(YARD_M, YARD_M), radio=radio)
    return replace(scenario, team=team, scenes=replace(scenario.scenes, targets_min=agents, targets_max=agents))


def play(scenario: Scenario, policy: Policy, episodes: int, seed: int) -> Trace:
    """Traces of episodes, as numpy arrays."""
    problem = scenario.problem()

    def run(key):
        return rollout(problem, policy, training_episode(problem, scenario.scenes, key, True, True), TRUE, key)

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(seed), episodes)))


def scores(options: argparse.Namespace) -> None:
    """The table of the published world."""
    methods = [*options.methods, *(["policy", "policy+greedy"] if options.run else [])]
    for radio in options.radios:
        scenario = world(options.agents, RADIOS[radio])
        for method in methods:
            name, _, rule = method.partition("+")
            name, _, depth = name.partition("@")
            depth_m = float(depth or scenario.view.depth_m)
            policy = load(options.run)[1] if name == "policy" else heuristic_policy(name, scenario.problem(), depth_m)
            policy = assigned_in(scenario, policy, rule) if rule else policy
            trace = play(scenario, policy, options.episodes, options.seed)
            total = trace.log_det.mean(axis=2).sum(axis=1)
            worst = trace.team.log_det.mean(axis=3).sum(axis=1).min(axis=1)
            error = total.std(ddof=1) / len(total) ** 0.5
            print(
                f"{options.agents} robots, {radio}, {method}: {total.mean():.0f} +- {error:.0f} "
                f"({total.min():.0f} .. {total.max():.0f}), worst robot {worst.mean():.0f}, "
                f"in view {trace.visible.mean():.0%}",
                flush=True,
            )


def kinds(options: argparse.Namespace) -> None:
    """The table of a team of two kinds, beside teams of robots that are alike."""
    mixed = load_toml(Experiment, SCOUTS).scenario
    teams = {"both kinds": mixed, "quick ones alone": mixed.of_robot(0), "slow ones alone": mixed.of_robot(1)}
    for radio in options.radios:
        for name, scenario in teams.items():
            assert scenario.team is not None, "of a team's file"
            scenario = replace(scenario, team=replace(scenario.team, radio=RADIOS[radio]))
            for method in [*KINDS_METHODS, *(["policy", "policy+hungarian"] if options.run else [])]:
                policy_name, _, rule = method.partition("+")
                if policy_name == "policy":
                    policy = foveate.load(options.run).for_scenario(scenario).network
                else:
                    policy = heuristic_in(scenario, policy_name)
                policy = assigned_in(scenario, policy, rule) if rule else policy
                trace = play(scenario, policy, options.episodes, options.seed)
                total, own = trace.log_det.mean(axis=(1, 2)), trace.team.visible.mean(axis=(0, 1, 3))
                print(
                    f"{radio}, {name}, {method}: {total.mean():.2f} +- {total.std(ddof=1) / len(total) ** 0.5:.2f}, "
                    f"in view {trace.visible.mean():.0%}, by each robot {', '.join(f'{share:.0%}' for share in own)}",
                    flush=True,
                )


def consistency() -> None:
    """NEES of the robots' own beliefs under every kind of radio, and with sensors that differ."""
    stds_m = (0.3, 0.1, 0.9)
    robots = tuple(RobotSettings(sensor=SensorSettings(std_m=std_m)) for std_m in stds_m)
    cases = [(name, radio, None) for name, radio in CONSISTENCY.items()]
    different = [(f"{name}, std {stds_m} m", radio, robots) for name, radio in list(CONSISTENCY.items())[:3]]
    for name, radio, robots in [*cases, *different]:
        scenario = replace(PLAIN, team=TeamSettings(agents=3, radio=radio, robots=robots))
        trace = play(scenario, heuristic_policy("nearest", scenario.problem(), 6.0), 1000, 5)
        each = trace.team.nees[:, -1].mean(axis=(1, 2))
        low, high = chi_square_band(4, 2000)
        print(
            f"{name}: NEES {each.mean():.2f} +- {each.std() / 1000**0.5:.2f} (4 is right; {low:.2f} .. {high:.2f}), "
            f"log det {trace.team.log_det[:, -1].mean():.2f} of {trace.log_det[:, -1].mean():.2f}",
            flush=True,
        )


def cost() -> None:
    """Time of a step of 4 robots over that of one, in a batch of 256 episodes of 100 steps with 4 targets."""
    scenes = replace(PLAIN.scenes, targets_min=4, targets_max=4, steps=100)
    teams = {"one": None, **{name: TeamSettings(agents=4, radio=radio) for name, radio in RADIOS.items()}}
    programs = {}
    for name, team in teams.items():
        scenario = replace(PLAIN, scenes=scenes, team=team)
        problem, policy = scenario.problem(), heuristic_policy("nearest", scenario.problem(), 6.0)

        def score(episode, key, problem=problem, policy=policy):
            return rollout(problem, policy, episode, TRUE, key).log_det[-1].mean()

        keys = jax.random.split(jax.random.key(0), 256)
        make = jax.jit(jax.vmap(lambda key, p=problem, s=scenes: training_episode(p, s, key, True)))
        program, arguments = jax.jit(jax.vmap(score)), (make(keys), keys)
        program(*arguments).block_until_ready()
        programs[name] = program, arguments
    times = {name: [] for name in programs}
    for _ in range(15):
        for name, (program, arguments) in programs.items():
            start = time.process_time()
            program(*arguments).block_until_ready()
            times[name].append(time.process_time() - start)
    for name, each in times.items():
        median = np.median(each)
        print(f"{name}: median {median:.3f} s, {median / np.median(times['one']):.2f} times that of one robot")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", type=int, default=4)
    parser.add_argument("--radios", nargs="+", default=list(RADIOS))
    parser.add_argument("--methods", nargs="*", default=list(METHODS))
    parser.add_argument("--run")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", action="store_true")
    parser.add_argument("--consistency", action="store_true")
    parser.add_argument("--cost", action="store_true")
    options = parser.parse_args()
    if options.cost:
        cost()
    elif options.kinds:
        kinds(options)
    elif options.consistency:
        consistency()
    else:
        scores(options)
