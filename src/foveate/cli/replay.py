"""`foveate replay`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import option
from foveate.errors import InputError

GATE = 0.9999
"""Of `models.gate`, repeated here to keep help fast."""


@dataclass(kw_only=True)
class Replay:
    """Drive the agent through a recording of real targets, with the real Kalman filter and the real view.

    Targets come and go; positions are interpolated between fixes. All methods get the same noise and the same start.
    Writes replay.json, a figure and an animation into --out.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or a preset, of which the package brings a trained policy."""
    recording: Annotated[tyro.conf.Positional[Path], option("RECORDING.csv")]
    """Header time_s,track_id,x_m,y_m[,z_m]."""
    method: tuple[str, ...] = ("all",)
    """Any of policy, random, still, nearest, uncertain, lawnmower; or all."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Begin here [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End here [s]."""
    agent_start: Annotated[str | None, option("X,Y,YAW")] = None
    """Where the agent starts [m, rad] (x,y,z,qw,qx,qy,qz in space; default: the middle of the recording)."""
    starts: int = 1
    """Number of starts; with more than one they are drawn, alike for all methods, and means are printed."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap between two fixes over which a target counts as present [s] (default: 2 s, or three fixes of a slow
    clock)."""
    gate: float | None = GATE
    """The filter rejects measurements that are farther from their prediction than this share of honest ones; None: it
    takes whatever comes. With the fifth in a row the target has really jumped, and its belief begins anew."""
    seed: int = 0
    """Seed of the noise and of drawn starts."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for replay.json, replay.png and replay.gif."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the rows for programs."""

    def run_command(self) -> int:
        """Replay every method from every start, print means, write files."""
        import sys

        import jax.numpy as jnp
        import numpy as np

        from foveate.cli.common import check_methods, check_output, check_seed
        from foveate.experiment.resolve import experiment_of, policy_of
        from foveate.io.files import write_document
        from foveate.io.progress import Bar
        from foveate.recordings.formats import load_recording
        from foveate.recordings.motion import default_max_gap_s
        from foveate.recordings.plausibility import warnings_for
        from foveate.recordings.recording import window
        from foveate.recordings.replay import VERSION, prepare_replay, replay, result

        methods = check_methods(self.method)
        check_output(self.out, folder=True)
        check_output(self.json, self.recording)
        check_seed(self.seed)
        experiment = experiment_of(self.run)
        recording = window(load_recording(self.recording), self.start, self.end)
        gap_s = default_max_gap_s(recording) if self.max_gap is None else self.max_gap
        box = np.stack(recording.extent)
        policies = {name: policy_of(self.run, name, experiment, jnp.asarray(box, float)) for name in methods}
        starts = self._starts(recording, experiment)
        rows, films = [], {}
        with Bar("replaying", len(starts) * len(methods), "runs") as bar:
            for start in starts:
                ready = prepare_replay(experiment.scenario, recording, start, gap_s, self.seed, self.gate)
                if not rows:
                    for line in warnings_for(experiment.scenario, recording, ready.slots, gap_s):
                        print(f"warning: {line}", file=sys.stderr)
                for name in methods:
                    row, trace = replay(ready, name, policies[name])
                    rows.append(row)
                    if start is starts[0] and self.out is not None:
                        films[name] = (ready, trace)
                    bar.update(len(rows), name)
        self._print(rows, methods)
        facts = {"run": self.run, "recording": self.recording.name, "seed": self.seed, "gate": self.gate}
        facts |= {"start_s": self.start, "end_s": self.end, "max_gap_s": gap_s, "starts": starts}
        document = result(rows, experiment, recording, facts)
        if self.json is not None:
            write_document(self.json, "replay", VERSION, document)
        if self.out is not None:
            self.out.mkdir(exist_ok=True)
            write_document(self.out / "replay.json", "replay", VERSION, document)
            self._draw(films)
        return 0

    def _starts(self, recording, experiment) -> list[list[float]]:
        from foveate.recordings.replay import default_agent_start, random_agent_starts

        if self.starts < 1:
            raise InputError(f"--starts {self.starts}: expected >= 1")
        if self.agent_start is not None:
            if self.starts > 1:
                raise InputError("--agent-start and --starts: expected one of them")
            try:
                numbers = [float(part) for part in self.agent_start.split(",")]
                experiment.scenario.problem().agent.space.from_numbers(numbers)
            except ValueError as error:
                raise InputError(f"--agent-start {self.agent_start}: {error}") from None
            return [numbers]
        if self.starts > 1:
            return random_agent_starts(recording, experiment.scenario, self.starts, self.seed)
        return [default_agent_start(recording, experiment.scenario)]

    def _print(self, rows, methods) -> None:
        import numpy as np

        from foveate.cli.common import print_table

        names = (
            "seen_time_fraction",
            "seen_fraction",
            "longest_unseen_s",
            "log_det_mean",
            "rmse_m",
            "nees",
            "nees_seen",
            "nees_unseen",
            "lost",
            "rejected",
        )
        lines = []
        for method in methods:
            mine = [row for row in rows if row.method == method]
            found = [[value for row in mine if (value := getattr(row, name)) is not None] for name in names]
            texts = ["-" if not values else f"{np.mean(values):.2f}" for values in found[2:]]
            shown = [f"{np.mean(found[0]):.1%}", f"{np.mean(found[1]):.0%}", *texts]
            lines.append((method, f"{mine[0].targets} tracks", *shown))
        header = (
            "method",
            "targets",
            "time seen",
            "ever seen",
            "longest unseen [s]",
            "log det",
            "rmse [m]",
            "nees",
            "of the seen",
            "of the never seen",
            "lost",
            "rejected",
        )
        print_table(f"{self.recording.name}: mean of {self.starts} start(s)", header, lines)

    def _draw(self, films) -> None:
        from foveate.plotting.animation import animate
        from foveate.plotting.episode_data import episode_data
        from foveate.plotting.figures import replay_figure

        assert self.out is not None, "called with a folder only"
        shots = {}
        for name, (ready, trace) in films.items():
            steps, columns = trace.visible.shape
            shots[name] = episode_data(
                ready.problem, trace, ready.truth, steps, columns, f"{name} on {self.recording.name}"
            )
        replay_figure(shots, self.out / "replay.png")
        first = next(iter(shots))
        animate(shots[first], self.out / "replay.gif")
        print(f"{self.out}: replay.json, replay.png, replay.gif ({first})")
