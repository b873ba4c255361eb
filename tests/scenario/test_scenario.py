"""Settings: everything wrong is rejected in one line that names field and value; TOML gives back what it was given."""

import math

import numpy as np
import pytest
from helpers.rejections import assert_rejected

from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS, PPOSettings, TrainingSettings
from foveate.io.toml import dumps_toml, load_toml
from foveate.policies.attention import AttentionSettings
from foveate.scenario.agent import DifferentialDrive, FixedWing, FreeBody, Quadrotor
from foveate.scenario.field_of_view import (
    BallView,
    ConeView,
    FrustumView,
    PolygonView,
    PrismView,
    SectorView,
    TriangleView,
)
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import AccelerationTarget, DriftTarget, LinearTarget, StaticTarget, VelocityTarget

EYE = ((1.0, 0.0), (0.0, 1.0))
TURNED = ((0.5, 0.5), (0.5, 0.5))
"""Rank 1, not along an axis."""


def linear(**changes):
    parts = {"A": EYE, "B": EYE, "W": ((0.01, 0.0), (0.0, 0.01)), "Z": EYE, "prior": EYE}
    return LinearTarget(kind="linear", **{**parts, **changes})


FOUR = linear(
    A=((1.0, 0.0, 0.1, 0.0), (0.0, 1.0, 0.0, 0.1), (0.0, 0.0, 0.9, 0.05), (0.0, 0.0, 0.0, 0.9)),
    B=((0.005, 0.0), (0.0, 0.005), (0.1, 0.0), (0.0, 0.1)),
    W=((0.02, 0.01, 0.0, 0.0), (0.01, 0.03, 0.0, 0.0), (0.0, 0.0, 0.1, 0.0), (0.0, 0.0, 0.0, 1e-3)),
    Z=((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)),
    prior=((2.0, 0.0, 0.0, 0.1), (0.0, 2.0, 0.0, 0.0), (0.0, 0.0, 1 / 3, 0.0), (0.1, 0.0, 0.0, 0.7)),
)
VOLUME = SceneSettings(centre_m=(0.0,) * 3, half_side_m=(1.0,) * 3, drift_m_s=(0.1,) * 3)
SPARSE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))

BAD = {
    "tau": (lambda: Scenario(tau_s=0.0), "tau_s = 0.0"),
    "negative tau": (lambda: Scenario(tau_s=-1.0), "tau_s = -1.0"),
    "tau no number": (lambda: Scenario(tau_s=math.nan), "tau_s = nan"),
    "H too wide": (
        lambda: Scenario(sensor=SensorSettings(H=SPARSE)),
        "sensor.H = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)): expected 2 columns",
    ),
    "V of another size": (lambda: Scenario(sensor=SensorSettings(V=((1.0,),))), "sensor.V = ((1.0,),): expected 2 x 2"),
    "body noise of a part": (
        lambda: Scenario(sensor=SensorSettings(H=((1.0, 0.0),), V=((1.0,),), frame="body")),
        "sensor.frame = 'body'",
    ),
    "more measurements than states": (
        lambda: Scenario(sensor=SensorSettings(H=(*EYE, (1.0, 1.0)))).problem(),
        "expected at most 2 rows",
    ),
    "a camera in the plane": (lambda: Scenario(view=FrustumView(shape="frustum")), "expected a shape in 2 dimensions"),
    "a triangle in space": (
        lambda: Scenario(agent=Quadrotor(kind="quadrotor"), scenes=VOLUME),
        "expected a shape in 3 dimensions",
    ),
    "a density with negative directions": (
        lambda: VelocityTarget(kind="constant_velocity", Q=((1.0, 2.0), (2.0, 1.0))),
        "no negative eigenvalue",
    ),
    "B not a number": (lambda: linear(B=((math.nan, 0.0), (0.0, 1.0))), "expected a finite number"),
    "A loses what a scheduled W does not restore": (
        lambda: Scenario(
            target=linear(A=((1.0, 0.0), (0.0, 0.0))),
            schedule=ScheduleSettings(W=(((0.0, 0.0), (0.0, 0.0)),)),
            scenes=SceneSettings(drift_m_s=(0.0, 0.0)),
        ),
        "target.A, schedule.W",
    ),
    "fading without noise": (
        lambda: VelocityTarget(kind="constant_velocity", memory_s=1.0, acceleration_m2_s3=0.0),
        "expected > 0 with memory_s",
    ),
    "a step far beyond the memory": (
        lambda: Scenario(
            target=VelocityTarget(kind="constant_velocity", memory_s=0.1), schedule=ScheduleSettings(tau_s=(1.0, 5.0))
        ),
        "memory_s = 0.1",
    ),
    "a drift through another B": (lambda: Scenario(target=linear(B=((0.1, 0.0), (0.0, 0.1)))), "Z = B = I"),
    "a first error that would have to turn": (
        lambda: Scenario(sensor=SensorSettings(frame="body", V=((1.0, 0.0), (0.0, 4.0)))),
        "initial_error = 'paper'",
    ),
    "two first errors": (
        lambda: SceneSettings(first_error_std=(1.0,), initial_error="consistent"),
        "initial_error = 'consistent': expected 'paper'",
    ),
    "a negative first error": (lambda: SceneSettings(first_error_std=(1.0, -1.0)), "first_error_std = (1.0, -1.0)"),
    "a first error of a velocity that is 0": (
        lambda: SceneSettings(first_error_std=(1.0, 0.5), first_mean_velocity="zero"),
        "first_error_std = (1.0, 0.5): expected 0 after the first",
    ),
    "first errors of a state without velocity": (
        lambda: Scenario(scenes=SceneSettings(first_error_std=(1.0, 0.5))),
        "scenes.first_error_std = (1.0, 0.5): expected 1 numbers",
    ),
    "first errors of a state in another order": (
        lambda: Scenario(
            target=linear(Z=((0.0, 1.0), (1.0, 0.0))),
            scenes=SceneSettings(first_error_std=(1.0,), drift_m_s=(0.0, 0.0)),
        ),
        "scenes.first_error_std = (1.0,): expected none",
    ),
    "a ring inside out": (lambda: SceneSettings(target_ring_m=(5.0, 4.0)), "target_ring_m = (5.0, 4.0)"),
    "a ring without extent": (lambda: SceneSettings(target_ring_m=(0.0, 0.0)), "target_ring_m = (0.0, 0.0)"),
    "births on a ring": (
        lambda: SceneSettings(target_ring_m=(1.0, 2.0), birth_and_death=True),
        "birth_and_death = True: expected false with target_ring_m",
    ),
    "agent's centre": (lambda: SceneSettings(agent_centre_m=(1.0,)), "agent_centre_m = (1.0,)"),
    "agent's box": (lambda: SceneSettings(agent_half_side_m=(1.0, -1.0)), "agent_half_side_m = (1.0, -1.0)"),
    "process std": (lambda: DriftTarget(process_std_m=-0.1), "process_std_m = -0.1"),
    "first variance": (lambda: DriftTarget(initial_variance_m2=0.0), "initial_variance_m2 = 0.0"),
    "W negative": (lambda: DriftTarget(W=((1.0, 2.0), (2.0, 1.0))), "no negative eigenvalue"),
    "W not symmetric": (lambda: DriftTarget(W=((1.0, 0.5), (0.0, 1.0))), "symmetric"),
    "W of another size": (lambda: Scenario(target=DriftTarget(W=((1.0,),))), "expected shape 2 x 2, got 1 x 1"),
    "A not square": (lambda: linear(A=SPARSE), "expected shape 2 x 2, got 2 x 3"),
    "B of another height": (lambda: linear(B=((1.0,),)), "B = ((1.0,),): expected shape 2 x any, got 1 x 1"),
    "linear W": (lambda: linear(W=((0.0, 1.0), (1.0, 0.0))), "W = ((0.0, 1.0), (1.0, 0.0))"),
    "prior": (lambda: linear(prior=TURNED), "prior = ((0.5, 0.5)"),
    "Z of another width": (lambda: Scenario(target=linear(Z=SPARSE)), "expected shape 2 x 2, got 2 x 3"),
    "Z of rank 1": (lambda: Scenario(target=linear(Z=TURNED)), "expected rank 2"),
    "A loses what W does not restore": (lambda: linear(A=TURNED, W=TURNED), "singular"),
    "A = 0, W = 0": (lambda: linear(A=((0.0, 0.0),) * 2, W=((0.0, 0.0),) * 2), "singular"),
    "targets": (lambda: SceneSettings(targets_min=0), "targets_min = 0"),
    "targets in order": (lambda: SceneSettings(targets_min=4, targets_max=3), "targets_max = 3"),
    "spread": (lambda: SceneSettings(agent_spread=-1.0), "agent_spread = -1.0"),
    "drift": (lambda: SceneSettings(drift_m_s=(0.1, -0.8)), "drift_m_s = (0.1, -0.8)"),
    "drifts": (lambda: SceneSettings(drift_m_s=(0.1,)), "drift_m_s = (0.1,)"),
    "box": (lambda: SceneSettings(half_side_m=(1.0, -1.0)), "half_side_m = (1.0, -1.0)"),
    "centre": (lambda: SceneSettings(centre_m=(0.0,)), "centre_m = (0.0,)"),
    "centre in space": (
        lambda: Scenario(scenes=SceneSettings(centre_m=(0.0,) * 3, half_side_m=(0.0,) * 3, drift_m_s=(0.0,) * 3)),
        "scenes.centre_m = (0.0, 0.0, 0.0)",
    ),
    "steps a target": (lambda: SceneSettings(steps_per_target=0), "steps_per_target = 0"),
    "steps": (lambda: SceneSettings(steps=0), "steps = 0"),
    "epochs": (lambda: TrainingSettings(epochs=0), "epochs = 0"),
    "rate": (lambda: TrainingSettings(learning_rate=0.0), "learning_rate = 0.0"),
    "softness": (lambda: TrainingSettings(softness=()), "softness = ()"),
    "held out": (lambda: TrainingSettings(held_out=0), "held_out = 0"),
    "batch": (lambda: PPOSettings(algorithm="ppo", batch=100), "batch = 100: expected a divisor of"),
    "discount": (lambda: PPOSettings(algorithm="ppo", discount=1.5), "discount = 1.5: expected 0 to 1"),
    "kappa": (lambda: TrainingSettings(softness=((1.0, 0.4), (1.0, 0.0))), "softness = ((1.0, 0.4), (1.0, 0.0))"),
}


def test_the_mean_horizon_is_that_of_the_scenes_drawn():
    """The paper's: 3 n steps with n uniform on 3 .. 8, so 3 x 5.5; 1000 epochs of 60 episodes are 990,000 steps."""
    assert SceneSettings().mean_horizon == 16.5
    assert SceneSettings(steps=7).mean_horizon == 7.0


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_rejected(name):
    assert_rejected(*BAD[name])


def test_singular_motion_is_fine_where_noise_restores_it():
    """A = [[1, 1], [1, 1]] / 2 loses (1, -1); W along (1, -1) restores it, W along (1, 1) does not."""
    restores = ((0.1, -0.1), (-0.1, 0.1))
    motion = Scenario(target=linear(A=TURNED, W=restores)).problem().motion
    predicted = np.asarray(motion.A) @ np.asarray(motion.A).T + np.asarray(motion.W)
    assert np.linalg.eigvalsh(predicted).min() > 0.1
    np.testing.assert_allclose(Scenario(target=DriftTarget(process_std_m=0.0)).problem().motion.W, 0)


def test_the_default_is_the_papers_experiment():
    problem = Scenario().problem()
    np.testing.assert_allclose(problem.agent.lower, [0, -np.pi / 3])
    np.testing.assert_allclose(problem.agent.upper, [4, np.pi / 3])
    assert problem.agent.axes == (0, 2)
    np.testing.assert_allclose(problem.sensor.V, 0.2**2 * np.eye(2))
    np.testing.assert_allclose(problem.sensor.H, np.eye(2))
    np.testing.assert_allclose(problem.motion.W, 0.05**2 * np.eye(2))
    np.testing.assert_allclose(problem.prior_information, 0.5 * np.eye(2))
    assert float(problem.tau) == 1.0
    half = 2 * np.tan(np.pi / 3)
    np.testing.assert_allclose(sorted(problem.sensor.view.vertices.tolist()), [[0, 0], [2, -half], [2, half]])
    assert Scenario().scenes.horizon(5) == 15
    assert Scenario().scenes.horizon(0) == 3


def test_full_matrices_reach_the_problem():
    sensor = SensorSettings(V=((0.5,),), H=((0.0, 1.0, 0.0, 2.0),), range_growth_per_m=0.1)
    problem = Scenario(target=FOUR, sensor=sensor).problem()
    np.testing.assert_allclose(problem.prior_information @ np.array(FOUR.prior), np.eye(4), atol=1e-12)
    for name in "ABWZ":
        np.testing.assert_array_equal(getattr(problem.motion, name), getattr(FOUR, name))
    np.testing.assert_array_equal(problem.sensor.H, sensor.H)
    np.testing.assert_array_equal(problem.sensor.V, sensor.V)


EXPERIMENTS = {
    "default": Experiment(),
    "everything": Experiment(
        scenario=Scenario(
            tau_s=0.1,
            agent=DifferentialDrive(v_min_m_s=-0.5, v_max_m_s=1 / 3, w_max_rad_s=0.7),
            view=SectorView(depth_m=7.5, angle_deg=360.0),
            sensor=SensorSettings(V=((0.05, 0.01), (0.01, 0.02)), frame="body", range_growth_per_m=0.25),
            target=FOUR,
            scenes=SceneSettings(
                targets_min=1, targets_max=20, centre_m=(1.5, -2.5), half_side_m=(30.0, 1e-3), steps=50,
                shared_drift=False, known_drift=False, process_noise=False, initial_error="consistent",
            ),
        ),
        policy=AttentionSettings(frame="world", agent_widths=(8,), target_widths=(3, 8), out_widths=(5, 4), alpha=0.3),
        training=TrainingSettings(
            epochs=7, learning_rate=1e-4, schedule="cosine", softness=((1.0, 0.4), (0.3, 0.25)), objective="mean",
            noise=True, select="true",
        ),
    ),
    "wing": Experiment(
        scenario=Scenario(
            agent=FixedWing(kind="fixed_wing"), view=ConeView(shape="cone", depth_m=300.0), scenes=VOLUME,
            target=AccelerationTarget(kind="constant_acceleration", jerk_m2_s5=0.3),
            schedule=ScheduleSettings(tau_s=(0.5, 1.0), V=(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 4.0)),) * 2),
        )
    ),
    "free body": Experiment(
        scenario=Scenario(
            agent=FreeBody(kind="body", axes=("wz", "vx"), lower=(-1.0, 0.0), upper=(1.0, 3.0)), scenes=VOLUME,
            view=PrismView(shape="prism", base=TriangleView()),
            target=VelocityTarget(kind="constant_velocity", Q=((1.0, 0.5, 0.0), (0.5, 1.0, 0.0), (0.0, 0.0, 0.1))),
        )
    ),
    "ball": Experiment(
        scenario=Scenario(
            view=BallView(shape="ball", radius_m=4.0, center_m=(1.0, 0.0)), target=StaticTarget(kind="static"),
            scenes=SceneSettings(drift_m_s=(0.0, 0.0)),
        )
    ),
    **PRESETS,
    "starts": Experiment(
        scenario=Scenario(
            target=VelocityTarget(kind="constant_velocity"),
            sensor=SensorSettings(V=((0.1, 0.0), (0.0, 0.2)), frame="body"),
            scenes=SceneSettings(
                first_error_std=(2.0, 0.0), first_mean_velocity="zero", target_ring_m=(5.0, 10.0),
                agent_centre_m=(1.0, 2.0), agent_half_side_m=(0.0, 0.0),
            ),
        )
    ),
    "polygon": Experiment(
        scenario=Scenario(
            view=PolygonView(shape="polygon", vertices_m=((0.0, 0.0), (3.0, -1.0), (3.0, 1.0))),
            target=DriftTarget(W=((0.1, 0.05), (0.05, 0.2))),
        )
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_toml_round_trip(tmp_path, name):
    path, experiment = tmp_path / "config.toml", EXPERIMENTS[name]
    path.write_text(dumps_toml(experiment, "a header"))
    assert load_toml(Experiment, path) == experiment


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[scenario]\ntau_s = 0", "scenario: tau_s = 0.0"),
        ("[scenario.view]\nshape = 'triangle'\ndepth_m = -1", "scenario.view: depth_m = -1.0"),
        ("[scenario.target]\nkind = 'drift'\nW = [[1, 2], [2, 1]]", "scenario.target: W = ((1.0, 2.0), (2.0, 1.0))"),
        ("[scenario.target]\nkind = 'orbit'", "scenario.target.kind = 'orbit'"),
        ("[scenario.target]\nkind = 'linear'\nA = [[1.0]]", "scenario.target.B: is missing"),
        ("[scenario.sensor]\nstd = 0.1", "scenario.sensor.std = 0.1: unknown key; did you mean std_m?"),
        ("[policy]\nframe = 'bodies'", "policy.frame = 'bodies'"),
        ("[training]\nepochs = 2.5", "training.epochs = 2.5"),
        ("[training]\nlearning_rate = nan", "training.learning_rate = nan"),
    ],
)
def test_bad_toml(tmp_path, text, words):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"bad\.toml") as caught:
        load_toml(Experiment, path)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
