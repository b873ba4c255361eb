"""Plausibility of a replay: contradictions between a recording and a scenario, or within the recording."""

import jax.numpy as jnp
import numpy as np

from foveate.recordings.motion import fit_statistics, median_fix_interval_s
from foveate.recordings.recording import Recording, Slots
from foveate.scenario.scenario import Scenario

MAX_CLOCK_GAP = 20.0  # larger gaps in the recording's clock, in its median steps, are worth a warning
MAX_VARIANCE_RATIO = 4.0  # so is a process noise off by more than this factor in variance


def warnings_for(scenario: Scenario, recording: Recording, slots: Slots, max_gap_s: float) -> list[str]:
    """List the reasons to doubt the result of a replay, a line each; none where scenario and recording fit."""
    lines: list[str] = []
    most, trained = int(slots.present.sum(axis=1).max()), scenario.scenes.targets_max
    if most > trained:
        lines.append(f"up to {most} targets at once: the run's scenario goes up to {trained}")
    if slots.dropped:
        lines.append(f"{slots.dropped} tracks fall between the control instants and are left out")
    times = np.unique(np.concatenate([track.times_s for track in recording.tracks]))
    gaps = np.diff(times)
    if len(gaps) and gaps.max() > max(max_gap_s, MAX_CLOCK_GAP * np.median(gaps)):
        first = int(np.argmax(gaps))
        lines.append(
            f"nothing is recorded between {times[first]:.10g} s and {times[first + 1]:.10g} s: all targets leave and "
            "appear again; if the clock jumped, cut the recording there by start or end"
        )
    interval = median_fix_interval_s(recording) if any(len(track.times_s) > 1 for track in recording.tracks) else 0.0
    if interval > max_gap_s:
        lines.append(
            f"fixes are {interval:g} s apart, more than max_gap {max_gap_s:g} s: targets are absent most of the time"
        )
    motion = scenario.problem().motion
    if motion.state_size == scenario.dimension:
        try:
            statistics = fit_statistics(recording, float(scenario.tau_s), float(max_gap_s))
        except ValueError:  # too few pairs of fixes to estimate W
            return lines
        walk, claimed = float(np.trace(statistics.walk_covariance_m2)), float(jnp.trace(motion.W))
        if not walk / MAX_VARIANCE_RATIO <= claimed <= walk * MAX_VARIANCE_RATIO:
            lines.append(
                f"targets move {walk**0.5:.2g} m (rms) per step, the scenario's W claims {claimed**0.5:.2g} m: "
                "beliefs will be overconfident or too vague; fit a scenario to this recording"
            )
    return lines
