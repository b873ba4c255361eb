"""Collect the files of the site: the pages and all files that they link to; code becomes pages of its own."""

import ast
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

FENCE = r"^ *```.*?^ *```"
LINK = r"\[(?P<label>(?:[^\[\]]|\[[^\[\]]*\])*)\]\((?P<target>[^()\s#]+)(?P<anchor>#[^()\s]*)?\)"
FOUND = re.compile(rf"{FENCE}|{LINK}", re.DOTALL | re.MULTILINE)
LABEL = re.compile(r"`[\w/]+\.py` `([\w.]+)`|`[\w/]+\.py::(\w+)`")
PAGES = ("*.md", "docs/*.md", "docs/api/*.md", "experiments/*.md")
AS_THEY_ARE = {".png", ".gif", ".svg", ".jpg", ".css", ".html"}
ASSETS = ("docs/images/logo.svg", "docs/generator/site.css")


def gather(root: Path, out: Path) -> None:
    """Lay out the pages in `out` as in the repository at `root`, with all files that they link to.

    Raises ValueError, naming page and target, for a dead link.
    """
    waiting = [path for pattern in PAGES for path in sorted(root.glob(pattern))]
    waiting += [root / asset for asset in ASSETS]
    done: set[Path] = set()
    while waiting:
        source = waiting.pop()
        if source in done:
            continue
        done.add(source)
        target = out / source.relative_to(root)
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.suffix in AS_THEY_ARE:
            shutil.copy(source, target)
        elif source.suffix == ".md":
            text = source.read_text(encoding="utf-8")
            waiting += linked(source, text, root)
            target.write_text(rewritten(source, text), encoding="utf-8")
        else:
            page_of(target).write_text(code_page(source, source.relative_to(root)), encoding="utf-8")


def page_of(file: Path) -> Path:
    """Return the path of the page for a code file."""
    return file.with_name(f"{file.name}.md")


def linked(page: Path, text: str, root: Path) -> Iterator[Path]:
    """Yield the files of the repository that a page links to."""
    for found in FOUND.finditer(text):
        target = found["target"]
        if target is None or re.match(r"[a-z]+:", target):
            continue
        file = (page.parent / target).resolve()
        if not file.is_file() or not file.is_relative_to(root):
            raise ValueError(f"{page.relative_to(root)}: {target}: expected a file of the repository")
        yield file


def rewritten(page: Path, text: str) -> str:
    """Return the text of a page with its links to code replaced by links to the code's page and line."""

    def link(match: re.Match[str]) -> str:
        label, target, anchor = match["label"], match["target"], match["anchor"] or ""
        if target is None or re.match(r"[a-z]+:", target) or Path(target).suffix in {".md", *AS_THEY_ARE}:
            return match[0]
        symbol = LABEL.fullmatch(label)
        if symbol is not None:
            anchor = f"#__codelineno-0-{line_of(page.parent / target, symbol[1] or symbol[2])}"
        return f"[{label}]({page_of(Path(target)).as_posix()}{anchor})"

    return FOUND.sub(link, text)


def line_of(file: Path, symbol: str) -> int:
    """Return the line on which a file defines a symbol, `name` or `Class.name`; without it the class's line, or 1."""
    nodes, line = ast.parse(file.read_text(encoding="utf-8")).body, 1
    for name in symbol.split("."):
        found = next((node for node in nodes if name in _names(node)), None)
        if found is None:
            return line
        nodes, line = getattr(found, "body", []), found.lineno
    return line


def code_page(file: Path, name: Path) -> str:
    """Return a page that shows a file, excluded from search."""
    kind = {".py": "python", ".toml": "toml", ".json": "json"}.get(file.suffix, "text")
    fence = "`````"
    head = "---\nsearch:\n  exclude: true\n---\n"
    return f"{head}\n# {name.name}\n\n`{name.as_posix()}`\n\n{fence}{kind}\n{file.read_text(encoding='utf-8')}{fence}\n"


def _names(node: ast.stmt) -> list[str]:
    """Return the names that a statement defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]
