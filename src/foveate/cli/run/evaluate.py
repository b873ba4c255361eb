"""Work of `foveate evaluate`."""

from foveate import api
from foveate.cli.common import check_output, policy_named, print_tables
from foveate.cli.evaluate import Evaluate
from foveate.errors import InputError
from foveate.names import PRESET_NAMES
from foveate.scenario.scenes import write_scenes


def run(options: Evaluate) -> int:
    """Evaluate, print the summary, write the files."""
    runs = [policy_named(name) for name in options.run]
    if not runs:
        raise InputError(f"expected at least one run folder or preset: presets are {', '.join(PRESET_NAMES)}")
    for path in (options.json, options.write_scenes):
        check_output(path, options.scenes)
    evaluation = api.evaluate(
        runs if len(runs) > 1 else runs[0],
        options.scenes,
        method=options.method,
        protocol=options.protocol,
        episodes=options.episodes,
        seed=options.seed,
        scene_seed=options.scene_seed,
        initial_error=options.initial_error,
        normalised=options.normalised,
    )
    print_tables(*evaluation.tables, wide=options.wide)
    if options.json is not None:
        evaluation.to_json(options.json)
    if options.write_scenes is not None:
        write_scenes(options.write_scenes, evaluation.scenes)
    return 0
