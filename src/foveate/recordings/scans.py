"""Detections without ids made from a recording: what the filter expects of it, and the random numbers of its scans."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from foveate.errors import InputError
from foveate.io.validate import require
from foveate.models.detections.records import DetectionModel
from foveate.models.problem import Problem
from foveate.names import GATE
from foveate.recordings.recording import Recording, Slots, resample
from foveate.scenario.detections import MAX_SLOTS, BirthSettings, DetectionSettings
from foveate.scenario.population import most_of
from foveate.scenario.scenario import Scenario
from foveate.simulation.population import scan_noise, with_tracks
from foveate.simulation.records import Episode

LEAST_HALF_SIDE_M = 1.0
"""Least half side of the box of the detections [m]: a recording may have no extent along an axis."""
SPARE_TRACKS = 8
"""Room for false tracks, beside twice as many tracks as there are targets at once."""


def detecting(
    scenario: Scenario,
    recording: Recording,
    max_gap_s: float,
    gate: float | None = GATE,
    probability: float | None = None,
    clutter: float | None = None,
) -> Scenario:
    """The scenario of a replay with detections without ids, if it has them or one of the two numbers is given.

    Its own settings stay, but for these numbers. Without any, births, the survival and the expected number of targets
    at the start, anywhere in the recording's extent, are the recording's own, and no target is known; the box is that
    extent and a view around it, where false alarms may be. Raises InputError where settings are wrong, or have too
    little room for the recording's targets.
    """
    own, numbers = scenario.detections, {"probability": probability, "clutter": clutter}
    given: dict[str, Any] = {name: value for name, value in numbers.items() if value is not None}
    if own is None and not given:
        return scenario
    require(gate is not None, "gate", gate, "expected a probability, with detections without ids")
    given |= {} if gate == GATE else {"gate": gate}
    slots = resample(recording, float(scenario.tau_s), max_gap_s)
    most = int(slots.present.sum(axis=1).max())
    if own is not None:
        right = f"expected at least {most}, the most targets at once in {recording.short_name}"
        require(own.tracks >= most, "detections.tracks", own.tracks, right)
        return replace(scenario, detections=_of(own, **given))
    return _fitted(scenario, recording, slots, most, given)


def _of(settings: DetectionSettings, **changes: Any) -> DetectionSettings:
    try:
        return replace(settings, **changes)
    except InputError as error:
        raise InputError(f"detections.{str(error).removeprefix('DetectionSettings: ')}") from None


def _fitted(scenario: Scenario, recording: Recording, slots: Slots, most: int, given: dict[str, Any]) -> Scenario:
    """The scenario with the recording's own rates and box."""
    depth_m = float(scenario.view.depth_m)
    require(np.isfinite(depth_m), "view.depth_m", depth_m, "expected a finite depth, with detections without ids")
    index, steps = slots.track_index, len(slots.times_s) - 1
    there, stays = index >= 0, (index[1:] == index[:-1]) & (index[1:] >= 0)
    begins, ends = (int((part & ~stays).sum()) for part in (there[1:], there[:-1]))
    lower, upper = recording.extent
    middle, half = (lower + upper) / 2, np.maximum((upper - lower) / 2, LEAST_HALF_SIDE_M)
    at_once = max(1, round(float(there.sum(axis=1).mean())))
    low, high, around = *_corners(middle, half), _corners(middle, half + depth_m)
    # Half an event more: what a recording does not show may be rare, but is not impossible.
    births = BirthSettings(rate=(begins + 0.5) / steps, low_m=low, high_m=high)
    base, alarms = DetectionSettings(low_m=around[0], high_m=around[1]), given.get("clutter", 0.0)
    room = most + most_of(alarms) if 0 <= alarms < MAX_SLOTS else 0
    detections = _of(
        base,
        births=(births,),
        survival=1.0 - (ends + 0.5) / (int(there[:-1].sum()) + 1.0),
        tracks=min(max(2 * most + SPARE_TRACKS, base.tracks), MAX_SLOTS),
        detections=min(max(room, base.detections), MAX_SLOTS),
        known=False,
        **given,
    )
    scenes = replace(
        scenario.scenes,
        targets_min=at_once,
        targets_max=at_once,
        centre_m=tuple(middle.tolist()),
        # Of the recording alone, which a map that is given holds.
        half_side_m=tuple(np.maximum((upper - lower) / 2, 1e-3).tolist()),
        half_side_per_target_m=0.0,
        known_drift=False,
        birth_and_death=False,
        target_ring_m=None,
        steps=steps,
    )
    return replace(scenario, scenes=scenes, detections=detections)


def _corners(
    middle: Float[np.ndarray, " d"], half: Float[np.ndarray, " d"]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return tuple((middle - half).tolist()), tuple((middle + half).tolist())


def outside(scenario: Scenario, slots: Slots) -> list[str]:
    """A warning about recorded targets outside of the box of the scenario's detections, if there are any."""
    if scenario.detections is None:
        return []
    points = slots.positions_m[slots.present]
    low, high = np.array(scenario.detections.low_m), np.array(scenario.detections.high_m)
    share = float(np.any((points < low) | (points > high), axis=1).mean())
    where = "outside of the box of scenario.detections, low_m to high_m: the filter takes it to be at the border"
    return [f"{share:.0%} of the target time is {where}"] if share else []


def with_scans(problem: Problem, model: DetectionModel, episode: Episode, seed: int) -> Episode:
    """The episode of a recording with scans in place of identities: its recorded targets are detected or missed.

    Those of the first instant have a track each if the model's targets are `known`.
    """
    arrivals = episode.arrivals
    assert arrivals is not None, "recorded targets come and go"
    present, alarms = np.asarray(arrivals.present), _most_alarms(model)
    steps, targets = present.shape[0] - 1, present.shape[1]
    rng = np.random.default_rng([seed, 0x7363616E])  # apart from the noise of measurements, which stays
    sizes = (steps, targets), (steps,), (steps, alarms), (steps, targets + alarms)
    numbers = [jnp.asarray(rng.random(size), float) for size in sizes]
    scans = scan_noise(model, arrivals.present, *numbers)
    # Slots of tracks are fewer than columns: the targets that are there come first.
    order = np.argsort(~present[0], kind="stable")
    first = replace(episode, mean=episode.mean[order], present=episode.present[order], arrivals=None)
    return with_tracks(problem, first, scans)


def _most_alarms(model: DetectionModel) -> int:
    assert model.sources is not None, "a scenario's model has them"
    return model.sources.clutter
