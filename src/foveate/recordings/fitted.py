"""Derive an experiment from a recording, with the statistics that it was made of."""

from dataclasses import dataclass
from pathlib import Path

from foveate.experiment.experiment import Experiment
from foveate.io.toml import save_toml
from foveate.io.validate import require
from foveate.names import Goal
from foveate.recordings.fit import Robot, fit_experiment
from foveate.recordings.formats import load_recording
from foveate.recordings.motion import MotionStatistics, fit_statistics
from foveate.recordings.recording import Recording, window


@dataclass(frozen=True, kw_only=True, repr=False)
class Fitted:
    """An experiment for the targets of a recording, ready for `foveate.train`; shows their statistics as text."""

    experiment: Experiment
    statistics: MotionStatistics
    recording: Recording

    def save(self, path: str | Path) -> None:
        """Write the experiment as a TOML file that people may edit, with the statistics as comments."""
        name = Path(self.recording.name).name
        header = "\n".join([f"Fitted to {name} by foveate fit.", *self.statistics.lines()])
        save_toml(self.experiment, path, header, sealed=False)

    def __repr__(self) -> str:
        return "\n".join(self.statistics.lines())


def fit(
    recording: Recording | str | Path,
    *,
    start: float | None = None,
    end: float | None = None,
    max_gap: float | None = None,
    v_max: float = 3.0,
    w_max: float = 1.5,
    view_depth: float = 10.0,
    view_angle_deg: float = 90.0,
    tau: float = 0.5,
    sensor_std_m: float = 0.3,
    goal: Goal = "seen",
) -> Fitted:
    """Derive an experiment from a recording of real targets: train its `experiment`, or `save` it.

    `start`, `end` and `max_gap` [s] as for `replay`; the others are of the robot that will move there: largest speed
    [m/s] and turn rate [rad/s], depth [m] and angle [deg] of its view, time between decisions [s], standard deviation
    of a measured position [m]. `goal`: to have targets in view ("seen"), or to know all of them well ("information").
    """
    require(tau > 0, "tau", tau, "expected > 0")
    part = window(as_recording(recording), start, end)
    statistics = fit_statistics(part, tau, max_gap)
    robot = Robot(v_max=v_max, w_max=w_max, depth_m=view_depth, angle_deg=view_angle_deg, std_m=sensor_std_m)
    return Fitted(experiment=fit_experiment(statistics, robot, goal), statistics=statistics, recording=part)


def as_recording(recording: Recording | str | Path) -> Recording:
    """The recording, read from its file where that is given."""
    return recording if isinstance(recording, Recording) else load_recording(Path(recording))
