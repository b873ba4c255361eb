"""Work of `foveate reproduce`."""

import importlib.util
import shutil
import sys
from pathlib import Path

from foveate.cli.common import check_seed, print_table
from foveate.cli.reproduce import Reproduce
from foveate.errors import InputError
from foveate.io.progress import Bar
from foveate.study.comparison import Comparison
from foveate.study.methods import Method
from foveate.study.publish import heading, publish
from foveate.study.run import jobs, reproduce
from foveate.study.study import Study, paper_study, true_view_study
from foveate.study.tables import consistency, differences, scores

INTERVALS_WIDTH = 175
"""Terminal columns from which tables show intervals."""


def run(options: Reproduce) -> int:
    """Do the remaining jobs, write the files, print the tables."""
    study, out = _study(options), options.folder
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is no folder: choose another place")
    total = len(jobs(study, out))
    with Bar(f"reproducing {options.suite}", total, "jobs") as bar:
        try:
            results = reproduce(study, out, bar.update, bar.say)
            bar.update(total, "tables and figures")
            comparisons = publish(study, out, results)
        except KeyboardInterrupt:
            bar.say(f"interrupted: finished jobs are kept in {out}; the same command resumes")
            raise
    _print(study, comparisons)
    print(f"{out}: {', '.join(sorted(path.name for path in out.iterdir() if path.is_file() and path.suffix))}")
    return 0


def _study(options: Reproduce) -> Study:
    for seed in options.seeds or ():
        check_seed(seed, "--seeds")
    check_seed(options.scene_seed, "--scene-seed")
    changes = {} if options.seeds is None else {"seeds": options.seeds}
    methods = tuple(method for place in options.add for method in _methods_at(place))
    make = true_view_study if options.suite == "true-view" else paper_study
    return make(options.quick, methods, scene_seed=options.scene_seed, **changes)


def _methods_at(place: str) -> list[Method]:
    """Load the methods at FILE.py:NAME. Raises InputError where there are none."""
    file, _, name = place.rpartition(":")
    if not file.endswith(".py") or not Path(file).is_file():
        raise InputError(f"--add {place}: expected FILE.py:NAME of a file that exists")
    spec = importlib.util.spec_from_file_location(f"foveate_own_{Path(file).stem}", file)
    assert spec is not None, "a name that ends in .py has a loader"
    assert spec.loader is not None, "a name that ends in .py has a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a user's file raises is not a bug of foveate
        raise InputError(f"--add {place}: {type(error).__name__}: {error}") from error
    value = getattr(module, name, None)
    values = list(value) if isinstance(value, tuple | list) else [value]
    methods = [method for method in values if isinstance(method, Method)]
    if not methods or len(methods) < len(values):
        raise InputError(f"--add {place}: expected a foveate.Method, or a tuple of them, of that name")
    return methods


def _print(study: Study, comparisons: list[Comparison]) -> None:
    print(heading(study))
    is_wide = not sys.stdout.isatty() or shutil.get_terminal_size().columns >= INTERVALS_WIDTH
    kinds = (scores, consistency) if study.suite == "true-view" else (scores, differences)
    for table in (kind(one, protocol) for one in comparisons for protocol in study.protocols for kind in kinds):
        rows = table.rows if is_wide else [[_mean_alone(cell) for cell in row] for row in table.rows]
        print_table(table.title, table.header, rows)
        print(table.note)


def _mean_alone(cell: str) -> str:
    return cell.partition(" ±")[0].partition(" [")[0]
