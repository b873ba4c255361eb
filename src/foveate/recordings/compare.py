"""Compare methods on a recording: each drives through it from the same starts, with the same noise."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.experiment.resolve import NamedPolicy, Subject, subject_of
from foveate.experiment.subjects import other_period
from foveate.io.progress import Bar
from foveate.names import GATE, Part
from foveate.recordings import replay as replays
from foveate.recordings.choice import best_of
from foveate.recordings.formats import AnyPath, load_window
from foveate.recordings.maps import under, warnings_of
from foveate.recordings.methods import method_in, replay_methods
from foveate.recordings.motion import default_max_gap_s
from foveate.recordings.outliers import prepared
from foveate.recordings.plausibility import warnings_for
from foveate.recordings.recording import Recording, moved
from foveate.recordings.replay import prepare_replay
from foveate.recordings.results import ReplayResult, ReplaySettings
from foveate.recordings.scans import detecting, outside
from foveate.recordings.split import parsed_split, part_of, span_of
from foveate.recordings.starts import agent_starts
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Policy


def replay(
    policy: NamedPolicy | Policy | str | Path,
    recording: Recording | AnyPath | Sequence[AnyPath],
    *,
    method: str | Sequence[str] = "all",
    start: float | None = None,
    end: float | None = None,
    split: str | Sequence[float] | None = None,
    part: Part = "judge",
    candidates: Sequence[NamedPolicy | str | Path] = (),
    agent_start: Sequence[float] | None = None,
    starts: int = 1,
    max_gap: float | None = None,
    max_speed: float | None = None,
    gate: float | None = GATE,
    detection_probability: float | None = None,
    clutter: float | None = None,
    map: str | Path | None = None,
    seed: int = 0,
    scenario: Scenario | None = None,
    progress: bool = True,
) -> ReplayResult:
    """Drive a policy, and heuristics beside it, through a recording of real targets; warnings go to standard error.

    Args:
        policy: as for `foveate.evaluate`.
        recording: files with the header time_s,track_id,x_m,y_m[,z_m], or what `foveate.load_recording` reads.
        method: as for `foveate.evaluate`; also planners: "icr" as published, "icr-4", "refine-15" (from the policy).
        start: first time to replay [s].
        end: last time to replay [s].
        split: shares of that time to train on, to choose on and to judge on, as "60,20,20".
        part: part of the split to replay: "train", "choose" or "judge".
        candidates: further policies; the best of all on the part to choose on is replayed on the part to judge on.
        agent_start: pose on the recording's map [m, rad], by default its middle; or those of all robots of a team.
        starts: number of starts; more than one are random.
        max_gap: longest gap between two fixes over which a target counts as present [s].
        max_speed: fastest that a target can move [m/s], by default far above its usual steps; infinity keeps all.
        gate: probability of the filter's chi-square gate; None accepts every measurement.
        detection_probability: of a target in the view; with it or `clutter` detections have no ids.
        clutter: expected number of false alarms a step, uniform in the view.
        map: YAML file of the robot's map (ROS's map_server), in the recording's frame: walls stop the robot and hide
            targets. By default the scenario's own obstacles, unless they are random.
        seed: of the noise and of random starts.
        scenario: replaces the one that the policy was trained for.
        progress: show a bar.
    """
    subjects = [subject_of(each, scenario) for each in (policy, *candidates)]
    numbers = gate, detection_probability, clutter, map, seed
    given = _Given(start, end, split, part, agent_start, starts, max_gap, max_speed, *numbers, not progress)
    return _judged(subjects, load_window(recording, start, end), method, given)


class _Given(NamedTuple):
    """The arguments of `replay` of these names; `quiet`: without a bar."""

    start: float | None
    end: float | None
    split: str | Sequence[float] | None
    part: Part
    agent_start: Sequence[float] | None
    starts: int
    max_gap: float | None
    max_speed: float | None
    gate: float | None
    detection_probability: float | None
    clutter: float | None
    map: str | Path | None
    seed: int
    quiet: bool


def _judged(
    subjects: Sequence[Subject], recording: Recording, method: str | Sequence[str], given: _Given
) -> ReplayResult:
    """Replay the only subject, or the best of several on the part to choose on."""
    have_ids = all(subject.experiment.scenario.detections is None for subject in subjects)
    has_ids = have_ids and given.detection_probability is given.clutter is None
    methods = replay_methods(method, has_ids)
    if len(subjects) == 1:
        return _replayed(subjects[0], recording, methods, given)
    if given.split is None or given.part != "judge":
        raise InputError("candidates: expected a split, on whose middle part they are compared, and part judge")
    if not has_ids:
        raise InputError("candidates: expected none with detections without ids: choose by GOSPA of a replay of each")
    choosing = given._replace(part="choose")
    compared = {each.name: _replayed(each, recording, ["policy"], choosing).rows for each in subjects}
    best, candidates = best_of(subjects, compared)
    result = _replayed(best, recording, methods, given)
    return replace(result, settings=replace(result.settings, candidates=candidates))


def _replayed(subject: Subject, recording: Recording, methods: Sequence[str], given: _Given) -> ReplayResult:
    shares = None if given.split is None else parsed_split(given.split)
    mine = moved(recording, subject.experiment.scenario.origin)
    used = prepared(mine if shares is None else part_of(mine, shares, given.part), given.max_speed)
    scenario, warnings = under(used, subject.experiment.scenario, given.map)
    subject = replace(subject, experiment=replace(subject.experiment, scenario=scenario))
    settings = ReplaySettings(
        run=subject.name,
        recording=used.short_name if shares is None else f"{used.short_name}, {span_of(used)}",
        seed=given.seed,
        gate=given.gate,
        start_s=given.start,
        end_s=given.end,
        max_gap_s=default_max_gap_s(used) if given.max_gap is None else given.max_gap,
        starts=agent_starts(used, scenario, given.agent_start, given.starts, given.seed),
        split=shares,
        part=None if shares is None else given.part,
        map=None if given.map is None else str(given.map),
    )
    numbers = given.detection_probability, given.clutter
    acting = detecting(scenario, used, settings.max_gap_s, given.gate, *numbers)
    return _run(subject, acting, methods, used, settings, warnings, given.quiet)


def _run(
    trained: Subject,
    scenario: Scenario,
    methods: Sequence[str],
    part: Recording,
    settings: ReplaySettings,
    doubts: Sequence[str],
    quiet: bool,
) -> ReplayResult:
    """Replay in a scenario: that of the subject's training, or the same with detections without ids."""
    subject = replace(trained, experiment=replace(trained.experiment, scenario=scenario))
    box_world = jnp.asarray(np.stack(part.extent), float)
    rows, traces, warnings, policies = [], {}, [], {}
    with Bar("replaying", len(settings.starts) * len(methods), "runs", quiet) as bar:
        for start in settings.starts:
            ready = prepare_replay(scenario, part, start, settings.max_gap_s, settings.seed, settings.gate)
            if not rows:  # the recording is the same from every start
                found = warnings_for(trained.experiment.scenario, part, ready.slots, settings.max_gap_s)
                found += [*warnings_of(ready.inside, ready.slots), *outside(scenario, ready.slots)]
                warnings = [*doubts, *other_period(subject), *found]
                for line in (*part.notes, *(f"warning: {line}" for line in warnings)):
                    bar.say(line)
                steps = len(ready.slots.times_s) - 1
                policies = {name: method_in(subject, name, box_world, steps) for name in methods}
            for name, policy in policies.items():
                row, trace = replays.drive(ready, name, policy)
                rows.append(row)
                traces.setdefault(name, (ready, trace))
                bar.update(len(rows), name)
    return ReplayResult(
        experiment=subject.experiment,
        recording=part,
        settings=settings,
        rows=tuple(rows),
        warnings=tuple(warnings),
        traces=traces,
    )
