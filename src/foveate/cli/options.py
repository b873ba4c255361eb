"""Options of commands: their base class, and how --help shows an option."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from foveate.errors import InputError
from foveate.names import PRESET_NAMES

SCENES = ("table1", "own")
"""Values of --scenes that are no files."""


class Command:
    """Options of a command; `cli.run` has a module of the same name whose `run` does the work."""

    def check(self) -> None:
        """Raise InputError for inputs that do not exist, before anything is imported that takes seconds."""
        for name in ("run", "config", "recording", "scenes", "map"):
            value = getattr(self, name, None)
            for each in value if isinstance(value, tuple) else () if value is None else (value,):
                _check_exists(name, each)

    def prepare(self) -> None:
        """Configure JAX before it makes its first array: called before the module of `run` is imported."""


def _check_exists(name: str, value: str | Path) -> None:
    is_exported = Path(value).suffix == ".onnx" and Path(value).is_file()
    if name == "run" and not Path(value).is_dir() and not is_exported:
        run = str(value).partition("@")[0]  # of NAME@SOURCE, a policy in the scenario of SOURCE
        if run not in PRESET_NAMES and not Path(run).is_dir():
            raise InputError(f"{run}: no such run folder or file, and no preset: presets are {', '.join(PRESET_NAMES)}")
    if name != "run" and str(value) not in SCENES and not Path(value).exists():
        raise InputError(f"{value}: no such file")


def option(metavar: str) -> Any:
    """Name the value of an option in --help; the text of an option without default says what happens without it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=_hint)


def _hint(default: str) -> str:
    return "" if default in ("None", "") else f"(default: {default})"


Changes = Annotated[tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction, option("KEY=VALUE ..")]
"""Settings that replace others: `--set KEY=VALUE ..`, once or more often."""


@dataclass(kw_only=True)
class ReadingCommand(Command):
    """Options of commands that read a recording: how its files are to be understood."""

    columns: Annotated[str | None, option("time=..,id=..,x=..,y=..")] = None
    """Columns of another table, by name or number from 1, as time=t,id=name,x=east,y=north[,z=up] in metres, or with
    lat=..,lon=.. in degrees. Times are ISO 8601 or seconds; time_ms, time_us, time_ns and frame are other units.
    Without id each file is a target."""
    fps: Annotated[float | None, option("N")] = None
    """Frames per second, where times are numbers of frames (MOT challenge, ETH/UCY)."""
    scale: Annotated[float | None, option("METRES")] = None
    """Metres per unit of x, y and z: per pixel on the ground for MOT challenge text."""
    topics: Annotated[tuple[str, ...], option("TOPIC ..")] = ()
    """Topics of a ROS bag (default: all with poses)."""
    planar: bool = False
    """Leave z out: a robot in the plane."""
    max_speed: Annotated[float | None, option("M/S")] = None
    """Fastest that a target can move [m/s]: a step above is a jump, where its track is cut, or a wrong fix, which is
    left out. inf keeps all (default: steps far above those of the track)."""

    map: Annotated[Path | None, option("map.yaml")] = None
    """Map of the robot, in the recording's frame: the YAML file of ROS's map_server. Its walls stop the robot and hide
    what is behind them."""

    def reading(self) -> dict[str, Any]:
        """The arguments of `foveate.load_recording` beside the path."""
        return {name: getattr(self, name) for name in ("columns", "fps", "scale", "topics", "planar")}
