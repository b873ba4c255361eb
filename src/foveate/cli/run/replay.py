"""Work of `foveate replay`."""

from foveate import api
from foveate.cli.common import check_output, print_table
from foveate.cli.replay import Replay
from foveate.errors import InputError
from foveate.plotting.replay import draw_replay


def run(options: Replay) -> int:
    """Replay every method from every start, print means, write files."""
    check_output(options.out, folder=True)
    check_output(options.json, options.recording)
    result = api.replay(
        options.run,
        options.recording,
        method=options.method,
        start=options.start,
        end=options.end,
        agent_start=None if options.agent_start is None else _numbers(options.agent_start),
        starts=options.starts,
        max_gap=options.max_gap,
        gate=options.gate,
        seed=options.seed,
    )
    print_table(result.table.title, result.table.header, result.table.rows)
    if options.json is not None:
        result.to_json(options.json)
    if options.out is not None:
        options.out.mkdir(exist_ok=True)
        result.to_json(options.out / "replay.json")
        animated = draw_replay(result, options.out)
        print(f"{options.out}: replay.json, replay.png, replay.gif ({animated})")
    return 0


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"--agent-start {text}: {error}") from None
