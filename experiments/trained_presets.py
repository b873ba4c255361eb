"""Train the policies shipped in the package: every preset with seed 0, into src/foveate/experiment/trained/.

    python experiments/trained_presets.py [PRESET ..]

    python experiments/trained_presets.py --judge [PRESET ..]

Each preset takes minutes and replaces an existing one. A policy's folder has its configuration and weights, the verdict
of its training (verdict.json), and record.json: seed, versions and duration of the training, and, for a test to compare
with, the scores on a few scenes in float64. --judge writes verdict and scores again, without a training.
"""

import json
import shutil
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import jax

import foveate
from foveate.api import load, train
from foveate.evaluation.evaluate import Suite, episode_rows, evaluate_traces, prepare
from foveate.evaluation.verdict import judge_run
from foveate.experiment.presets import PRESETS
from foveate.experiment.resolve import TRAINED
from foveate.io.files import write_json
from foveate.simulation.records import PROTOCOLS, Trace
from foveate.simulation.suites import SUITE_SCENES_PER_CELL, own_suite

SEED = 0
SCORED = 2
"""Scenes per cell of a suite."""


def played(preset: str) -> tuple[Suite, Trace]:
    """Simulate a preset's trained policy on a few scenes of its own suite, with the real filter."""
    policy = load(preset)
    known = own_suite(policy.scenario.scenes, policy.problem)
    chosen = [scene for i, scene in enumerate(known) if i % SUITE_SCENES_PER_CELL < SCORED]
    suite = prepare(policy.problem, policy.scenario.scenes, chosen)
    return suite, evaluate_traces(suite, policy.network, PROTOCOLS["true"], chunk=len(chosen))


def scores(suite: Suite, trace: Trace) -> dict[str, float]:
    """The true score [nat per target] in each scene, by its id."""
    rows = episode_rows(suite, "policy", "true", trace, [0.0] * len(suite.scenes))
    return {row.scene: round(row.score, 4) for row in rows if row.score is not None}


def make(preset: str) -> None:
    """Train a preset, save its policy and write its record."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        policy = train(preset, seed=SEED, out=Path(folder) / preset, verdict=False)
    seconds = time.perf_counter() - began
    shutil.rmtree(TRAINED / preset, ignore_errors=True)
    policy.save(TRAINED / preset)
    found = judge(preset)
    record = {
        "preset": preset,
        "seed": SEED,
        "foveate": foveate.__version__,
        "jax": version("jax"),
        "trained_s": round(seconds),
        "epoch": policy.facts["epoch"],
        "held_out": policy.facts["held_out"],
        "scores": found,
    }
    write_json(TRAINED / preset / "record.json", record)
    print(f"{preset}: {seconds:.0f} s, held-out {policy.facts['held_out']:.2f}, {found}", flush=True)


def judge(preset: str) -> dict[str, float]:
    """Write the verdict of a shipped policy, and return its scores for the record."""
    judge_run(TRAINED / preset)
    jax.config.update("jax_enable_x64", True)  # for all threads; a context manager covers only this one
    found = scores(*played(preset))
    jax.config.update("jax_enable_x64", False)
    return found


def judge_again(preset: str) -> None:
    """Write verdict and scores of a shipped policy as the present code has them."""
    path = TRAINED / preset / "record.json"
    record = json.loads(path.read_text(encoding="utf-8")) | {"scores": judge(preset)}
    write_json(path, record)
    print(f"{preset}: {record['scores']}", flush=True)


def main() -> None:
    """Make, or judge, the presets named on the command line, or all of them."""
    given = [argument for argument in sys.argv[1:] if argument != "--judge"]
    for preset in given or PRESETS:
        if preset not in PRESETS:
            sys.exit(f"{preset}: presets are {', '.join(PRESETS)}")
        if "--judge" in sys.argv:
            judge_again(preset)
        else:
            make(preset)


if __name__ == "__main__":
    main()
