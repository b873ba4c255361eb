"""Pictures of a Gymnasium environment's running episode, as `foveate render` draws them."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np

from foveate.models.detections.expectation import confirmed
from foveate.models.detections.records import Population
from foveate.models.problem import Problem, first_information
from foveate.plotting.animation import picture
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData, state_data
from foveate.plotting.track_data import track_data
from foveate.simulation.batch import Batch
from foveate.simulation.scans import begin


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
        self._alive = None if episode.scans is None else np.asarray(episode.scans.alive[0])
        self._instants: list[list[np.ndarray]] = []
        if self._alive is not None:
            population = begin(self._problem, jax.tree.map(lambda x: x[0], episode))
            self._columns = np.arange(self._alive.shape[1])
            self._append_tracks(episode.pose[0], population, np.zeros_like(self._alive[0]))
            return
        present = np.asarray(episode.present[0] if episode.arrivals is None else episode.arrivals.present[0, 0])
        self._columns = np.flatnonzero(episode.present[0])
        information = first_information(self._problem, len(present))
        self._append(episode.pose[0], episode.mean[0], information, present, np.zeros_like(present))

    def add(self, batch: Batch) -> None:
        """Add the state after the last step."""
        assert batch.transition is not None, "the batch has stepped"
        state, visible = batch.transition.state, batch.transition.visible
        if state.population is not None:
            self._append_tracks(state.pose[0], jax.tree.map(lambda x: x[0], state.population), visible[0])
            return
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
        if self._alive is not None:
            return self._data_of_tracks(self._alive[: self._horizon + 1], pose, *columns)
        mean, information, present, visible = (values[:, self._columns] for values in columns)
        # Without truth targets are drawn at their estimates.
        truth = mean if self._truth is None else self._truth[: self._horizon + 1, self._columns]
        return self._drawn(pose, mean, information, visible, present, truth)

    def _data_of_tracks(self, alive, pose, mean, information, existence, shown, visible, undetected) -> EpisodeData:
        """The same of detections without ids; GOSPA is that of the steps so far."""
        assert self._truth is not None, "episodes with scans have it"
        truth = self._truth[: self._horizon + 1]
        so_far = slice(max(2, len(self._instants)))
        parts = {"existence": existence, "confirmed": shown, "mean": mean, "truth": truth, "alive": alive}
        parts["undetected"] = undetected
        gospa_m = track_data(self._problem, **{name: values[so_far] for name, values in parts.items()}).gospa_m
        tracks = replace(track_data(self._problem, **parts), gospa_m=gospa_m)
        return self._drawn(pose, mean, information, visible, alive, truth, tracks)

    def _drawn(self, pose, mean, information, visible, present, truth, tracks=None) -> EpisodeData:
        return state_data(
            self._problem,
            pose=pose,
            mean=mean,
            information=information,
            log_det=np.linalg.slogdet(information[1:])[1],
            visible=visible[1:],
            present=present,
            truth=truth,
            tracks=tracks,
        )

    def _append_tracks(self, pose: Any, population: Population, visible: Any) -> None:
        """Append the tracks of detections without ids, and the map of undetected targets."""
        tracks, model = population.tracks, self._problem.detections
        assert model is not None, "problems with tracks have it"
        shown = confirmed(self._problem, model, tracks)
        information = np.linalg.inv(np.asarray(tracks.covariance, float))
        self._append(pose, tracks.mean, information, tracks.existence, shown, visible, population.undetected)

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
