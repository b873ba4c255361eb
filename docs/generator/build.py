"""Build the documentation (`make docs`) from the repository's pages, without network access.

The pages made from code are refreshed first (`pages.py`). All pages are collected in a temporary folder, laid out as in
the repository, so that their links stay valid. Zensical converts them to HTML and rejects broken links. Formulas become
MathML, since no script may be loaded to draw them. The result is checked once more, and `site/` is replaced only if
everything succeeded.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pages
from finish import finish
from gather import gather

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent


def build(out: Path) -> int:
    """Build the site into `out` and return the number of pages. Raises ValueError that names what is broken."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "src").symlink_to(ROOT / "src")
        shutil.copy(HERE / "mkdocs.yml", work)
        gather(ROOT, work / "pages")
        zensical = Path(sys.executable).parent / "zensical"
        done = subprocess.run([zensical, "build", "--strict"], cwd=work, capture_output=True, text=True)
        if done.returncode:
            raise ValueError(f"zensical rejects the pages:\n{done.stdout}{done.stderr}")
        count = finish(work / "site")
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(work / "site", out)
    return count


if __name__ == "__main__":
    try:
        pages.write()
        print(f"{build(ROOT / 'site')} pages: open site/index.html; to search them: python -m http.server -d site")
    except ValueError as error:
        sys.exit(f"docs: {error}")
