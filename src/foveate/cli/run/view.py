"""Work of `foveate view`."""

import sys

from foveate.cli.common import check_output, check_seed
from foveate.cli.view import View
from foveate.errors import InputError
from foveate.experiment.resolve import subject_of
from foveate.plotting.live.player import EpisodeSource
from foveate.plotting.live.server import record, serve
from foveate.plotting.live.sources import methods_from, recorded, simulated
from foveate.recordings.formats import load_window


def run(options: View) -> int:
    """Serve, or write the page."""
    _check(options)
    source = _source(options)
    if options.record is None:
        serve(source, options.port, lambda line: print(line, flush=True))
        return 0
    data = source.episode(source.scenes[0], source.methods[0])
    record(data, options.record)
    print(f"{options.record}: {data.title}")
    return 0


def _check(options: View) -> None:
    """Raise InputError where options are out of range, or exclude each other."""
    if options.scenes is not None and options.recording is not None:
        raise InputError("--scenes and --recording: expected one of them")
    if options.scene is not None and options.recording is not None:
        raise InputError("--scene: a recording is one scene")
    if not 1 <= options.port <= 65535:
        raise InputError(f"--port {options.port}: expected a whole number from 1 to 65535")
    if options.record is not None and options.record.suffix.lower() != ".html":
        raise InputError(f"{options.record}: expected a name that ends in .html")
    check_output(options.record, options.scenes, options.recording)
    check_seed(options.seed)
    check_seed(options.scene_seed, "--scene-seed")


def _source(options: View) -> EpisodeSource:
    subject, methods = subject_of(options.run), methods_from(options.method)
    if options.recording is None:
        noise = (options.protocol, options.seed, options.scene_seed)
        return simulated(subject, options.scenes, options.scene, methods, *noise)
    recording = load_window(options.recording, options.start, options.end)
    source, warnings = recorded(subject, recording, methods, options.max_gap, options.seed)
    for line in warnings:
        print(f"warning: {line}", file=sys.stderr)
    return source
