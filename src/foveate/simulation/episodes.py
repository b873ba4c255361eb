"""Episodes: random scenes, their noise, the truth, and the initial belief."""

import math
from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.models.problem import Problem
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.records import Arrivals, Episode, Truth
from foveate.types import Count, Key, Pose


class Drawn(eqx.Module):
    """A random scene as arrays, padded to a fixed number of targets."""

    pose: Pose
    position: Float[Array, "n d"]
    drift: Float[Array, "n d"]
    present: Bool[Array, " n"]
    horizon: Count


class Noise(eqx.Module):
    """All random numbers of one episode: uniform jitter in [-1, 1], and standard normals for the rest."""

    jitter: Float[Array, "K n d"]
    process: Float[Array, "K n n_y"]
    measurement: Float[Array, "K n n_z"]
    first: Float[Array, "n n_y"]


def _draw_shapes(settings: SceneSettings, problem: Problem) -> tuple[tuple[int, ...], ...]:
    d, most = problem.agent.space.dimension, settings.targets_max
    return (), (), (d,), (most, d), (1 if settings.shared_drift else most, d)


def draw_size(settings: SceneSettings, problem: Problem) -> int:
    """Number of random numbers of one scene."""
    return _size(_draw_shapes(settings, problem))


def draw(
    settings: SceneSettings,
    problem: Problem,
    uniform: Float[Array, " size"],
    test: bool = False,
    targets: Count | None = None,
) -> Drawn:
    """Make a scene from `draw_size` numbers, uniform in [-1, 1), padded to the most targets.

    A scene of a `test` suite has its agent near the centre. `targets` > 0 sets the number of targets.
    """
    d, most = problem.agent.space.dimension, settings.targets_max
    count, yaw, agent, position, drift = _cut(uniform, _draw_shapes(settings, problem))

    sizes = most + 1 - settings.targets_min
    n = settings.targets_min + jnp.minimum(jnp.floor((count + 1.0) / 2.0 * sizes), sizes - 1).astype(int)
    if targets is not None:
        n = jnp.where(targets > 0, targets, n)
    centre = jnp.array(settings.centre_m)
    half_side = jnp.array(settings.half_side_m)
    half_side += settings.half_side_per_target_m * n.astype(half_side.dtype)
    agent_side = settings.agent_test_half_side_m if test else settings.agent_spread * half_side
    steps = settings.steps_per_target * n if settings.steps is None else jnp.asarray(settings.steps)
    return Drawn(
        pose=problem.agent.space.upright(centre + agent_side * agent, jnp.pi * yaw),
        position=centre + half_side * position,
        drift=jnp.broadcast_to(jnp.array(settings.drift_m_s) * drift, (most, d)),
        present=jnp.arange(most) < n,
        horizon=steps,
    )


def draw_noise(problem: Problem, key: Key, steps: int, targets: int, with_truth: bool = True) -> Noise:
    """Random numbers of one training episode; those that only a truth needs are 0 without it."""
    d, n_y, n_z = problem.agent.space.dimension, problem.motion.state_size, problem.sensor.H.shape[0]
    uniform_key, normal_key = jax.random.split(key)
    shapes = ((targets, n_y), (steps, targets, n_y), (steps, targets, n_z))
    # Each random number depends on its place alone: the first ones are the same without the rest.
    normal = jax.random.normal(normal_key, (_size(shapes if with_truth else shapes[:1]),))
    first, process, measurement = _cut(jnp.pad(normal, (0, _size(shapes) - len(normal))), shapes)
    jitter = jax.random.uniform(uniform_key, (steps, targets, d), minval=-1.0)
    return Noise(jitter=jitter, process=process, measurement=measurement, first=first)


def _size(shapes: Sequence[tuple[int, ...]]) -> int:
    return sum(math.prod(shape) for shape in shapes)


def _cut(flat: Float[Array, " size"], shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Random numbers cut into arrays: each call of the generator costs a second of compilation."""
    parts = jnp.split(flat, np.cumsum([math.prod(shape) for shape in shapes])[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def episode_of(
    problem: Problem,
    settings: SceneSettings,
    scene: Drawn,
    noise: Noise,
    with_truth: bool = True,
    birth_and_death: bool = False,
) -> Episode:
    """Make the episode of a scene and its random numbers.

    Targets that are positions only have the known input xi = tau (drift + jitter) [m]; for longer states the drift is
    the initial velocity and the input is zero. With `birth_and_death` a new target enters at the other side for each
    that leaves the scene's box: the stationary crowd of a street.
    """
    motion, d = problem.motion, problem.agent.space.dimension
    period = problem.period
    entry = jnp.arange(len(noise.jitter)) % len(period.tau)
    first = jax.vmap(motion.state_at)(scene.position)
    inputs = jnp.zeros((*noise.jitter.shape[:2], motion.input_size))
    if motion.state_size == d == motion.input_size:
        inputs = period.tau[entry, None, None] * (scene.drift + settings.jitter_m_s * noise.jitter)
    elif motion.takes_drift:
        first = first.at[:, d : 2 * d].add(scene.drift)

    known = inputs if settings.known_drift else jnp.zeros_like(inputs)
    truth = None
    if with_truth:
        roots = jnp.swapaxes(_root(period.motion.W), -1, -2)
        pushes = noise.process @ roots[entry] * float(settings.process_noise)

        def move(state, step):
            motion, known_input, push = step
            after = motion.advance(state, known_input) + push
            return after, after

        motions = jax.tree.map(lambda part: part[entry], period.motion)
        states = jnp.concatenate([first[None], jax.lax.scan(move, first, (motions, inputs, pushes))[1]])
        truth = Truth(state=states, measurement_noise=noise.measurement)
    error = first_error(problem, settings, noise.first)
    episode = Episode(scene.pose, first + error, scene.present, known, scene.horizon, truth)
    return _with_birth_and_death(problem, settings, episode, error) if birth_and_death else episode


def training_episode(
    problem: Problem, scenes: SceneSettings, key: Key, noise: bool, test: bool = False, targets: Count | None = None
) -> Episode:
    """Make a random episode, `test` and `targets` as in `draw`; without `noise` it has no truth."""
    scene_key, noise_key = jax.random.split(key)
    numbers = draw_noise(problem, noise_key, scenes.horizon(scenes.targets_max), scenes.targets_max, noise)
    uniform = jax.random.uniform(scene_key, (draw_size(scenes, problem),), minval=-1.0)
    scene = draw(scenes, problem, uniform, test, targets)
    has_births = noise and scenes.birth_and_death
    return episode_of(problem, scenes, scene, numbers, with_truth=noise, birth_and_death=has_births)


def _with_birth_and_death(
    problem: Problem, settings: SceneSettings, episode: Episode, error: Float[Array, "n n_y"]
) -> Episode:
    """Wrap the truth around the scene's box; a target that wraps is absent for one instant, then a new target."""
    assert episode.truth is not None, "birth and death moves the truth"
    states, motion = episode.truth.state, problem.motion
    half_side = jnp.array(settings.half_side_m)
    half_side += settings.half_side_per_target_m * jnp.sum(episode.present).astype(half_side.dtype)
    low = jnp.array(settings.centre_m) - half_side
    laps = jnp.floor((motion.position(states) - low) / (2 * half_side))
    states = states - jax.vmap(jax.vmap(motion.state_at))(2 * half_side * laps)
    wraps = jnp.any(laps[1:] != laps[:-1], axis=-1)
    present = episode.present & ~jnp.concatenate([jnp.zeros_like(wraps[:1]), wraps])
    return replace(
        episode, truth=replace(episode.truth, state=states), arrivals=Arrivals(present=present, mean=states + error)
    )


def first_error(problem: Problem, settings: SceneSettings, normal: Float[Array, "*b n_y"]) -> Float[Array, "*b n_y"]:
    """Error of the initial mean: N(0, V) in position ("paper") or N(0, Y_0^-1) ("consistent")."""
    if settings.initial_error == "consistent":
        return normal @ _root(jnp.linalg.inv(problem.prior_information)).T
    V, H = problem.period.V[0], problem.sensor.H
    # The least-norm state error whose measurement H y has the distribution N(0, V).
    return normal[..., : len(V)] @ (jnp.linalg.pinv(H) @ _root(V)).T


def _root(covariance: Float[Array, "*b n n"]) -> Float[Array, "*b n n"]:
    """A matrix R with R R^T = covariance, which may be singular."""
    values, vectors = jnp.linalg.eigh(covariance)
    return vectors * jnp.sqrt(jnp.maximum(values, 0.0))[..., None, :]
