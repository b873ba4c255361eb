"""Work of `foveate view`."""

import sys

from foveate.cli.common import check_output, check_seed, policy_named
from foveate.cli.view import View
from foveate.experiment.resolve import subject_of
from foveate.plotting.live.player import EpisodeSource
from foveate.plotting.live.server import record, serve
from foveate.plotting.live.sources import methods_from, recorded, simulated
from foveate.recordings.formats import load_recording, load_window
from foveate.recordings.outliers import prepared


def run(options: View) -> int:
    """Serve, or write the page."""
    check_output(options.record, options.scenes, options.recording)
    check_seed(options.seed)
    check_seed(options.scene_seed, "--scene-seed")
    source = _source(options)
    if options.record is None:
        serve(source, options.port, lambda line: print(line, flush=True))
        return 0
    data = source.episode(source.scenes[0], source.methods[0])
    record(data, options.record)
    print(f"{options.record}: {data.title}")
    return 0


def _source(options: View) -> EpisodeSource:
    subject = subject_of(policy_named(options.run))
    methods = methods_from(options.method, subject.experiment.scenario.detections is None)
    if options.recording is None:
        noise = (options.protocol, options.seed, options.scene_seed)
        return simulated(subject, options.scenes, options.scene, methods, *noise)
    whole = load_recording(options.recording, **options.reading())
    recording = prepared(load_window(whole, options.start, options.end), options.max_speed)
    source, warnings = recorded(subject, recording, methods, options.max_gap, options.seed, options.map)
    for line in recording.notes:
        print(line, file=sys.stderr)
    for line in warnings:
        print(f"warning: {line}", file=sys.stderr)
    return source
