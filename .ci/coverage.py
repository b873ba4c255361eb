"""Lines of the package that the tests reach, by coverage.json: 95 % in all, 85 % of every file, or exit status 1."""

import json
import sys
from pathlib import Path

ALL, EACH = 95.0, 85.0


def main() -> int:
    """Compare, and name what falls short."""
    found = json.loads(Path("coverage.json").read_text())
    total = found["totals"]["percent_covered"]
    shares = {name: one["summary"]["percent_covered"] for name, one in found["files"].items()}
    low = {name: share for name, share in shares.items() if share < EACH}
    for name, share in sorted(low.items()):
        print(f"== coverage: {name}: {share:.1f} %, of at least {EACH:g} %")
    print(f"== coverage: {total:.1f} % of all lines, of at least {ALL:g} %")
    return int(bool(low) or total < ALL)


if __name__ == "__main__":
    sys.exit(main())
