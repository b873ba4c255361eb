"""The live view: what a written page holds, read back from its own format; pages and clicks in a real Chromium."""

import base64
import re
import socket
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

pytest.importorskip("viser", reason="needs the extra view")

import msgspec
import zstandard
from helpers.browser import CHROMIUM, Browser, wait_for
from helpers.commands import failure
from helpers.episode_data import late_sightings

from foveate.cli.main import main
from foveate.plotting.episode_data import SUBSTEPS
from foveate.plotting.live import chart, player, primitives, scene
from foveate.plotting.live import server as view
from foveate.scenario.scenes import Scene, write_scenes

HOSTILE = "<img src=x> [a](http://b) *c* {d} & _e_ | \\ `f` <b>é"
"""A name that would be more than text in a page's Markdown."""
GREEN, VERMILLION = (0, 158, 115), (213, 94, 0)


def messages(page: Path):
    """Messages of a written page, (time [s], message), by the format that viser's own player reads."""
    text = page.read_text(encoding="utf-8")
    packed = base64.b64decode(re.search(r'__VISER_EMBED_DATA__="([^"]*)"', text)[1])
    size = int.from_bytes(packed[:8], "little")
    inner = zstandard.ZstdDecompressor().decompress(packed[8:], max_output_size=size)
    length = int.from_bytes(inner[:8], "little")
    return msgspec.msgpack.decode(inner[8 : 8 + length])


def last_of(played, name, prop):
    """The last value that a node's property or pose is given."""
    found = [
        message["updates"][prop] if "updates" in message else message[prop]
        for _, message in played["messages"]
        if message.get("name") == name and (prop in message or prop in message.get("updates", {}))
    ]
    return found[-1]


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_page_holds_the_episode(tmp_path, dimension):
    """At its end: the agent where it is, truths and estimates, and 95 % bodies whose axes come from numpy's svd."""
    data = late_sightings(dimension)
    view.record(data, tmp_path / "page.html")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    played = messages(tmp_path / "page.html")
    assert played["durationSeconds"] == pytest.approx(data.times_s[-1] + 1.0)
    times = [at for at, _ in played["messages"]]
    assert times == sorted(times)
    d = data.space.dimension
    here = data.pose[-1]
    place = here[:2] if d == 2 else here[:3, 3]
    np.testing.assert_allclose(last_of(played, "/agent", "position")[:d], place, atol=1e-5)
    heading = Rotation.from_quat(last_of(played, "/agent", "wxyz"), scalar_first=True).apply([1, 0, 0])
    expected = [np.cos(here[2]), np.sin(here[2]), 0] if d == 2 else here[:3, 0]
    np.testing.assert_allclose(heading, expected, atol=1e-6)
    for i in range(data.targets):
        np.testing.assert_allclose(last_of(played, f"/target/{i}", "position")[:d], data.truth[-1, i], atol=1e-5)
        np.testing.assert_allclose(last_of(played, f"/belief/{i}", "position")[:d], data.estimate[-1, i], atol=1e-5)
        assert tuple(last_of(played, f"/belief/{i}", "color")) == GREEN
        turn = Rotation.from_quat(last_of(played, f"/belief/{i}", "wxyz"), scalar_first=True).as_matrix()
        scale = np.array(last_of(played, f"/belief/{i}", "scale"))
        shape = (turn @ np.diag(scale**2) @ turn.T)[:d, :d]
        np.testing.assert_allclose(shape, chi2.ppf(0.95, d) * data.covariance[-1, i], rtol=1e-6, atol=1e-9)
    assert "score so far 7.00 nat per target" in last_of(played, "/chart/facts", "text")


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_page_holds_the_robots_of_a_team_and_who_has_heard_whom(tmp_path, dimension):
    rng, d = np.random.default_rng(4), dimension
    mates = np.array(late_sightings(d).pose)[:, None].repeat(2, axis=1)
    where = (..., slice(2)) if d == 2 else (..., slice(3), 3)
    mates[where] += rng.normal(0, 5.0, mates[where].shape)
    heard = np.zeros((4, 3, 3), bool)
    heard[3, 0, 1] = heard[3, 1, 0] = heard[3, 2, 1] = True
    views = tuple(tuple(scale * line for line in late_sightings(d).outline) for scale in (2.0, 0.5))
    data = late_sightings(d, mates=mates, heard=heard, mate_outlines=views)
    view.record(data, tmp_path / "page.html")
    played = messages(tmp_path / "page.html")
    places = [data.pose[-1][where], *mates[-1][where]]
    for i in range(2):
        np.testing.assert_allclose(last_of(played, f"/mate/{i}", "position")[:d], places[i + 1], atol=1e-5)
        heading = Rotation.from_quat(last_of(played, f"/mate/{i}", "wxyz"), scalar_first=True).apply([1, 0, 0])
        yaw = mates[-1, i, 2] if d == 2 else None
        expected = [np.cos(yaw), np.sin(yaw), 0] if d == 2 else mates[-1, i, :3, 0]
        np.testing.assert_allclose(heading, expected, atol=1e-6)
    canvas = MagicMock(
        add_line_segments=lambda name, *_, **__: drawn.setdefault(name, MagicMock()),
        add_mesh_simple=lambda name, vertices, *_, **__: meshes.update({name: vertices}) or MagicMock(),
    )
    drawn, meshes = {}, {}
    scene.LiveScene(canvas, data).show(4 * SUBSTEPS)
    for i, scale in enumerate((2.0, 0.5)):
        np.testing.assert_allclose(meshes[f"/mate/{i}/view"], scale * meshes["/agent/view"])
    lines = drawn["/mates/heard"].points[..., :d]
    np.testing.assert_allclose(lines[0], [places[0], places[1]], atol=1e-5)
    dashes = lines[1:]
    np.testing.assert_allclose([dashes[0, 0], dashes[-1, 1]], [places[1], places[2]], atol=1e-5)
    # Dashes and gaps take turns: the dashes are a little more than half of the way.
    length = np.linalg.norm(np.diff(dashes, axis=1), axis=-1).sum()
    assert length / np.linalg.norm(places[2] - places[1]) == pytest.approx(
        len(dashes) / (2 * len(dashes) - 1), rel=1e-4
    )
    assert "messages heard 3 of 6" in last_of(played, "/chart/facts", "text")
    assert chart.facts(data, 0)["messages heard"].startswith("0 of 6")
    assert "messages heard" not in chart.facts(late_sightings(d), 6)


SCRIPTS = "</script><script>document.title='ran'</script><img src=x onerror=document.title='ran'>"


def test_names_are_not_written_into_a_page(tmp_path):
    view.record(late_sightings(title=SCRIPTS), tmp_path / "page.html")
    assert "document.title=" not in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.browser
def test_a_page_with_hostile_names_runs_nothing(browser, tmp_path, monkeypatch):
    """Also not where a label in the scene shows them."""
    monkeypatch.setattr(chart, "CURVES", SCRIPTS)
    view.record(late_sightings(steps=8, n=3, title=SCRIPTS), tmp_path / "page.html")
    browser.ask("Page.navigate", url=(tmp_path / "page.html").as_uri())
    wait_for(lambda: pixels(browser.picture(), GREEN) > 10)
    assert browser.run("document.title") != "ran"
    assert browser.run("document.querySelectorAll('img[src=x]').length") == 0


def test_facts_and_curves():
    data = late_sightings(n=2, present=np.array([[True, True]] * 3 + [[True, False]] * 2))
    values = chart.curves(data)
    np.testing.assert_allclose(values[:, 0], [-0.5, 6.5, 6.0, 6.0])  # the second one has gone
    assert values.shape == (4, 1), "where targets come and go, the mean alone"
    assert chart.curves(late_sightings(n=21)).shape == (4, 1)
    facts = chart.facts(data, 3 * SUBSTEPS)
    assert facts["score so far"] == "6.00 nat per target"
    assert (facts["time"], facts["step"], facts["detected now"]) == ("1.5 of 2.0 s", "3 of 4", "1 of 1")
    assert "ever detected" not in facts  # a column may serve several, one after the other
    assert chart.facts(late_sightings(), 2 * SUBSTEPS)["ever detected"] == "3 of 3"
    assert facts["in view"] == "60%"  # 3 of the 5 target-steps so far
    assert chart.facts(data, 0)["score so far"] == "-"
    assert data.moment_at(0.75) == 1.5 * SUBSTEPS
    assert player.usual_speed(data) == 1.0
    assert player.usual_speed(late_sightings(times_s=100.0 * np.arange(5))) == 10.0


def test_meshes():
    """Areas and volumes against closed forms: the view's triangle, a disc and ball of their polygons."""

    def area(mesh):
        a, b, c = mesh[0][mesh[1]].swapaxes(0, 1)
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum()

    assert area(primitives.view_mesh(late_sightings().outline)) == pytest.approx(6.0)
    assert area(primitives.view_mesh(late_sightings(3).outline)) == pytest.approx(4.0)
    assert area(primitives.disc()) == pytest.approx(24 * np.sin(2 * np.pi / 48))
    assert area(primitives.ball()) == pytest.approx(4 * np.pi, rel=0.02)
    angle = np.linspace(-2.0, 2.0, 65)  # a sector of more than half a turn, from its apex
    sector = np.concatenate([[[0, 0]], np.column_stack([np.cos(angle), np.sin(angle)]), [[0, 0]]])
    assert area(primitives.fan(sector)) == pytest.approx(2.0, rel=1e-3)


def test_bad_input_is_one_line(capsys, tmp_path, monkeypatch):
    scenes, page = tmp_path / "scenes.json", tmp_path / "page.html"
    write_scenes(scenes, [Scene(id="a", agent=(0.0,) * 3, targets=((1.0, 1.0),), drift=((0.0, 0.0),), horizon=2)])
    few = ("paper", "--scenes", scenes)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert f"port {port}: is in use" in failure(capsys, "view", *few, "--port", port)
    assert "port 70000" in failure(capsys, "view", *few, "--port", 70000)
    assert "ends in .html" in failure(capsys, "view", *few, "--record", tmp_path / "page.htm")
    assert "expected one of them" in failure(capsys, "view", *few, "--recording", "x.csv")
    assert "--fps: expected a --recording beside it" in failure(capsys, "view", *few, "--fps", 25)
    assert "--clutter: expected a --recording beside it" in failure(capsys, "view", *few, "--clutter", 0)
    assert f"no such scene in {scenes}: known are a" in failure(capsys, "view", *few, "--scene", "nowhere")
    assert "--method 'best'" in failure(capsys, "view", *few, "--method", "best")
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'foveate[view]'" in failure(capsys, "view", *few)
    assert "pip install 'foveate[view]'" in failure(capsys, "view", *few, "--method", "still", "--record", page)
    assert [path.name for path in tmp_path.iterdir()] == ["scenes.json"]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    opened = Browser(tmp_path_factory.mktemp("chromium"))
    yield opened
    opened.close()


def pixels(picture, color):
    """Number of pixels of this hue: lines are drawn in their colour, edges are smoothed."""
    return int((np.abs(picture - np.array(color)).max(axis=-1) < 40).sum())


@pytest.mark.browser
def test_a_written_page_plays_without_a_server(browser, tmp_path):
    """Beliefs in vermillion at first, then in green; how wide each is, the page's messages say (above)."""
    view.record(late_sightings(steps=8, n=3, times_s=0.5 * np.arange(9)), tmp_path / "page.html")
    browser.ask("Page.navigate", url=(tmp_path / "page.html").as_uri())
    drawn = {VERMILLION: 0, GREEN: 0}

    def both() -> bool:
        picture = browser.picture()
        now = {color: pixels(picture, color) for color in drawn}
        assert min(now.values()) < 10  # all are seen, or none
        drawn.update({color: max(drawn[color], count) for color, count in now.items()})
        return min(drawn.values()) > 10

    wait_for(both)  # it plays over and over


@pytest.mark.browser
def test_a_live_page_follows_its_panel(browser):
    """It shows the score as it accrues; a click in the page stops the clock, another chooses another method."""
    asked = []

    def make(scene, method):
        asked.append((scene, method))
        # The agent stays: what its way covers is in the picture, and would be large beside the beliefs.
        pose, title = np.zeros((401, 3)), f"{method} on {scene} {HOSTILE}"
        return late_sightings(steps=400, n=2, pose=pose, title=title)

    source = player.EpisodeSource(scenes=("one", "two"), methods=("nearest", "still"), episode=make)
    with view._server(0) as server:
        with pytest.raises(OSError, match=r"refused|unreachable|timed out"):  # at no other address of this machine
            socket.create_connection(("127.0.0.2", server.get_port()), timeout=5)
        panel = player.Player(server, source)
        panel.tick(0.0)
        assert asked == [("one", "nearest")]
        data = panel._episodes["one", "nearest"]
        browser.ask("Page.navigate", url=f"http://127.0.0.1:{server.get_port()}")
        text = "document.body.innerText"
        wait_for(lambda: "score so far" in (browser.run(text) or ""))
        panel.tick(10.0)
        wait_for(lambda: "6.50 nat per target" in browser.run(text))
        assert f"nearest on one {HOSTILE} · 2 targets" in browser.run(text), "as it is"
        before = panel._moment
        assert before > 10 * SUBSTEPS
        browser.run("[...document.querySelectorAll('button')].find(b => b.innerText == 'pause').click()")
        wait_for(lambda: panel._playing is False)
        panel.tick(5.0)
        assert panel._moment == before
        browser.run("[...document.querySelectorAll('button')].find(b => b.innerText == 'back').click()")
        wait_for(lambda: data.moment_at(panel._time_s) < before)
        panel.tick(1.0)
        assert panel._moment == before - before % SUBSTEPS - SUBSTEPS
        browser.run("document.querySelector('input[role=combobox][value=nearest]').click()")
        choose = "[...document.querySelectorAll('[role=option]')].find(each => each.innerText == 'still').click() ?? 1"
        wait_for(lambda: browser.run(choose))
        wait_for(lambda: panel._method.value == "still")
        panel.tick(0.0)
        assert asked[-1] == ("one", "still")
        wait_for(lambda: "still on one" in browser.run(text))
        wait_for(lambda: pixels(browser.picture(), VERMILLION) > 10)


def test_scenes_and_recordings_from_the_command_line(capsys, tmp_path, monkeypatch):
    """A hand-made policy that stands still: what is written of a scene and of a recording is what they say."""
    monkeypatch.chdir(tmp_path)
    rest = {"targets": ((1.0, 1.0),), "drift": ((0.0, 0.0),), "horizon": 2}
    scenes = [Scene(id=name, agent=(x, 0.0, 0.0), **rest) for name, x in (("a", 0.0), ("b", 3.0))]
    write_scenes(Path("s.json"), scenes)
    rows = [f"{time_s}\t7\t{1 + 0.1 * time_s}\t0.5" for time_s in range(5)]
    Path("r.tsv").write_text("\n".join(["t\tname\teast\tnorth", "0\t8\t4\t-2", *rows, "4\t8\t4\t-2"]))
    shown = {
        "scene.html": ("--scenes", "s.json", "--scene", "b"),
        "recording.html": ("--recording", "r.tsv", "--max-gap", "5", "--columns", "time=t,id=name,x=east,y=north"),
        "no-ids.html": ("--recording", "r.tsv", "--columns", "time=t,id=name,x=east,y=north", "--clutter", "0.5"),
    }
    for page, source in shown.items():
        assert main(["view", "paper", *source, "--method", "still", "--record", page]) == 0
        assert capsys.readouterr().out.startswith(f"{page}: still")
    scene, recording, alarms = (messages(Path(page)) for page in shown)
    assert scene["durationSeconds"] == 2.0 + 1.0
    np.testing.assert_allclose(last_of(scene, "/agent", "position")[:2], [3.0, 0.0], atol=1e-6)
    assert recording["durationSeconds"] == 4.0 + 1.0
    np.testing.assert_allclose(last_of(recording, "/agent", "position")[:2], [2.5, -0.75], atol=1e-6)  # the middle
    ends = sorted(tuple(np.round(last_of(recording, f"/target/{i}", "position")[:2], 5)) for i in range(2))
    np.testing.assert_allclose(ends, [(1.4, 0.5), (4.0, -2.0)], atol=1e-5)
    names = [{message.get("name") for _, message in each["messages"]} for each in (recording, alarms)]
    assert "/undetected" in names[1] - names[0]
