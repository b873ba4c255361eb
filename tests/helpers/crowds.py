"""Worlds of targets that are born, die, are missed and mixed up with false alarms, and the filter run in them.

Truth and scans are drawn by NumPy, from the definition of the world alone.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate.models.detections import filter as pmb
from foveate.models.detections.records import DetectionModel, Population, Scan
from foveate.models.problem import Problem
from foveate.scenario.detections import DetectionSettings


class Crowd(NamedTuple):
    """Runs, padded: states and presence of the targets after every step, the poses, and the scans."""

    state: np.ndarray  # runs K n n_y
    alive: np.ndarray  # runs K n
    pose: np.ndarray  # K ...
    measurement: np.ndarray  # runs K m n_z
    valid: np.ndarray  # runs K m


def draw(
    problem: Problem, settings: DetectionSettings, poses: np.ndarray, runs: int, seed: int, slots: int = 40
) -> Crowd:
    """Draw runs of a world: births over the whole box, first velocities by the prior, positions in the box."""
    rng, motion = np.random.default_rng(seed), problem.motion
    A, W, Z, H, V = (np.asarray(x, float) for x in (motion.A, motion.W, motion.Z, problem.sensor.H, problem.sensor.V))
    prior = np.linalg.inv(np.asarray(problem.prior_information, float))
    low, high = np.array(settings.low_m), np.array(settings.high_m)
    steps, d, m = len(poses), len(Z), settings.detections
    rate = sum(birth.rate for birth in settings.births)

    def fresh(shape):
        state = rng.multivariate_normal(np.zeros(len(A)), prior, shape)
        return np.concatenate([rng.uniform(low, high, (*shape, d)), state[..., d:]], axis=-1)

    state = fresh((runs, slots))
    alive = np.arange(slots) < rng.poisson(settings.undetected, (runs, 1))
    states, lives, scans, valids = [], [], np.zeros((runs, steps, m, len(H))), np.zeros((runs, steps, m), bool)
    for k, pose in enumerate(poses):
        state = state @ A.T + rng.multivariate_normal(np.zeros(len(A)), W, (runs, slots))
        alive = alive & (rng.uniform(size=alive.shape) < settings.survival)
        born = ~alive & (np.cumsum(~alive, axis=1) <= rng.poisson(rate, (runs, 1)))
        state, alive = np.where(born[..., None], fresh((runs, slots)), state), alive | born
        body = np.asarray(problem.agent.space.to_body(jnp.asarray(pose), jnp.asarray(state @ Z.T)))
        range_m = np.linalg.norm(body, axis=-1)
        chance = settings.probability * 2.0 ** -((range_m / (settings.half_range_m or np.inf)) ** 2)
        seen = alive & np.asarray(problem.sensor.view.contains(jnp.asarray(body)))
        seen &= rng.uniform(size=seen.shape) < chance
        noisy = state @ H.T + rng.multivariate_normal(np.zeros(len(H)), V, (runs, slots))
        ends = np.cumsum(rng.poisson(settings.clutter, runs))
        clutter = np.asarray(
            problem.agent.space.to_world(jnp.asarray(pose), jnp.asarray(_inside(problem, rng, ends[-1])))
        )
        for run, false in enumerate(np.split(clutter, ends[:-1])):
            scan = rng.permutation(np.concatenate([noisy[run, seen[run]], false]))[:m]
            scans[run, k, : len(scan)], valids[run, k, : len(scan)] = scan, True
        states.append(state)
        lives.append(alive)
    return Crowd(np.stack(states, 1), np.stack(lives, 1), np.asarray(poses), scans, valids)


def _inside(problem: Problem, rng: np.random.Generator, count: int) -> np.ndarray:
    """Points uniform in the view, by rejection."""
    view, depth, points = problem.sensor.view, float(problem.sensor.view.depth), np.zeros((0, problem.motion.dimension))
    while len(points) < count:
        more = rng.uniform(-depth, depth, (1000 + count, points.shape[1]))
        points = np.concatenate([points, more[np.asarray(view.contains(jnp.asarray(more)))]])
    return points[:count]


@eqx.filter_jit
def run(problem: Problem, model: DetectionModel, poses, measurement, valid) -> Population:
    """The filter's state after every step of every run: (runs, K, ..)."""
    nothing = jnp.zeros((model.tracks, problem.motion.input_size))

    def one(measurement, valid):
        def advance(population, step):
            pose, z, mask = step
            population = pmb.predict(problem, model, population, nothing)
            population = pmb.update(problem, model, population, pose, Scan(z, mask))
            return population, population

        return jax.lax.scan(advance, pmb.start(problem, model, poses[0]), (poses, measurement, valid))[1]

    return jax.vmap(one)(measurement, valid)
