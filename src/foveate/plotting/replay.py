"""Figure and animation of methods on a recording."""

from pathlib import Path

from foveate.plotting.animation import animate
from foveate.plotting.episode_data import EpisodeData, episode_data
from foveate.plotting.replay_figure import replay_figure
from foveate.recordings.compare import ReplayResult
from foveate.recordings.measures import PreparedReplay
from foveate.simulation.records import Trace


def replay_data(ready: PreparedReplay, trace: Trace, title: str) -> EpisodeData:
    """Episode data of one method on a recording."""
    steps, columns = trace.visible.shape
    return episode_data(ready.problem, trace, ready.truth, steps, columns, title)


def draw_replay(result: ReplayResult, folder: Path) -> str:
    """Write replay.png, of every method, and replay.gif, of the first: return the name of the first."""
    name_of = result.settings.recording
    data = {name: replay_data(*run, f"{name} on {name_of}") for name, run in result.traces.items()}
    replay_figure(data, folder / "replay.png")
    first = next(iter(data))
    animate(data[first], folder / "replay.gif")
    return first
