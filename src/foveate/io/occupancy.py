"""Occupancy maps as robots have them: an image and the YAML file of ROS's map_server.

A pixel has a share p of black (of white with `negate`). Mode "trinary": occupied for p > occupied_thresh, free for
p < free_thresh, else unknown. "scale": between the thresholds the occupancy grows from 0 to 100 %, and what is
transparent is unknown. "raw": a pixel is the percentage itself, and above 100 unknown. Occupied here is all from 50 %
on, and what is unknown.
"""

from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from jaxtyping import Bool, Float
from PIL import Image

from foveate.errors import InputError
from foveate.io.files import read_text
from foveate.io.validate import LARGEST, require

MODES = ("trinary", "scale", "raw")
KEYS = ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate", "mode")
MAX_YAML_BYTES = 1 << 16
MAX_CELLS = 4096 * 4096
"""Largest map that is read."""


class OccupancyGrid(NamedTuple):
    """Occupied cells, the x axis first, from the corner `low` [m] in the world, where x and y are lowest."""

    occupied: Bool[np.ndarray, "x y"]
    low: Float[np.ndarray, "2"]
    cell_m: float

    @property
    def high(self) -> Float[np.ndarray, "2"]:
        """The corner where x and y are highest [m]."""
        return self.low + self.cell_m * np.array(self.occupied.shape)


def read_map(path: str | Path) -> OccupancyGrid:
    """Read a map's YAML file and its image.

    Args:
        path: The YAML file; the image is looked for beside it.

    Raises:
        InputError: One line that names file, key and value: a missing or unreadable file, an unknown mode, a resolution
            that is no positive number, an origin that is turned, thresholds out of order.
    """
    path = Path(path)
    table = _table(path)
    resolution = _number(path, table, "resolution", None)
    require(resolution > 0, f"{path}: resolution", resolution, "expected > 0 [m per pixel]")
    low = _origin(path, table.get("origin"))
    mode = table.get("mode", "trinary")
    require(mode in MODES, f"{path}: mode", mode, f"expected {', '.join(MODES)}")
    free, taken = _number(path, table, "free_thresh", 0.196), _number(path, table, "occupied_thresh", 0.65)
    right = f"expected 0 <= free_thresh < occupied_thresh {taken:g} <= 1"
    require(0 <= free < taken <= 1, f"{path}: free_thresh", free, right)
    negate = table.get("negate", 0)
    require(negate in (0, 1, False, True), f"{path}: negate", negate, "expected 0 or 1")
    image = table.get("image")
    require(isinstance(image, str) and image != "", f"{path}: image", image, "expected the name of an image file")
    grey, opaque = _pixels(path.parent / str(image), with_alpha=mode == "trinary")
    black = grey / 255.0 if negate else 1.0 - grey / 255.0
    occupied = {
        "trinary": ~(black < free),
        "scale": (black >= 0.5 * (free + taken)) | ~opaque,
        "raw": grey >= 50,
    }[mode]
    # Rows of an image begin at the top, y counts up from the origin.
    return OccupancyGrid(np.ascontiguousarray(occupied[::-1].T), low, resolution)


def _table(path: Path) -> dict[str, Any]:
    text = read_text(path, "map (YAML of map_server)", MAX_YAML_BYTES)
    try:
        table = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path}: is not YAML: {reason}") from error
    if not isinstance(table, dict):
        raise InputError(f"{path}: expected keys and values: {', '.join(KEYS)}")
    if missing := [name for name in KEYS[:3] if name not in table]:
        raise InputError(f"{path}: no {missing[0]!r}: expected {', '.join(KEYS[:3])}")
    return table


def _number(path: Path, table: dict[str, Any], name: str, default: float | None) -> float:
    value = table.get(name, default)
    if isinstance(value, str):  # YAML has 1e-2 for a text, and map_server for a number
        with suppress(ValueError):
            value = float(value)
    require(_is_number(value), f"{path}: {name}", value, f"expected a finite number, up to {LARGEST:g}")
    return float(value)  # type: ignore[arg-type]  # as just required


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST


def _origin(path: Path, value: Any) -> Float[np.ndarray, "2"]:
    """Position of the lower left corner of the image; map_server gives x, y and yaw, or x, y, z, roll, pitch, yaw."""
    name, fits = f"{path}: origin", isinstance(value, list) and len(value) in (3, 6)
    numbers = [x for x in value if _is_number(x)] if fits else []
    right = "expected [x, y, yaw] of finite numbers"
    require(fits and len(numbers) == len(value), name, value, right)
    roll, pitch, yaw = (0.0, 0.0, numbers[2]) if len(numbers) == 3 else numbers[3:]
    require(roll == pitch == 0, name, value, "expected a level map: no roll and no pitch")
    require(yaw == 0, name, value, "expected yaw 0: turn the image, or the map's frame")
    return np.array(numbers[:2], float)


def _pixels(path: Path, with_alpha: bool) -> tuple[Float[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]:
    """Mean of the channels of each pixel, 0 to 255, and where the image is not transparent.

    The mean is `with_alpha` in mode "trinary", where map_server counts opacity as a colour.
    """
    try:
        with Image.open(path) as image:
            cells = image.width * image.height
            require(cells <= MAX_CELLS, f"{path}: pixels", cells, f"expected at most {MAX_CELLS}")
            has_alpha = "A" in image.getbands() or "transparency" in image.info
            if image.mode.startswith("I"):  # 16 bits a pixel
                grey = np.asarray(image, float) * (255.0 / 65535.0)
                return grey, np.ones(grey.shape, bool)
            channels = np.asarray(image.convert("RGBA" if has_alpha else "RGB"), float)
    except InputError:
        raise
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"{path}: cannot be read as an image: {reason}") from error
    opaque = channels[..., 3] > 0 if has_alpha else np.ones(channels.shape[:2], bool)
    return channels[..., : None if with_alpha else 3].mean(axis=-1), opaque
