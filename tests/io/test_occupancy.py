"""Maps of map_server: pixels by the rules of its documentation, and one line for every broken map."""

import numpy as np
import pytest
from PIL import Image

from foveate.errors import InputError
from foveate.io.occupancy import read_map

GREY = np.array([[0, 60, 100, 205, 254], [254, 254, 254, 254, 0]], np.uint8)
YAML = (
    "image: map.pgm\nresolution: 0.5\norigin: [-1.0, 2.0, 0.0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\nnegate: 0\n"
)


def written(folder, text=YAML, pixels=GREY, name="map.pgm"):
    Image.fromarray(pixels).save(folder / name)
    path = folder / "map.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("extra", "top"),
    [
        # p = (255 - x) / 255: 1, 0.76, 0.61, 0.196, 0.004; unknown between the thresholds is an obstacle.
        ("", [1, 1, 1, 1, 0]),
        ("mode: trinary\n", [1, 1, 1, 1, 0]),
        # Half way between the thresholds: p = 0.423.
        ("mode: scale\n", [1, 1, 1, 0, 0]),
        # The numbers are percent; above 100 it is unknown.
        ("mode: raw\n", [0, 1, 1, 1, 1]),
    ],
)
def test_pixels_are_read_by_their_mode(tmp_path, extra, top):
    grid = read_map(written(tmp_path, YAML + extra))
    assert grid.occupied.shape == (5, 2)
    # The first row of the image is the upper one, where y is largest.
    assert grid.occupied[:, 1].tolist() == [bool(x) for x in top]
    assert grid.low.tolist() == [-1.0, 2.0]
    assert grid.cell_m == 0.5


def test_a_number_may_be_written_with_an_exponent(tmp_path):
    assert read_map(written(tmp_path, YAML.replace("0.5", "5e-1"))).cell_m == 0.5


def test_negate_turns_black_and_white(tmp_path):
    grid = read_map(written(tmp_path, YAML.replace("negate: 0", "negate: 1")))
    assert grid.occupied[:, 1].tolist() == [False, True, True, True, True]


def test_a_transparent_pixel_is_unknown_in_scale(tmp_path):
    pixels = np.full((1, 2, 4), 254, np.uint8)
    pixels[0, 1, 3] = 0
    text = YAML.replace("map.pgm", "map.png") + "mode: scale\n"
    assert read_map(written(tmp_path, text, pixels, "map.png")).occupied[:, 0].tolist() == [False, True]


def test_opacity_is_a_colour_in_trinary(tmp_path):
    """As in map_server: (3 * 180 + 255) / 4 = 199 of 255, p = 0.22; without opacity it would be 0.29."""
    pixels = np.array([[[180, 180, 180, 255]]], np.uint8)
    text = YAML.replace("map.pgm", "map.png").replace("0.196", "0.25")
    assert not read_map(written(tmp_path, text, pixels, "map.png")).occupied.any()


def test_sixteen_bits_and_ascii_are_read(tmp_path):
    (tmp_path / "map.pgm").write_text("P2\n2 1\n65535\n65535 0\n")
    (tmp_path / "map.yaml").write_text(YAML)
    assert read_map(tmp_path / "map.yaml").occupied[:, 0].tolist() == [False, True]


BAD = {
    "no YAML": ("image: [", "is not YAML"),
    "a list": ("- 1\n", "expected keys and values"),
    "no image": (YAML.replace("image: map.pgm\n", ""), "no 'image': expected image, resolution, origin"),
    "an empty name": (YAML.replace("map.pgm", "''"), "image = ''"),
    "no resolution": (YAML.replace("0.5", ".nan"), "resolution = nan: expected a finite number"),
    "a word": (YAML.replace("0.5", "coarse"), "resolution = 'coarse': expected a finite number"),
    "a huge number": (YAML.replace("0.5", "9" * 400), "expected a finite number, up to 1e+12"),
    "a number too large": (YAML.replace("0.5", "1.0e+300"), "expected a finite number, up to 1e+12"),
    "a huge origin": (YAML.replace("2.0", "9" * 400), "expected [x, y, yaw] of finite numbers"),
    "brackets": ("[" * 3000, "is not YAML"),
    "no number in quotes": (YAML.replace("0.5", "'nan'"), "resolution = nan: expected a finite number"),
    "a size of zero": (YAML.replace("0.5", "0.0"), "resolution = 0.0: expected > 0"),
    "rolled": (YAML.replace("[-1.0, 2.0, 0.0]", "[0.0, 0.0, 0.0, 0.1, 0.0, 0.0]"), "no roll and no pitch"),
    "pitched": (YAML.replace("[-1.0, 2.0, 0.0]", "[0.0, 0.0, 0.0, 0.0, 0.1, 0.0]"), "no roll and no pitch"),
    "turned": (YAML.replace("0.0]", "0.3]"), "expected yaw 0"),
    "short": (YAML.replace("[-1.0, 2.0, 0.0]", "[1.0, 2.0]"), "expected [x, y, yaw] of finite numbers"),
    "an infinite origin": (YAML.replace("2.0", ".inf"), "expected [x, y, yaw] of finite numbers"),
    "crossed": (YAML.replace("0.196", "0.7"), "free_thresh = 0.7: expected 0 <= free_thresh < occupied_thresh 0.65"),
    "another mode": (YAML + "mode: costmap\n", "mode = 'costmap': expected trinary, scale, raw"),
    "half negated": (YAML.replace("negate: 0", "negate: 2"), "negate = 2: expected 0 or 1"),
    "elsewhere": (YAML.replace("map.pgm", "other.pgm"), "other.pgm: cannot be read as an image"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_broken_map_is_one_line(tmp_path, name):
    text, words = BAD[name]
    with pytest.raises(InputError) as caught:
        read_map(written(tmp_path, text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_broken_image_is_one_line(tmp_path):
    path = written(tmp_path)
    (tmp_path / "map.pgm").write_bytes(b"P5\n4 4\n255\nab")
    with pytest.raises(InputError, match=r"map\.pgm: cannot be read as an image"):
        read_map(path)
    with pytest.raises(InputError, match=r"nowhere\.yaml"):
        read_map(tmp_path / "nowhere.yaml")
