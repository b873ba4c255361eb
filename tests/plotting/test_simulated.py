"""Simulated episodes: the numbers of an evaluation, their pictures, and the Python of docs/pictures.md."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import foveate
from foveate.errors import InputError
from foveate.io.figures import new_figure

PAGE = Path(__file__).parents[2] / "docs" / "pictures.md"


@pytest.fixture(scope="module")
def nearest() -> foveate.RobotPolicy:
    return foveate.heuristic("nearest", "paper")


@pytest.mark.slow
def test_an_episode_has_the_score_of_the_evaluation_and_draws_itself(nearest: foveate.RobotPolicy, tmp_path: Path):
    scene = foveate.Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((3.0, 1.0), (-2.0, 4.0)))
    episode = nearest.simulate(scene, seed=3)
    evaluated = foveate.evaluate(nearest, [scene], protocol="true", seed=3, progress=False)
    assert episode.score == pytest.approx(evaluated.rows[0].score, abs=1e-5)
    assert episode.steps == 6, "the scenario's three steps a target"
    own = new_figure(3.0, 3.0).subplots()
    assert episode.plot(own, step=2) is own
    assert own.get_title() == "t = 2 s"
    assert episode.plot().get_title() == "t = 6 s"
    with pytest.raises(InputError, match="step = 7: expected from 0 to 6"):
        episode.plot(step=7)
    assert episode.animate(tmp_path / "a.gif") is None
    shown = episode.animate()
    assert shown is not None
    shown.save(tmp_path / "b.gif")
    for name in "ab":
        with Image.open(tmp_path / f"{name}.gif") as picture:
            assert getattr(picture, "n_frames", 1) > 6
    assert "data:image/gif;base64," in shown._repr_html_()
    assert repr(episode).startswith("SimulatedEpisode('nearest on a': 2 targets, 6 steps, score ")


@pytest.mark.slow
def test_the_page_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """With a pandas that keeps its records, where none is installed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=list))
    monkeypatch.setattr("foveate.evaluation.evaluate.decision_time", lambda *_: 0.125)
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    names: dict = {}
    exec(compile(block, str(PAGE), "exec"), names)
    assert {path.name for path in tmp_path.iterdir()} == {"episode.pdf", "episode.gif", "scores.pdf"}
    assert np.isfinite([record["ci95_low"] for record in names["table"]]).all()


def test_without_pandas_the_error_names_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    empty = foveate.Evaluation(title="", facts={}, rows=(), summary=(), scenes=())
    with pytest.raises(ImportError, match="pip install pandas"):
        empty.to_pandas()
