"""Selection after a validation: the best is kept, a collapse is rolled back, and a training without progress stops."""

import math

import jax.numpy as jnp
import pytest

from foveate.experiment.learners import ActorCriticSettings, TrainingSettings
from foveate.learning.learner import Learner
from foveate.learning.policy_gradient import begin
from foveate.learning.selection import COLLAPSED_VALIDATIONS, MAX_ROLLBACKS, Decision, Progress, decide
from foveate.simulation.records import Policy

SETTINGS = TrainingSettings(schedule="cosine")


class Constant(Policy):
    """A stand-in with one weight."""

    weight: jnp.ndarray

    def __call__(self, observation, memory, key):
        raise AssertionError("nothing is simulated here")


def learner(weight: float, epoch: int) -> Learner:
    made = begin(Constant(jnp.array(float(weight))), SETTINGS)
    return Learner(policy=made.policy, optimizer=made.optimizer, epoch=jnp.array(epoch))


def progress(best: float = 1.0, best_epoch: int = 10, below: int = 0, rollbacks: int = 0) -> Progress:
    return Progress(
        learner=learner(0.2, 20),
        best=learner(0.1, best_epoch),
        best_score=jnp.array(float(best)),
        best_epoch=jnp.array(best_epoch),
        below=jnp.array(below),
        rollbacks=jnp.array(rollbacks),
    )


def after(before: Progress, new: Learner, score: float, at_limit: float = 0.1, finite: bool = True) -> Decision:
    return decide(before, new, score, at_limit, finite, SETTINGS)


def facts(decision: Decision) -> dict[str, float]:
    """All numbers of the progress, by name."""
    state = decision.progress
    return {
        "learner": float(state.learner.policy.weight),
        "epoch": int(state.learner.epoch),
        "best": float(state.best.policy.weight),
        "best_score": float(state.best_score),
        "best_epoch": int(state.best_epoch),
        "below": int(state.below),
        "rollbacks": int(state.rollbacks),
    }


UNCHANGED = {"best": pytest.approx(0.1), "best_score": 1.0, "best_epoch": 10, "below": 0, "rollbacks": 0}


def test_a_better_policy_becomes_the_best():
    decision = after(progress(below=3, rollbacks=2), learner(0.3, 30), 1.5)
    weight = pytest.approx(0.3)
    assert facts(decision) == {
        "learner": weight,
        "epoch": 30,
        "best": weight,
        "best_score": 1.5,
        "best_epoch": 30,
        "below": 0,
        "rollbacks": 2,
    }
    assert (decision.is_best, decision.event, decision.stop_reason) == (True, "", None)


def test_a_worse_policy_continues():
    decision = after(progress(), learner(0.3, 30), 0.9)
    assert facts(decision) == {**UNCHANGED, "learner": pytest.approx(0.3), "epoch": 30}
    assert (decision.is_best, decision.event, decision.stop_reason) == (False, "", None)


@pytest.mark.parametrize("score", [-1.0, 2.0])
def test_a_saturated_policy_is_rolled_back(score):
    """Even one that scores better: no gradient leads on from it. The epoch keeps counting, as the schedule does."""
    decision = after(progress(), learner(9.0, 30), score, at_limit=0.95)
    assert facts(decision) == {**UNCHANGED, "learner": pytest.approx(0.1), "epoch": 30, "rollbacks": 1}
    assert (decision.is_best, decision.stop_reason) == (False, None)
    assert "95% of commands at a limit" in decision.event
    assert "iteration 10" in decision.event
    counts = [int(x.count) for x in decision.progress.learner.optimizer[1]]
    assert counts == [30, 30], "of Adam, and of the falling learning rate"


def test_updates_of_the_actor_critic_are_counted_in_epochs():
    settings = ActorCriticSettings(algorithm="actor-critic", update_epochs=3, minibatches=5)
    state = progress(best=3.0, below=COLLAPSED_VALIDATIONS - 1)
    decision = decide(state, learner(9.0, 30), 0.0, 0.0, True, settings)
    assert int(decision.progress.learner.optimizer[1][0].count) == 30 * 3 * 5


def test_an_actor_critic_at_the_limits_is_not_saturated():
    """A camera that only turns is there for good reason, and samples lead beyond them."""
    settings = ActorCriticSettings(algorithm="actor-critic")
    decision = decide(progress(), learner(0.3, 30), 1.5, 1.0, True, settings)
    assert (decision.is_best, decision.event) == (True, "")


def test_many_validations_far_below_the_best_are_a_collapse():
    state, events = progress(best=3.0), []
    for k in range(COLLAPSED_VALIDATIONS):
        decision = after(state, learner(0.5, 30 + k), 1.9)
        state = decision.progress
        events.append(bool(decision.event))
        assert decision.stop_reason is None
    assert events == [False] * (COLLAPSED_VALIDATIONS - 1) + [True]
    assert (facts(decision)["learner"], facts(decision)["below"], facts(decision)["rollbacks"]) == (
        pytest.approx(0.1),
        0,
        1,
    )
    decision = after(progress(best=3.0, below=COLLAPSED_VALIDATIONS - 1), learner(0.5, 30), 2.1)
    assert (facts(decision)["below"], decision.event) == (0, ""), "one validation that is not far below ends the row"


@pytest.mark.parametrize(("score", "below"), [(0.29, 1), (0.31, 0)])
def test_time_in_view_is_far_below_its_best_at_half_of_it(score, below):
    settings = TrainingSettings(objective="seen", schedule="cosine")
    decision = decide(progress(best=0.6), learner(0.5, 30), score, 0.0, True, settings)
    assert facts(decision)["below"] == below


def test_one_collapse_too_many_stops():
    decision = after(progress(rollbacks=MAX_ROLLBACKS), learner(9.0, 30), 0.0, at_limit=1.0)
    assert decision.event
    assert "collapsed" in str(decision.stop_reason)
    assert facts(decision)["learner"] == pytest.approx(0.2), "the state of the last validation is kept"


def test_the_first_policy_is_kept_even_if_saturated():
    decision = after(progress(best=-math.inf, best_epoch=0), learner(9.0, 30), 0.0, at_limit=1.0)
    assert (facts(decision)["learner"], facts(decision)["best"]) == (9.0, 9.0)
    assert (decision.is_best, decision.event, decision.stop_reason) == (True, "", None)


def test_a_number_that_is_not_finite_stops_training_at_the_best():
    decision = after(progress(), learner(math.nan, 30), 5.0, finite=False)
    assert facts(decision) == {**UNCHANGED, "learner": pytest.approx(0.1), "epoch": 10}
    assert (decision.is_best, decision.event) == (False, "not finite")
    assert "iteration 30" in str(decision.stop_reason)


def test_a_training_without_any_gradient_ends_with_a_word():
    """Its first validation is kept all the same, and a reason that was found before stays."""
    first = decide(Progress.of(learner(0.2, 0)), learner(0.3, 5), -1.4, 0.85, True, SETTINGS, 0.0)
    assert first.is_best
    assert first.stop_reason is not None
    assert first.stop_reason.startswith("iteration 5: all gradients are 0, 85% of commands at a limit")
    later = decide(progress(), learner(0.3, 30), 0.9, 0.1, True, SETTINGS, 0.0)
    assert later.stop_reason is not None
    assert not later.is_best
    assert decide(progress(), learner(0.3, 30), 0.9, 0.1, True, SETTINGS, 1e-30).stop_reason is None
    broken = decide(progress(), learner(0.3, 30), math.nan, 0.1, False, SETTINGS, 0.0)
    assert "not finite" in broken.stop_reason
