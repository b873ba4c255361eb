"""Figure and animation of methods on a recording."""

from pathlib import Path

from foveate.plotting.animation import animate
from foveate.plotting.episode_data import EpisodeData, episode_data
from foveate.plotting.replay_figure import replay_figure
from foveate.plotting.track_data import intensities
from foveate.recordings.measures import PreparedReplay
from foveate.recordings.results import ReplayResult
from foveate.simulation.records import Trace


def replay_data(ready: PreparedReplay, trace: Trace, title: str, with_map: bool = True) -> EpisodeData:
    """Episode data of one method on a recording; of detections without ids with the map of undetected targets."""
    (steps, columns), scans = trace.visible.shape, {}
    if ready.problem.detections is not None:
        undetected = intensities(ready.problem, ready.episode, trace) if with_map else None
        scans = {"alive": ready.slots.present, "undetected": undetected}
    return episode_data(ready.problem, trace, ready.truth, steps, columns, title, **scans)


def draw_replay(result: ReplayResult, folder: Path) -> str:
    """Write replay.png, of every method, and replay.gif, of the first: return the name of the first."""
    name_of = result.settings.recording
    first = next(iter(result.traces))
    data = {name: replay_data(*run, f"{name} on {name_of}", name == first) for name, run in result.traces.items()}
    replay_figure(data, folder / "replay.png")
    animate(data[first], folder / "replay.gif")
    return first
