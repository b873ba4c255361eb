"""Reading of recordings: files and their contents, and the one line that says what is wrong with them."""

from pathlib import Path

import numpy as np
import pytest

from foveate.recordings.formats import load_recording

HEADER = "time_s,track_id,x_m,y_m\n"


def write(tmp_path, content: str | bytes) -> Path:
    path = tmp_path / "recording.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_reads_planar_and_spatial_files(tmp_path):
    path = write(tmp_path, "\ufeff" + HEADER + '0.0,07,1,2\r\n0.5,7,-1e1,4\r\n\r\n1.0, 07 ,3,4\r\n1.0,"a,b",0,0\r\n')
    planar = load_recording(path)
    assert planar.dimension == 2
    assert planar.name == str(path)
    assert [t.track_id for t in planar.tracks] == ["07", "7", "a,b"]
    np.testing.assert_array_equal(planar.tracks[0].times_s, [0.0, 1.0])
    np.testing.assert_array_equal(planar.tracks[0].positions_m, [[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(planar.tracks[1].positions_m, [[-10.0, 4.0]])
    assert (planar.start_s, planar.end_s) == (0.0, 1.0)
    np.testing.assert_array_equal(planar.extent, [[-10.0, 0.0], [3.0, 4.0]])

    spatial = load_recording(write(tmp_path, "time_s,track_id,x_m,y_m,z_m\n-3,drone 1,1,2,3"))
    assert spatial.dimension == 3
    np.testing.assert_array_equal(spatial.tracks[0].positions_m, [[1.0, 2.0, 3.0]])


GOOD = HEADER + "0.0,1,0,0\n"
RIGHT_HEADER = "the header must be time_s,track_id,x_m,y_m or time_s,track_id,x_m,y_m,z_m"


@pytest.mark.parametrize(
    ("content", "line", "value", "expected"),
    [
        ("", 1, "the file is empty", RIGHT_HEADER),
        ("\n" + GOOD, 1, "'time_s' is missing", RIGHT_HEADER),
        ("0.0,1,0,0\n", 1, "'0.0'", RIGHT_HEADER),
        ("time_s,track_id,x_m\n0,1,0\n", 1, "'y_m' is missing", RIGHT_HEADER),
        ("time_s,track_id,x_m,y_m,speed\n", 1, "'speed'", RIGHT_HEADER),
        ("time_s,track_id,x_m,y_m,y_m\n", 1, "'y_m'", RIGHT_HEADER),
        ("track_id,time_s,x_m,y_m\n", 1, "track_id,time_s,x_m,y_m", RIGHT_HEADER),
        ("q" * 500 + "\n", 1, "'qqqq", RIGHT_HEADER),
        (HEADER, 2, "no rows", "at least one row must follow the header"),
        (HEADER + "\n\n", 4, "no rows", "at least one row must follow the header"),
        (GOOD + "0.1,1,0\n", 3, "3 fields", "there must be 4: time_s,track_id,x_m,y_m"),
        (GOOD + "\n0.1,1,0,0,0\n", 4, "5 fields", "there must be 4: time_s,track_id,x_m,y_m"),
        (GOOD + "0.1,1,zero,0\n", 3, "x_m is 'zero'", "finite number of metres"),
        (GOOD + "0.1,1,0,\n", 3, "y_m is ''", "finite number of metres"),
        (GOOD + "now,1,0,0\n", 3, "time_s is 'now'", "finite number of seconds"),
        (GOOD + "1_0,1,0,0\n", 3, "time_s is '1_0'", "finite number of seconds"),
        (GOOD + "nan,1,0,0\n", 3, "time_s is 'nan'", "finite number of seconds"),
        (GOOD + "0.1,1,0,-inf\n", 3, "y_m is '-inf'", "finite number of metres"),
        (GOOD + "0.1,1,1e13,0\n", 3, "x_m is '1e13'", "at most 1e+12"),
        (GOOD + "0.1,1," + "7" * 400 + ",0\n", 3, "x_m is '777", "at most 1e+12"),
        (GOOD + "0.1, ,0,0\n", 3, "track_id is ''", "name or number"),
        (GOOD + '0.1,"a\nb",0,0\n', 3, "track_id is 'a\\nb'", "printable characters"),
        (GOOD + "0.1,a\0b,0,0\n", 3, "track_id is 'a\\x00b'", "printable characters"),
        (GOOD + '0.1,"a,0,0\n', 3, "unexpected end of data", "plain comma-separated text"),
        (GOOD + '0.1,"a' + "\nb" * 100_000, 3, "field limit", "plain comma-separated text"),
        (GOOD + "-0.1,1,0,0\n", 3, "-0.1 comes after 0.0", "sorted by time"),
        (GOOD + "0.0,2,0,0\n0,1,1,1\n", 4, "'1' has two rows at time_s 0.0", "one row for each"),
        (GOOD + "0.1," + "i" * 5000 + ",0,0\n", 3, "4096 bytes", "a time, a track id and a position"),
        (GOOD.encode() + b"0.1,caf\xe9,0,0\n", 3, "byte b'\\xe9' is not UTF-8", "save the file as UTF-8"),
        (
            (HEADER + "0.0,1,0,0\n").encode("utf-16"),
            1,
            "byte b'\\xff' is not UTF-8",
            "save the file as UTF-8",
        ),
    ],
)
def test_bad_files_are_rejected_in_one_line(tmp_path, content, line, value, expected):
    path = write(tmp_path, content)
    with pytest.raises(ValueError, match=r": line \d+: ") as caught:
        load_recording(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: line {line}: ")
    assert value in message
    assert expected in message
    assert "\n" not in message
    assert len(message) < 400 + len(str(path))


def test_bad_paths_are_rejected_in_one_line(tmp_path):
    with pytest.raises(ValueError, match=r"^.*nowhere\.csv: no such file; give the path of a recording"):
        load_recording(tmp_path / "nowhere.csv")
    with pytest.raises(ValueError, match=r"^.*: is a directory; give the path of a recording"):
        load_recording(tmp_path)
    path = write(tmp_path, GOOD)
    with pytest.raises(ValueError, match=r"^.*: cannot be read: Not a directory"):
        load_recording(path / "inside")
