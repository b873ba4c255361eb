"""`foveate view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from foveate.cli.options import option
from foveate.errors import InputError

if TYPE_CHECKING:
    from foveate.experiment.experiment import Experiment
    from foveate.plotting.live.player import EpisodeSource


@dataclass(kw_only=True)
class View:
    """Play episodes in the browser, in 3-D: the agent with its view, targets, beliefs, and what is known of each.

    Serves a page at 127.0.0.1, for this machine only, until ctrl-C; or, with --record, writes one episode as a page
    that plays without a server. The same chance as in `foveate evaluate` and `foveate replay`.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or a preset, of which the package brings a trained policy."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Where scenes come from (default: table1 in the plane, own in space)."""
    recording: Annotated[Path | None, option("RECORDING.csv")] = None
    """Drive through a recording of real targets in the place of scenes."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Begin the recording here [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End the recording here [s]."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap between two fixes over which a target of the recording counts as present [s] (default: 2 s, or three
    fixes of a slow clock)."""
    port: int = 8080
    """Where to serve the page."""
    record: Annotated[Path | None, option("FILE.html")] = None
    """Write a page that plays one episode without a server, and end."""
    scene: Annotated[str | None, option("NAME")] = None
    """The scene to begin with, or to record (default: the first)."""
    method: Annotated[str | None, option("NAME")] = None
    """The method to begin with, or to record: policy, random, still, nearest, uncertain or lawnmower."""
    protocol: Literal["surrogate", "true"] = "true"
    """How information is counted; in a recording always the true way."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own."""
    seed: int = 0
    """Seed of the noise."""

    def run_command(self) -> int:
        """Serve, or write the page."""
        from foveate.cli.common import check_output, check_seed

        if self.scenes is not None and self.recording is not None:
            raise InputError("--scenes and --recording: expected one of them")
        if not 1 <= self.port <= 65535:
            raise InputError(f"--port {self.port}: expected a whole number from 1 to 65535")
        if self.record is not None and self.record.suffix.lower() != ".html":
            raise InputError(f"{self.record}: expected a name that ends in .html")
        check_output(self.record, *[name for name in (self.scenes, self.recording) if name])
        check_seed(self.seed)
        check_seed(self.scene_seed, "--scene-seed")
        from foveate.experiment.resolve import experiment_of
        from foveate.plotting.live.server import record, serve

        experiment = experiment_of(self.run)
        source = self._recorded(experiment) if self.recording is not None else self._simulated(experiment)
        if self.record is None:
            serve(source, self.port, lambda line: print(line, flush=True))
            return 0
        episode = source.episode(source.scenes[0], source.methods[0])
        record(episode, self.record)
        print(f"{self.record}: {episode.title}")
        return 0

    def _methods(self) -> tuple[str, ...]:
        """All there are, the chosen one first."""
        from foveate.cli.common import METHODS, check_methods

        if self.method is None:
            return METHODS
        check_methods((self.method,) if self.method != "all" else ("one of them",))
        return tuple(dict.fromkeys((self.method, *METHODS)))

    def _simulated(self, experiment: "Experiment") -> "EpisodeSource":
        from foveate.evaluation.evaluate import prepare
        from foveate.experiment.resolve import policy_of, scenes_of
        from foveate.io.records import suggestion
        from foveate.plotting.episode_data import EpisodeData, suite_data
        from foveate.plotting.live.player import EpisodeSource

        name, known = scenes_of(self.scenes, self.scene_seed, experiment)
        by_id = {scene.id: scene for scene in known}
        if self.scene is not None and self.scene not in by_id:
            raise InputError(f"--scene {self.scene}: no such scene in {name}: {suggestion(self.scene, by_id)}")
        first = (self.scene,) if self.scene is not None else ()
        problem, settings = experiment.scenario.problem(), experiment.scenario.scenes

        def make(scene: str, method: str) -> EpisodeData:
            suite = prepare(problem, settings, [by_id[scene]], self.seed)
            return suite_data(suite, policy_of(self.run, method, experiment), self.protocol, method)[0]

        return EpisodeSource(scenes=tuple(dict.fromkeys((*first, *by_id))), methods=self._methods(), episode=make)

    def _recorded(self, experiment: "Experiment") -> "EpisodeSource":
        import sys

        import jax.numpy as jnp
        import numpy as np

        from foveate.experiment.resolve import policy_of
        from foveate.plotting.episode_data import EpisodeData, episode_data
        from foveate.plotting.live.player import EpisodeSource
        from foveate.recordings.formats import load_recording
        from foveate.recordings.motion import default_max_gap_s
        from foveate.recordings.plausibility import warnings_for
        from foveate.recordings.recording import window
        from foveate.recordings.replay import default_agent_start, prepare_replay, replay

        assert self.recording is not None, "called with a recording only"
        if self.scene is not None:
            raise InputError("--scene: a recording is one scene")
        recording = window(load_recording(self.recording), self.start, self.end)
        gap_s = default_max_gap_s(recording) if self.max_gap is None else self.max_gap
        box = jnp.asarray(np.stack(recording.extent), float)
        start = default_agent_start(recording, experiment.scenario)
        ready = prepare_replay(experiment.scenario, recording, start, gap_s, self.seed)
        for line in warnings_for(experiment.scenario, recording, ready.slots, gap_s):
            print(f"warning: {line}", file=sys.stderr)

        def make(scene: str, method: str) -> EpisodeData:
            _, trace = replay(ready, method, policy_of(self.run, method, experiment, box))
            steps, columns = trace.visible.shape
            return episode_data(ready.problem, trace, ready.truth, steps, columns, f"{method} on {scene}")

        return EpisodeSource(scenes=(self.recording.name,), methods=self._methods(), episode=make)
