"""Work of `foveate bench`."""

import sys

from foveate.bench.report import measure, read_ratios, regressions
from foveate.cli.bench import Bench
from foveate.cli.common import check_output, print_tables
from foveate.errors import InputError
from foveate.io.validate import check_count


def run(options: Bench) -> int:
    """Measure, print, write, compare."""
    check_output(options.json)
    if not options.episodes:
        raise InputError("--episodes: expected at least one number")
    for size in options.episodes:
        check_count(size, "episodes")
    if not options.tolerance > 0:
        raise InputError(f"--tolerance {options.tolerance}: expected > 0")
    before = {} if options.baseline is None else read_ratios(options.baseline)
    report = measure(options.episodes, options.quick)
    if options.json is not None:
        report.to_json(options.json)
    print_tables(report.table(before))
    for line in report.doubts(before):
        print(f"foveate: {line}", file=sys.stderr)
    worse = regressions(report.metrics, report.ratios, before, options.tolerance)
    for key, factor in worse.items():
        print(f"worse than the baseline: {key} by a factor of {factor:.2f}")
    return 1 if worse else 0
