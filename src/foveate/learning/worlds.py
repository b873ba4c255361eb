"""The worlds that the actor-critic plays in: the experiment's own, or many of random robots."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
from jaxtyping import Array
from jaxtyping import Key as Keys

from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.experiment.presets import PAN
from foveate.io.jax_settings import quick_compilation
from foveate.models.problem import Problem
from foveate.names import Objective
from foveate.policies.places import token_count
from foveate.policies.pointer import PointerPolicy
from foveate.scenario.agent import FreeBody
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import DriftTarget, VelocityTarget
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import Episode
from foveate.simulation.robots import RobotRanges, draw_robot, with_robot
from foveate.types import Key

ROBOT_STREAM = 7
"""Folded into the key of an episode: its robot does not depend on the numbers of its scene."""


@dataclass(frozen=True, kw_only=True)
class World:
    """Where episodes are played, and for what: a problem with its scenes, and ranges of robots unless there is one."""

    problem: Problem
    scenes: SceneSettings
    objective: Objective
    robots: RobotRanges | None = None

    @property
    def agents(self) -> int:
        """Robots of an episode."""
        return 1 if self.problem.team is None else self.problem.team.agents

    def drawn(self, key: Key, test: bool = False) -> tuple[Problem, Episode]:
        """The robot and the noisy episode of a key; `test` as in `draw`."""
        problem = self.problem
        if self.robots is not None:
            problem = with_robot(problem, draw_robot(self.robots, jax.random.fold_in(key, ROBOT_STREAM)))
        return problem, training_episode(problem, self.scenes, key, noise=True, test=test)

    def held_out(self, keys: Keys[Array, " episodes"]) -> tuple[Problem | None, Episode]:
        """Episodes of the test distribution, and the robot of each; None where there is one."""

        def drawn(key):
            problem, episode = self.drawn(key, test=True)
            return None if self.robots is None else problem, episode

        options = quick_compilation() if self.problem.agent.space.dimension == 2 else {}
        return jax.jit(jax.vmap(drawn), compiler_options=options)(keys)


WALKERS = VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.02, initial_velocity_variance_m2_s2=0.3)
CROSSING = SceneSettings(
    targets_min=1,
    targets_max=10,
    half_side_m=(10.0, 10.0),
    half_side_per_target_m=0.0,
    agent_spread=1.0,
    drift_m_s=(0.7, 0.7),
    shared_drift=False,
    steps=40,
    initial_error="consistent",
)
SECTOR = SectorView(depth_m=5.0, angle_deg=90.0)
HOLONOMIC = FreeBody(
    kind="body", space="planar", axes=("vx", "vy", "wz"), lower=(-2.0, -2.0, -1.0), upper=(2.0, 2.0, 1.0)
)
REST = DriftTarget(process_std_m=0.05, initial_variance_m2=1.0)
STILL = {"drift_m_s": (0.0, 0.0), "jitter_m_s": 0.0}
COMING_AND_GOING = replace(
    CROSSING, known_drift=False, birth_and_death=True, jitter_m_s=0.0, first_mean_velocity="zero", steps=60
)

RANDOM: tuple[tuple[Scenario, Objective], ...] = (
    # The paper's world, twice: the score at the end, and that at all times.
    (Scenario(scenes=SceneSettings(targets_min=2, targets_max=10)), "terminal"),
    (Scenario(scenes=SceneSettings(targets_min=2, targets_max=10, shared_drift=False)), "mean"),
    # Targets that cross a hall, to be known at all times or at the end.
    (Scenario(view=SECTOR, target=WALKERS, scenes=CROSSING), "mean"),
    (Scenario(agent=HOLONOMIC, view=SECTOR, target=WALKERS, scenes=CROSSING), "terminal"),
    # Endless watching of targets that hardly move.
    (
        Scenario(view=SECTOR, target=REST, scenes=replace(CROSSING, half_side_m=(15.0, 15.0), steps=192, **STILL)),
        "mean",
    ),
    # Many of them, which drift.
    (
        Scenario(
            view=SECTOR,
            scenes=replace(
                CROSSING, targets_min=10, targets_max=20, half_side_m=(20.0, 20.0), drift_m_s=(0.3, 0.3), steps=60
            ),
        ),
        "mean",
    ),
    # A street, to be kept in view.
    (Scenario(tau_s=0.5, view=SECTOR, target=WALKERS, scenes=COMING_AND_GOING), "seen"),
    # A camera that only turns.
    (replace(PAN, scenes=replace(PAN.scenes, targets_min=2)), "mean"),
)
"""Scenarios and objectives of the worlds of random robots: together, what robots in the plane meet."""


def worlds_of(experiment: Experiment) -> tuple[World, ...]:
    """The worlds of a training."""
    if experiment.is_for_any_robot:
        return tuple(
            World(problem=scenario.problem(), scenes=scenario.scenes, objective=objective, robots=RobotRanges())
            for scenario, objective in RANDOM
        )
    scenario = experiment.scenario
    return (World(problem=scenario.problem(), scenes=scenario.scenes, objective=experiment.training.objective),)


def informed(policy: PointerPolicy, world: World, settings: ActorCriticSettings) -> PointerPolicy:
    """The policy, told the objective of a world of random robots, and the time left where it depends on that."""
    if world.robots is None:
        return policy
    return replace(policy, objective=world.objective, tells_time=settings.discount_of(world.scenes) == 1.0)


def most_targets(worlds: Sequence[World]) -> int:
    """The largest number of tokens of all worlds."""
    return max(token_count(world.problem, world.scenes.targets_max) for world in worlds)
