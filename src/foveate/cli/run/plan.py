"""Work of `foveate plan`."""

from foveate import api
from foveate.cli.common import check_output, print_tables
from foveate.cli.plan import Plan
from foveate.errors import InputError


def run(options: Plan) -> int:
    """Plan, print the summary, write the file."""
    check_output(options.json, options.scenes)
    if sum(source is not None for source in (options.run, options.config, options.preset)) > 1:
        raise InputError("--run, --config and --preset: each names a scenario; give one of them")
    evaluation = api.plan(
        options.scenes,
        experiment=options.config or options.preset or "paper",
        run=options.run,
        refine=options.refine,
        omniscient=options.omniscient,
        open_loop=options.open_loop,
        starts=options.starts,
        iterations=options.iterations,
        window=options.window,
        protocol=options.protocol,
        episodes=options.episodes,
        seed=options.seed,
        scene_seed=options.scene_seed,
    )
    print_tables(*evaluation.tables, wide=options.wide)
    if options.json is not None:
        evaluation.to_json(options.json)
    return 0
