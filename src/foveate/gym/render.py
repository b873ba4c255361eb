"""Pictures of a Gymnasium environment's running episode, as `foveate render` draws them."""

from typing import Any

import numpy as np

from foveate.models.problem import Problem, first_information
from foveate.plotting.animation import picture
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData, state_data
from foveate.simulation.batch import Batch


class Screen:
    """Records and draws the episode of one environment; in a `window` too, if matplotlib's backend has windows."""

    def __init__(self, problem: Problem, window: bool) -> None:
        self._problem, self._window = problem, window
        self._figure: Any = None
        self._image: Any = None
        self._truth: np.ndarray | None = None

    def begin(self, batch: Batch) -> None:
        """Begin with the initial beliefs of an episode."""
        assert batch.states is not None, "the batch has begun"
        episode = batch.states.episode
        if episode.map_number is not None:
            self._problem = self._problem.of_map(episode.map_number[0])
        self._horizon = int(episode.horizon[0])
        self._truth = None if episode.truth is None else np.asarray(episode.truth.state[0], float)
        present = np.asarray(episode.present[0] if episode.arrivals is None else episode.arrivals.present[0, 0])
        self._columns, self._instants = np.flatnonzero(episode.present[0]), []
        information = first_information(self._problem, len(present))
        self._append(episode.pose[0], episode.mean[0], information, present, np.zeros_like(present))

    def add(self, batch: Batch) -> None:
        """Add the state after the last step."""
        assert batch.transition is not None, "the batch has stepped"
        state, visible = batch.transition.state, batch.transition.visible
        self._append(state.pose[0], state.mean[0], state.information[0, -1], state.present[0], visible[0])

    def picture(self) -> np.ndarray:
        """Draw the state after the last step: uint8, (height, width, 3)."""
        return picture(self._data(), SUBSTEPS * (len(self._instants) - 1))

    def close(self) -> None:
        """Close the window, if any."""
        if self._figure is not None:
            from matplotlib import pyplot

            pyplot.close(self._figure)
            self._figure = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_figure": None, "_image": None}  # a copy opens a window of its own

    def _data(self) -> EpisodeData:
        """Data of the whole episode; future instants repeat the last one, so that frame and axes stay in place."""
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
            # Without truth targets are drawn at their estimates.
            truth=mean if self._truth is None else self._truth[: self._horizon + 1, self._columns],
        )

    def _append(self, *instant: Any) -> None:
        """Append pose, mean, information, presence and visibility; show them in the window, if any."""
        self._instants.append([np.asarray(values, None if values.dtype == bool else float) for values in instant])
        if not self._window:
            return
        from matplotlib import pyplot

        frame = self.picture()
        if self._figure is None:
            height, width, _ = frame.shape
            self._figure = pyplot.figure("foveate", figsize=(width / 100, height / 100), dpi=100)
            self._image = self._figure.figimage(frame)
        self._image.set_data(frame)
        pyplot.pause(0.01)  # draws, and lets the window respond
