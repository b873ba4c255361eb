"""Nothing is let in: no network, no file outside of the chosen folder, nothing that is not pinned."""

import ast
import contextlib
import json
import re
import sys
import tomllib
from pathlib import Path

import pytest

from foveate.cli.main import main

ROOT = Path(__file__).parents[1]
NAMES = ("../../escaped", "/tmp/escaped", "..\\escaped", "a/b", "con", "~", "$HOME", "x\x07y", "%s%n")
_watched: list[list[str]] = []


def _listen(event, arguments):
    local = event == "socket.bind" and str(arguments[1][0]) == "127.0.0.1"  # where a page is made
    if _watched and not local and event in ("socket.connect", "socket.getaddrinfo", "socket.sendto", "socket.bind"):
        _watched[0].append(f"{event} {arguments}")


@pytest.fixture(scope="module", autouse=True)
def listening():
    sys.addaudithook(_listen)  # once: there is no way to take it back


@contextlib.contextmanager
def offline():
    """Raises AssertionError in the end where anything asked for the network: Python tells of every attempt."""
    _watched[:] = [[]]
    try:
        yield
    finally:
        attempts = _watched.pop()
    assert attempts == []


def everything(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


@pytest.mark.slow
def test_commands_stay_in_their_folder_and_off_the_network(tmp_path, monkeypatch, capsys):
    """Scenes and tracks with names that would lead elsewhere, were they names of files."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    place = tmp_path / "a" / "b"
    place.mkdir(parents=True)
    monkeypatch.chdir(place)
    scenes = [
        {"id": name, "agent": [0, 0, 0], "targets": [[1, 1]], "drift": [[0.1 * i, 0]]} for i, name in enumerate(NAMES)
    ]
    Path("s.json").write_text(json.dumps({"format": "foveate-scenes", "version": 1, "scenes": scenes}))
    tracks = [name for name in NAMES if name.isprintable()]
    rows = [f"{t},{name},{i + 0.1 * t},{0.2 * t}" for t in range(4) for i, name in enumerate(tracks)]
    Path("r.csv").write_text("\n".join(["time_s,track_id,x_m,y_m", *rows]))
    before = everything(tmp_path)
    with offline():
        for said in (
            "evaluate paper --scenes s.json --method still --protocol true --json out/r.json --write-scenes out/w.json",
            "replay paper r.csv --method still --json out/replay.json",
            "view paper --scenes s.json --scene ../../escaped --method still --record out/p.html",
            "fit r.csv --out out/fit.toml",
        ):
            Path("out").mkdir(exist_ok=True)
            assert main(said.split()) == 0, capsys.readouterr()
    made = everything(tmp_path) - before
    outside = {name for name in made if not name.startswith(("a/b/out", "cache"))}
    assert outside == set()
    assert {f"a/b/out/{name}" for name in ("r.json", "w.json", "replay.json", "p.html", "fit.toml")} <= made
    assert not Path("/tmp/escaped").exists()
    rows = json.loads(Path("out/r.json").read_text())["rows"]
    assert [row["scene"] for row in rows] == list(NAMES), "names they are, all the same"


def test_network_access_while_offline_is_an_error():
    import socket

    with pytest.raises(AssertionError, match=r"127\.0\.0\.1"), offline(), socket.socket() as one:
        one.connect_ex(("127.0.0.1", 1))


def test_no_address_but_this_machine_is_ever_served():
    """By what is written: a server is made in one place, with the loopback's address."""
    made = []
    for path in (ROOT / "src" / "foveate").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "0.0.0.0" not in text
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("ViserServer", "bind", "HTTPServer"):
                if ast.unparse(node).startswith(("_product", "operation.primitive")):
                    continue  # a primitive of JAX
                made.append((path.name, ast.unparse(node)))
    assert sorted(made) == [
        ("common.py", "probe.bind(('127.0.0.1', port))"),  # is a port free, before anything heavy is imported
        ("server.py", "probe.bind((HOST, port))"),
        ("server.py", "viser.ViserServer(host=HOST, port=port, label='foveate', verbose=False)"),
    ]
    assert re.search(
        r'^HOST = "127\.0\.0\.1"$', (ROOT / "src/foveate/plotting/live/server.py").read_text(), re.MULTILINE
    )


def test_every_dependency_is_pinned_and_they_are_few():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    def names(wanted):
        found = {re.match(r"[A-Za-z0-9_.-]+", one).group(0) for one in wanted}
        return {name.lower().replace("_", "-") for name in found} - {"foveate"}

    core = names(project["dependencies"])
    assert len(core) <= 13
    every = core.union(*map(names, project["optional-dependencies"].values()))
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+==[^=<>~,\s]+", line) for line in lines)
    assert every - names(lines) == set()
