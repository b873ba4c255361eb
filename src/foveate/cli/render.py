"""`foveate render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from foveate.cli.options import option
from foveate.errors import InputError


@dataclass(kw_only=True)
class Render:
    """Draw episodes: a moving picture of one scene, or its course (start, 1/3, 2/3, end), a row a scene.

    The same chance as in `foveate evaluate`: what is drawn is the row of its table with that scene and --seed.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or a preset, of which the package brings a trained policy."""
    out: Annotated[Path, option("FILE.gif|.mp4|.png|.pdf|.svg")]
    """.gif or .mp4: the episode as it unfolds. .png, .pdf or .svg: its course in four pictures."""
    scene: Annotated[tuple[str, ...], option("ID ..")] = ()
    """Which scenes (default: the last of each number of targets; the last of all for a moving picture)."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Where they come from (default: table1 in the plane, own in space)."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own."""
    protocol: Literal["surrogate", "true"] = "true"
    """How information is counted."""
    method: str = "policy"
    """policy, random, still, nearest, uncertain or lawnmower."""
    seed: int = 0
    """Seed of the noise."""

    def run_command(self) -> int:
        """Simulate the scenes, draw them, say what was written."""
        from foveate.cli.common import check_methods, check_output, check_seed
        from foveate.evaluation.evaluate import prepare
        from foveate.experiment.resolve import experiment_of, policy_of, scenes_of
        from foveate.plotting.animation import animate
        from foveate.plotting.episode_data import suite_data
        from foveate.plotting.figures import trajectory_figure

        moving = self.out.suffix.lower() in (".gif", ".mp4")
        if not moving and self.out.suffix.lower() not in (".png", ".pdf", ".svg"):
            raise InputError(f"{self.out}: expected a name that ends in .gif, .mp4, .png, .pdf or .svg")
        check_output(self.out, *([self.scenes] if self.scenes else []))
        check_seed(self.seed)
        check_seed(self.scene_seed, "--scene-seed")
        if self.method == "all":
            raise InputError("--method all: expected one method to draw")
        (method,) = check_methods((self.method,))
        experiment = experiment_of(self.run)
        policy = policy_of(self.run, method, experiment)
        name, known = scenes_of(self.scenes, self.scene_seed, experiment)
        chosen = self._chosen(known, name, moving)
        problem = experiment.scenario.problem()
        suite = prepare(problem, experiment.scenario.scenes, chosen, self.seed)
        shown = suite_data(suite, policy, self.protocol, method)
        if moving:
            animate(shown[0], self.out)
        else:
            trajectory_figure(shown, self.out)
        print(f"{self.out}: {', '.join(scene.id for scene in chosen)}")
        return 0

    def _chosen(self, known, name: str, moving: bool):
        """The scenes to draw. Raises ValueError for an id that is not there, and several in one moving picture."""
        from foveate.io.records import suggestion

        by_id = {scene.id: scene for scene in known}
        for scene in self.scene:
            if scene not in by_id:
                raise InputError(f"--scene {scene}: no such scene in {name}: {suggestion(scene, by_id)}")
        if moving and len(self.scene) > 1:
            raise InputError("--scene: a moving picture shows one scene; name one, or choose .png")
        if self.scene:
            return [by_id[scene] for scene in self.scene]
        last = {len(scene.targets): scene for scene in known}
        return [known[-1]] if moving else [last[count] for count in sorted(last)]
