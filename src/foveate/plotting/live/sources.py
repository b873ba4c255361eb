"""Sources of the live view: methods in the scenes of an evaluation, or in a recording."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.evaluation.evaluate import prepare
from foveate.experiment.resolve import Subject, methods_of, scenes_of
from foveate.io.records import suggestion
from foveate.plotting.episode_data import EpisodeData, suite_data
from foveate.plotting.live.player import EpisodeSource
from foveate.plotting.replay import replay_data
from foveate.recordings.maps import under, warnings_of
from foveate.recordings.motion import default_max_gap_s
from foveate.recordings.plausibility import warnings_for
from foveate.recordings.recording import Recording, moved
from foveate.recordings.replay import drive, prepare_replay
from foveate.recordings.scans import detecting
from foveate.recordings.starts import default_agent_start
from foveate.scenario.scenes import Scene


def methods_from(first: str | None, has_ids: bool = True) -> tuple[str, ...]:
    """All methods, `first` at the beginning; those that search are of detections without ids."""
    everything = methods_of("all", has_ids)
    if first == "all":
        raise InputError(f"method all: expected one of {', '.join(everything)}, to begin with")
    return everything if first is None else tuple(dict.fromkeys((*methods_of(first), *everything)))


def simulated(
    subject: Subject,
    scenes: str | Path | Sequence[Scene] | None,
    first: str | None,
    methods: Sequence[str],
    protocol: str,
    seed: int,
    scene_seed: int,
) -> EpisodeSource:
    """Episodes of scenes, the one with the id `first` at the beginning, with the noise of an evaluation from `seed`."""
    name, suite = scenes_of(scenes, scene_seed, subject.experiment)
    by_id = {scene.id: scene for scene in suite}
    if first is not None and first not in by_id:
        raise InputError(f"scene {first}: no such scene in {name}: {suggestion(first, by_id)}")
    order = by_id if first is None else dict.fromkeys((first, *by_id))
    problem, settings = subject.experiment.scenario.problem(), subject.experiment.scenario.scenes

    def episode(scene: str, method: str) -> EpisodeData:
        ready = prepare(problem, settings, [by_id[scene]], seed)
        return suite_data(ready, subject.policy(method), protocol, subject.name if method == "policy" else method)[0]

    return EpisodeSource(scenes=tuple(order), methods=tuple(methods), episode=episode)


def recorded(
    subject: Subject,
    recording: Recording,
    methods: Sequence[str],
    max_gap: float | None,
    seed: int,
    map: Path | None = None,
    detection_probability: float | None = None,
    clutter: float | None = None,
) -> tuple[EpisodeSource, list[str]]:
    """Episodes of a recording, begun in its middle, in a robot's map if there is one, and warnings about it.

    With a probability of detection, or clutter, detections have no ids (`recordings.scans`).
    """
    scenes = (Path(recording.name).name,)
    recording = moved(recording, subject.experiment.scenario.origin)
    scenario, doubts = under(recording, subject.experiment.scenario, map)
    gap_s = default_max_gap_s(recording) if max_gap is None else max_gap
    scenario = detecting(scenario, recording, gap_s, probability=detection_probability, clutter=clutter)
    subject = replace(subject, experiment=replace(subject.experiment, scenario=scenario))
    box_world = jnp.asarray(np.stack(recording.extent), float)
    ready = prepare_replay(scenario, recording, default_agent_start(recording, scenario, seed), gap_s, seed)

    def episode(scene: str, method: str) -> EpisodeData:
        _, trace = drive(ready, method, subject.policy(method, box_world))
        return replay_data(ready, trace, f"{subject.name if method == 'policy' else method} on {scene}")

    found = warnings_for(scenario, recording, ready.slots, gap_s)
    warnings = [*doubts, *found, *warnings_of(ready.inside, ready.slots)]
    return EpisodeSource(scenes=scenes, methods=tuple(methods), episode=episode), warnings
