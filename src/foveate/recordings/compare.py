"""Compare methods on a recording: each drives through it from the same starts, with the same noise."""

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
from foveate.recordings import replay as replays
from foveate.recordings.formats import load_window
from foveate.recordings.motion import default_max_gap_s
from foveate.recordings.plausibility import warnings_for
from foveate.recordings.recording import Recording
from foveate.recordings.replay import PreparedReplay, ReplayRow, prepare_replay
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
    """Settings of a replay beside the experiment and the recording; times in [s], poses in [m, rad]."""

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
class ReplayResult:
    """Results of methods on a recording; shows itself as a table of means over the starts.

    `rows`: one for each method and start (`recordings.replay.ReplayRow`). `warnings`: reasons to doubt them. `traces`:
    of each method from the first start, for pictures.
    """

    experiment: Experiment
    recording: Recording
    settings: ReplaySettings
    rows: tuple[ReplayRow, ...]
    warnings: tuple[str, ...]
    traces: dict[str, tuple[PreparedReplay, Trace]]

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
        """Write the rows as JSON, as `foveate replay --json`."""
        content = replays.result(self.rows, self.experiment, self.recording, asdict(self.settings))
        write_document(path, "replay", replays.VERSION, content)

    def __repr__(self) -> str:
        return text(self.table)

    def _repr_html_(self) -> str:
        return html(self.table)


def _mean(values: Sequence[float | int | None], form: str) -> str:
    numbers = [value for value in values if value is not None]
    return f"{np.mean(numbers):{form}}" if numbers else "-"


def _agent_starts(
    recording: Recording, scenario: Scenario, given: Sequence[float] | None, count: int, seed: int
) -> list[list[float]]:
    """Return the given pose, several random ones, or the middle of the recording."""
    check_count(count, "starts")
    if given is None and count > 1:
        return replays.random_agent_starts(recording, scenario, count, seed)
    if given is None:
        return [replays.default_agent_start(recording, scenario)]
    if count > 1:
        raise InputError("agent_start and starts: expected one of them")
    numbers = [float(number) for number in given]
    try:
        scenario.agent.agent().space.from_numbers(numbers)
    except InputError as error:
        raise InputError(f"agent_start {','.join(f'{number:g}' for number in numbers)}: {error}") from None
    return [numbers]


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
) -> ReplayResult:
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
        gate: probability of the filter's chi-square gate; None accepts every measurement.
        seed: of the noise and of random starts.
        scenario: replaces the one that the policy was trained for.
        progress: show a bar.
    """
    subject, part = subject_of(policy, scenario), load_window(recording, start, end)
    settings = ReplaySettings(
        run=subject.name,
        recording=Path(part.name).name,
        seed=seed,
        gate=gate,
        start_s=start,
        end_s=end,
        max_gap_s=default_max_gap_s(part) if max_gap is None else max_gap,
        starts=_agent_starts(part, subject.experiment.scenario, agent_start, starts, seed),
    )
    return _run(subject, methods_of(method), part, settings, quiet=not progress)


def _run(
    subject: Subject, methods: Sequence[str], part: Recording, settings: ReplaySettings, quiet: bool
) -> ReplayResult:
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
                row, trace = replays.drive(ready, name, policy)
                rows.append(row)
                traces.setdefault(name, (ready, trace))
                bar.update(len(rows), name)
    return ReplayResult(
        experiment=subject.experiment,
        recording=part,
        settings=settings,
        rows=tuple(rows),
        warnings=tuple(warnings),
        traces=traces,
    )
