"""Work of `foveate reproduce`."""

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from foveate.cli.common import check_output, check_seed, print_tables
from foveate.cli.reproduce import Reproduce
from foveate.errors import InputError
from foveate.io.files import write_atomic
from foveate.io.progress import Bar
from foveate.study import world_results
from foveate.study.comparison import Comparison
from foveate.study.methods import Method
from foveate.study.publish import DATA, heading, publish
from foveate.study.run import jobs, reproduce
from foveate.study.study import Study, paper_study, true_view_study
from foveate.study.tables import consistency, differences, scores
from foveate.study.worlds import WORLDS, reproduce_worlds, world_jobs, worlds_at, worlds_study


def run(options: Reproduce) -> int:
    """Do the remaining jobs, write the files, print the tables."""
    out = options.folder
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is no folder: choose another place")
    check_output(options.json)
    for seed in options.seeds or ():
        check_seed(seed, "--seeds")
    check_seed(options.scene_seed, "--scene-seed")
    data = _worlds(options, out) if options.suite == "worlds" else _comparison(options, out)
    print(f"{out}: {', '.join(sorted(path.name for path in out.iterdir() if path.is_file() and path.suffix))}")
    if options.json is not None:
        write_atomic(options.json, data.read_bytes())
    return 0


def _comparison(options: Reproduce, out: Path) -> Path:
    """Compare methods; return the file of the results."""
    study = _study(options)
    total = len(jobs(study, out))
    with _progress(options, out, total) as bar:
        results = reproduce(study, out, bar.update, bar.say)
        bar.update(total, "tables and figures")
        comparisons = publish(study, out, results)
    _print(study, comparisons)
    return out / DATA


def _worlds(options: Reproduce, out: Path) -> Path:
    """Train and judge in every world; return the file of the results."""
    if options.add:
        raise InputError(f"--add {options.add[0]}: expected another suite: methods are not added to worlds")
    changes = {} if options.seeds is None else {"seeds": options.seeds}
    worlds = worlds_at(options.worlds or WORLDS, options.only)
    study = worlds_study(worlds, options.quick, scene_seed=options.scene_seed, **changes)
    with _progress(options, out, len(world_jobs(study, out))) as bar:
        scored, trained = reproduce_worlds(study, out, bar.update, bar.say)
    print(world_results.heading(study))
    print_tables(*world_results.publish_worlds(study, out, world_results.world_results(study, scored, trained)))
    return out / world_results.DATA


@contextmanager
def _progress(options: Reproduce, out: Path, total: int) -> Iterator[Bar]:
    """A progress bar of jobs; an interrupt prints how to continue."""
    with Bar(f"reproducing {options.suite}", total, "jobs") as bar:
        try:
            yield bar
        except KeyboardInterrupt:
            bar.say(f"interrupted: finished jobs are kept in {out}; the same command resumes")
            raise


def _study(options: Reproduce) -> Study:
    if options.worlds is not None or options.only:
        raise InputError("--worlds and --only: expected --suite worlds beside them")
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
    kinds = (scores, consistency) if study.suite == "true-view" else (scores, differences)
    print_tables(*(kind(one, protocol) for one in comparisons for protocol in study.protocols for kind in kinds))
