"""Several policies in one evaluation."""

import logging
from dataclasses import replace

import jax
import pytest

from foveate.errors import InputError
from foveate.experiment.presets import PRESETS
from foveate.experiment.resolve import NamedPolicy
from foveate.experiment.subjects import policies_of, subjects_of


def named(name: str, preset: str = "paper", tau_s: float = 1.0) -> NamedPolicy:
    """An untrained policy."""
    experiment = PRESETS[preset]
    experiment = replace(experiment, scenario=replace(experiment.scenario, tau_s=tau_s))
    return NamedPolicy(name=name, experiment=experiment, network=experiment.new_policy(jax.random.key(0)))


def test_each_is_a_method_of_its_own_name_beside_the_heuristics():
    first, *others = subjects_of([named("a"), named("b"), named("c")])
    found = policies_of(first, others, ["policy", "nearest"])
    assert list(found) == ["a", "b", "c", "nearest"]
    assert [found["a"], found["b"]] == [first.network(), others[0].network()]
    alone = subjects_of(named("a"))
    assert list(policies_of(alone[0], [], ["policy"])) == ["policy"]


def test_all_run_in_the_scenario_of_the_first_with_a_warning(caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.WARNING, "foveate"):
        found = subjects_of([named("a", tau_s=0.5), named("b"), named("c", tau_s=0.5)])
    assert {float(each.experiment.scenario.tau_s) for each in found} == {0.5}
    assert caplog.messages == ["warning: b was trained in another scenario than a, in which it runs"]


def test_a_policy_at_another_period_than_that_of_its_training_says_so(caplog: pytest.LogCaptureFixture):
    policy = named("a")
    (subject,) = subjects_of(policy, replace(policy.experiment.scenario, tau_s=2.0))
    with caplog.at_level(logging.WARNING, "foveate"):
        policies_of(subject, [], ["still"])
        policies_of(subjects_of(policy)[0], [], ["policy"])
        assert caplog.messages == []
        policies_of(subject, [], ["policy", "still"])
    assert caplog.messages == ["warning: a was trained for a period of 1 s, and runs at 2 s here"]


def test_policies_that_fit_no_common_scenario_are_rejected():
    with pytest.raises(InputError, match=r"scenario: has 2 dimensions.*expected 3 dimensions"):
        subjects_of(["paper", "quadrotor"])
    with pytest.raises(InputError, match="policy paper: is given twice"):
        subjects_of(["paper", "best", "paper"])
    with pytest.raises(InputError, match="policy: expected at least one"):
        subjects_of([])
