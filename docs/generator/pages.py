"""Write the pages that are made from code and files of the package: `make docs` refreshes them, and they are committed,
so that links to them work in the repository too.
"""

from pathlib import Path

import commands_page
import configuration_page
import presets_page

ROOT = Path(__file__).parents[2]
GENERATED = {
    "docs/configuration.md": configuration_page.page,
    "docs/commands.md": commands_page.page,
    "docs/presets.md": presets_page.page,
}
NOTE = "<!-- Made by make docs: change what it is made from, not this file. -->"


def generated(name: str) -> str:
    """Return a page as it has to be in the repository, with a note for its editors below its title."""
    title, _, rest = GENERATED[name]().partition("\n\n")
    lines = (line.rstrip() for line in f"{title}\n\n{NOTE}\n\n{rest}".splitlines())
    return "\n".join(lines).rstrip() + "\n"


def write(root: Path = ROOT) -> None:
    """Write every page into a checkout."""
    for name in GENERATED:
        (root / name).write_text(generated(name), encoding="utf-8")


if __name__ == "__main__":
    write()
