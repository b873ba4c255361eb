"""Draw episodes of an evaluation: a moving picture of one scene, or the course of several."""

from collections.abc import Sequence
from pathlib import Path

from foveate.errors import InputError
from foveate.evaluation.evaluate import prepare
from foveate.experiment.resolve import Trained, methods_of, scenes_of, subject_of
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
"""Endings of files."""


def render(
    policy: Trained | Policy | str | Path,
    out: str | Path,
    scenes: str | Path | Sequence[Scene] | None = None,
    *,
    scene: Sequence[str] = (),
    method: str = "policy",
    protocol: ProtocolName = "true",
    seed: int = 0,
    scene_seed: int = 2023,
    scenario: Scenario | None = None,
) -> list[str]:
    """Draw a policy in the episodes that `foveate.evaluate` has with the same seed; returns the ids of their scenes.

    Args:
        policy: as for `foveate.evaluate`.
        out: file to write: .gif or .mp4, the episode as it unfolds; .png, .pdf or .svg, its course in four pictures.
        scenes: as for `foveate.evaluate`.
        scene: ids of the scenes to draw, one for a moving picture; by default the last of each number of targets, and
            for a moving picture the last of all.
        method: of the policy, or a heuristic in its place.
        protocol: how information is counted.
        seed: of the noise.
        scene_seed: of the scenes of table1 or own.
        scenario: another one than the policy was trained for.
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
    name, known = scenes_of(scenes, scene_seed, subject.experiment)
    chosen = _chosen(known, name, scene, moving)
    world = subject.experiment.scenario
    suite = prepare(world.problem(), world.scenes, chosen, seed)
    shown = suite_data(suite, subject.policy(method), protocol, method)
    if moving:
        animate(shown[0], path)
    else:
        trajectory_figure(shown, path)
    return [each.id for each in chosen]


def _chosen(known: Sequence[Scene], name: str, ids: Sequence[str], moving: bool) -> list[Scene]:
    """The scenes to draw. Raises InputError for an unknown id, and for several in one moving picture."""
    by_id = {scene.id: scene for scene in known}
    for each in ids:
        if each not in by_id:
            raise InputError(f"scene {each}: no such scene in {name}: {suggestion(each, by_id)}")
    if moving and len(ids) > 1:
        raise InputError("scene: a moving picture shows one scene; name one, or choose .png")
    if ids:
        return [by_id[each] for each in ids]
    last = {len(scene.targets): scene for scene in known}
    return [known[-1]] if moving else [last[count] for count in sorted(last)]
