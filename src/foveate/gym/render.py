"""Pictures of a Gymnasium environment's episode as it unfolds, the same as `foveate render` draws."""

from typing import Any, NamedTuple

import numpy as np

from foveate.models.problem import Problem, first_information
from foveate.plotting.animation import picture
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData, state_data
from foveate.simulation.batch import Batch


class _Instant(NamedTuple):
    pose: np.ndarray
    mean: np.ndarray
    information: np.ndarray
    present: np.ndarray
    visible: np.ndarray


class Screen:
    """Records the episode of the one environment of a batch, and draws it.

    With `window` on the screen too, which needs a backend of matplotlib that has windows.
    """

    def __init__(self, problem: Problem, window: bool) -> None:
        self._problem, self._window, self._figure = problem, window, None
        self._image: Any = None
        self._instants: list[_Instant] = []
        self._truth: np.ndarray | None = None
        self._horizon = 0

    def begin(self, batch: Batch) -> None:
        """Begin with the first beliefs of an episode."""
        assert batch.states is not None, "called after its begin"
        episode = batch.states.episode
        self._horizon = int(episode.horizon[0])
        self._truth = None if episode.truth is None else np.asarray(episode.truth.state[0], float)
        present = np.asarray(episode.present[0] if episode.arrivals is None else episode.arrivals.present[0, 0])
        self._instants = [
            _Instant(
                pose=np.asarray(episode.pose[0], float),
                mean=np.asarray(episode.mean[0], float),
                information=np.asarray(first_information(self._problem, len(present)), float),
                present=present,
                visible=np.zeros_like(present),
            )
        ]
        self._columns = np.flatnonzero(episode.present[0])
        self._show()

    def add(self, batch: Batch) -> None:
        """Add the state after the last step."""
        assert batch.transition is not None, "called after its step"
        state, visible = batch.transition.state, batch.transition.visible
        self._instants.append(
            _Instant(
                pose=np.asarray(state.pose[0], float),
                mean=np.asarray(state.mean[0], float),
                information=np.asarray(state.information[0, -1], float),
                present=np.asarray(state.present[0]),
                visible=np.asarray(visible[0]),
            )
        )
        self._show()

    def picture(self) -> np.ndarray:
        """Draw the moment after the last step: uint8, (height, width, 3)."""
        return picture(self._data(), SUBSTEPS * (len(self._instants) - 1))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._figure is not None:
            import matplotlib.pyplot as plt

            plt.close(self._figure)
            self._figure = None

    def _data(self) -> EpisodeData:
        """Data of the whole episode; instants to come are as the last one, so that frame and axes stay in place."""
        instants = self._instants + self._instants[-1:] * (self._horizon + 1 - len(self._instants))
        pose, *columns = (np.stack(values) for values in zip(*instants, strict=True))
        mean, information, present, visible = (values[:, self._columns] for values in columns)
        return state_data(
            self._problem,
            pose=pose,
            mean=mean,
            information=information,
            log_det=np.linalg.slogdet(information[1:])[1],
            visible=visible[1:],
            present=present,
            # A task of a user may have no truth: targets are then drawn where they are believed.
            truth=mean if self._truth is None else self._truth[: self._horizon + 1, self._columns],
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
