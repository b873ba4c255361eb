"""Fusion over a radio that loses or delays messages where detections have no ids: no scan is counted twice.

A message holds the scans of the last steps that its sender knows, each with its step, its source and the pose from
which it was taken, and the sender's population at the beginning of this window. The receiver adds the scans that it
lacks, and filters again from its own beginning: exactly the filter of all these scans. Older scans are in the
populations at its beginning, which are matched and fused (`models.detections.fusion`).
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.models.detections import filter as pmb
from foveate.models.detections.fusion import fused
from foveate.models.detections.records import DetectionModel, Population, Scan
from foveate.models.problem import Problem
from foveate.simulation.team.window import Message, latest, news
from foveate.types import Count


class ScanStep(NamedTuple):
    """The scans of all robots in a step, and the pose of each; those of several steps have a leading axis of L."""

    pose: Float[Array, "..."]
    scan: Scan


class ScanWindow(eqx.Module):
    """The scans of the last L steps, oldest first, and what each robot knows of them.

    `base` are the robots' populations before these steps, with a leading axis of M; `knows` says whose scans (last
    axis) of which step each robot has. `unseen` is the intensity at that time if nobody had ever looked.
    """

    steps: ScanStep
    base: Population
    knows: Bool[Array, "M L M"]
    unseen: Float[Array, "*cells"]


def _model(problem: Problem) -> DetectionModel:
    assert problem.detections is not None, "for problems with detections"
    return problem.detections


def first_window(problem: Problem, base: Population, poses: Float[Array, "M ..."]) -> ScanWindow:
    """A window before the first step, of the populations that the robots begin with."""
    assert problem.team is not None, "a window is a team's"
    model, length, robots = _model(problem), problem.team.radio.memory, len(poses)
    shape = (length, robots, model.detections)
    scan = Scan(jnp.zeros((*shape, problem.sensor.size), poses.dtype), jnp.zeros(shape, bool))
    steps = ScanStep(jnp.broadcast_to(poses, (length, *poses.shape)), scan)
    return ScanWindow(steps, base, jnp.zeros((robots, length, robots), bool), model.first)


def shifted(window: ScanWindow, step: ScanStep) -> ScanWindow:
    """The window one step later; of the new step each robot knows its own scan."""
    steps, knows = latest(window.steps, step, window.knows)
    return replace(window, steps=steps, knows=knows)


def received(problem: Problem, window: ScanWindow, sent: Message, heard: Bool[Array, "M M"], delay: int) -> ScanWindow:
    """The window after the messages that were heard, sent `delay` steps ago: their bases are of the window's own time.

    Every receiver fuses the populations of the senders that it hears, one after another.
    """

    def hear(base: Population, entry: tuple) -> tuple[Population, None]:
        sender, receives = entry
        both = jax.vmap(lambda own: fused(problem, _model(problem), own, sender, window.unseen))(base)
        return _where(receives, both, base), None

    assert isinstance(sent.base, Population), "of detections without ids"
    base = jax.lax.scan(hear, window.base, (sent.base, heard.T))[0]
    return replace(window, base=base, knows=window.knows | news(sent.knows, heard, delay))


def filtered(problem: Problem, window: ScanWindow, last: Count) -> Population:
    """Populations of every robot after each step of the window, of which `last` is the newest: leading axes L, M.

    Steps before the first one of an episode change nothing.
    """

    def advance(populations: Population, entry: tuple) -> tuple[Population, Population]:
        step, knows, number = entry
        after = _updated(problem, populations, step, knows, number)
        after = jax.tree.map(lambda new, old: jnp.where(number >= 0, new, old), after, populations)
        return after, after

    entries = window.steps, jnp.moveaxis(window.knows, 1, 0), _numbers(window, last)
    return jax.lax.scan(advance, window.base, entries)[1]


def begun_later(problem: Problem, window: ScanWindow, course: Population, last: Count) -> ScanWindow:
    """The window whose beginning is one step later, after the first populations of its `course`."""
    first = _numbers(window, last)[0]
    ahead = pmb.undetected_ahead(problem.at(jnp.maximum(first, 0)), _model(problem), window.unseen)
    base = jax.tree.map(lambda x: x[0], course)
    return replace(window, base=base, unseen=jnp.where(first >= 0, ahead, window.unseen))


def _numbers(window: ScanWindow, last: Count) -> Int[Array, " L"]:
    """Number of each step of the window; negative before the first one of an episode."""
    return last - jnp.arange(window.knows.shape[1] - 1, -1, -1)


def _updated(
    problem: Problem, populations: Population, step: ScanStep, knows: Bool[Array, "M sources"], number: Count
) -> Population:
    """Populations (M, ..) predicted by one step, and updated by the scans that each robot knows of it, in turn."""
    model, number = _model(problem), jnp.maximum(number, 0)
    nothing = jnp.zeros((model.tracks, problem.motion.input_size), step.pose.dtype)
    ahead = jax.vmap(lambda own: pmb.predict(problem.at(number), model, own, nothing))(populations)

    def hear(populations: Population, entry: tuple) -> tuple[Population, None]:
        source, pose, scan, known = entry
        sender = problem.of_robot(source).at(number)
        updated = jax.vmap(lambda own: pmb.update(sender, model, own, pose, scan))(populations)
        return _where(known, updated, populations), None

    entries = jnp.arange(len(knows)), step.pose, step.scan, knows.T
    return jax.lax.scan(hear, ahead, entries)[0]


def _where(which: Bool[Array, " M"], new: Population, old: Population) -> Population:
    def pick(new: Array, old: Array) -> Array:
        return jnp.where(which.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    return jax.tree.map(pick, new, old)
