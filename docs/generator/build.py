"""Build the documentation (`make docs`) from the repository's pages and the generated ones, without network access.

The pages are collected in a temporary folder, laid out as in the repository, so that their links stay valid. Zensical
converts them to HTML and rejects broken links. Formulas become MathML, since no script may be loaded to draw them. The
result is checked once more, and `site/` is replaced only if everything succeeded.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import commands_page
import configuration_page
from finish import finish
from gather import gather

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent
GENERATED = {"docs/configuration.md": configuration_page.page, "docs/commands.md": commands_page.page}


def build(out: Path) -> int:
    """Build the site into `out` and return the number of pages. Raises ValueError that names what is broken."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "src").symlink_to(ROOT / "src")
        shutil.copy(HERE / "mkdocs.yml", work)
        gather(ROOT, work / "pages", {name: make() for name, make in GENERATED.items()})
        zensical = Path(sys.executable).parent / "zensical"
        done = subprocess.run([zensical, "build", "--strict"], cwd=work, capture_output=True, text=True)
        if done.returncode:
            raise ValueError(f"zensical rejects the pages:\n{done.stdout}{done.stderr}")
        pages = finish(work / "site")
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(work / "site", out)
    return pages


if __name__ == "__main__":
    try:
        print(f"{build(ROOT / 'site')} pages: open site/index.html; to search them: python -m http.server -d site")
    except ValueError as error:
        sys.exit(f"docs: {error}")
