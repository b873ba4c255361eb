"""Tables as other tools write them: metres and seconds, or one line that says what to do."""

import numpy as np
import pytest

from foveate.errors import InputError
from foveate.recordings import rows
from foveate.recordings.formats import load_recording
from foveate.recordings.recording import moved, window
from foveate.scenario.origin import OriginSettings

COLUMNS = "time=when,id=who,x=east,y=north"
HEADER = "time_s,track_id,x_m,y_m\n"


def written(tmp_path, content, name="r.csv"):
    path = tmp_path / name
    path.write_text(content)
    return path


def refused(path, **options) -> str:
    with pytest.raises(InputError) as caught:
        load_recording(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


# Times


@pytest.mark.parametrize("start", [0, 1_760_000_000])
@pytest.mark.parametrize("digits", [1, 2, 3, 6])
def test_a_clock_since_1970_gives_the_numbers_of_one_from_zero_to_the_last_digit(tmp_path, start, digits):
    rng = np.random.default_rng(digits)
    times = np.unique(rng.integers(0, 10 ** (digits + 3), 300))
    texts = [f"{k // 10**digits}.{k % 10**digits:0{digits}d}" for k in times]
    shifted = [f"{start + k // 10**digits}.{k % 10**digits:0{digits}d}" for k in times]
    read = load_recording(written(tmp_path, HEADER + "".join(f"{t},a,0,0\n" for t in shifted)))
    if start:
        begin = int(times[0] // 10**digits)
        assert read.clock_origin_s == start + begin
        expected = [float(f"{k // 10**digits - begin}.{k % 10**digits:0{digits}d}") for k in times]
    else:
        assert read.clock_origin_s == 0
        expected = list(map(float, texts))
    np.testing.assert_array_equal(read.tracks[0].times_s, expected)


def test_parts_of_a_seconds_clock_are_recognised(tmp_path):
    for power, name, key in (
        (9, "nanoseconds", "time_ns"),
        (6, "microseconds", "time_us"),
        (3, "milliseconds", "time_ms"),
    ):
        stamps = [1_760_000_000 * 10**power, 1_760_000_000 * 10**power + 10**power // 4]
        path = written(tmp_path, HEADER + "".join(f"{stamp},a,{i},0\n" for i, stamp in enumerate(stamps)))
        said = refused(path)
        assert f"looks like {name} since 1970" in said
        assert f"--columns {key}=" in said
        read = load_recording(path, columns=f"{key}=time_s,id=track_id,x=x_m,y=y_m")
        np.testing.assert_array_equal(read.tracks[0].times_s, [0, 0.25])
    uptime = written(tmp_path, HEADER + "".join(f"{k * 10**8},a,{k},0\n" for k in range(5)))
    assert "look like nanoseconds" in refused(uptime)


def test_iso_times_have_zones_and_cross_the_change_to_summer_time(tmp_path):
    rows_ = [
        ("2026-03-29T01:59:30+01:00", "a", 1, 1),
        ("2026-03-29T03:00:00.500+02:00", "a", 2, 2),  # half a minute later
        ("2026-03-29T00:59:00Z", "b", 3, 3),  # before both
        ("2026-03-29 01:00:30Z", "b", 4, 4),
    ]
    text = "when,who,east,north\n" + "".join(",".join(map(str, row)) + "\n" for row in rows_)
    read = load_recording(written(tmp_path, text), columns=COLUMNS)
    assert [track.times_s.tolist() for track in read.tracks] == [[30.0, 60.5], [0.0, 90.0]]
    assert read.notes == ()
    bare = text.replace("Z", "").replace("+01:00", "").replace("+02:00", "")
    read = load_recording(written(tmp_path, bare), columns=COLUMNS)
    assert read.notes == ("times without a zone are taken as UTC",)
    mixed = refused(written(tmp_path, text.replace("Z", "")), columns=COLUMNS)
    assert "some have none" in mixed
    broken = refused(written(tmp_path, text.replace("00:59:00Z", "noon")), columns=COLUMNS)
    assert "line 4: when is '2026-03-29Tnoon'; it must be a time as" in broken


def test_a_window_is_of_the_clock_or_after_its_origin(tmp_path):
    text = HEADER + "".join(f"{1_760_000_000 + k},a,{k},0\n" for k in range(10))
    read = load_recording(written(tmp_path, text))
    for start in (3.0, 1_760_000_003.0):
        np.testing.assert_array_equal(window(read, start, None).tracks[0].positions_m[:, 0], np.arange(3, 10))


# Places


def test_degrees_become_metres_about_an_origin_of_their_own(tmp_path):
    """Two ships that keep 1 minute of latitude (1,852 m to 0.3 %) apart, in rows that are not sorted."""
    rows_ = [
        f"{t},{who},{47.6 + lat / 60:.6f},{-122.34 + 0.0001 * t:.6f}\n"
        for t in (40, 0, 20)
        for who, lat in (("A", 0), ("B", 1))
    ]
    path = written(tmp_path, "t,MMSI,LAT,LON\n" + "".join(rows_) + "50,A,91.0,181.0\n")
    read = load_recording(path, columns="time=t,id=MMSI,lat=LAT,lon=LON")
    a, b = (track.positions_m for track in read.tracks)
    np.testing.assert_array_equal(read.tracks[0].times_s, [0, 20, 40])
    np.testing.assert_allclose(b[:, 1] - a[:, 1], 1852, rtol=3e-3)
    np.testing.assert_allclose(np.diff(a[:, 0]), 0.002 * 111_320 * np.cos(np.radians(47.6)), rtol=3e-3)
    assert np.abs(a).max() < 5000
    assert read.origin == OriginSettings(latitude_deg=47.61, longitude_deg=-122.34)
    assert "1 rows have no position" in " ".join(read.notes)
    elsewhere = OriginSettings(latitude_deg=47.5, longitude_deg=-122.3)
    given = load_recording(path, columns="time=t,id=MMSI,lat=LAT,lon=LON", origin=elsewhere)
    np.testing.assert_allclose(moved(read, elsewhere).tracks[0].positions_m, given.tracks[0].positions_m, atol=1e-6)


def test_a_degree_or_pixel_is_never_taken_for_a_metre(tmp_path):
    ships = written(tmp_path, "MMSI,BaseDateTime,LAT,LON\n1,2026-03-29T01:05:07Z,47.6,-122.3\n")
    assert "--columns time=BaseDateTime,id=MMSI,lat=LAT,lon=LON" in refused(ships)
    assert "looks like degrees" in refused(ships, columns="time=BaseDateTime,id=MMSI,x=LON,y=LAT")
    far = written(tmp_path, "t,id,lat,lon\n0,1,95,0\n")
    assert "line 2: latitude and longitude [95.0, 0.0]" in refused(far, columns="time=t,id=id,lat=lat,lon=lon")
    boxes = written(tmp_path, "frame,id,bb_left,bb_top\n0,1,603,300\n")
    assert "looks like pixels" in refused(boxes, columns="frame=frame,id=id,x=bb_left,y=bb_top", fps=25.0)
    plain = written(tmp_path, "0\t1\t603\t300\n1\t1\t604.5\t300\n")
    assert "as pixels are; give --scale" in refused(plain, fps=25.0)
    assert load_recording(plain, fps=25.0, scale=0.02).tracks[0].positions_m[0, 0] == pytest.approx(12.06)


def test_positions_far_from_zero_get_an_origin_and_keep_their_digits(tmp_path):
    steps = np.round(np.random.default_rng(0).normal(size=(50, 2)), 3)
    near = written(tmp_path, HEADER + "".join(f"{k},a,{x:.3f},{y:.3f}\n" for k, (x, y) in enumerate(steps)))
    near = load_recording(near)
    far = written(
        tmp_path, HEADER + "".join(f"{k},a,{5e5 + x:.3f},{5.4e6 + y:.3f}\n" for k, (x, y) in enumerate(steps))
    )
    far = load_recording(far)
    assert near.origin is None
    assert far.origin == OriginSettings(position_m=(5e5, 5.4e6))
    np.testing.assert_allclose(far.tracks[0].positions_m, near.tracks[0].positions_m, atol=2e-9)
    assert "metres from (500000, 5400000) m" in far.notes[0]
    there = OriginSettings(position_m=(5e5 - 100, 5.4e6))
    np.testing.assert_allclose(moved(far, there).tracks[0].positions_m - steps, [[100, 0]] * 50, atol=2e-9)


# Layouts


def test_columns_by_name_and_by_number_in_any_delimiter(tmp_path):
    for delimiter in (",", ";", "\t"):
        lines = [["who", "when", "north", "east", "up"], ["a b", "0.5", "1", "2", "3"], ["a b", "0.25", "4", "5", "6"]]
        path = written(tmp_path, "".join(delimiter.join(line) + "\n" for line in lines))
        by_name = load_recording(path, columns={"time": "when", "id": "who", "x": "east", "y": "north", "z": "up"})
        by_number = load_recording(path, columns="time=2,id=1,x=4,y=3,z=5")
        for read in (by_name, by_number):
            assert read.tracks[0].track_id == "a b"
            np.testing.assert_array_equal(read.tracks[0].times_s, [0.25, 0.5])
            np.testing.assert_array_equal(read.tracks[0].positions_m, [[5, 4, 6], [2, 1, 3]])
        assert load_recording(path, columns=COLUMNS + ",z=up", planar=True).dimension == 2
    headless = written(tmp_path, "# made by a tool\n0 a 1 2\n1 a 3 4\n")
    np.testing.assert_array_equal(
        load_recording(headless, columns="time=1,id=2,x=3,y=4").tracks[0].positions_m, [[1, 2], [3, 4]]
    )


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ("time=when,id=who,x=east", "expected time=..,id=..,x=..,y=.."),
        ("id=who,x=east,y=north", "one time"),
        ("time=when,frame=when,id=who,x=east,y=north", "one time"),
        ("time=when,id=who,x=east,y=north,lat=east,lon=north", "expected"),
        ("time=when,id=who,x=east,y=north,speed=v", "columns speed=: unknown"),
        ("time=when,id=who,x=east,y=south", "columns y=south: no such column; the file has when,who,east,north"),
        ("frame=when,id=who,x=east,y=north", "give fps"),
    ],
)
def test_wrong_columns_are_named(tmp_path, columns, said):
    assert said in refused(written(tmp_path, "when,who,east,north\n0,a,1,2\n"), columns=columns)


def test_mot_challenge_text_needs_a_rate_and_a_scale(tmp_path):
    text = "1,7,600,300,40,100,1,1,1.0\n3,7,602,301,40,100,1,1,1.0\n2,8,10,20,30,40,0,1,1.0\n"
    path = written(tmp_path, text, "gt.txt")
    for given in ({}, {"fps": 25.0}, {"scale": 0.02}):
        assert "give --fps FRAMES_PER_S and --scale METRES_PER_PIXEL" in refused(path, **given)
    read = load_recording(path, fps=25.0, scale=0.02)
    (seven,) = read.tracks  # the other has conf 0
    np.testing.assert_allclose(seven.times_s, [0.04, 0.12])
    np.testing.assert_allclose(seven.positions_m, [[12.4, -8.0], [12.44, -8.02]])
    assert "1 rows have conf 0" in " ".join(read.notes)
    without = written(tmp_path, "1,-1,600,300,40,100,0.9,-1,-1,-1\n")
    assert "detections without ids" in refused(without, fps=25.0, scale=0.02)


def test_frames_and_tabs_ask_for_a_rate(tmp_path):
    path = written(tmp_path, "780\t1.0\t8.40\t3.5\n780\t2.0\t13.0\t5.8\n786\t1.0\t8.60\t3.5\n")
    assert "give --fps FRAMES_PER_S" in refused(path)
    read = load_recording(path, fps=15.0)
    assert [track.track_id for track in read.tracks] == ["1", "2"]
    np.testing.assert_allclose(read.tracks[0].times_s, [52.0, 52.4])


def test_several_trajectories_make_one_recording_in_space(tmp_path):
    def tum(name, x, start):
        lines = "".join(f"{start + 0.1 * k:.6f} {x + k} 2.0 1.2 0 0 0.1 0.995\n" for k in range(3))
        return written(tmp_path, "# timestamp tx ty tz qx qy qz qw\n" + lines, f"{name}.txt")

    read = load_recording([tum("anna", 1.0, 1_760_000_000), tum("ben", 4.0, 1_760_000_010)])
    assert read.dimension == 3
    assert [track.track_id for track in read.tracks] == ["anna", "ben"]
    np.testing.assert_allclose(read.tracks[1].times_s, [10.0, 10.1, 10.2], atol=1e-9)
    np.testing.assert_array_equal(read.tracks[1].positions_m[:, 0], [4, 5, 6])
    own = written(tmp_path, HEADER + "0,a,1,2\n")
    assert "other columns than" in refused([tum("anna", 1.0, 0), own])


def test_repeated_rows_are_counted(tmp_path):
    text = "when,who,east,north\n0,a,1,2\n1,a,3,4\n0,a,1,2\n1,a,9,9\n"
    read = load_recording(written(tmp_path, text), columns=COLUMNS)
    np.testing.assert_array_equal(read.tracks[0].positions_m, [[1, 2], [3, 4]])
    assert "1 rows are exact repeats" in " ".join(read.notes)
    assert "a at 1 s): the first of each is taken" in " ".join(read.notes)


# Blocks


def test_blocks_give_what_one_row_at_a_time_gives(tmp_path, monkeypatch):
    """Small blocks, with lines that only the careful way can read in the middle, and an error behind them."""
    rng, lines = np.random.default_rng(1), []
    for k in range(400):
        name = '"a, b"' if k == 211 else f"t{rng.integers(3)}"
        lines += ["\n"] * (k in (300, 301)) + [f"{k},{name},{k}.5,{-k}\n"]
    path = written(tmp_path, HEADER + "".join(lines))
    whole = load_recording(path)
    monkeypatch.setattr(rows, "BLOCK_BYTES", 100)
    monkeypatch.setattr(rows, "BLOCK_ROWS", 7)
    parts = load_recording(path)
    assert [track.track_id for track in whole.tracks] == [track.track_id for track in parts.tracks]
    for one, other in zip(whole.tracks, parts.tracks, strict=True):
        np.testing.assert_array_equal(one.times_s, other.times_s)
        np.testing.assert_array_equal(one.positions_m, other.positions_m)
    assert sum(len(track.times_s) for track in parts.tracks) == 400
    for k, wrong in ((150, "150,t0,x,0\n"), (390, "1,t0,0,0\n"), (299, "299,t0,1\n")):
        line = 2 + k + 2 * (k > 299)
        bad = written(tmp_path, HEADER + "".join(lines[: k + 2 * (k > 299)]) + wrong)
        assert f": line {line}: " in refused(bad)
