"""Pictures of a Gymnasium environment's episode as it unfolds, the same as `foveate render` draws."""

from typing import Any

import numpy as np

from foveate.models.problem import Problem, first_information
from foveate.plotting.animation import picture
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.simulation.batch import Batch


class Screen:
    """Records and draws the episode of a batch of one environment.

    With `window` it is shown on the screen too, which needs a backend of matplotlib that has windows.
    """

    def __init__(self, problem: Problem, window: bool) -> None:
        self._problem, self._window, self._figure = problem, window, None
        self._image: Any = None
        self._steps: list[dict[str, np.ndarray]] = []
        self._truth: np.ndarray | None = None
        self._horizon = 0

    def begin(self, batch: Batch) -> None:
        """Begin with the first beliefs of an episode."""
        assert batch.moments is not None, "called after its begin"
        episode = batch.moments.episode
        self._horizon = int(episode.horizon[0])
        self._truth = None if episode.truth is None else np.asarray(episode.truth.state[0], float)
        present = np.asarray(episode.present[0] if episode.arrivals is None else episode.arrivals.present[0, 0])
        self._steps = [
            {
                "pose": np.asarray(episode.pose[0], float),
                "mean": np.asarray(episode.mean[0], float),
                "information": np.asarray(first_information(self._problem, len(present)), float),
                "present": present,
                "visible": np.zeros_like(present),
            }
        ]
        self._columns = np.flatnonzero(episode.present[0])
        self._show()

    def add(self, batch: Batch) -> None:
        """Add the last step."""
        assert batch.transition is not None, "called after its step"
        state, visible = batch.transition.state, batch.transition.visible
        self._steps.append(
            {
                "pose": np.asarray(state.pose[0], float),
                "mean": np.asarray(state.mean[0], float),
                "information": np.asarray(state.information[0, -1], float),
                "present": np.asarray(state.present[0]),
                "visible": np.asarray(visible[0]),
            }
        )
        self._show()

    def picture(self) -> np.ndarray:
        """Picture after the last step: uint8, (height, width, 3)."""
        return picture(self._episode_data(), SUBSTEPS * (len(self._steps) - 1))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._figure is not None:
            import matplotlib.pyplot as plt

            plt.close(self._figure)
            self._figure = None

    def _episode_data(self) -> EpisodeData:
        """The whole episode, with the present state at all later steps, so that frame and axes of a picture stay."""
        kept = self._steps + self._steps[-1:] * (self._horizon + 1 - len(self._steps))
        pose, mean, information, present, visible = (np.stack([step[name] for step in kept]) for name in kept[0])
        mean, information, present, visible = (x[:, self._columns] for x in (mean, information, present, visible))
        information = np.where(present[..., None, None], information, np.eye(mean.shape[-1]))
        truth = mean if self._truth is None else self._truth[: self._horizon + 1, self._columns]
        Z, outline = np.asarray(self._problem.motion.Z, float), self._problem.sensor.view.outline()
        return EpisodeData(
            title="",
            space=self._problem.agent.space,
            visible=visible[1:],
            log_det=np.linalg.slogdet(information[1:])[1],
            times_s=np.concatenate([[0.0], np.cumsum(self._problem.step_lengths_s(self._horizon))]),
            pose=pose,
            truth=truth @ Z.T,
            estimate=mean @ Z.T,
            covariance=Z @ np.linalg.inv(information) @ Z.T,
            present=present,
            outline=tuple(
                np.asarray(line, float) for line in ([outline] if isinstance(outline, np.ndarray) else outline)
            ),
        )

    def _show(self) -> None:
        if not self._window:
            return
        import matplotlib.pyplot as plt

        frame = self.picture()
        if self._figure is None:
            self._figure = plt.figure("foveate", figsize=(frame.shape[1] / 100, frame.shape[0] / 100), dpi=100)
            self._image = self._figure.figimage(frame)
        else:
            self._image.set_data(frame)
        plt.pause(0.01)  # draws, and lets the window answer
