"""Measure what the dynamic window costs: in simulated episodes, in a network that proposes its command, and in a file.

python experiments/window_cost.py
"""

import time
from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np
import onnxruntime

from foveate.deploy.onnx.export import to_onnx
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import QUADROTOR
from foveate.planning.named import heuristic_in
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE, Policy
from foveate.simulation.rollout import rollout

EPISODES, TARGETS, REPEATS = 128, 8, 7
PLAIN, WINDOW = PointerSettings(), PointerSettings(dynamic_window=True)


def median_s(work: Callable[[], object], clock: Callable[[], float]) -> float:
    """Median time of some repeats after one that is not counted."""
    work()
    times = []
    for _ in range(REPEATS):
        began = clock()
        work()
        times.append(clock() - began)
    return float(np.median(times))


def episodes_s(scenario: Scenario, policy: Policy) -> float:
    """Processor time of a batch of episodes [s]."""
    problem, keys = scenario.problem(), jax.random.split(jax.random.key(0), EPISODES)

    @eqx.filter_jit
    def play(keys):
        def one(key):
            return rollout(problem, policy, training_episode(problem, scenario.scenes, key, noise=True), TRUE, key)

        return jax.vmap(one)(keys)

    return median_s(lambda: jax.block_until_ready(play(keys)), time.process_time)


def file_of(scenario: Scenario, settings: PointerSettings) -> tuple[float, float]:
    """Time to export an untrained network, and to decide about some targets, one at a time [s]."""
    began, problem = time.perf_counter(), scenario.problem()
    model = to_onnx(Experiment(scenario=scenario, policy=settings), settings.policy(problem, jax.random.key(0)))
    export_s = time.perf_counter() - began
    options, rng, n_y = onnxruntime.SessionOptions(), np.random.default_rng(0), problem.motion.state_size
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model.SerializeToString(), options)
    given = {
        "pose": np.asarray(problem.agent.space.identity(), np.float32)[None],
        "mean": rng.uniform(-6, 6, (1, TARGETS, n_y)).astype(np.float32),
        "information": np.tile(np.eye(n_y, dtype=np.float32), (1, TARGETS, 1, 1)),
        "present": np.ones((1, TARGETS), bool),
        "known_input": np.zeros((1, TARGETS, problem.motion.input_size), np.float32),
        "steps_left": np.array([9]),
    }
    given = {each.name: given[each.name] for each in session.get_inputs()}
    return export_s, median_s(lambda: session.run(None, given), time.perf_counter)


def main() -> None:
    """Print the times."""
    paper = Scenario()
    policies = {
        "network": PLAIN.policy(paper.problem(), jax.random.key(0)),
        "network with the window": WINDOW.policy(paper.problem(), jax.random.key(0)),
        "heuristic window": heuristic_in(paper, "window"),
    }
    for name, policy in policies.items():
        print(f"{EPISODES} episodes, {name}: {episodes_s(paper, policy):.2f} s of processor time", flush=True)
    for place, scenario in (("plane", paper), ("space", QUADROTOR)):
        for name, settings in (("network", PLAIN), ("network with the window", WINDOW)):
            export_s, decision_s = file_of(scenario, settings)
            print(f"file, {place}, {name}: export {export_s:.1f} s, decision {1e3 * decision_s:.2f} ms", flush=True)


if __name__ == "__main__":
    main()
