"""What robots tell their team passes through every policy that holds others, and a verdict has it."""

import dataclasses
import importlib
import pkgutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import foveate
from foveate.evaluation.held_out import held_out, policy_scores
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.planning.named import assigned_in, heuristic_in
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.records import PROTOCOLS, Policy
from foveate.simulation.rollout import rollout


def kinds_of(kind: type) -> list[type]:
    return [kind, *(each for below in kind.__subclasses__() for each in kinds_of(below))]


def test_every_policy_that_holds_another_passes_on_its_claims():
    for found in pkgutil.walk_packages(foveate.__path__, "foveate."):
        if not found.name.startswith(("foveate.ros", "foveate.learning.sb3", "foveate.__main__", "foveate.stonesoup")):
            importlib.import_module(found.name)
    holders = [
        kind
        for kind in kinds_of(Policy)
        if kind.__module__.startswith("foveate.")
        and any("Policy" in str(part.type) for part in dataclasses.fields(kind))
    ]
    assert {"OneOf", "KeepOff", "EmbeddedPolicy", "Receding", "ByKind", "Assigned"} <= {
        kind.__name__ for kind in holders
    }
    assert [kind.__name__ for kind in holders if kind.claims is Policy.claims] == []


@pytest.mark.slow
def test_a_verdict_of_a_team_is_that_of_each_policy_alone():
    """By an auction, which lives by what the robots tell each other."""
    scenes = SceneSettings(targets_min=4, targets_max=4, drift_m_s=(0.1, 0.1), steps=8)
    scenario = Scenario(scenes=scenes, team=TeamSettings(agents=3, radio=RadioSettings()))
    training = ActorCriticSettings(algorithm="actor-critic", held_out=6)
    experiment = Experiment(scenario=scenario, policy=PointerSettings(kind="pointer"), training=training)
    given = held_out(experiment, 6, 0)
    auction = assigned_in(scenario, heuristic_in(scenario, "uncertain"), "auction")
    mine = policy_scores(given, {"uncertain": heuristic_in(scenario, "uncertain"), "auction": auction})["auction"]
    run = jax.jit(lambda episode, key: rollout(given.problem, auction, episode, PROTOCOLS["true"], key))
    alone = []
    for i in range(6):
        trace = run(jax.tree.map(lambda x, i=i: x[i], given.episodes), given.keys[i])
        alone.append(float(jnp.mean(trace.log_det[-1])))
    np.testing.assert_allclose(mine, alone, rtol=1e-9)
