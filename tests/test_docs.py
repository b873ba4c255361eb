"""Pages refer to things that exist: files behind links, headings, symbols, tests, and quoted lines of code."""

import ast
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import foveate

ROOT = Path(__file__).parents[1]
PAGES = sorted(path for folder in (".", "docs", "docs/api", "experiments") for path in (ROOT / folder).glob("*.md"))
NOT_COMMITTED = {".venv", "runs", "site", "dist", "node_modules", ".git", ".pytest_cache"}
MARKDOWN = sorted(path for path in ROOT.rglob("*.md") if not NOT_COMMITTED & {*path.relative_to(ROOT).parts})
"""All pages of the repository, linked from the site or not."""
EQUATIONS = ROOT / "docs" / "equations.md"
API = sorted([ROOT / "docs" / "api.md", *ROOT.glob("docs/api/*.md")])
USERS_PAGES = [
    page for page in PAGES if page.parent.name != "experiments" and page.stem not in ("equations", "CHANGELOG")
]
"""Pages with names for users to copy; the equations quote the package, and the changelog names what was."""
CONTRIBUTING = ROOT / "CONTRIBUTING.md"
PUBLIC_MODULES = ("foveate", "foveate.gym", "foveate.ros", "foveate.stonesoup")
NUMBERS = list(range(1, 29))
"""The numbered equations of the compiled paper."""

LINK = re.compile(r"\[([^\[\]]*)\]\(([^()\s]+)\)")
TARGET = re.compile(r"\]\(([^()\s]+)\)|(?:src|href)=[\"']([^\"']+)")
"""Where a link or a picture leads, also a picture inside of a link."""
NO_LINK = re.compile(r"\][\[]\w")
"""A reference that only the site's generator understands: the repository's own view shows its brackets."""
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
SYMBOL = re.compile(r"`([\w/]+\.py)` `([\w.]+)`")
TEST = re.compile(r"`(tests/[\w/]+\.py)::(test_\w+)`")
SHOWN = re.compile(r"^::: foveate\.([\w.]+)$", re.MULTILINE)
NAMED = re.compile(r"`foveate\.([\w.]+)`")
PLACE = re.compile(r"`((?:src|tests|docs|examples|\.ci)/[\w/.*]*)`")
NUMBERED = re.compile(r"^### \((\d+)\)(?:–\((\d+)\))?", re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Names of a `#fragment`: headings, as GitHub writes them."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def broken_links(page: Path) -> list[str]:
    """Relative links of a page that lead nowhere."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    found = [f"{page.name}: a reference of the generator: {match[0]}" for match in NO_LINK.finditer(text)]
    for target in ("".join(parts) for parts in TARGET.findall(text)):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, fragment = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        if not file.exists() or (fragment and file.suffix == ".md" and fragment not in anchors(file)):
            found.append(f"{page.name}: nothing at {target}")
    return found


def bound(node: ast.stmt) -> list[str]:
    """The names that a statement of a module or class body defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def defines(file: Path, symbol: str) -> bool:
    """True if a file has this function, class or constant, or `Class.member`."""
    body = ast.parse(file.read_text(encoding="utf-8")).body
    for part in symbol.split("."):
        node = next((node for node in body if part in bound(node)), None)
        if node is None:
            return False
        body = node.body if isinstance(node, ast.ClassDef) else []
    return True


def quotes(file: Path, snippet: str) -> bool:
    """True if the lines follow each other in the file, whatever their indentation."""
    wanted, lines = ([line.strip() for line in text.splitlines()] for text in (snippet, file.read_text("utf-8")))
    return any(lines[i : i + len(wanted)] == wanted for i in range(len(lines)))


def unkept(page: Path) -> list[str]:
    """Symbols, tests and quoted lines of an equations page that are not in the files that it names."""
    text, found, source = page.read_text(encoding="utf-8"), [], None
    places = sorted([*LINK.finditer(text), *FENCE.finditer(text)], key=lambda match: match.start())
    for match in places:
        if match.re is FENCE:
            if match[2] == "python" and (source is None or not quotes(source, match[3])):
                found.append(f"{page.name}: not in {source and source.name}: {match[3].strip()}")
            continue
        label, target = match.groups()
        file = page.parent / target
        if file.suffix != ".py" or not file.exists():
            continue
        symbol = SYMBOL.fullmatch(label) or TEST.fullmatch(label)
        if symbol is None or not target.endswith(symbol[1]) or not defines(file, symbol[2]):
            found.append(f"{page.name}: {target} does not have {label}")
        if SYMBOL.fullmatch(label):
            source = file
    return found


def numbers(text: str) -> list[int]:
    """The equation numbers in the headings of a page, in order."""
    spans = [(int(first), int(last or first)) for first, last in NUMBERED.findall(text)]
    return [number for first, last in spans for number in range(first, last + 1)]


def untold(text: str) -> list[str]:
    """Sections of numbered equations without code or without a test."""
    sections = [part for part in re.split(r"^(?=##)", text, flags=re.MULTILINE) if NUMBERED.match(part)]
    return [part.splitlines()[0] for part in sections if not (SYMBOL.search(part) and TEST.search(part))]


def deep_imports(code: str) -> list[str]:
    """Imports of modules of the package that are not for users."""
    found = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.append(node.module)
    return [name for name in found if name.partition(".")[0] == "foveate" and name not in PUBLIC_MODULES]


def exported() -> list[str]:
    """Every public name, those of the extras' modules with their module: `gym.TrackingEnv`."""
    names = [name for name in dir(foveate) if name != "__version__"]
    for module in PUBLIC_MODULES[1:]:
        folder = module.partition(".")[2]
        body = ast.parse((ROOT / "src" / "foveate" / folder / "__init__.py").read_text(encoding="utf-8")).body
        (value,) = [node.value for node in body if isinstance(node, ast.Assign) and "__all__" in bound(node)]
        names += [f"{folder}.{name}" for name in ast.literal_eval(value)]
    return sorted(names)


@pytest.mark.parametrize("page", MARKDOWN, ids=[str(page.relative_to(ROOT)) for page in MARKDOWN])
def test_links_have_targets(page: Path):
    assert broken_links(page) == []


@pytest.mark.parametrize("page", USERS_PAGES, ids=[str(page.relative_to(ROOT)) for page in USERS_PAGES])
def test_pages_import_and_name_only_public_names(page: Path):
    text = page.read_text(encoding="utf-8")
    blocks = [code for _, kind, code in FENCE.findall(text) if kind == "python"]
    assert [name for code in blocks for name in deep_imports(code)] == []
    public = {*exported(), *(module.partition(".")[2] for module in PUBLIC_MODULES)}
    assert [name for name in NAMED.findall(text) if name not in public] == []


@pytest.mark.parametrize("file", sorted(ROOT.glob("examples/*.py")), ids=lambda file: file.name)
def test_examples_import_only_public_names(file: Path):
    assert deep_imports(file.read_text(encoding="utf-8")) == []


def test_deep_imports_are_caught():
    code = "import foveate.gym, foveate.io.files\ndef f():\n    from foveate.scenario import target\nimport foveate"
    assert deep_imports(code) == ["foveate.io.files", "foveate.scenario"]
    assert deep_imports("from foveate import train\nfrom foveate.gym import ID\nimport foveated.x") == []


def test_every_public_name_stands_on_one_page():
    assert sorted(name for page in API for name in SHOWN.findall(page.read_text(encoding="utf-8"))) == exported()


def test_the_picture_of_the_layout_names_every_folder_and_places_that_exist():
    text = CONTRIBUTING.read_text(encoding="utf-8")
    (picture,) = [code for _, kind, code in FENCE.findall(text) if kind == "text"]
    folders = {path.parent.name for path in ROOT.glob("src/foveate/*/__init__.py")}
    assert folders == set(re.findall(r"(\w+)/(?=[\s,])", picture.partition("\n")[2]))
    places = PLACE.findall(text)
    assert len(places) > 20
    assert [place for place in places if not list(ROOT.glob(place))] == []


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_tests_that_a_page_names_exist(page: Path):
    named = TEST.findall(page.read_text(encoding="utf-8"))
    assert [f"{file}::{name}" for file, name in named if not defines(ROOT / file, name)] == []


def test_every_equation_has_its_code_and_its_test():
    text = EQUATIONS.read_text(encoding="utf-8")
    assert numbers(text) == NUMBERS
    assert untold(text) == []
    assert len(SYMBOL.findall(text)) > 28
    assert unkept(EQUATIONS) == []


def table_row(file: Path, start: str) -> list[float]:
    """The numbers that begin the cells of a row, the last of a page that starts so."""
    lines = file.read_text(encoding="utf-8").splitlines()
    row = [line for line in lines if line.startswith(f"| {start} |")][-1]
    return [float(number) for number in re.findall(r"\| \**(\d+\.\d+)", row)]


def test_results_of_the_first_page_are_those_of_the_experiments():
    """Scores are means of six cells; in the plane log det Y = -4 log of the standard deviation's geometric mean."""
    first, numbers = ROOT / "README.md", ROOT / "experiments" / "README.md"
    (price,) = re.findall(r"`price` (\d\.\d\d), `true-view`", numbers.read_text(encoding="utf-8"))
    rows = {
        "the best heuristic, `price`": float(price),
        "**`true-view`**, trained for five minutes": np.mean(table_row(numbers, "`true-view` | true")),
        "a planner that knows the future, a reference": np.mean(table_row(numbers, "omniscient")),
    }
    for name, score in rows.items():
        std_m, shown = table_row(first, name)
        assert shown == pytest.approx(score, abs=0.0051), name
        assert std_m == pytest.approx(np.exp(-score / 4), abs=0.0051), name


@pytest.mark.slow
def test_python_on_the_first_page_prints_what_the_page_shows(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr("foveate.evaluation.evaluate.decision_time", lambda *_: 0.125)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,), (shown,) = (
        [code for _, kind, code in FENCE.findall(text) if kind == each] for each in ("python", "text")
    )
    exec(compile(block, "README.md", "exec"), {})
    assert capsys.readouterr().out == shown


@pytest.mark.slow
def test_the_example_of_the_python_api_has_the_documented_scores(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr("foveate.evaluation.evaluate.decision_time", lambda *_: 0.125)
    found = runpy.run_path(str(ROOT / "examples" / "python_api.py"))["main"]()
    assert "the tracker has" in capsys.readouterr().out
    documented = table_row(ROOT / "experiments" / "README.md", "`true-view` | true")
    means = {(cell.targets, cell.motion): cell.mean for cell in found.summary}
    cells = [means[n, motion] for n in (3, 5, 7) for motion in ("unbiased", "biased")]
    np.testing.assert_allclose(cells, documented, atol=0.05)


MADE_UP = """\
# A page

### (1)–(2) Two in one

[`code.py` `CONSTANT`](code.py), [`code.py` `Thing.field`](code.py), [`code.py` `Thing.act`](code.py), [this](#a-page)

  ```python
  x = [0](1)
  return x
  ```

[`tests/test_it.py::test_it`](tests/test_it.py), [elsewhere](https://example.org/no)
"""
CODE = """\
CONSTANT: int = 1


class Thing:
    field: int

    def act(self):
        x = [0](1)
        return x
"""


def made_up(folder: Path, text: str) -> Path:
    (folder / "tests").mkdir()
    (folder / "code.py").write_text(CODE, encoding="utf-8")
    (folder / "tests" / "test_it.py").write_text("def test_it(): ...\n", encoding="utf-8")
    (folder / "page.md").write_text(text, encoding="utf-8")
    return folder / "page.md"


def test_a_sound_page_passes(tmp_path: Path):
    page = made_up(tmp_path, MADE_UP)
    assert broken_links(page) == unkept(page) == untold(MADE_UP) == []
    assert numbers(MADE_UP) == [1, 2]


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("(code.py), [this]", "(gone.py), [this]"),
        ("#a-page", "#another-page"),
        ("[this](#a-page)", "[![this](gone.png)](#a-page)"),
        ("[this](#a-page)", "<img src='gone.png'>"),
        ("[this](#a-page)", "[this][a-page]"),
        ("`CONSTANT`", "`GONE`"),
        ("`Thing.field`", "`Thing.gone`"),
        ("`Thing.act`", "`act`"),
        ("`code.py` `CONSTANT`", "`other.py` `CONSTANT`"),
        ("`code.py` `CONSTANT`", "the constant"),
        ("::test_it", "::test_gone"),
        ("return x", "return y"),
    ],
)
def test_an_unsound_page_is_caught(tmp_path: Path, right: str, wrong: str):
    assert MADE_UP.count(right) == 1
    page = made_up(tmp_path, MADE_UP.replace(right, wrong))
    assert len(broken_links(page) + unkept(page)) == 1


def test_a_section_without_code_or_test_is_caught():
    assert untold(MADE_UP.replace("::test_it", "")) == untold(MADE_UP.replace("`code.py` ", "")) != []
