"""Random robots: their distribution, and the problem of one against the scenario with its values."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import kstest, triang

from foveate.errors import InputError
from foveate.experiment.presets import PAN, QUADROTOR
from foveate.scenario.agent import DifferentialDrive, FreeBody
from foveate.scenario.field_of_view import SectorView, TriangleView
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import DriftTarget
from foveate.simulation.robots import RobotFactors, RobotRanges, draw_robot, with_robot

RANGES = RobotRanges(depth=(0.5, 8.0), angle_deg=(20.0, 100.0), reverse=(0.2, 0.6))


def test_numbers_are_triangular_in_their_logarithms():
    robots = jax.vmap(lambda key: draw_robot(RANGES, key))(jax.random.split(jax.random.key(0), 2000))
    for name in RobotRanges.__dataclass_fields__:
        low, high = getattr(RANGES, name)
        values = np.asarray(getattr(robots, name))
        if name == "reverse":
            assert kstest(values, "uniform", args=(low, high - low)).pvalue > 1e-3
        else:
            expected = triang(0.5, loc=math.log(low), scale=math.log(high / low))
            assert kstest(np.log(values), expected.cdf).pvalue > 1e-3, name
    together = np.corrcoef([np.log(np.asarray(getattr(robots, name))) for name in RobotRanges.__dataclass_fields__])
    assert np.abs(together - np.eye(8)).max() < 0.1, "independent"


NUMBERS = {
    "depth": 2.0,
    "angle_deg": 50.0,
    "speed": 0.5,
    "turn": 3.0,
    "reverse": 0.25,
    "sensor_std": 0.4,
    "process_std": 2.5,
    "prior_std": 1.5,
}
DRIFTING = DriftTarget(process_std_m=0.1, initial_variance_m2=2.0)
FAR = DriftTarget(process_std_m=0.25, initial_variance_m2=4.5)
SHARP = SensorSettings(std_m=0.08)
VEHICLE = Scenario(view=TriangleView(depth_m=2.0), sensor=SensorSettings(std_m=0.2), target=DRIFTING)
PAIRS = {
    "vehicle": (
        VEHICLE,
        replace(
            VEHICLE,
            agent=DifferentialDrive(v_min_m_s=-0.5, v_max_m_s=2.0, w_max_rad_s=math.pi),
            view=TriangleView(depth_m=4.0, angle_deg=50.0),
            sensor=SHARP,
            target=FAR,
        ),
    ),
    "camera": (
        replace(PAN, target=DRIFTING, sensor=SensorSettings(std_m=0.2)),
        replace(
            PAN,
            agent=FreeBody(kind="body", space="planar", axes=("wz",), lower=(-3.0,), upper=(3.0,)),
            view=SectorView(depth_m=40.0, angle_deg=50.0),
            sensor=SHARP,
            target=FAR,
        ),
    ),
}


@pytest.mark.parametrize("name", PAIRS)
def test_the_problem_of_a_robot_is_that_of_the_scenario_with_its_values(name):
    base, expected = (scenario.problem() for scenario in PAIRS[name])
    found = with_robot(base, RobotFactors(**{name: jnp.asarray(value) for name, value in NUMBERS.items()}))
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_a_robot_needs_a_planar_view_and_no_schedule():
    robot = draw_robot(RANGES, jax.random.key(0))
    with pytest.raises(InputError, match="expected a triangle or a sector"):
        with_robot(QUADROTOR.problem(), robot)
    chosen = replace(VEHICLE, agent=DifferentialDrive(commands=((0.0, 0.5), (1.0, 0.0))))
    with pytest.raises(InputError, match=r"agent\.commands: expected none"):
        with_robot(chosen.problem(), robot)
    with pytest.raises(InputError, match="schedule: expected none"):
        with_robot(replace(VEHICLE, schedule=ScheduleSettings(tau_s=(1.0, 0.5))).problem(), robot)
