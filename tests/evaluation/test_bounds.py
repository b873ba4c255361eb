"""Lower bounds against closed forms, and the normalised score between its two ends."""

from dataclasses import replace

import numpy as np
import pytest

from foveate.evaluation.bounds import lower_bounds, normalised_score, unseen_scores
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.scenario.sensor import ScheduleSettings, SensorSettings

SCENARIO = Scenario()


def test_lower_bound_is_the_score_of_prediction_alone():
    covariance = 2.0 + 0.05**2 * np.array([3, 9, 21])
    np.testing.assert_allclose(unseen_scores(SCENARIO.problem(), [3, 9, 21]), -2 * np.log(covariance), rtol=1e-12)
    growing = ScheduleSettings(W=(((1.0, 0.0), (0.0, 1.0)), ((3.0, 0.0), (0.0, 3.0))))
    scheduled = replace(SCENARIO, schedule=growing).problem()
    np.testing.assert_allclose(unseen_scores(scheduled, [1, 4]), -2 * np.log([2 + 1, 2 + 1 + 3 + 1 + 3]), rtol=1e-12)
    assert normalised_score(-1.4, -1.4, 8.0) == 0.0
    assert normalised_score(8.0, -1.4, 8.0) == 1.0
    assert normalised_score(3.3, -1.4, 8.0) == pytest.approx(0.5)


def test_missed_detections_have_no_lower_bound():
    scene = Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((1.0, 1.0),), drift=((0.0, 0.0),), horizon=3)
    with pytest.raises(ValueError, match="normalised_score has no bounds"):
        lower_bounds(Scenario(sensor=SensorSettings(missed_detections="used")).problem(), [scene])


def test_lower_bounds_are_means_over_the_scenes_of_a_cell():
    problem = Scenario().problem()
    scenes = [
        Scene(id=f"{n}-{steps}", agent=(0.0,) * 3, targets=((1.0, 1.0),) * n, drift=((0.0, 0.0),) * n, horizon=steps)
        for n, steps in ((1, 3), (1, 9), (2, 21))
    ]
    unseen = {steps: -2 * np.log(2.0 + 0.05**2 * steps) for steps in (3, 9, 21)}
    found = lower_bounds(problem, scenes)
    assert found["unbiased", 1] == pytest.approx((unseen[3] + unseen[9]) / 2)
    assert found["unbiased", 2] == pytest.approx(unseen[21])
