"""Fusion over a radio that loses or delays messages, without counting a measurement twice.

A message holds the measurements of the last steps that its sender knows, each with its step and its source, and the
sender's belief at the beginning of this window. The receiver adds the measurements that it lacks, and filters again
from its own beginning: exactly the Kalman filter of all these measurements. Measurements older than the window are in
the beliefs at its beginning, of which nobody knows what they have in common: they are fused by covariance intersection.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from foveate.geometry.linalg import log_det_spd
from foveate.models.belief import Belief, predict_information
from foveate.models.detections.records import Population
from foveate.models.fusion import Evidence, corrected_by, covariance_intersection
from foveate.models.problem import Problem
from foveate.types import Count


class Beliefs(NamedTuple):
    """Beliefs of all targets, of one robot or of several; information of every level of the protocol."""

    mean: Float[Array, "*b n n_y"]
    information: Float[Array, "*b levels n n_y n_y"]


class Fresh(NamedTuple):
    """Beliefs that begin in a step, by each robot: of targets that appear, and where its gate restarts one."""

    begins: Bool[Array, "*L M n"]
    mean: Float[Array, "*L M n n_y"]
    information: Float[Array, "*L M n n_y n_y"]


class Step(NamedTuple):
    """What all robots have measured in a step: evidence (M, n, ..), its references, and the known inputs.

    `fresh` is None where no target appears and no gate restarts beliefs.
    """

    evidence: Evidence
    reference: Float[Array, "*L n n_y"]
    known_input: Float[Array, "*L n m_y"]
    fresh: Fresh | None = None


class Window(eqx.Module):
    """The measurements of the last L steps, oldest first, and what each robot knows of them.

    `base` are the beliefs before these steps; `knows` says whose measurements (last axis) of which step each robot has.
    """

    steps: Step
    base: Beliefs
    knows: Bool[Array, "M L M"]


class Message(NamedTuple):
    """What every robot sends: the measurements that it knows, and its beliefs at the beginning of the window.

    Where detections have no ids the measurements are scans, and the beliefs are populations.
    """

    knows: Bool[Array, "M L M"]
    base: Beliefs | Population


def first_window(problem: Problem, beliefs: Beliefs, levels: int, has_fresh: bool) -> Window:
    """A window before the first step, of the beliefs (M, n, ..) that each robot begins with.

    `has_fresh`: its steps may begin beliefs.
    """
    assert problem.team is not None, "a window is a team's"
    (robots, n, n_y), length = beliefs.mean.shape, problem.team.radio.memory
    zero = jnp.zeros((length, robots, n, n_y, n_y), beliefs.mean.dtype)
    evidence = Evidence(zero, zero[..., 0], jnp.zeros((length, robots, n, levels, n_y, n_y), zero.dtype))
    known_input = jnp.zeros((length, n, problem.motion.input_size), zero.dtype)
    fresh = Fresh(jnp.zeros((length, robots, n), bool), zero[..., 0], zero) if has_fresh else None
    steps = Step(evidence, zero[:, 0, ..., 0], known_input, fresh)
    return Window(steps, beliefs, jnp.zeros((robots, length, robots), bool))


def shifted(window: Window, step: Step) -> Window:
    """The window one step later; of the new step each robot knows its own measurements."""
    steps, knows = latest(window.steps, step, window.knows)
    return Window(steps, window.base, knows)


def latest(steps: PyTree, step: PyTree, knows: Bool[Array, "M L M"]) -> tuple[PyTree, Bool[Array, "M L M"]]:
    """The steps of a window and who knows what of them, one step later."""
    steps = jax.tree.map(lambda old, new: jnp.concatenate([old[1:], new[None]]), steps, step)
    own = jnp.eye(knows.shape[0], dtype=bool)[:, None]
    return steps, jnp.concatenate([knows[:, 1:], own], axis=1)


def news(knows: Bool[Array, "M L M"], heard: Bool[Array, "M M"], delay: int) -> Bool[Array, "M L M"]:
    """What each robot hears of the measurements that senders knew `delay` steps ago."""
    known = jnp.any(heard[:, :, None, None] & knows, axis=1)
    if delay:
        late = jnp.zeros_like(known[:, :delay])
        known = jnp.concatenate([known[:, delay:], late], axis=1)
    return known


def received(problem: Problem, window: Window, sent: Message, heard: Bool[Array, "M M"], delay: int) -> Window:
    """The window after the messages that were heard, sent `delay` steps ago: their bases are of the window's own time.

    Of several beliefs the best known one of each target is fused, by its last level.
    """
    assert isinstance(sent.base, Beliefs), "of detections with ids"
    worth = log_det_spd(sent.base.information[:, -1])
    worth = jnp.where(heard[..., None] & jnp.isfinite(worth), worth, -jnp.inf)  # receiver, sender, target
    best, target = jnp.argmax(worth, axis=1), jnp.arange(worth.shape[-1])
    exists = jnp.isfinite(jnp.max(worth, axis=1))
    mean, information = sent.base.mean[best, target], jnp.moveaxis(sent.base.information, 1, 2)[best, target]

    def fuse(own_mean, own_information, mean, information, exists):
        both = jax.vmap(lambda own, other: covariance_intersection(Belief(own_mean, own), Belief(mean, other)))
        fused = both(own_information, information)
        return (
            jnp.where(exists, fused.mean[-1], own_mean),
            jnp.where(exists, fused.information, own_information),
        )

    each = jax.vmap(jax.vmap(fuse, (0, 1, 0, 0, 0), (0, 1)))
    base = Beliefs(*each(*window.base, mean, information, exists))
    return replace(window, base=base, knows=window.knows | news(sent.knows, heard, delay))


def filtered(problem: Problem, window: Window, last: Count) -> Beliefs:
    """Beliefs of every robot after each step of the window, of which `last` is the newest: a leading axis of L.

    Steps before the first one of an episode change nothing.
    """
    length = window.knows.shape[1]
    numbers = last - jnp.arange(length - 1, -1, -1)

    def advance(beliefs: Beliefs, entry: tuple[Step, Bool[Array, "M M"], Count]) -> tuple[Beliefs, Beliefs]:
        step, knows, number = entry
        after = updated(problem, beliefs, step, knows, number)
        after = jax.tree.map(lambda new, old: jnp.where(number >= 0, new, old), after, beliefs)
        return after, after

    return jax.lax.scan(advance, window.base, (window.steps, jnp.moveaxis(window.knows, 1, 0), numbers))[1]


def begun_later(problem: Problem, window: Window, course: Beliefs, last: Count) -> Window:
    """The window whose beginning is one step later, after the first beliefs of its `course`."""
    return replace(window, base=jax.tree.map(lambda x: x[0], course))


def updated(problem: Problem, beliefs: Beliefs, step: Step, knows: Bool[Array, "M sources"], number: Count) -> Beliefs:
    """Beliefs (M, ..) predicted by one step, and updated by the measurements that each robot knows of it."""
    motion = problem.at(jnp.maximum(number, 0)).motion
    share = knows.astype(beliefs.mean.dtype)
    # Robot by source times source by the rest: one product for all targets.
    known: Evidence = jax.tree.map(lambda x: jnp.tensordot(share, x, 1, precision="highest"), step.evidence)
    begun = None if step.fresh is None else _begun(step.fresh, knows)

    def of_target(mean, information, evidence, begun, reference, known_input):
        mean, information = (
            motion.advance(mean, known_input),
            jax.vmap(predict_information, (0, None))(information, motion),
        )
        if begun is not None:
            begins, first, own = begun
            mean, information = jnp.where(begins, first, mean), jnp.where(begins, own, information)
        prediction = Belief(mean, information[-1])
        return corrected_by(prediction, evidence, reference), information + evidence.growth

    of_robot = jax.vmap(of_target, (0, 1, 0, 0, 0, 0), (0, 1))
    of_team = jax.vmap(of_robot, (0, 0, 0, 0, None, None))
    return Beliefs(*of_team(*beliefs, known, begun, step.reference, step.known_input))


def _begun(fresh: Fresh, knows: Bool[Array, "M sources"]) -> Fresh:
    """What each robot knows of beliefs that begin in a step: of several robots' that of the first."""
    told = knows[..., None] & fresh.begins
    source, target = jnp.argmax(told, axis=1), jnp.arange(told.shape[-1])
    return Fresh(jnp.any(told, axis=1), fresh.mean[source, target], fresh.information[source, target])
