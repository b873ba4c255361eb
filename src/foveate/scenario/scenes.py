"""Scenes: initial poses of agents, initial positions and drifts of targets, in memory and in files."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from foveate.errors import InputError
from foveate.geometry.space import Space
from foveate.io.files import content_digest, read_document, write_document
from foveate.io.settings import Settings
from foveate.io.validate import at_least, require
from foveate.names import FirstVelocity, InitialError
from foveate.scenario.rows import pose_of, poses_of, table_of


@dataclass(frozen=True, kw_only=True)
class SceneSettings(Settings):
    """Distribution of training scenes, and settings of an episode.

    Targets: n uniform on `targets_min` .. `targets_max` (a policy takes any number), positions uniform in a box about
    `centre_m` with half side `half_side_m` + n `half_side_per_target_m`. Agent: uniform in `agent_spread` times that
    box in training, within `agent_test_half_side_m` of the centre in test scenes, any heading. With `target_ring_m`,
    `agent_centre_m` or `agent_half_side_m` test scenes are drawn as those of training. Drift: uniform in [-d, d] on
    each axis, d = `drift_m_s`, one for all targets of a scene (`shared_drift`) or each its own. Targets that are
    positions driven by an input get a new jitter, uniform in [-j, j], j = `jitter_m_s`, added at each step; for other
    kinds the drift is the first velocity: at rest where it is 0. `known_drift`: the agent knows these inputs (the
    paper: yes). `process_noise`: targets also move by N(0, W). `birth_and_death`: in training, a target that leaves the
    box is replaced by a new one that enters on the opposite side. Horizon: `steps`, or `steps_per_target` n.
    `initial_error` of the initial mean: N(0, V), V of the first step at range 0 ("paper": smaller than the belief
    claims), or sampled from the initial belief ("consistent").
    """

    RENAMED: ClassVar[dict[str, str]] = {"turnover": "birth_and_death"}
    targets_min: int = 3
    targets_max: int = 8
    centre_m: tuple[float, ...] = (0.0, 0.0)
    half_side_m: tuple[float, ...] = (0.0, 0.0)
    half_side_per_target_m: float = 2.0
    agent_spread: float = 1.25
    agent_test_half_side_m: float = 2.0
    drift_m_s: tuple[float, ...] = (0.8, 0.8)
    shared_drift: bool = True
    known_drift: bool = True
    process_noise: bool = True
    birth_and_death: bool = False
    jitter_m_s: float = 0.5
    steps_per_target: int = 3
    steps: int | None = None
    initial_error: InitialError = "paper"
    first_error_std: tuple[float, ...] | None = None
    """Standard deviation of the error of a first mean, whatever the initial belief claims: a number for each block of
    the state (position [m], velocity [m/s], acceleration [m/s^2]), for all axes. It replaces `initial_error`, which
    then stays at its default."""
    first_mean_velocity: FirstVelocity | None = None
    """Mean velocity (and acceleration) of a new belief: `"zero"`, or `"truth"` with its error. Left out: 0 for targets
    that appear later and for all in a replay, as a tracker begins; the truth with its error at the start of an episode.
    """
    target_ring_m: tuple[float, float] | None = None
    """Inner and outer radius of a ring about the agent on which targets start, uniform in angle and in radius, in place
    of the box; in space the ring is horizontal, and heights are those of the box."""
    agent_centre_m: tuple[float, ...] | None = None
    """Centre of the box in which the agent starts. Left out: `centre_m`."""
    agent_half_side_m: tuple[float, ...] | None = None
    """Half side of the box in which the agent starts. Left out: `agent_spread` times that of the targets' box."""

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(1, self, "targets_min", "steps_per_target", "steps")
        right = f"expected >= targets_min {self.targets_min}"
        require(self.targets_max >= self.targets_min, "targets_max", self.targets_max, right)
        at_least(0, self, "half_side_per_target_m", "agent_spread", "agent_test_half_side_m", "jitter_m_s")
        half_side, drift = self.half_side_m, self.drift_m_s
        require(min(half_side, default=-1) >= 0, "half_side_m", half_side, "expected >= 0 per axis")
        require(min(drift, default=-1) >= 0, "drift_m_s", drift, "expected >= 0 per axis")
        for name, numbers in (("centre_m", self.centre_m), ("drift_m_s", drift)):
            require(len(numbers) == len(half_side), name, numbers, "expected one number per axis, as half_side_m has")
        self._check_starts()
        std = self.first_error_std or ()
        require(min(std, default=0) >= 0, "first_error_std", std, "expected >= 0 per block of the state")
        right = "expected 'paper', the default, with first_error_std: both set the error of the first means"
        require(not std or self.initial_error == "paper", "initial_error", self.initial_error, right)
        is_used = self.first_mean_velocity != "zero" or not any(std[1:])
        require(is_used, "first_error_std", std, "expected 0 after the first with first_mean_velocity = 'zero'")
        has_extent = min(half_side) + self.half_side_per_target_m > 0
        require(not self.birth_and_death or has_extent, "half_side_m", half_side, "expected > 0 with birth_and_death")

    def _check_starts(self) -> None:
        centre, side, axes = self.agent_centre_m, self.agent_half_side_m, len(self.half_side_m)
        for name, numbers in (("agent_centre_m", centre), ("agent_half_side_m", side)):
            fits = numbers is None or len(numbers) == axes
            require(fits, name, numbers, "expected one number per axis, as half_side_m has")
        require(side is None or min(side) >= 0, "agent_half_side_m", side, "expected >= 0 per axis")
        if self.target_ring_m is not None:
            inner, outer = self.target_ring_m
            right = "expected radii 0 <= inner <= outer, outer > 0"
            require(0 <= inner <= outer and outer > 0, "target_ring_m", self.target_ring_m, right)
            right = "expected false with target_ring_m: targets that leave the box come back into it"
            require(not self.birth_and_death, "birth_and_death", True, right)

    @property
    def has_own_starts(self) -> bool:
        """True if the starts are set apart from the targets' box: test scenes then have those of training."""
        return any(key is not None for key in (self.target_ring_m, self.agent_centre_m, self.agent_half_side_m))

    def horizon(self, targets: int) -> int:
        """Steps of an episode with this number of targets."""
        return self.steps if self.steps is not None else self.steps_per_target * max(1, targets)

    @property
    def mean_horizon(self) -> float:
        """Expected steps of an episode."""
        counts = range(self.targets_min, self.targets_max + 1)
        return sum(map(self.horizon, counts)) / len(counts)

    @property
    def middle_steps_left(self) -> int:
        """Steps left in the middle of an episode: the constant value for a robot whose task has no end."""
        return round(self.mean_horizon / 2)


VERSION = 1
MAX_HORIZON = 100_000


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A scene as in a scenes file: lengths in metres, drift in m/s, a row per target.

    Without `drift` targets have none; a `horizon` of 0 steps is that of the scenario; `map` is the number of its map;
    `others` are the poses of the other robots of a team.
    """

    id: str
    agent: tuple[float, ...]
    targets: tuple[tuple[float, ...], ...]
    drift: tuple[tuple[float, ...], ...] = ()
    horizon: int = 0
    map: int = 0
    others: tuple[tuple[float, ...], ...] = ()

    def record(self) -> dict[str, Any]:
        """All fields as plain values, without the first map's number, as without obstacles, and without a team."""
        return {name: value for name, value in asdict(self).items() if name not in ("map", "others") or value}

    @property
    def motion(self) -> str:
        """`unbiased` if every drift is 0, else `biased`."""
        return "biased" if any(any(row) for row in self.drift) else "unbiased"


def write_scenes(path: Path, scenes: Sequence[Scene]) -> None:
    """Write a scenes file.

    Args:
        path: File to write.
        scenes: Scenes, each with its own id.
    """
    write_document(path, "scenes", VERSION, {"scenes": [_given(scene) for scene in scenes]})


def scenes_digest(scenes: Sequence[Scene]) -> str:
    """Digest of the scenes' content, 16 hex digits."""
    return content_digest([scene.record() for scene in scenes])[:16]


def checked(scenes: Sequence[Scene], space: Space, settings: SceneSettings) -> list[Scene]:
    """Check scenes of an agent in `space`. Raises as `read_scenes`."""
    # Through JSON, so that scenes made in Python, perhaps of arrays, pass the same checks as those in files.
    rows = json.dumps([_given(scene) for scene in scenes], default=lambda array: np.asarray(array).tolist())
    return _scenes(json.loads(rows), "scenes", space, settings)


def _given(scene: Scene) -> dict[str, Any]:
    """Fields of a scene, without a drift and a horizon that were left out."""
    is_left_out = {"drift": len(scene.targets) > 0 == len(scene.drift), "horizon": scene.horizon == 0}
    return {name: value for name, value in scene.record().items() if not is_left_out.get(name, False)}


def read_scenes(path: Path, space: Space, settings: SceneSettings) -> list[Scene]:
    """Read a scenes file.

    Args:
        path: File to read.
        space: Space of the agent, which gives the size of poses and positions.
        settings: Scene settings of the scenario, which give a missing horizon.

    Raises:
        InputError: One line that names file, scene, field and what would be right.
    """
    data = read_document(path, "scenes", VERSION, "scenes file")
    if unknown := sorted(set(data) - {"scenes"}):
        raise InputError(f"{path}: unknown key {unknown[0]!r}: expected digest, format, scenes, version")
    return _scenes(data.get("scenes"), f"{path}: scenes", space, settings)


def _scenes(rows: Any, where: str, space: Space, settings: SceneSettings) -> list[Scene]:
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{where}: expected a list of at least one scene")
    scenes = [_scene(row, f"{where}[{i}]", space, settings) for i, row in enumerate(rows)]
    if twice := [name for name, count in Counter(scene.id for scene in scenes).items() if count > 1]:
        raise InputError(f"{where}: id {twice[0]!r} is given twice: expected one scene per id")
    return scenes


def _scene(row: Any, where: str, space: Space, settings: SceneSettings) -> Scene:
    if not isinstance(row, dict):
        raise InputError(f"{where}: expected an object with id, agent, targets")
    names = ("id", "agent", "targets", "drift", "horizon", "map", "others")
    if missing := [name for name in names[:3] if name not in row]:
        raise InputError(f"{where}: no {missing[0]!r}: expected id, agent and targets")
    if unknown := sorted(set(row) - set(names)):
        raise InputError(f"{where}: unknown key {unknown[0]!r}: expected {', '.join(names)}")
    is_text = isinstance(row["id"], str) and row["id"] != "" and row["id"] == row["id"].encode(errors="ignore").decode()
    require(is_text, f"{where}: id", row["id"], "expected a non-empty text of whole characters")
    where = f"{where} ({row['id']!r})"
    agent = pose_of(row["agent"], f"{where}: agent", space)
    others = poses_of(row.get("others", []), f"{where}: others", space)
    targets = table_of(row["targets"], f"{where}: targets", space.dimension)
    drift = ((0.0,) * space.dimension,) * len(targets)
    if row.get("drift") is not None:
        drift = table_of(row["drift"], f"{where}: drift", space.dimension)
    if len(drift) != len(targets):
        raise InputError(f"{where}: drift has {len(drift)} rows: expected {len(targets)}, one per target")
    horizon = row.get("horizon", settings.horizon(len(targets)))
    fits = type(horizon) is int and 1 <= horizon <= MAX_HORIZON
    require(fits, f"{where}: horizon", horizon, f"expected a whole number from 1 to {MAX_HORIZON}")
    number = row.get("map", 0)
    require(type(number) is int and number >= 0, f"{where}: map", number, "expected a whole number >= 0")
    return Scene(id=row["id"], agent=agent, targets=targets, drift=drift, horizon=horizon, map=number, others=others)
