"""`foveate reproduce`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from foveate.cli.options import Command, option
from foveate.errors import InputError

if TYPE_CHECKING:
    from foveate.evaluation.comparison import Comparison
    from foveate.study.methods import Method
    from foveate.study.study import Study


INTERVALS_WIDTH = 175
"""Columns of a terminal that has room for intervals, too."""


@dataclass(kw_only=True)
class Reproduce(Command):
    """Reproduce a comparison: every learner, every method, the same scenes; tables and figures.

    The paper's: learners with three seeds, planners, a policy refined by a planner, heuristics, and the omniscient
    planner as the oracle, each under both protocols. Into --out: table.md, table.json (every episode, the summary with
    normalised_score, paired differences to the reference), learning.png, trajectories-*.png, pareto.png, and one run
    folder a training. Ctrl-C is safe: the same command continues where it stopped, and a call with other settings
    computes again only what depends on them.

      foveate reproduce --quick                        # minutes: short training, few scenes; a look, not a result
      foveate reproduce                                # the whole of it: an hour and a half or so on 2 cores
      foveate reproduce --suite true-view              # where only what is really seen counts
      foveate reproduce --scene-seed 7 --out runs/reproduce-7     # the same on scenes that nobody has seen
      foveate reproduce --add examples/own_method.py:METHOD       # with a method of your own beside the others
    """

    suite: Literal["paper", "true-view"] = "paper"
    """paper: the paper's table 1, with its figures. true-view: the same scenes where a target counts only when it is
    really seen, with first errors of beliefs as in the paper and as the beliefs claim (consistent); is the filter
    honest; scores in worlds that differ from training (robustness.png, robustness.json); moving pictures of easy and
    hard scenes (episodes/)."""
    quick: bool = False
    """One seed, a short training, 3 scenes a cell of 3 and 5 targets, fewer planners; marked in all that is written."""
    seeds: Annotated[tuple[int, ...] | None, option("INT ..")] = None
    """Training seeds (default: 0 10 100; quick: 0)."""
    scene_seed: int = 2023
    """Seed of the scenes; table1 proper is the default."""
    add: Annotated[tuple[str, ...], option("FILE.py:NAME ..")] = ()
    """Methods of your own: records of foveate.study.methods, or tuples of them, in Python files. Runs these files."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for all that is written (default: runs/reproduce; -true-view and -quick behind it as asked for)."""

    def run_command(self) -> int:
        """Do what is not done yet, write the files, print the tables."""
        from foveate.cli.common import compile_fast

        if self.quick:
            compile_fast()
        from foveate.io.progress import Bar
        from foveate.study.publish import publish
        from foveate.study.run import jobs, reproduce

        study = self._study()
        suffix = f"{'-true-view' * (self.suite == 'true-view')}{'-quick' * self.quick}"
        out = self.out or Path("runs") / f"reproduce{suffix}"
        if out.exists() and not out.is_dir():
            raise InputError(f"{out}: is no folder: choose another place")
        total = len(jobs(study, out))
        with Bar(f"reproducing {self.suite}", total, "jobs") as bar:
            try:
                results = reproduce(study, out, bar.update, bar.say)
                bar.update(total, "tables and figures")
                comparisons = publish(study, out, results)
            except KeyboardInterrupt:
                bar.say(f"interrupted: what is done is kept in {out}; the same command continues from there")
                raise
        _print(study, comparisons)
        print(f"{out}: {', '.join(sorted(path.name for path in out.iterdir() if path.is_file() and path.suffix))}")
        return 0

    def _study(self) -> "Study":
        from foveate.cli.common import check_seed
        from foveate.study.study import paper_study, true_view_study

        for seed in self.seeds or ():
            check_seed(seed, "--seeds")
        check_seed(self.scene_seed, "--scene-seed")
        changes = {} if self.seeds is None else {"seeds": self.seeds}
        own = tuple(method for place in self.add for method in _own(place))
        make = true_view_study if self.suite == "true-view" else paper_study
        return make(self.quick, own, scene_seed=self.scene_seed, **changes)


def _own(place: str) -> "list[Method]":
    """The methods that FILE.py:NAME means. Raises ValueError where there are none."""
    import importlib.util
    import sys

    from foveate.study.methods import Method

    file, _, name = place.rpartition(":")
    if not file.endswith(".py") or not Path(file).is_file():
        raise InputError(f"--add {place}: expected FILE.py:NAME of a file that exists")
    spec = importlib.util.spec_from_file_location(f"foveate_own_{Path(file).stem}", file)
    assert spec is not None, "a name that ends in .py has a loader"
    assert spec.loader is not None, "a name that ends in .py has a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    found = getattr(module, name, None)
    methods = list(found) if isinstance(found, tuple | list) else [found]
    ours = [method for method in methods if isinstance(method, Method)]
    if not ours or len(ours) < len(methods):
        raise InputError(f"--add {place}: expected a record of foveate.study.methods, or a tuple of them, of that name")
    return ours


def _slim(cell: str) -> str:
    """A cell as a terminal has room for it: on a narrow one the mean alone."""
    import shutil
    import sys

    wide = not sys.stdout.isatty() or shutil.get_terminal_size().columns >= INTERVALS_WIDTH
    return cell if wide else cell.partition(" ±")[0].partition(" [")[0]


def _print(study: "Study", comparisons: "list[Comparison]") -> None:
    from foveate.cli.common import print_table
    from foveate.study.publish import heading
    from foveate.study.tables import consistency, differences, scores

    print(heading(study))
    kinds = (scores, consistency) if study.suite == "true-view" else (scores, differences)
    for table in (kind(one, protocol) for one in comparisons for protocol in study.protocols for kind in kinds):
        print_table(table.title, table.header, [[_slim(cell) for cell in row] for row in table.rows])
        print(table.note)
