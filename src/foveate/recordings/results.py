"""Results of a replay: rows, tables, and a file."""

from dataclasses import asdict, dataclass
from pathlib import Path

from foveate.experiment.experiment import Experiment
from foveate.io.files import write_document
from foveate.io.tables import Table, html, text
from foveate.io.validate import seed_number
from foveate.names import Part
from foveate.recordings import replay as replays
from foveate.recordings.choice import Candidate
from foveate.recordings.measures import PreparedReplay, ReplayRow
from foveate.recordings.recording import Recording
from foveate.recordings.replay_table import replay_table, robots_table
from foveate.recordings.split import Shares
from foveate.simulation.records import Trace


@dataclass(frozen=True, kw_only=True)
class ReplaySettings:
    """Settings of a replay beside the experiment and the recording; times in [s], poses in [m, rad].

    With a `split`, `part` was replayed. `candidates` were compared on the part to choose on; `run` is the best of them.
    `map`: the file of the robot's map, if one was given.
    """

    run: str
    recording: str
    seed: int
    gate: float | None
    start_s: float | None
    end_s: float | None
    max_gap_s: float
    starts: list[list[float]]
    split: Shares | None = None
    part: Part | None = None
    candidates: tuple[Candidate, ...] = ()
    map: str | None = None

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
        return replay_table(self.settings.recording, self.rows)

    @property
    def robots_table(self) -> Table | None:
        """Means over the starts, one line for each robot of a team under each method; None of a single robot."""
        return robots_table(self.settings.recording, self.rows)

    def to_json(self, path: str | Path) -> None:
        """Write the rows as JSON, as `foveate replay --json`."""
        content = replays.result(self.rows, self.experiment, self.recording, asdict(self.settings))
        write_document(path, "replay", replays.VERSION, content)

    def __repr__(self) -> str:
        return "\n".join(map(text, self._tables))

    def _repr_html_(self) -> str:
        return "".join(map(html, self._tables))

    @property
    def _tables(self) -> list[Table]:
        return [self.table, *([] if self.robots_table is None else [self.robots_table])]
