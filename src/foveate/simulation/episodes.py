"""Episodes: random scenes, their noise, the truth, and the initial belief."""

import math
from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry.linalg import root_semidefinite
from foveate.models.problem import Problem
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.drawn import Drawn, Noise
from foveate.simulation.population import joined, noise_shapes, with_tracks
from foveate.simulation.records import Arrivals, Episode, Truth
from foveate.simulation.starts import TRIES, agent_start, map_of, starts, target_starts
from foveate.simulation.team.mate_scans import mate_scan_shapes, team_draws
from foveate.simulation.team.starts import MateNumbers, mate_noise, mate_places, mate_shapes, middles
from foveate.simulation.truth import true_states
from foveate.types import Count, Key, Point

POPULATION_STREAM = 11
"""Folded into the key of an episode's noise: that of detections without ids changes no other number."""
MATE_STREAM = 17
"""Folded into the same key, for the scans of a team's other robots."""


def draw_shapes(settings: SceneSettings, problem: Problem) -> tuple[tuple[int, ...], ...]:
    """Shapes into which the random numbers of one scene are cut; those with a row per target grow with their number."""
    d, most = problem.agent.space.dimension, settings.targets_max
    shapes = (), (), (d,), (most, d), (1 if settings.shared_drift else most, d)
    has_obstacles = problem.obstacles is not None
    shapes = (*shapes, (), (TRIES, d), (most, TRIES, d)) if has_obstacles else shapes
    return shapes if problem.team is None else (*shapes, *mate_shapes(problem.team, most, d, has_obstacles))


def draw_size(settings: SceneSettings, problem: Problem) -> int:
    """Number of random numbers of one scene."""
    return _size(draw_shapes(settings, problem))


def draw(
    settings: SceneSettings,
    problem: Problem,
    uniform: Float[Array, " size"],
    test: bool = False,
    targets: Count | None = None,
) -> Drawn:
    """Make a scene from `draw_size` numbers, uniform in [-1, 1), padded to the most targets.

    A scene of a `test` suite has its agent near the centre, unless the settings have starts of their own. `targets` > 0
    sets the number of targets. Where a position is beyond a border that its owner keeps, it is moved onto it; where one
    is in an obstacle, others are tried.
    """
    d, most = problem.agent.space.dimension, settings.targets_max
    count, yaw, agent, position, drift, *rest = _cut(uniform, draw_shapes(settings, problem))
    tries, rest = ([], rest) if problem.obstacles is None else (rest[:3], rest[3:])
    mates = MateNumbers(*rest) if rest else None

    sizes = most + 1 - settings.targets_min
    n = settings.targets_min + jnp.minimum(jnp.floor((count + 1.0) / 2.0 * sizes), sizes - 1).astype(int)
    if targets is not None:
        n = jnp.where(targets > 0, targets, n)
    centre = jnp.array(settings.centre_m)
    half_side = jnp.array(settings.half_side_m)
    half_side += settings.half_side_per_target_m * n.astype(half_side.dtype)

    def agent_at(uniform: Float[Array, " d"]) -> Float[Array, " d"]:
        return problem.inside(agent_start(settings, centre, half_side, uniform, test), problem.bounds_agent)

    others = None if mates is None else mate_places(problem, mates, map_of(problem, tries, test), agent_at, centre)

    def targets_at(start: Point, uniform: Float[Array, "n d"]) -> Float[Array, "n d"]:
        middle = start if mates is None or others is None else middles(mates, start, others)
        positions = target_starts(settings, middle, centre + half_side * uniform, uniform)
        return problem.inside(positions, problem.bounds_targets)

    number, start, position = starts(problem, agent_at, targets_at, (agent, position), tries, test)
    steps = settings.steps_per_target * n if settings.steps is None else jnp.asarray(settings.steps)
    upright = problem.agent.space.upright
    return Drawn(
        pose=upright(start, jnp.pi * yaw),
        position=position,
        map_number=number,
        drift=jnp.broadcast_to(jnp.array(settings.drift_m_s) * drift, (most, d)),
        present=jnp.arange(most) < n,
        horizon=steps,
        others=None if mates is None or others is None else jax.vmap(upright)(others, jnp.pi * mates.yaw),
    )


def draw_noise(problem: Problem, key: Key, steps: int, targets: int, with_truth: bool = True) -> Noise:
    """Random numbers of one training episode; those that only a truth needs are 0 without it."""
    d, n_y, n_z = problem.agent.space.dimension, problem.motion.state_size, problem.sensor.size
    uniform_key, normal_key = jax.random.split(key)
    shapes = ((targets, n_y), (steps, targets, n_y), (steps, targets, n_z))
    # Each random number depends on its place alone: the first ones are the same without the rest.
    normal = jax.random.normal(normal_key, (_size(shapes if with_truth else shapes[:1]),))
    first, process, measurement = _cut(jnp.pad(normal, (0, _size(shapes) - len(normal))), shapes)
    jitter = jax.random.uniform(uniform_key, (steps, targets, d), minval=-1.0)
    uniform: dict[str, Array] = {}
    if problem.detections is not None:
        uniform = _uniform(key, POPULATION_STREAM, noise_shapes(problem, steps, targets))
    noise = Noise(jitter=jitter, process=process, measurement=measurement, first=first, **uniform)
    if problem.team is None or not with_truth:
        return noise
    mates, radio = mate_noise(problem, key, steps, targets)
    if problem.detections is None:
        return replace(noise, mates=mates, radio=radio)
    scans = _uniform(key, MATE_STREAM, mate_scan_shapes(problem, steps, targets))
    return replace(noise, mates=mates, radio=radio, **scans)


def _uniform(key: Key, stream: int, shapes: dict[str, tuple[int, ...]]) -> dict[str, Array]:
    """Numbers uniform in [0, 1) in arrays of these shapes, by their names, from a stream of the episode's noise."""
    sizes = list(shapes.values())
    flat = jax.random.uniform(jax.random.fold_in(key, stream), (_size(sizes),))
    return dict(zip(shapes, _cut(flat, sizes), strict=True))


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
    the initial velocity and the input is zero. A drift that a border has turned is turned in the inputs, too. With
    `birth_and_death` a new target enters at the other side for each that leaves the scene's box: the stationary crowd
    of a street. Raises InputError without truth in a region whose borders targets keep, or with detections without ids.
    """
    motion, d, others, drawn = problem.motion, problem.agent.space.dimension, None, noise
    if problem.detections is not None:
        scene, noise, others = joined(problem, scene, noise, with_truth)
    period = problem.period
    entry = jnp.arange(len(noise.jitter)) % len(period.tau)
    first, drift = jax.vmap(motion.state_at)(scene.position), None
    inputs = jnp.zeros((*noise.jitter.shape[:2], motion.input_size))
    if motion.state_size == d == motion.input_size:
        drift = scene.drift
        inputs = period.tau[entry, None, None] * (scene.drift + settings.jitter_m_s * noise.jitter)
    elif motion.takes_drift:
        first = first.at[:, d : 2 * d].add(scene.drift)
    if others is not None:
        first = first.at[-others.first.shape[0] :].set(others.first) if others.first.shape[0] else first

    truth = None
    if with_truth:
        roots = jnp.swapaxes(root_semidefinite(period.motion.W), -1, -2)
        pushes = noise.process @ roots[entry] * float(settings.process_noise)
        newcomers = None if others is None else others.newcomers
        states, inputs = true_states(problem.of_map(scene.map_number), first, drift, inputs, pushes, newcomers)
        truth = Truth(state=states, measurement_noise=noise.measurement)
    elif problem.bounds_targets or problem.turns_targets:
        where = "region" if problem.bounds_targets else "obstacles"
        raise InputError(f"noise = False: expected True, or {where}.targets = 'free': without noise there is no truth")
    known = inputs if settings.known_drift else jnp.zeros_like(inputs)
    error = first_error(problem, settings, noise.first)
    mean = first_mean(problem, settings, first + error, newcomer=False)
    episode = Episode(scene.pose, mean, scene.present, known, scene.horizon, truth, map_number=scene.map_number)
    if scene.others is not None:
        alive = None if others is None else others.scans.alive
        episode = replace(episode, team=team_draws(problem, scene.others, drawn, alive))
    if others is not None:
        return with_tracks(problem, episode, others.scans)
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
    mean = first_mean(problem, settings, states + error, newcomer=True)
    return replace(episode, truth=replace(episode.truth, state=states), arrivals=Arrivals(present=present, mean=mean))


def first_error(problem: Problem, settings: SceneSettings, normal: Float[Array, "*b n_y"]) -> Float[Array, "*b n_y"]:
    """Error of the first mean: N(0, V) in position ("paper"), N(0, Y_0^-1) ("consistent"), or of `first_error_std`."""
    if settings.first_error_std:
        return normal * jnp.repeat(jnp.array(settings.first_error_std), problem.motion.dimension)
    if settings.initial_error == "consistent":
        return normal @ root_semidefinite(jnp.linalg.inv(problem.prior_information)).T
    V, H = problem.period.V[0], problem.sensor.H
    # The least-norm state error whose measurement H y has the distribution N(0, V).
    return normal[..., : len(V)] @ (jnp.linalg.pinv(H) @ root_semidefinite(V)).T


def first_mean(
    problem: Problem, settings: SceneSettings, erring: Float[Array, "*b n_y"], newcomer: bool
) -> Float[Array, "*b n_y"]:
    """Mean of a belief that begins: the `erring` state, truth and error, or its position with every other number 0."""
    motion, velocity = problem.motion, settings.first_mean_velocity or ("zero" if newcomer else "truth")
    if velocity == "truth" or motion.state_size == motion.dimension:
        return erring
    return jnp.matmul(motion.position(erring), jnp.linalg.pinv(motion.Z).T, precision="highest")
