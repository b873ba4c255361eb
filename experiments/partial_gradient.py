"""Compare the printed gradient of Proposition 1 with the total gradient, on the paper's scenes.

    python experiments/partial_gradient.py [--run runs/paper-0 runs/paper-10 ...]

The printed recursion holds the policy's inputs s_k fixed, du/dtheta = dpi/dtheta; the total derivative lets pose and
information move with theta too. Both come from `foveate.learning.sensitivity`, in float64, noise-free, on the planar
scenario embedded in SE(3). Policies are those before training (as `foveate train` initialises them) and the best ones
of run folders. The table has the angle between the two gradients [deg] and |printed| / |total|: per scene, over the
scenes with a gradient of at least MIN_GRADIENT, and for the mean gradient of all scenes, which a training step follows.
At 90 degrees or more a small step along the printed gradient does not raise the objective.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from foveate.experiment.checkpoint import load_run
from foveate.experiment.presets import PRESETS
from foveate.learning.sensitivity import policy_gradient
from foveate.policies.inputs import Frame
from foveate.simulation.episodes import training_episode
from foveate.simulation.planar_in_space import EmbeddedPolicy, embedded_episode, embedded_problem
from foveate.simulation.records import Policy

PAPER = PRESETS["paper"]
SEEDS = (0, 10, 100)
TARGETS = (3, 5, 7)
MIN_GRADIENT = 1e-3
"""Least gradient norm [nat per target] for an angle; below it all targets are out of reach, where 1 - Phi is flat."""
RESAMPLES = 400


def fresh(seed: int, frame: Frame) -> Policy:
    """The paper's network as initialised with this seed: in float32, then cast to float64."""
    with jax.enable_x64(False):
        settings = replace(PAPER.policy, frame=frame)
        policy = settings.policy(PAPER.scenario.problem(), jax.random.split(jax.random.key(seed), 4)[0])
    return jax.tree.map(lambda x: x.astype(float) if eqx.is_inexact_array(x) else x, policy)


def trained(run: Path) -> Policy:
    """Load the best policy of a run folder. Raises ValueError unless it was trained in the paper's scenario."""
    experiment, policy, _ = load_run(run)
    if experiment.scenario != PAPER.scenario:
        raise ValueError(f"{run}: expected a run in the paper's scenario")
    return policy


@eqx.filter_jit
def gradients(policy: Policy, targets: int, keys: jax.Array) -> jax.Array:
    """Printed and total gradient for the parameters, one scene per key: (scenes, 2, n_p) [nat per target]."""
    problem = PAPER.scenario.problem()
    scenes = replace(PAPER.scenario.scenes, targets_min=targets, targets_max=targets)

    def one(key: jax.Array) -> jax.Array:
        episode = embedded_episode(training_episode(problem, scenes, key, noise=False))
        both = [
            policy_gradient(embedded_problem(problem), EmbeddedPolicy(policy), episode, total=total)
            for total in (False, True)
        ]
        return jnp.stack([ravel_pytree(gradient)[0] for _, gradient in both]) / targets

    return jax.lax.map(one, keys)  # sequential: the derivatives of one scene take much memory


def compare(printed: np.ndarray, total: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle [deg] and |printed| / |total| of vectors along the last axis."""
    sizes = [np.linalg.norm(x, axis=-1) for x in (printed, total)]
    one, other = (x / size[..., None] for x, size in zip((printed, total), sizes, strict=True))
    # Not by arccos, which resolves small angles only to the square root of the precision.
    half = np.arctan2(np.linalg.norm(one - other, axis=-1), np.linalg.norm(one + other, axis=-1))
    return np.degrees(2 * half), sizes[0] / sizes[1]


def row(name: str, targets: str, both: np.ndarray) -> str:
    """One row of the table, for gradients (scenes, 2, n_p)."""
    kept = both[np.linalg.norm(both[:, 1], axis=-1) >= MIN_GRADIENT]
    angle, ratio = compare(kept[:, 0], kept[:, 1])
    mean_angle, mean_ratio = compare(*both.mean(axis=0))
    # A few scenes dominate the mean: bootstrap over scenes for the uncertainty of its angle.
    counts = np.random.default_rng(0).multinomial(len(both), np.full(len(both), 1 / len(both)), RESAMPLES)
    means = np.tensordot(counts, both, axes=1)
    low, high = np.percentile(compare(means[:, 0], means[:, 1])[0], [10, 90])
    cells = [name, targets, f"{len(kept)} of {len(both)}", f"{np.median(angle):.1f}", f"{np.percentile(angle, 90):.0f}"]
    cells += [str(np.sum(angle >= 90)), f"{np.median(ratio):.2f}"]
    cells += [f"{mean_angle:.0f} ({low:.0f} to {high:.0f})", f"{mean_ratio:.2f}"]
    return "| " + " | ".join(cells) + " |"


def rows(name: str, policy: Policy, scenes: int, seed: int) -> Iterator[str]:
    """One row for each number of targets, and one for all scenes."""
    batches = []
    for targets in TARGETS:
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), targets), scenes)
        batches.append(np.asarray(gradients(policy, targets, keys)))
        yield row(name, str(targets), batches[-1])
    yield row(name, "all", np.concatenate(batches))


def main() -> None:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--run", nargs="+", action="extend", type=Path, default=[], help="run folders: trained policies"
    )
    parser.add_argument("--scenes", type=int, default=20, help="scenes for each of 3, 5 and 7 targets")
    parser.add_argument("--seed", type=int, default=0, help="seed of the scenes")
    parser.add_argument("--frame", choices=("body", "world"), default="body", help="frame of fresh policies' inputs")
    parser.add_argument("--skip-fresh", action="store_true", help="only the run folders")
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    policies = {} if given.skip_fresh else {f"fresh, seed {seed}": fresh(seed, given.frame) for seed in SEEDS}
    try:
        policies |= {str(run): trained(run) for run in given.run}
    except ValueError as error:
        parser.error(str(error))
    print(
        "| policy | targets | scenes with a gradient | angle, median | 90th percentile | scenes at 90 or more"
        " | ratio, median | angle of the mean (10th to 90th percentile) | ratio of the means |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, policy in policies.items():
        for line in rows(name, policy, given.scenes, given.seed):
            print(line, flush=True)


if __name__ == "__main__":
    main()
