"""Compare methods on a recording: each is driven through it from the same starts, with the same noise."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import Subject, Trained, methods_of, subject_of
from foveate.io.files import write_document
from foveate.io.progress import Bar
from foveate.io.tables import Table, html, text
from foveate.io.validate import check_count, seed_number
from foveate.names import GATE
from foveate.recordings.fitted import as_recording
from foveate.recordings.motion import default_max_gap_s
from foveate.recordings.plausibility import warnings_for
from foveate.recordings.recording import Recording, window
from foveate.recordings.replay import (
    VERSION,
    Replay,
    ReplayRow,
    default_agent_start,
    prepare_replay,
    random_agent_starts,
    result,
)
from foveate.recordings.replay import replay as drive
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Policy, Trace

COLUMNS: dict[str, tuple[str, str]] = {
    "time seen": ("seen_time_fraction", ".1%"),
    "ever seen": ("seen_fraction", ".0%"),
    "longest unseen [s]": ("longest_unseen_s", ".2f"),
    "log det": ("log_det_mean", ".2f"),
    "rmse [m]": ("rmse_m", ".2f"),
    "nees": ("nees", ".2f"),
    "of the seen": ("nees_seen", ".2f"),
    "of the never seen": ("nees_unseen", ".2f"),
    "lost": ("lost", ".2f"),
    "rejected": ("rejected", ".2f"),
}
"""Heading of each mean in the table: the field of `ReplayRow`, and its format."""


@dataclass(frozen=True, kw_only=True)
class ReplaySettings:
    """All that a comparison depends on beside the experiment and the recording; times in [s], poses in [m, rad]."""

    run: str
    recording: str
    seed: int
    gate: float | None
    start_s: float | None
    end_s: float | None
    max_gap_s: float
    starts: list[list[float]]

    def __post_init__(self) -> None:
        seed_number(self.seed, "seed")


@dataclass(frozen=True, kw_only=True, repr=False)
class Comparison:
    """Methods that were driven through a recording.

    `rows`: one a method and start (`recordings.replay.ReplayRow`). `warnings`: lines to read before trusting them.
    `traces`: of each method from the first start, for pictures. Shows itself as a table of means over the starts.
    """

    experiment: Experiment
    recording: Recording
    settings: ReplaySettings
    rows: tuple[ReplayRow, ...]
    warnings: tuple[str, ...]
    traces: dict[str, tuple[Replay, Trace]]

    @property
    def table(self) -> Table:
        """Means over the starts, one line a method."""
        lines = []
        for method in self.traces:
            rows = [row for row in self.rows if row.method == method]
            means = [_mean([getattr(row, name) for row in rows], form) for name, form in COLUMNS.values()]
            lines.append((method, f"{rows[0].targets} tracks", *means))
        title = f"{self.settings.recording}: mean of {len(self.settings.starts)} start(s)"
        return Table(title=title, header=("method", "targets", *COLUMNS), rows=tuple(lines))

    def to_json(self, path: str | Path) -> None:
        """Write the rows for programs, as `foveate replay --json`."""
        content = result(self.rows, self.experiment, self.recording, asdict(self.settings))
        write_document(path, "replay", VERSION, content)

    def __repr__(self) -> str:
        return text(self.table)

    def _repr_html_(self) -> str:
        return html(self.table)


def _mean(values: Sequence[float | int | None], form: str) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):{form}}" if known else "-"


def agent_starts(
    recording: Recording, scenario: Scenario, given: Sequence[float] | None, count: int, seed: int
) -> list[list[float]]:
    """Poses to start from: the one that is given, several random ones, or the middle of the recording.

    Raises InputError where `given` is no pose of the scenario's space, or more than one start is asked for beside it.
    """
    check_count(count, "starts")
    if given is not None:
        if count > 1:
            raise InputError("agent_start and starts: expected one of them")
        numbers = [float(number) for number in given]
        try:
            scenario.agent.agent().space.from_numbers(numbers)
        except InputError as error:
            raise InputError(f"agent_start {','.join(f'{number:g}' for number in numbers)}: {error}") from None
        return [numbers]
    if count > 1:
        return random_agent_starts(recording, scenario, count, seed)
    return [default_agent_start(recording, scenario)]


def replay(
    policy: Trained | Policy | str | Path,
    recording: Recording | str | Path,
    *,
    method: str | Sequence[str] = "all",
    start: float | None = None,
    end: float | None = None,
    agent_start: Sequence[float] | None = None,
    starts: int = 1,
    max_gap: float | None = None,
    gate: float | None = GATE,
    seed: int = 0,
    scenario: Scenario | None = None,
    progress: bool = True,
) -> Comparison:
    """Drive a policy, and heuristics beside it, through a recording of real targets, all with the same noise.

    Lines that begin with "warning:" go to standard error.

    Args:
        policy: as for `foveate.evaluate`.
        recording: a file, or what `foveate.load_recording` reads from it.
        method: as for `foveate.evaluate`.
        start: first time to replay [s].
        end: last time to replay [s].
        agent_start: pose to start from [m, rad], as numbers; by default the middle of the recording.
        starts: number of starts; more than one are random.
        max_gap: longest gap between two fixes over which a target counts as present [s].
        gate: probability of the filter's chi-square gate; None takes every measurement.
        seed: of the noise and of random starts.
        scenario: another one than the policy was trained for.
        progress: show a bar.
    """
    subject, part = subject_of(policy, scenario), window(as_recording(recording), start, end)
    settings = ReplaySettings(
        run=subject.name,
        recording=Path(part.name).name,
        seed=seed,
        gate=gate,
        start_s=start,
        end_s=end,
        max_gap_s=default_max_gap_s(part) if max_gap is None else max_gap,
        starts=agent_starts(part, subject.experiment.scenario, agent_start, starts, seed),
    )
    return _compare(subject, methods_of(method), part, settings, quiet=not progress)


def _compare(
    subject: Subject, methods: Sequence[str], part: Recording, settings: ReplaySettings, quiet: bool
) -> Comparison:
    scenario, box_world = subject.experiment.scenario, jnp.asarray(np.stack(part.extent), float)
    policies = {name: subject.policy(name, box_world) for name in methods}
    rows, traces, warnings = [], {}, []
    with Bar("replaying", len(settings.starts) * len(policies), "runs", quiet) as bar:
        for start in settings.starts:
            ready = prepare_replay(scenario, part, start, settings.max_gap_s, settings.seed, settings.gate)
            if not rows:  # the recording is the same from every start
                warnings = warnings_for(scenario, part, ready.slots, settings.max_gap_s)
                for line in warnings:
                    bar.say(f"warning: {line}")
            for name, policy in policies.items():
                row, trace = drive(ready, name, policy)
                rows.append(row)
                traces.setdefault(name, (ready, trace))
                bar.update(len(rows), name)
    return Comparison(
        experiment=subject.experiment,
        recording=part,
        settings=settings,
        rows=tuple(rows),
        warnings=tuple(warnings),
        traces=traces,
    )
