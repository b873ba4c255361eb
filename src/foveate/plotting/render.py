"""Draw episodes of an evaluation: an animation of one scene, or pictures of several."""

from collections.abc import Sequence
from pathlib import Path

from foveate.errors import InputError
from foveate.evaluation.evaluate import prepare
from foveate.experiment.resolve import NamedPolicy, methods_of, scenes_of, subject_of
from foveate.io.figures import DPI, WIDTH
from foveate.io.records import suggestion
from foveate.io.validate import seed_number
from foveate.names import ProtocolName
from foveate.plotting.animation import animate
from foveate.plotting.episode_data import suite_data
from foveate.plotting.figures import trajectory_figure
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Policy

MOVING, STILL = (".gif", ".mp4"), (".png", ".pdf", ".svg")
"""Endings of files of animations, and of figures."""


def render(
    policy: NamedPolicy | Policy | str | Path,
    out: str | Path,
    scenes: str | Path | Sequence[Scene] | None = None,
    *,
    scene: Sequence[str] = (),
    method: str = "policy",
    protocol: ProtocolName = "true",
    seed: int = 0,
    scene_seed: int = 2023,
    scenario: Scenario | None = None,
    width: float = WIDTH,
    dpi: int = DPI,
) -> list[str]:
    """Draw a policy in the episodes of `foveate.evaluate` with the same seed; return the ids of their scenes.

    Args:
        policy: as for `foveate.evaluate`.
        out: file to write: .gif or .mp4, an animation; .png, .pdf or .svg, four pictures of each episode.
        scenes: as for `foveate.evaluate`.
        scene: ids of the scenes to draw, one for an animation; by default the last of each number of targets, and for
            an animation the last of all.
        method: `policy`, or a heuristic in its place.
        protocol: surrogate or true information.
        seed: of the noise.
        scene_seed: of the scenes of table1 or own.
        scenario: scenario to act in, by default the one of the training.
        width: width of a figure [inches]: 9 for a page, 3.5 for a column of a paper.
        dpi: dots per inch of a .png figure.
    """
    path = Path(out)
    if path.suffix.lower() not in MOVING + STILL:
        raise InputError(f"{path}: expected a name that ends in {', '.join(MOVING + STILL[:-1])} or {STILL[-1]}")
    seed_number(seed, "seed")
    seed_number(scene_seed, "scene_seed")
    if method == "all":
        raise InputError("method all: expected one method to draw")
    methods_of(method)
    subject, moving = subject_of(policy, scenario), path.suffix.lower() in MOVING
    selected = _selected(*scenes_of(scenes, scene_seed, subject.experiment), scene, moving)
    scenario = subject.experiment.scenario
    suite = prepare(scenario.problem(), scenario.scenes, selected, seed)
    episodes = suite_data(suite, subject.policy(method), protocol, subject.name if method == "policy" else method)
    if moving:
        animate(episodes[0], path)
    else:
        trajectory_figure(episodes, path, width=width, dpi=dpi)
    return [each.id for each in selected]


def _selected(name: str, suite: Sequence[Scene], ids: Sequence[str], moving: bool) -> list[Scene]:
    """Scenes to draw. Raises InputError for an unknown id, and for several in one animation."""
    by_id = {scene.id: scene for scene in suite}
    for each in ids:
        if each not in by_id:
            raise InputError(f"scene {each}: no such scene in {name}: {suggestion(each, by_id)}")
    if moving and len(ids) > 1:
        raise InputError("scene: an animation shows one scene; name one, or choose .png")
    if ids:
        return [by_id[each] for each in ids]
    last = {len(scene.targets): scene for scene in suite}
    return [suite[-1]] if moving else [last[count] for count in sorted(last)]
