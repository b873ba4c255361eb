"""Work of `foveate replay`."""

from foveate import api
from foveate.cli.common import check_output, policy_named, print_tables
from foveate.cli.replay import Replay
from foveate.errors import InputError
from foveate.plotting.replay import draw_replay
from foveate.recordings.formats import load_recording
from foveate.ros.bag import write_bag


def run(options: Replay) -> int:
    """Replay every method from every start, print means, write files."""
    is_bag = options.out is not None and options.out.suffix == ".mcap"
    check_output(options.out, *options.recording, folder=not is_bag)
    check_output(options.json, *options.recording)
    recording = load_recording(options.recording, **options.reading())
    result = api.replay(
        policy_named(options.run),
        recording,
        method=options.method,
        start=options.start,
        end=options.end,
        split=options.split,
        part=options.part,
        candidates=options.candidates,
        agent_start=None if options.agent_start is None else _numbers(options.agent_start),
        starts=options.starts,
        max_gap=options.max_gap,
        max_speed=options.max_speed,
        gate=options.gate,
        detection_probability=options.detection_probability,
        clutter=options.clutter,
        seed=options.seed,
        map=options.map,
    )
    print_tables(result.table, wide=options.wide)
    if options.json is not None:
        result.to_json(options.json)
    if options.out is not None and is_bag:
        name = write_bag(result, options.out)
        print(f"{options.out}: a bag ({name})")
    elif options.out is not None:
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
