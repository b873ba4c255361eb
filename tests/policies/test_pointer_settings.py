"""Settings of pointer networks that cannot be, and networks whose size does not depend on the team."""

from dataclasses import replace

import equinox as eqx
import jax
import pytest

from foveate.errors import InputError
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import LinearTarget
from foveate.scenario.team import TeamSettings

KEY = jax.random.key(0)
SMALL = PointerSettings(kind="pointer", target_widths=(12, 8), heads=3, context_widths=(10, 9), mode_width=7, modes=3)


def test_wrong_settings():
    for change, message in (
        ({"target_widths": ()}, "target_widths"),
        ({"context_widths": (0,)}, "context_widths"),
        ({"mode_width": 0}, "mode_width = 0"),
        ({"heads": 0}, "heads = 0"),
        ({"modes": 0}, "modes = 0"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(SMALL, **change)
    swapped, eye = ((0.0, 1.0), (1.0, 0.0)), ((1.0, 0.0), (0.0, 1.0))
    target = LinearTarget(kind="linear", A=eye, B=eye, W=eye, Z=swapped, prior=eye)
    still = replace(Scenario().scenes, drift_m_s=(0.0, 0.0))
    with pytest.raises(ValueError, match="begins with the position"):
        SMALL.policy(replace(Scenario(), target=target, scenes=still).problem(), KEY)


def test_the_window_is_for_networks_without_rays_and_targets_with_ids():
    with pytest.raises(InputError, match=r"policy.dynamic_window = True: expected false with rays"):
        PointerSettings(kind="pointer", dynamic_window=True, rays=8).policy(Scenario().problem(), KEY)
    detections = DetectionSettings(low_m=(-9.0, -9.0), high_m=(9.0, 9.0))
    searched = Scenario(detections=detections, scenes=SceneSettings(known_drift=False))
    with pytest.raises(InputError, match=r"policy.dynamic_window = True: expected false with rays, and with"):
        replace(SMALL, dynamic_window=True).policy(searched.problem(), KEY)


@pytest.mark.parametrize("rule", [None, "auction"])
def test_with_an_assignment_the_weights_are_those_of_a_single_robot(rule):
    shapes = []
    for team in (None, TeamSettings(agents=3)):
        problem = Scenario(team=team).problem()
        network = eqx.filter_eval_shape(lambda problem=problem: replace(SMALL, assignment=rule).policy(problem, KEY))
        shapes.append([leaf.shape for leaf in jax.tree.leaves(network)])
    assert (shapes[0] == shapes[1]) == (rule is not None)
