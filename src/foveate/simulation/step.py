"""One step of the simulation as a tuple of named pure stages, which `stages` chooses for the kind of episode.

Step k: predict p_{k+1}, P_{k+1}; observe; decide u_k at T_k; then the stages: move to T_{k+1}, no farther than borders,
targets and obstacles allow, sense y_{k+1}, gate the measurements, correct the means, weigh, and update to mu_{k+1},
Y_{k+1}. A scenario without borders, a distance to keep, obstacles, truth, gate, missed detections or births and deaths
has no such stage, and does not pay for it.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.geometry.linalg import cholesky_spd, multiply
from foveate.models import belief, gate
from foveate.models.belief import Belief
from foveate.models.missed_detection import condition_on_missed_detection
from foveate.models.problem import Problem, first_information
from foveate.models.sensor import detection_weight
from foveate.simulation import motion
from foveate.simulation.draft import Draft, Sensed, Stage, noise_covariance, positions_body
from foveate.simulation.polar import compare_polar, correct_polar, expect_polar
from foveate.simulation.records import Episode, Instant, LastLook, Protocol, State
from foveate.simulation.scans import begin, predict_population, scan, shown, update_population
from foveate.simulation.sight import hide, weigh_sight
from foveate.types import Action


def instants(episode: Episode) -> Instant:
    """An episode cut into its steps: every array gets a leading axis of K."""
    truth = episode.truth and replace(episode.truth, state=episode.truth.state[1:])
    scans = episode.scans and replace(episode.scans, alive=episode.scans.alive[1:])
    arrivals = episode.arrivals and jax.tree.map(lambda part: part[1:], episode.arrivals)
    return Instant(episode.inputs, truth, arrivals, scans)


def start(problem: Problem, episode: Episode, protocol: Protocol) -> State:
    """The state before the first step."""
    present = episode.present if episode.arrivals is None else episode.arrivals.present[0]
    information = first_information(problem, episode.mean.shape[0])
    levels = max(1, len(protocol.levels))
    looks_back = episode.scans is None and episode.truth is not None and _uses_missed_detections(problem, protocol)
    state = State(
        step=jnp.zeros((), int),
        pose=episode.pose,
        mean=episode.mean,
        information=jnp.broadcast_to(information, (levels, *information.shape)),
        present=present,
        rejections=None if protocol.gate is None else jnp.zeros(present.shape, int),
        last_look=LastLook(episode.pose, jnp.zeros(present.shape, bool)) if looks_back else None,
        contacts=None if problem.obstacles is None else jnp.zeros((), int),
    )
    if problem.detections is None:
        return state
    return shown(problem, replace(state, dropped=jnp.zeros((), int)), begin(problem, episode))


def predict(problem: Problem, state: State, known_input: Float[Array, "n m_y"]) -> State:
    """Predict every belief one step ahead; the pose is still T_k."""
    problem = problem.at(state.step)
    if state.population is not None:
        return predict_population(problem, state, known_input)
    ahead = jax.vmap(jax.vmap(belief.predict_information, (0, None)), (0, None))
    information = ahead(state.information, problem.motion)
    return replace(state, mean=problem.motion.advance(state.mean, known_input), information=information)


def stages(problem: Problem, protocol: Protocol, instant: Instant) -> tuple[Stage, ...]:
    """The stages after a decision that problem, protocol and the kind of episode need."""
    has_truth, has_births = instant.truth is not None, instant.arrivals is not None
    has_gate = has_truth and protocol.gate is not None
    uses_missed_detections = has_truth and _uses_missed_detections(problem, protocol)
    keeps_off = problem.obstacles is not None and problem.obstacles.keep_off is not None
    way = (
        *((motion.keep_off_obstacles,) if keeps_off else ()),
        motion.move,
        *((motion.stop_at_border,) if problem.bounds_agent else ()),
        *((motion.keep_off_targets,) if problem.keep_off_m is not None else ()),
        *((motion.stop_at_obstacles,) if problem.obstacles is not None else ()),
    )
    if problem.detections is not None:
        shares = problem.team is not None and problem.team.radio.kind != "silent"  # then the exchange updates
        return (*way, *((scan,) if shares else (scan, update_population))) if has_truth else way
    return (
        *way,
        motion.expect_noise if problem.sensor.polar is None else expect_polar,
        *((sense,) if has_truth else ()),
        *((hide,) if has_truth and problem.obstacles is not None else ()),
        *((gate_measurements,) if has_gate else ()),
        *((correct_means if problem.sensor.polar is None else correct_polar,) if has_truth else ()),
        weigh_softly if protocol.levels else weigh_measured,
        *((weigh_sight,) if protocol.levels and problem.obstacles is not None else ()),
        update_information,
        *((restart_beliefs,) if has_gate else ()),
        *((use_missed_detections,) if uses_missed_detections else ()),
        *((replace_targets,) if has_births else ()),
    )


def _uses_missed_detections(problem: Problem, protocol: Protocol) -> bool:
    """Negative information is of the real field of view: a soft view has already counted a part of a measurement."""
    return problem.sensor.uses_missed_detections and not protocol.levels


def act(problem: Problem, protocol: Protocol, predicted: State, instant: Instant, action: Action) -> Draft:
    """Run the stages on a predicted state and an action; the draft's `state` is that after the step.

    The stages depend on what is present, never on values, so that a compiled program holds one fixed sequence.
    """
    problem, n = problem.at(predicted.step), len(predicted.present)
    draft = Draft(
        predicted=predicted,
        action=action,
        instant=instant,
        state=replace(predicted, step=predicted.step + 1),
        covariance=jnp.broadcast_to(problem.sensor.V, (n, *problem.sensor.V.shape)),
        measured=jnp.zeros(n, bool),
        weight=jnp.zeros((1, n)),
    )
    for stage in stages(problem, protocol, instant):
        draft = stage(problem, protocol, draft)
    return draft


def sense(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Measure every target at its true position; only those in view, and present before and after, count."""
    reality, arrivals, pose = draft.instant.truth, draft.instant.arrivals, draft.state.pose
    assert reality is not None, "a stage of episodes with truth"
    position_body = positions_body(problem, pose, reality.state)
    in_view = problem.sensor.view.contains(position_body) & draft.predicted.present
    if arrivals is not None:
        in_view = in_view & arrivals.present
    root = cholesky_spd(noise_covariance(problem, pose, position_body))
    noise = multiply(root, reality.measurement_noise[..., None])
    measurement = problem.sensor.expected(reality.state, position_body) + noise[..., 0]
    return draft._replace(sensed=Sensed(position_body, in_view, measurement), measured=in_view)


def gate_measurements(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Reject measurements too far from their prediction; after several in a row, restart the belief from the last."""
    sensed, rejections = draft.sensed, draft.state.rejections
    assert sensed is not None, "a stage of episodes with truth"
    assert protocol.gate is not None, "a stage of protocols with a gate"
    assert rejections is not None, "`start` counts them where there is a gate"

    distance, fresh = (_compare if problem.sensor.polar is None else compare_polar)(problem, draft, sensed)
    # Written so that a distance that is not a number is rejected, too.
    rejected = sensed.in_view & ~(distance <= protocol.gate)
    restarts = rejected & (rejections + 1 >= gate.RESTART_AFTER)
    measured = (sensed.in_view & ~rejected) | restarts
    state = replace(draft.state, rejections=jnp.where(measured, 0, jnp.where(rejected, rejections + 1, rejections)))
    return draft._replace(state=state, measured=measured, restart=(restarts, fresh))


def _compare(problem: Problem, draft: Draft, sensed: Sensed) -> tuple[Float[Array, " n"], Belief]:
    """Squared distances of measurements to their predictions, and the beliefs that begin with each."""
    H = problem.sensor.H
    # A fresh belief is where it was measured, and so is its V: the predicted mean has just been rejected.
    measured_body = positions_body(problem, draft.state.pose, sensed.measurement @ jnp.linalg.pinv(H).T)
    fresh_covariance = noise_covariance(problem, draft.state.pose, measured_body)

    def compare(mean, information, z, V, fresh_V):
        prediction = Belief(mean, information)
        return gate.squared_distance(prediction, z, H, V), gate.one_point(problem.prior_information, z, H, fresh_V)

    return jax.vmap(compare)(
        draft.predicted.mean, draft.predicted.information[-1], sensed.measurement, draft.covariance, fresh_covariance
    )


def correct_means(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """mu = p + K (z - H p) where a measurement is taken, with the gain of the predicted information."""
    assert draft.sensed is not None, "a stage of episodes with truth"
    corrected = jax.vmap(lambda p, P, z, V: belief.correct_mean(Belief(p, P), z, problem.sensor.H, V))(
        draft.predicted.mean, draft.predicted.information[-1], draft.sensed.measurement, draft.covariance
    )
    mean = jnp.where(draft.measured[:, None], corrected, draft.state.mean)
    return draft._replace(state=replace(draft.state, mean=mean))


def weigh_softly(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """1 - Phi(d) of every level: the surrogate, at the predicted mean or, `at_truth`, at the true position."""
    if protocol.at_truth and draft.sensed is not None:
        position_body = draft.sensed.position_body
    else:
        position_body = positions_body(problem, draft.state.pose, draft.predicted.mean)
    distance = problem.sensor.view.signed_distance(position_body)
    return draft._replace(weight=jnp.stack([detection_weight(distance, level) for level in protocol.levels]))


def weigh_measured(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """1 where a measurement is taken, 0 elsewhere: the Kalman filter."""
    return draft._replace(weight=draft.measured.astype(draft.predicted.mean.dtype)[None])


def update_information(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Y = P + weight H^T V^-1 H, for every level."""
    gain = jax.vmap(problem.sensor.information)(draft.covariance) if draft.gain is None else draft.gain
    update = jax.vmap(jax.vmap(belief.update_information), (0, None, 0))
    information = update(draft.predicted.information, gain, draft.weight)
    return draft._replace(state=replace(draft.state, information=information))


def restart_beliefs(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Take the one-point belief where `gate_measurements` restarts one."""
    assert draft.restart is not None, "`gate_measurements` comes first"
    where, fresh = draft.restart
    return _with_beliefs(draft, where, fresh.mean, fresh.information)


def use_missed_detections(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Condition the belief of every target not in view on its being outside of the view.

    Of a target that was missed before, only on ground that the previous look did not show (`models.missed_detection`).
    """
    state, sensed, last = draft.state, draft.sensed, draft.state.last_look
    assert sensed is not None, "a stage of episodes with truth"
    assert last is not None, "`start` keeps it where missed detections are used"

    def is_shown(positions_world: Float[Array, "points d"], missed: Bool[Array, ""]) -> Bool[Array, " points"]:
        known = missed & problem.sees(last.pose, positions_world)
        return problem.sees(state.pose, positions_world) & ~known

    outside = jax.vmap(
        lambda m, Y, missed: condition_on_missed_detection(
            Belief(m, Y), problem.motion.Z, partial(is_shown, missed=missed)
        )
    )(state.mean, state.information[0], last.missed)
    draft = _with_beliefs(draft, ~sensed.in_view, outside.mean, outside.information)
    look = LastLook(state.pose, ~sensed.in_view & state.present)
    return draft._replace(state=replace(draft.state, last_look=look))


def replace_targets(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Begin the belief of every target that has just appeared; it could not be measured yet."""
    state, arrivals = draft.state, draft.instant.arrivals
    assert arrivals is not None, "a stage of episodes with births and deaths"
    begins = arrivals.present & ~draft.predicted.present
    rejections = None if state.rejections is None else jnp.where(begins, 0, state.rejections)
    draft = _with_beliefs(draft, begins, arrivals.mean, problem.prior_information)
    return draft._replace(state=replace(draft.state, present=arrivals.present, rejections=rejections))


def _with_beliefs(draft: Draft, where: Bool[Array, " n"], mean: Array, information: Array) -> Draft:
    """Replace the beliefs of all levels where `where` holds."""
    mean = jnp.where(where[:, None], mean, draft.state.mean)
    information = jnp.where(where[:, None, None], information, draft.state.information)
    return draft._replace(state=replace(draft.state, mean=mean, information=information))
