"""The whole way once: train the paper's policy, evaluate it on the paper's test distribution, draw it.

    make demo            (or: python examples/demo.py)

Leaves config, checkpoint, metrics, table and pictures in runs/demo/.
"""

import shutil
import time
from pathlib import Path

import jax
import numpy as np

from foveate.learning.devices import use_cores

use_cores()  # before anything wakes JAX up

from foveate.cli.common import keep_compiled, print_table
from foveate.evaluation.evaluate import evaluate, prepare, simulate
from foveate.evaluation.summary import summarise, write_result
from foveate.experiment.checkpoint import load_run
from foveate.experiment.presets import PRESETS
from foveate.io.toml import digest
from foveate.learning.loop import METRICS
from foveate.learning.train import train, watched
from foveate.plotting.animation import animate
from foveate.plotting.figures import learning_curve, trajectory_figure
from foveate.simulation.records import PROTOCOLS
from foveate.simulation.suites import table1
from foveate.study.tables import MODEL_BASED, MODEL_FREE

OUT = Path("runs/demo")


def main() -> None:
    """Train, evaluate, draw, and say how long each took."""
    keep_compiled()
    began = time.perf_counter()
    shutil.rmtree(OUT, ignore_errors=True)
    experiment = PRESETS["paper"]
    print(f"training into {OUT}: {experiment.training.epochs} epochs of {experiment.training.episodes} episodes")
    with watched(experiment, str(OUT)) as report:
        outcome = train(experiment, OUT, report=report)
    trained = time.perf_counter()
    print(f"trained in {trained - began:.0f} s, compilation included; held-out score {outcome.best_score:.2f}")

    experiment, policy, _ = load_run(OUT)
    problem = experiment.scenario.problem()
    suite = prepare(problem, experiment.scenario.scenes, table1(problem))
    rows = evaluate(suite, "policy", policy, ("surrogate", "true"))
    summary = summarise(rows, problem.motion.state_size)
    facts = {"run": str(OUT), "scenes": "table1", "experiment": digest(experiment), "seed": suite.seed}
    write_result(OUT / "table1.json", rows, summary, facts)
    _print(summary)

    trace = simulate(suite, policy, PROTOCOLS["surrogate"])  # what the policy was trained for, as in the paper
    films = []
    for targets in (3, 5, 7):
        i = next(i for i, scene in enumerate(suite.scenes) if scene.id == f"biased-{targets}-00")
        scene = suite.scenes[i]
        one = jax.tree.map(lambda x, i=i: x[i], trace)
        title = "biased motion, surrogate score"
        films.append(episode_data(problem, one, np.asarray(suite.truth.state[i]), scene.horizon, targets, title))
    trajectory_figure(films, OUT / "trajectories.png")
    learning_curve([OUT / METRICS], OUT / "learning_curve.png")
    animate(films[1], OUT / "episode.gif")
    print(f"{OUT}: table1.json, trajectories.png, learning_curve.png, episode.gif")
    print(f"done in {time.perf_counter() - began:.0f} s")


def _print(summary) -> None:
    """Our two scores beside the paper's."""
    cells = {(cell.protocol, cell.motion, cell.targets): cell for cell in summary}
    lines = []
    for (motion, targets), (mean, std) in MODEL_BASED.items():
        soft, real = (cells[protocol, motion, targets] for protocol in ("surrogate", "true"))
        ppo = MODEL_FREE[motion, targets]
        lines.append(
            (
                motion,
                f"{targets} targets",
                f"{ppo[0]:.2f} +- {ppo[1]:.2f}",
                f"{mean:.2f} +- {std:.2f}",
                f"{soft.mean:.2f} +- {soft.std:.2f}",
                f"{real.mean:.2f} +- {real.std:.2f}",
                f"{real.seen_fraction:.0%}",
            )
        )
    title = "score per target [nat], 30 scenes a cell: the paper's surrogate score, and the true one of a real filter"
    header = (
        "motion",
        "scene",
        "paper: PPO",
        "paper: model-based",
        "foveate: surrogate",
        "foveate: true",
        "really seen",
    )
    print_table(title, header, lines)


if __name__ == "__main__":
    main()
