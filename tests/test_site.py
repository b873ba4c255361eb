"""The built documentation: generated pages, links to code, formulas, and content that no page may have."""

from dataclasses import dataclass, fields
from pathlib import Path
from types import ModuleType
from typing import get_type_hints

import commands_page
import configuration_page
import gather
import pages
import pytest

from foveate.cli.main import COMMANDS
from foveate.experiment.presets import PRESETS

ROOT = Path(__file__).parents[1]
GENERATOR = ROOT / "docs" / "generator"


def test_every_key_of_every_preset_stands_on_the_page_with_its_default():
    text = configuration_page.page()
    for preset in PRESETS.values():
        for name, table in (("scenario", preset.scenario), ("policy", preset.policy), ("training", preset.training)):
            assert f"## `[{name}]`" in text
            assert all(
                f"| `{f.name}` |" in text or f"## `[{name}.{f.name}]`" in text or f.name in ("kind", "algorithm")
                for f in fields(table)
            )
    assert "| `v_max_m_s` | number | 4 | m/s | Largest speed ahead. |" in text
    assert "| `W` | matrix | left out |" in text


def test_every_key_is_explained():
    unexplained = {kind.__name__: configuration_page.untold(kind) for _, kind in configuration_page.tables()}
    assert not {name: keys for name, keys in unexplained.items() if keys}


def test_a_key_without_explanation_is_found():
    @dataclass
    class Bare:
        """Has a `named` key."""

        named: int = 1
        other: int = 2

    assert configuration_page.untold(Bare) == ["other"]


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("v_max_m_s", "m/s"),
        ("acceleration_m2_s3", "m²/s³"),
        ("initial_velocity_variance_m2_s2", "m²/s²"),
        ("w_max_rad_s", "rad/s"),
        ("angle_deg", "deg"),
        ("tau_s", "s"),
        ("range_growth_per_m", "1/m"),
        ("epochs", ""),
        ("targets", ""),
    ],
)
def test_units(key: str, unit: str):
    assert configuration_page.unit(key) == unit


def test_every_option_of_every_command_stands_on_the_page():
    text = commands_page.page()
    for name, kind in COMMANDS.items():
        assert f"## foveate {name}\n" in text
        section = text.partition(f"## foveate {name}\n")[2].partition("\n## ")[0]
        for field in fields(kind):
            option = f"`--{field.name.replace('_', '-')}"
            positional = "Positional" in str(get_type_hints(kind, include_extras=True)[field.name])
            assert positional or option in section, (name, option)
    assert "| `--port INT` | 8080 | " in text


@pytest.mark.parametrize("name", pages.GENERATED)
def test_committed_pages_are_those_that_their_sources_make(name: str):
    """Otherwise run `make docs`, or `python docs/generator/pages.py`, and commit what it writes."""
    assert (ROOT / name).read_text(encoding="utf-8") == pages.generated(name)


def test_pages_are_written_with_a_note_to_their_editors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pages, "GENERATED", {"docs/made.md": lambda: "# Made\n\ntext  \nmore\n\n\n"})
    (tmp_path / "docs").mkdir()
    pages.write(tmp_path)
    text = (tmp_path / "docs" / "made.md").read_text(encoding="utf-8")
    assert text == f"# Made\n\n{pages.NOTE}\n\ntext\nmore\n"


PAGE = """\
[`code.py` `Thing.act`](../code.py) [there](https://example.org) [page](other.md#part) ![p](p.png)

```sh
echo [not](a-link.py)
```
"""
CODE = "x = 1\n\n\nclass Thing:\n    def act(self):\n        return 1\n"


def laid_out(root: Path, page: str) -> Path:
    (root / "docs").mkdir(parents=True)
    (root / "docs" / "generator").mkdir()
    (root / "docs" / "images").mkdir()
    for name in gather.ASSETS:
        (root / name).write_text("", encoding="utf-8")
    (root / "code.py").write_text(CODE, encoding="utf-8")
    (root / "docs" / "page.md").write_text(page, encoding="utf-8")
    (root / "docs" / "other.md").write_text("# Other\n", encoding="utf-8")
    (root / "docs" / "p.png").write_bytes(b"")
    return root


def test_links_to_code_lead_to_its_line_on_a_page(tmp_path: Path):
    gather.gather(laid_out(tmp_path / "in", PAGE), tmp_path / "out")
    text = (tmp_path / "out" / "docs" / "page.md").read_text(encoding="utf-8")
    assert text == PAGE.replace("../code.py)", "../code.py.md#__codelineno-0-5)")
    assert CODE in (tmp_path / "out" / "code.py.md").read_text(encoding="utf-8")
    found = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*")}
    assert found == {"docs/page.md", "docs/other.md", "docs/p.png", "code.py.md", *gather.ASSETS}


@pytest.mark.parametrize("target", ["gone.md", "../gone.py", "../../outside.md"])
def test_a_broken_link_is_named(tmp_path: Path, target: str):
    (tmp_path / "outside.md").write_text("", encoding="utf-8")
    root = laid_out(tmp_path / "in", f"[this]({target})\n")
    with pytest.raises(ValueError, match=rf"docs/page.md: {target}: expected a file of the repository"):
        gather.gather(root, tmp_path / "out")


def test_formulas_become_mathml_and_sound_pages_pass(tmp_path: Path):
    finish = finished()
    inline = r'<span class="arithmatex">\(\tfrac12 &lt; \mathcal N \mathbb H\)</span>.'
    (tmp_path / "a.html").write_text(f'{inline}<a href="b.html#here">b</a><div class="arithmatex">\\[x\\]</div>')
    (tmp_path / "b.html").write_text(
        '<h1 id="here">b</h1><a href="https://example.org">a link, which loads nothing</a>'
    )
    assert finish.finish(tmp_path) == 2
    text = (tmp_path / "a.html").read_text()
    assert "arithmatex" not in text
    assert "<mfrac><mn>1</mn><mn>2</mn></mfrac>" in text
    assert "<mi>𝒩</mi><mi>ℍ</mi>" in text
    assert "</math>.</span>" in text, "the full stop stays with its formula"
    assert 'display="block"' in text


@pytest.mark.parametrize(
    ("html", "fault"),
    [
        ('<a href="gone.html">x</a>', "nothing at gone.html"),
        ('<a href="#gone">x</a>', "no anchor at #gone"),
        ('<script src="https://example.org/x.js"></script>', "loads https://example.org/x.js"),
        ('<link rel="stylesheet" href="//example.org/x.css">', "loads //example.org/x.css"),
        ('<link rel="preconnect" href="https://example.org">', "loads https://example.org"),
        ('<img src="gone.png">', "nothing at gone.png"),
    ],
)
def test_an_unsound_page_is_named(tmp_path: Path, html: str, fault: str):
    (tmp_path / "a.html").write_text(html)
    with pytest.raises(ValueError, match=f"a.html: {fault}"):
        finished().finish(tmp_path)


def test_a_style_that_loads_from_elsewhere_is_named(tmp_path: Path):
    (tmp_path / "a.css").write_text("@import 'https://example.org/font.css'; b { src: url(own.woff) }")
    with pytest.raises(ValueError, match=r"a\.css: loads https://example\.org/font\.css"):
        finished().finish(tmp_path)


def finished() -> ModuleType:
    """The module that goes over the built pages."""
    pytest.importorskip("latex2mathml", reason="needs the extra docs")
    import finish

    return finish


@pytest.mark.slow
def test_the_site_builds(tmp_path: Path):
    """Strictly: dead links, anchors and cross-references of any page, or docstring, would be rejected."""
    pytest.importorskip("zensical", reason="needs the extra docs")
    finished()
    import build

    nav = (GENERATOR / "mkdocs.yml").read_text(encoding="utf-8")
    found = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/api/*.md")])
    names = [path.relative_to(ROOT).as_posix() for path in found]
    assert [name for name in names if f"- {name}\n" not in nav] == [], "not in the navigation"
    assert build.build(tmp_path / "site") > len(names)
    text = (tmp_path / "site" / "docs" / "equations.html").read_text(encoding="utf-8")
    assert text.count("<math") > 100
    assert "arithmatex" not in text
    text = (tmp_path / "site" / "docs" / "api" / "scenarios.html").read_text(encoding="utf-8")
    assert 'id="foveate.SectorView"' in text
    assert "Full angle, up to 360." in text, "the docstring of a field"
