"""Finish the built pages: convert formulas to MathML, and reject dead links and external resources."""

import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from unicodedata import lookup
from urllib.parse import unquote, urlsplit

from latex2mathml.converter import convert

INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>([.,;:)]*)', re.DOTALL)
DISPLAY = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)
LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "audio": "src"}
LOADED_LINKS = {"stylesheet", "icon", "preload", "preconnect", "dns-prefetch", "modulepreload", "manifest"}
VARIANT = re.compile(r'(?<=<mi) mathvariant="(script|double-struck)">([A-Z])(?=</mi>)')


def finish(site: Path) -> int:
    """Convert the formulas of a built site, check its pages, and return their number.

    Raises ValueError with a line for each dead link and each external resource.
    """
    pages = sorted(site.rglob("*.html"))
    for page in pages:
        page.write_text(with_formulas(page.read_text(encoding="utf-8")), encoding="utf-8")
    read = {page: Links.of(page) for page in pages}
    wrong = [line for page in pages for line in faults(page, read, site)]
    wrong += [f"{sheet.relative_to(site)}: loads {url}" for sheet in site.rglob("*.css") for url in foreign(sheet)]
    if wrong:
        raise ValueError("\n".join(["the built pages are not sound:", *wrong]))
    return len(pages)


def with_formulas(html: str) -> str:
    """Return the page with every formula in MathML, which browsers draw natively."""

    def formula(found: re.Match[str]) -> str:
        drawn = convert(unescape(found[1]).strip(), display="block" if found.re is DISPLAY else "inline")
        drawn = VARIANT.sub(lambda letter: f">{styled(letter[1], letter[2])}", drawn)
        return drawn if found.re is DISPLAY else f'<span class="formula">{drawn}{found[2]}</span>'

    return DISPLAY.sub(formula, INLINE.sub(formula, html))


def styled(style: str, letter: str) -> str:
    """Return a script or double-struck capital as a character, since browsers no longer support its attribute."""
    name = f"{style.upper()} CAPITAL {letter}"  # the oldest few lack MATHEMATICAL in their name
    try:
        return lookup(f"MATHEMATICAL {name}")
    except KeyError:
        return lookup(name)


class Links(HTMLParser):
    """Links, loaded resources and anchors of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.linked: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()

    @classmethod
    def of(cls, page: Path) -> "Links":
        """Parse a file."""
        found = cls()
        found.feed(page.read_text(encoding="utf-8"))
        return found

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record the links and anchors of a tag."""
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.linked.append(given["href"])
        if tag in LOADED and LOADED[tag] in given:
            self.loaded.append(given[LOADED[tag]])
        if tag == "link" and set(given.get("rel", "").split()) & LOADED_LINKS:
            self.loaded.append(given.get("href", ""))


def faults(page: Path, read: dict[Path, Links], site: Path) -> list[str]:
    """Return a line for each dead link of a page, and for each external resource."""
    name, found = page.relative_to(site), []
    for target in [*read[page].linked, *read[page].loaded]:
        parts = urlsplit(target)
        if parts.scheme in ("http", "https", "mailto") or parts.netloc:
            if target in read[page].loaded:
                found.append(f"{name}: loads {target}")
            continue
        if parts.scheme:
            continue
        start = site if parts.path.startswith("/") else page.parent
        file = (start / unquote(parts.path).lstrip("/")).resolve() if parts.path else page
        anchors = read[file].anchors if file in read else set()
        if not file.exists():
            found.append(f"{name}: nothing at {target}")
        elif parts.fragment and file in read and unquote(parts.fragment) not in anchors:
            found.append(f"{name}: no anchor at {target}")
    return found


def foreign(sheet: Path) -> list[str]:
    """Return the external resources that a style sheet would load."""
    return re.findall(r"(?:url\(|@import)\s*['\"]?((?:https?:)?//[^'\")\s]+)", sheet.read_text(encoding="utf-8"))
