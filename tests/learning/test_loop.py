"""Training: it learns, is reproducible, resumes where it stopped, and keeps its best policy."""

import json
import math
import shutil

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import foveate
from foveate.experiment.checkpoint import accepted_digests, load_run, load_tree
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import TrainingSettings
from foveate.experiment.run_folder import BEST, CONFIG, LAST, METRICS, VERDICT
from foveate.io.toml import read_toml
from foveate.learning import loop as training
from foveate.learning.learner import EpochReport
from foveate.learning.loop import train
from foveate.learning.policy_gradient import begin
from foveate.learning.run_files import stored_run
from foveate.learning.selection import Progress
from foveate.learning.validation import held_out_episodes, validate
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.records import Policy

TINY = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=4, drift_m_s=(0.1, 0.1))),
    policy=AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,)),
    training=TrainingSettings(epochs=40, episodes=8, learning_rate=1e-2, held_out=16, check_every=10),
)


class Interrupted(Exception):
    pass


def interrupted_after(checks):
    seen = []

    def report(check, total):
        seen.append(check)
        if len(seen) == checks:
            raise Interrupted

    return report


def lines(run):
    return [json.loads(line) for line in (run / METRICS).read_text().splitlines()]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    run, checks = tmp_path_factory.mktemp("runs") / "a", []
    outcome = train(TINY, run, seed=3, on_validation=lambda check, total: checks.append((check, total)))
    return run, outcome, checks


def test_training_improves_the_score_and_reports_it(undisturbed):
    run, outcome, checks = undisturbed
    assert [(check.epoch, total) for check, total in checks] == [(10, 40), (20, 40), (30, 40), (40, 40)]
    assert outcome.epochs == 40
    assert outcome.stopped == ""
    objective, held_out = ([getattr(check, name) for check, _ in checks] for name in ("objective", "held_out"))
    assert objective[-1] > objective[0] + 0.3, "a tiny problem must be learned"
    assert held_out[-1] > held_out[0]
    assert outcome.best_score == max(held_out)
    assert outcome.best_epoch == 10 * (1 + int(np.argmax(held_out)))
    # 8 episodes of 4 steps an epoch.
    assert [check.env_steps for check, _ in checks] == [32 * check.epoch for check, _ in checks]
    written = lines(run)
    assert [line["held_out"] for line in written] == held_out
    assert [line["best"] for line in written] == [h == max(held_out[: i + 1]) for i, h in enumerate(held_out)]
    experiment, policy, facts = load_run(run)
    assert experiment == TINY
    assert facts["epoch"] == outcome.best_epoch
    assert facts["held_out"] == outcome.best_score
    keys = jax.random.split(jax.random.key(3), 4)
    episodes = held_out_episodes(TINY, keys[1])
    score, _ = eqx.filter_jit(lambda p: validate(TINY, p, episodes, keys[3]))(policy)
    assert float(score) == outcome.best_score, "the file holds the policy of that score"
    assert list(run.glob("events*")), "TensorBoard reads the run folder"


@pytest.mark.slow
def test_interrupted_and_resumed_is_undisturbed(undisturbed, tmp_path):
    """Also: the same seed twice gives the same bytes, since the first half is trained again from nothing."""
    run, outcome, _ = undisturbed
    with pytest.raises(Interrupted):
        train(TINY, tmp_path / "b", seed=3, on_validation=interrupted_after(2))
    with (tmp_path / "b" / METRICS).open("a") as file:
        file.write('{"epoch": 30, "obj')  # a line that was cut by the interruption
    before = (tmp_path / "b" / BEST).read_bytes()
    with pytest.raises(ValueError, match="expected the same, got 4"):
        train(TINY, tmp_path / "b", seed=4, resume=True)
    other = Experiment(policy=TINY.policy, training=TINY.training)
    with pytest.raises(ValueError, match="another experiment"):
        train(other, tmp_path / "b", seed=3, resume=True)
    with pytest.raises(ValueError, match="exists already"):
        train(TINY, tmp_path / "b", seed=3)
    assert (tmp_path / "b" / BEST).read_bytes() == before, "a rejected run folder is left as it was"
    resumed = train(TINY, tmp_path / "b", seed=3, resume=True)
    assert resumed == outcome
    assert foveate.train(out=tmp_path / "b", resume=True, verdict=False, progress=False).experiment == TINY
    assert (tmp_path / "b" / BEST).read_bytes() == (run / BEST).read_bytes()
    assert same_arrays(run / LAST, tmp_path / "b" / LAST)
    untimed = [
        [{k: v for k, v in line.items() if k not in ("elapsed_s", "epochs_per_s")} for line in lines(folder)]
        for folder in (run, tmp_path / "b")
    ]
    assert untimed[0] == untimed[1]
    elapsed = [line["elapsed_s"] for line in lines(tmp_path / "b")]
    assert elapsed == sorted(elapsed), "the clock resumes, too"


@pytest.mark.slow
def test_a_finished_run_continues_to_more_epochs(undisturbed, tmp_path):
    """Its checkpoints stay valid, also where a kill leaves it between the writes; a run is extended twice."""
    run = shutil.copytree(undisturbed[0], tmp_path / "run")
    (run / VERDICT).write_text("of the policy before")
    with pytest.raises(ValueError, match="epochs 40: expected more than the 40 that"):
        stored_run(run, 40)
    assert load_run(run)[0] == TINY
    for total in (50, 60):
        digest, config = read_toml(Experiment, run / CONFIG)[1], (run / CONFIG).read_bytes()
        experiment, seed = stored_run(run, total)
        assert (experiment.training.epochs, seed) == (total, 3)
        extended = (run / CONFIG).read_bytes()
        (run / CONFIG).write_bytes(config)
        assert digest in accepted_digests(run, digest)
        load_run(run)  # as if killed before the second write
        (run / CONFIG).write_bytes(extended)
        load_run(run)
        outcome = train(experiment, run, seed=seed, resume=True)
        assert outcome.epochs == total
        assert load_run(run)[0] == experiment
    assert [line["epoch"] for line in lines(run)] == [10, 20, 30, 40, 50, 60]
    assert not (run / VERDICT).exists()


def same_arrays(one, other):
    with np.load(one) as a, np.load(other) as b:
        names = set(a.files) - {"header"}
        return names == set(b.files) - {"header"} and all(a[n].tobytes() == b[n].tobytes() for n in names)


def test_a_training_that_explodes_from_the_start(monkeypatch, tmp_path):
    """For real, from weights so large that products overflow: there is no best yet, and nothing may crash."""

    def begin_badly(experiment, policy, key):
        made = begin(policy, experiment.training)
        return eqx.tree_at(lambda m: m.policy, made, jax.tree.map(lambda x: 1e200 * x, policy))

    monkeypatch.setattr(training, "_begin", begin_badly)
    checks = []
    outcome = train(TINY, tmp_path / "r", seed=3, on_validation=lambda check, total: checks.append(check))
    assert "not finite" in outcome.stopped
    assert [check.event for check in checks] == ["not finite"]
    assert outcome.epochs == 0, "epochs that are not finite change nothing, and do not count"
    strict(tmp_path / "r" / METRICS)


def strict(path):
    for line in path.read_text().splitlines():
        json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


class Constant(Policy):
    """A stand-in with one weight."""

    weight: jax.Array

    def __call__(self, observation, memory, key):
        return jnp.full(2, jnp.tanh(self.weight)), memory


def test_a_policy_at_its_limits_is_seen_as_such():
    """All commands at the limits for a saturated policy, none for one in the middle."""
    ((_, episodes),) = held_out_episodes(TINY, jax.random.key(0))
    places = (episodes.mean, episodes.truth.state)
    far = eqx.tree_at(lambda e: (e.mean, e.truth.state), episodes, tuple(x + 1e4 for x in places))
    look = eqx.filter_jit(lambda p: validate(TINY, p, [(None, far)], jax.random.key(1)))
    for weight_, share in [(9.0, 1.0), (-9.0, 1.0), (0.1, 0.0)]:
        score, at_limit = look(Constant(jnp.array(weight_)))
        assert float(at_limit) == share
    # Nothing is in view: the belief's variance grows from 2 by four times W.
    assert float(score) == pytest.approx(-2 * np.log(2.0 + 4 * 0.05**2), abs=1e-9)


def stubbed(monkeypatch, script):
    """`train` with learning and validation replaced by a list of (weight, score, share at a limit, finite)."""
    steps = iter(script)

    def advance(count, learner_, key):
        keys["training"] = key
        moved, *rest = next(steps)
        after = eqx.tree_at(
            lambda x: (x.policy, x.epoch), learner_, (moved_policy(learner_, moved), learner_.epoch + count)
        )
        validated.append(rest[:2])
        return after, EpochReport(jnp.array(1.0), jnp.array(1.0 if rest[2] else jnp.inf), jnp.array(rest[2]))

    def moved_policy(learner_, value):
        return jax.tree.map(lambda x: jnp.full_like(x, value) if eqx.is_array(x) else x, learner_.policy)

    validated, keys = [], {}
    monkeypatch.setattr(training, "compiled", lambda simulate, quick: simulate)
    monkeypatch.setattr(training, "held_out_episodes", lambda experiment, key: keys.update(held_out=key))
    monkeypatch.setattr(training, "advance_of", lambda experiment: advance)
    monkeypatch.setattr(training, "validate", lambda *args: [jnp.array(x) for x in validated[-1]])
    return keys


def best_weight(run):
    policy = load_run(run)[1]
    return float(policy.out_layers[0].bias[0])


def test_a_number_that_is_not_finite_leaves_the_best_checkpoint_alone(monkeypatch, tmp_path):
    stubbed(monkeypatch, [(1.0, 2.0, 0.0, True), (2.0, 1.5, 0.0, True), (3.0, math.nan, 0.0, False)])
    outcome = train(TINY, tmp_path / "r", seed=3)
    assert "iteration 30" in outcome.stopped
    assert (outcome.best_epoch, outcome.best_score) == (10, 2.0)
    assert best_weight(tmp_path / "r") == 1.0
    like = Progress.of(begin(load_run(tmp_path / "r")[1], TINY.training))
    last, _ = load_tree(tmp_path / "r" / LAST, like, "training")
    assert float(last.learner.policy.out_layers[0].bias[0]) == 1.0
    strict(tmp_path / "r" / METRICS)


@pytest.mark.slow
def test_a_collapse_is_noticed_and_undone(monkeypatch, tmp_path):
    keys = stubbed(
        monkeypatch, [(1.0, 2.0, 0.0, True), (9.0, 0.0, 1.0, True), (3.0, 2.5, 0.0, True), (4.0, 2.4, 0.0, True)]
    )
    checks = []
    outcome = train(TINY, tmp_path / "r", seed=3, on_validation=lambda check, total: checks.append(check))
    assert [bool(check.event) for check in checks] == [False, True, False, False]
    assert [check.epoch for check in checks] == [10, 20, 30, 40]
    assert (outcome.rollbacks, outcome.best_epoch, outcome.best_score) == (1, 30, 2.5)
    assert best_weight(tmp_path / "r") == 3.0
    assert not jnp.array_equal(*map(jax.random.key_data, (keys["training"], keys["held_out"]))), "held out is held out"


@pytest.mark.slow
def test_a_run_without_improvement_can_be_loaded(monkeypatch, tmp_path):
    """Saturated from the first check to the last: there is something to look at all the same."""
    stubbed(monkeypatch, [(9.0, 0.0, 1.0, True)] * 4)
    train(TINY, tmp_path / "r", seed=3)
    assert load_run(tmp_path / "r")


def test_an_existing_folder_is_rejected_and_untouched(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="exists already") as caught:
        train(TINY, tmp_path)
    assert str(caught.value).startswith(str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    with pytest.raises(ValueError, match="exists already"):
        train(TINY, tmp_path / "notes.txt")
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_folder_without_a_run_cannot_be_resumed(tmp_path):
    with pytest.raises(ValueError, match=r"config\.toml"):
        train(TINY, tmp_path / "none", resume=True)
    assert not (tmp_path / "none").exists()
