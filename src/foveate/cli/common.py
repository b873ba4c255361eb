"""What several commands share: where a policy comes from, tables, progress, results for programs."""

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from foveate.problem import Policy
    from foveate.scenes import Scene
    from foveate.settings import Experiment
    from foveate.summary import Summary

METHODS = ("policy", "random", "still", "nearest", "uncertain", "lawnmower")
"""The trained policy, and the hand-made ones (`policies.handmade.METHODS`; repeated here to keep help fast)."""


def keep_compiled() -> None:
    """Keep compiled programs in the user's cache folder (foveate/jax there; safe to delete), so that only the first
    run of a kind waits for compilation. JAX_COMPILATION_CACHE_DIR names another place."""
    import jax

    from foveate.files import cache_folder

    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        jax.config.update("jax_compilation_cache_dir", str(cache_folder("jax")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def compile_fast() -> None:
    """Let XLA compile in a fifth less time, for programs that wait for that more than they run. Call it before
    anything of foveate that makes arrays is imported; does nothing where XLA_FLAGS is set, or a JAX may not know it."""
    from importlib.metadata import version

    if version("jax").startswith("0.10."):
        os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")


def check_methods(methods: Sequence[str]) -> tuple[str, ...]:
    """The methods to run, `all` spelled out. Raises ValueError for a name that is not known."""
    if "all" in methods:
        return METHODS
    for name in methods:
        if name not in METHODS:
            raise ValueError(f"--method {name}: expected one of {', '.join(METHODS)}, or all")
    return tuple(dict.fromkeys(methods))


def experiment_of(run: str) -> "Experiment":
    """The experiment of a run folder, or the preset of that name where there is no such folder."""
    from foveate.checkpoint import CONFIG
    from foveate.configuration import load_toml
    from foveate.settings import PRESETS, Experiment

    if Path(run).is_dir():
        return load_toml(Experiment, Path(run) / CONFIG)
    if run in PRESETS:
        return PRESETS[run]
    raise ValueError(f"{run}: no such run folder, and no preset: presets are {', '.join(PRESETS)}")


def with_initial_error(
    experiment: "Experiment", initial_error: 'Literal["paper", "consistent"] | None'
) -> "Experiment":
    """The experiment with this first error of beliefs; with its own where None is given."""
    if initial_error is None:
        return experiment
    scenario = experiment.scenario
    scenes = replace(scenario.scenes, initial_error=initial_error)
    return replace(experiment, scenario=replace(scenario, scenes=scenes))


def policy_of(run: str, method: str, experiment: "Experiment", box_world: Any = None) -> "Policy":
    """The policy that a method name means for a run. Raises ValueError where a preset has no trained policy."""
    from foveate.checkpoint import load_run
    from foveate.policies.handmade import handmade

    if method != "policy":
        scenario = experiment.scenario
        return handmade(method, scenario.problem(), float(scenario.view.depth_m), box_world)
    if not Path(run).is_dir():
        raise ValueError(
            f"preset {run} has no trained policy here: train it (foveate train --preset {run}), or name a --method"
        )
    return load_run(Path(run))[1]


def scenes_of(name: str | None, seed: int, experiment: "Experiment") -> tuple[str, list["Scene"]]:
    """The scenes that a name means, and the name: a file, table1, or own; None is table1 in the plane, own in space."""
    from foveate.episodes import own_suite, table1
    from foveate.scenes import read_scenes

    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    planar = experiment.scenario.dimension == 2
    chosen = name or ("table1" if planar else "own")
    if chosen == "own":
        return chosen, own_suite(settings, problem, seed)
    if chosen != "table1":
        return chosen, read_scenes(Path(chosen), problem.agent.space, settings)
    if not planar:
        raise ValueError("--scenes table1: the paper's suite is planar: give a scenes file, or own")
    return chosen, table1(problem, seed)


def check_seed(seed: int, name: str = "--seed") -> None:
    """Raise ValueError for a seed that is no seed."""
    if not 0 <= seed < 2**32:
        raise ValueError(f"{name} {seed}: expected a whole number from 0 to {2**32 - 1}")


def check_least(name: str, value: int | None, least: int) -> None:
    """Raise ValueError for an option that is given and too small."""
    if value is not None and value < least:
        raise ValueError(f"{name} {value}: expected >= {least}")


def check_output(path: Path | None, *inputs: Path | str, folder: bool = False) -> None:
    """Raise ValueError now, not after minutes of work, where a result could not be written or would hit an input."""
    if path is None:
        return
    if any(path.resolve() == Path(name).resolve() for name in inputs):
        raise ValueError(f"{path}: is an input of this command: choose another file")
    if path.exists() and path.is_dir() != folder:
        raise ValueError(f"{path}: is {'no ' * folder}a folder: choose another place")
    if not path.resolve().parent.is_dir():
        raise ValueError(f"{path}: no folder {path.parent}: make it first, or choose another place")


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on standard output; the first two columns are text, the others numbers."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left", header_style="bold")
    for i, name in enumerate(header):
        table.add_column(escape(name), justify="left" if i < 2 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # Not a terminal: no colours, and as wide as the table needs.
    console = Console() if sys.stdout.isatty() else Console(width=200, no_color=True)
    console.print(table)


def print_summary(title: str, episodes: int, summary: "Sequence[Summary]") -> None:
    """The table of an evaluation."""
    header = ("method", "protocol", "motion", "targets", "score", "95 % interval", "std", "seen", "of the time")
    close = ("closeness",) * any(cell.closeness is not None for cell in summary)
    print_table(
        f"{title}: score per target [nat], {episodes} episode(s) a scene",
        (*header, "longest not [s]", "rmse [m]", "nees (band)", "seen, never seen", *close),
        [
            (
                cell.method,
                cell.protocol,
                cell.motion,
                str(cell.targets),
                f"{cell.mean:.2f}",
                f"{cell.ci95[0]:.2f} .. {cell.ci95[1]:.2f}",
                f"{cell.std:.2f}",
                f"{cell.seen_fraction:.0%}",
                f"{cell.seen_step_fraction:.0%}",
                f"{cell.longest_unseen_s:.1f}",
                f"{cell.rmse_m:.2f}",
                f"{cell.nees:.1f} ({cell.nees_band[0]:.1f} .. {cell.nees_band[1]:.1f})",
                ", ".join("-" if nees is None else f"{nees:.1f}" for nees in (cell.nees_seen, cell.nees_unseen)),
                *("-" if cell.closeness is None else f"{cell.closeness:.3f}" for _ in close),
            )
            for cell in summary
        ],
    )


class Bar:
    """A progress bar with rate and time left on a terminal; nothing elsewhere."""

    def __init__(self, what: str, total: int, unit: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn(unit),
            TextColumn("{task.fields[note]}"),
            TimeRemainingColumn(),
        )
        self._progress = Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty())
        self._task = self._progress.add_task(what, total=total, note="")

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def update(self, done: int, note: str = "") -> None:
        """Set how much is done, and a note beside it."""
        self._progress.update(self._task, completed=done, note=note)

    def say(self, line: str) -> None:
        """Print a line above the bar; on standard error, also where there is no terminal."""
        self._progress.console.print(line, highlight=False, markup=False, soft_wrap=True)
