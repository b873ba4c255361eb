"""A simulated episode that draws and animates itself."""

import base64
from dataclasses import dataclass, fields
from pathlib import Path

from matplotlib.axes import Axes

from foveate.evaluation.evaluate import prepare
from foveate.experiment.resolve import NamedPolicy, scenes_of
from foveate.io.figures import DPI, new_figure
from foveate.io.files import write_atomic
from foveate.io.validate import require, seed_number
from foveate.names import ProtocolName
from foveate.plotting.animation import animate, gif
from foveate.plotting.episode_data import EpisodeData, suite_data
from foveate.plotting.figures import draw_scene
from foveate.plotting.scene_spatial import scene_class
from foveate.scenario.scenes import Scene
from foveate.simulation.records import PROTOCOLS


@dataclass(frozen=True)
class Gif:
    """An animation, which a notebook shows."""

    content: bytes

    def save(self, path: str | Path) -> None:
        """Write the file, whole or not at all."""
        write_atomic(path, self.content)

    def _repr_html_(self) -> str:
        return f'<img src="data:image/gif;base64,{base64.b64encode(self.content).decode()}">'


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SimulatedEpisode(EpisodeData):
    """An episode as numpy arrays (see `EpisodeData`), with its pictures; from the `simulate` of a policy."""

    def plot(self, ax: Axes | None = None, *, step: int | None = None) -> Axes:
        """Draw the scene after a step, by default the last, with the path up to there.

        Args:
            ax: Axes to draw in, of a 3-D projection in space; None: new ones.
            step: Steps since the start.

        Returns:
            The axes: `ax.figure.savefig("episode.png")`.

        Raises:
            InputError: There is no such step.
        """
        last = self.steps if step is None else step
        require(0 <= last <= self.steps, "step", step, f"expected from 0 to {self.steps}")
        kind = scene_class(self)
        axes = new_figure(5.0, 5.0, DPI).add_subplot(axes_class=kind.axes_class) if ax is None else ax
        draw_scene(axes, self, last, kind.limits([self]), scale=1.0)
        return axes

    def animate(self, path: str | Path | None = None, fps: int = 10) -> Gif | None:
        """Animate the episode as .gif or .mp4, or its last moment as .png; without a path, return it for a notebook.

        Args:
            path: File to write.
            fps: Frames per second.

        Raises:
            InputError: Another ending, a bad `fps`, or no ffmpeg for .mp4.
        """
        if path is None:
            return Gif(gif(self, fps))
        animate(self, path, fps)
        return None

    def __repr__(self) -> str:
        score = "" if self.score is None else f", score {self.score:.2f}"
        return f"SimulatedEpisode({self.title!r}: {self.targets} targets, {self.steps} steps{score})"


def simulate(policy: NamedPolicy, scene: Scene | None, protocol: ProtocolName, seed: int) -> SimulatedEpisode:
    """Run a policy through one scene, by default the first of its scenario's own, as an evaluation does."""
    seed_number(seed, "seed")
    require(protocol in PROTOCOLS, "protocol", protocol, f"expected {' or '.join(PROTOCOLS)}")
    require(scene is None or isinstance(scene, Scene), "scene", scene, "expected a foveate.Scene")
    _, scenes = scenes_of("own" if scene is None else [scene], 2023, policy.experiment)
    scenario = policy.experiment.scenario
    suite = prepare(scenario.problem(), scenario.scenes, scenes[:1], seed)
    (data,) = suite_data(suite, policy.network, protocol, policy.name)
    return SimulatedEpisode(**{field.name: getattr(data, field.name) for field in fields(data)})
