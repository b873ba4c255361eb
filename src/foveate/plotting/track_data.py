"""Tracks of detections without ids, to draw: their existence, and the map of targets that were never detected."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.evaluation.gospa import mean_gospa
from foveate.models.problem import Problem
from foveate.simulation.records import TRUE, Episode, Trace
from foveate.simulation.rollout import simulate
from foveate.simulation.scans import begin
from foveate.simulation.team.rollout import simulate as team_simulate


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackData:
    """Tracks at every instant, and the expected number of targets never detected in each cell of a box [m].

    `existence` is 0 in slots without a track; policies are told of those above `tell`, the `confirmed` ones are
    reported. `gospa_m` is the mean GOSPA over the steps [m].
    """

    existence: Float[np.ndarray, "instants b"]
    confirmed: Bool[np.ndarray, "instants b"]
    tell: float
    gospa_m: float
    box: Float[np.ndarray, "2 d"]
    undetected: Float[np.ndarray, "instants *cells"] | None = None

    @property
    def expected(self) -> Float[np.ndarray, " instants"]:
        """Expected number of targets, in tracks and never detected."""
        number = self.existence.sum(axis=1)
        return number if self.undetected is None else number + self.undetected.reshape(len(number), -1).sum(axis=1)


def track_data(
    problem: Problem,
    *,
    existence: Float[np.ndarray, "instants b"],
    confirmed: Bool[np.ndarray, "instants b"],
    mean: Float[np.ndarray, "instants b n_y"],
    truth: Float[np.ndarray, "instants targets n_y"],
    alive: Bool[np.ndarray, "instants targets"],
    undetected: Float[np.ndarray, "instants *cells"] | None = None,
) -> TrackData:
    """Tracks with these means beside the true states of the targets that are `alive`."""
    model, Z = problem.detections, np.asarray(problem.motion.Z, float)
    assert model is not None, "for problems with detections"
    estimates, targets = mean[1:] @ Z.T, truth[1:] @ Z.T
    found = mean_gospa(estimates, confirmed[1:], targets, alive[1:], float(np.asarray(model.cutoff)))
    return TrackData(
        existence=existence,
        confirmed=confirmed,
        tell=model.tell,
        gospa_m=found.gospa,
        box=np.array([model.grid.low, model.grid.high], float),
        undetected=undetected,
    )


def intensities(problem: Problem, episode: Episode, trace: Trace) -> Float[np.ndarray, "instants *cells"]:
    """The intensity of undetected targets at every instant: the filter again, on the actions of a trace."""
    if trace.team is not None:
        return np.asarray(_of_team(problem, episode, jnp.asarray(trace.team.action)))
    return np.asarray(_intensities(problem, episode, jnp.asarray(trace.action)))


@eqx.filter_jit
def _of_team(problem: Problem, episode: Episode, action: Float[Array, "K M m"]) -> Float[Array, "instants *cells"]:
    """The intensity of the filter that hears every scan."""

    def decide(observation, memory, key):
        own = action[observation.step, observation.team.number]
        return own, jnp.zeros_like(observation.mean[:, 0]), memory, ()

    def record(outcome):
        return outcome.state.central.population.undetected

    after = team_simulate(problem, decide, episode, TRUE, jax.random.key(0), record)[2]
    return jnp.concatenate([begin(problem, episode).undetected[None], after])


@eqx.filter_jit
def _intensities(problem: Problem, episode: Episode, action: Float[Array, "K m"]) -> Float[Array, "instants *cells"]:
    def decide(observation, memory, key):
        return action[observation.step], memory, ()

    def record(outcome):
        return outcome.state.population.undetected

    after = simulate(problem, decide, episode, TRUE, jax.random.key(0), record)
    return jnp.concatenate([begin(problem, episode).undetected[None], after])
