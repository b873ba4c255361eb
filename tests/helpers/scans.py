"""Scans of the robots of a team by their definition, in numpy."""

import jax.numpy as jnp
import numpy as np

from foveate.models.detections.records import Scan


def scan_of(problem, episode, pose, k, robot):
    """What a robot detects from its pose in step k: targets in view with a probability, false alarms, in its order.

    For sensors whose noise is the same everywhere.
    """
    model, scans, state = problem.detections, episode.scans, np.asarray(episode.truth.state[k + 1])
    if robot == 0:
        noise = episode.truth.measurement_noise[k]
        numbers = scans.detection[k], scans.clutter_body[k], scans.is_false[k], scans.order[k]
    else:
        of, draws = robot - 1, episode.team
        noise = draws.measurement_noise[k, of]
        mate = draws.scans
        numbers = mate.detection[k, of], mate.clutter_body[k, of], mate.is_false[k, of], mate.order[k, of]
    uniform, clutter, is_false, order = map(np.asarray, numbers)
    position = jnp.asarray(state @ np.asarray(problem.motion.Z).T)
    in_view = np.asarray(problem.sensor.view.contains(problem.agent.space.to_body(jnp.asarray(pose), position)))
    alarms = np.asarray(problem.agent.space.to_world(jnp.asarray(pose), jnp.asarray(clutter)))
    z = state @ np.asarray(problem.sensor.H).T + np.asarray(noise) @ np.linalg.cholesky(np.asarray(problem.sensor.V)).T
    detected = np.asarray(scans.alive[k + 1]) & in_view & (uniform < float(model.probability))
    chosen = sorted(np.flatnonzero(np.concatenate([detected, is_false])), key=lambda i: order[i])
    found = np.zeros((model.detections, z.shape[1]))
    found[: len(chosen)] = np.concatenate([z, alarms])[chosen]
    return Scan(jnp.asarray(found), jnp.arange(model.detections) < len(chosen))
