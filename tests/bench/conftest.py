"""A tiny experiment, and a clock for the workloads."""

import jax
import numpy as np
import pytest

from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import TrainingSettings
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

CALL_S = 2.0


@pytest.fixture
def tiny():
    return Experiment(
        scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=3)),
        policy=AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)),
        training=TrainingSettings(episodes=2, held_out=2),
    )


@pytest.fixture
def clock():
    """A replacement of `in_turn`: runs every call, keeps its result, and says that it took CALL_S seconds."""
    return Clock()


class Clock:
    def __init__(self):
        self.results = []

    def __call__(self, calls, repeats):
        self.results += [jax.block_until_ready(call()) for call in calls]
        return np.full((repeats, len(calls)), CALL_S)
