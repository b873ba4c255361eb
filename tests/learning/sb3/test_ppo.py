"""PPO: the network against the JAX one, an episode's end against a probe, a run from end to end.

The oracle for returns at the end of an episode is arithmetic: a probe with reward 1 a step, K steps.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment, with_learner
from foveate.experiment.presets import PPO, PPOSettings, TrainingSettings
from foveate.experiment.run_folder import BEST, METRICS
from foveate.learning import loop as training
from foveate.learning.run_files import stored_run
from foveate.learning.sb3 import ppo
from foveate.learning.validation import held_out_episodes, validate
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.environment import Environment, observation, reset, step
from foveate.simulation.records import SURROGATE, Observation

pytest.importorskip("stable_baselines3", reason="needs the extra ppo")

import torch
from gymnasium import spaces
from stable_baselines3 import PPO as Learner
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from foveate.learning.sb3.network import ActorAndCritic, Attention, flat_inputs, to_jax
from foveate.learning.sb3.vec_env import TargetsVecEnv

pytestmark = pytest.mark.torch

WIDTHS = AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,))
TINY = Experiment(
    scenario=Scenario(scenes=SceneSettings(targets_min=1, targets_max=2, steps=4, drift_m_s=(0.1, 0.1))),
    policy=WIDTHS,
    training=PPOSettings(
        algorithm="ppo", steps=600, environments=8, rollout_steps=16, batch=64, check_every=256, held_out=8
    ),
)
PROBLEM = TINY.scenario.problem()


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize(
    "settings",
    [AttentionSettings(), replace(WIDTHS, frame="world", alpha=0.7, length_m=3.0, information="asinh")],
    ids=["paper", "other"],
)
def test_the_torch_actor_decides_as_the_policy_it_becomes(settings: AttentionSettings):
    """Random observations, some without a target; what padding holds must not matter to either."""
    torch.manual_seed(0)
    actor = Attention(PROBLEM, settings, 2, sees_time=False)
    policy = to_jax(actor, PROBLEM, settings)
    rng = np.random.default_rng(0)
    count, n = 50, 8
    root = rng.normal(size=(count, n, 2, 2))
    pose = rng.normal(size=(count, 3)) * [5.0, 5.0, 2.0]
    mean = rng.normal(size=(count, n, 2)) * 6.0
    information = root @ np.swapaxes(root, -1, -2) * 10.0 ** rng.uniform(-1, 2, (count, n, 1, 1))
    present = np.arange(n) < rng.integers(0, n + 1, (count, 1))
    assert not present.any(axis=1).all(), "one of them must be empty"

    def both(pose, mean, information, present):
        seen = Observation(jnp.zeros((), int), jnp.ones((), int), pose, mean, information, present, jnp.zeros((n, 2)))
        action, _ = policy(seen, (), jax.random.key(0))
        return flat_inputs(PROBLEM, settings, seen, jnp.array(0.5)), action

    rows, expected = jax.jit(jax.vmap(both))(pose, mean, information, present)
    with torch.no_grad():
        actions = torch.tanh(actor(torch.tensor(np.array(rows, np.float32))))
    np.testing.assert_allclose(actions.numpy(), expected, rtol=0, atol=1e-5)
    assert np.ptp(np.array(expected), axis=0).min() > 0.02, "the actions must differ, or nothing was compared"


def test_first_weights_are_within_one_over_the_root_of_inputs():
    """Bounds equal those of the JAX network, also for biases, and the weights reach nearly to them."""
    torch.manual_seed(0)
    for layer in Attention(PROBLEM, AttentionSettings(), 2, sees_time=False).target_layers:
        bound = layer.in_features**-0.5
        for weights in (layer.weight, layer.bias):
            assert 0.8 * bound < float(weights.detach().abs().max()) <= bound


class Probe(VecEnv):
    """Reward 1 at each of `steps` steps, seen as the share of steps gone by; ends as `TargetsVecEnv` does, or not."""

    def __init__(self, steps: int, count: int, ending: dict[str, Any]) -> None:
        self.steps, self.ending, self.at = steps, ending, np.zeros(count, int)
        super().__init__(count, spaces.Box(0.0, 1.0, (1,), np.float32), spaces.Box(-1.0, 1.0, (1,), np.float32))

    def rows(self) -> np.ndarray:
        return (self.at[:, None] / self.steps).astype(np.float32)

    def reset(self) -> np.ndarray:
        self.at[:] = 0
        return self.rows()

    def step_async(self, actions: np.ndarray) -> None:
        pass

    def step_wait(self):
        self.at += 1
        done = self.at == self.steps
        infos = [{"terminal_observation": row, **self.ending} if d else {} for row, d in zip(self.rows(), done)]  # noqa: B905
        self.at[done] = 0
        return self.rows(), np.ones(len(done), np.float32), done, infos

    close = TargetsVecEnv.close
    get_attr = TargetsVecEnv.get_attr
    set_attr = TargetsVecEnv.set_attr
    env_method = TargetsVecEnv.env_method
    env_is_wrapped = TargetsVecEnv.env_is_wrapped


class Kept(BaseCallback):
    """Returns and rewards of each rollout, as (step, environment)."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        buffer = self.locals["rollout_buffer"]
        self.returns, self.rewards = buffer.returns.copy(), buffer.rewards.copy()
        self.starts, self.values = buffer.episode_starts.copy(), buffer.values.copy()


def flattering(model: Learner) -> None:
    """Make the critic claim that every state is worth 100."""
    last = [
        module for module in model.policy.modules() if isinstance(module, torch.nn.Linear) and module.out_features == 1
    ]
    with torch.no_grad():
        last[-1].weight.zero_()
        last[-1].bias.fill_(100.0)


def last_steps(kept: Kept) -> np.ndarray:
    """Which steps of a rollout were the last of their episodes."""
    return kept.starts[1:].astype(bool)


def experiment_ppo(**changes: Any) -> Learner:
    experiment = replace(TINY, training=replace(TINY.training, **changes))
    return ppo.make_ppo(experiment, experiment.training, seed=1)


def test_the_value_after_the_horizon_is_zero():
    """Whatever the critic claims, the return of an episode's last step is its reward, and no bootstrap is in that."""
    model = experiment_ppo()
    flattering(model)
    assert model.policy.predict_values(torch.as_tensor(model.env.reset())).detach().unique().tolist() == [100.0]
    kept = Kept()
    model.learn(1, kept)
    last = last_steps(kept)
    assert last.sum() > 8
    returns, rewards = kept.returns[:-1], kept.rewards[:-1]
    np.testing.assert_allclose(returns[last], rewards[last], rtol=0, atol=2e-5)
    # A step earlier the claim is believed by a twentieth: lambda 0.95, discount 0.99.
    expected = rewards[:-1] + 0.99 * (0.05 * 100.0 + 0.95 * rewards[1:])
    np.testing.assert_allclose(returns[:-1][last[1:]], expected[last[1:]], rtol=0, atol=2e-5)


def test_the_test_above_catches_a_horizon_that_is_taken_for_a_truncation():
    for ending, expected in [
        ({"TimeLimit.truncated": False}, 1.0),
        ({"TimeLimit.truncated": True}, 1.0 + 0.99 * 100.0),
    ]:
        model = Learner("MlpPolicy", Probe(4, 4, ending), n_steps=16, batch_size=64, n_epochs=1, device="cpu", seed=0)
        flattering(model)
        kept = Kept()
        model.learn(1, kept)
        np.testing.assert_allclose(kept.returns[:-1][last_steps(kept)], expected, rtol=1e-5)


def test_the_critic_learns_the_remaining_return():
    """Reward 1 a step and no discount: after k of 5 steps, 5 - k is left; with a value beyond the end it would grow."""
    probe = Probe(5, 8, {"TimeLimit.truncated": False})
    options: dict[str, Any] = {"gamma": 1.0, "learning_rate": 5e-3, "device": "cpu", "seed": 0}
    model = Learner("MlpPolicy", probe, n_steps=20, batch_size=80, **options)
    model.learn(4800)
    rows = torch.arange(5.0)[:, None] / 5
    values = model.policy.predict_values(rows).detach().numpy()[:, 0]
    np.testing.assert_allclose(values, [5, 4, 3, 2, 1], atol=0.25)


def test_the_vec_env_equals_the_environment():
    """Rows, rewards (scaled), ends and infos against the environment stepped by itself, one copy at a time."""
    environment = Environment(PROBLEM, TINY.scenario.scenes, SURROGATE, noise=False)
    key, count = jax.random.key(5), 8
    vec_env = TargetsVecEnv(environment, WIDTHS, count, key, reward_scale=0.5)
    rows = vec_env.reset()
    one, begin = eqx.filter_jit(step), eqx.filter_jit(reset)
    look = jax.jit(lambda moment, left: flat_inputs(PROBLEM, WIDTHS, observation(environment, moment), left))
    moments = [begin(environment, each) for each in jax.random.split(jax.random.split(key)[1], count)]
    rng, returns = np.random.default_rng(0), np.zeros(count)
    for k in range(5):
        actions = rng.uniform(-1, 1, (count, 2)).astype(np.float32)
        previous, (rows, rewards, dones, infos) = rows, vec_env.step(actions)
        assert rows.dtype == rewards.dtype == previous.dtype == np.float32
        for i, moment in enumerate(moments):
            after, transition = one(environment, moment, jnp.asarray(actions[i], float))
            returns[i] += 0.5 * float(transition.reward)
            assert rewards[i] == pytest.approx(0.5 * float(transition.reward), abs=1e-5)
            assert bool(dones[i]) == bool(transition.done) == (k % 4 == 3)
            if not dones[i]:
                assert infos[i] == {}
            else:
                assert infos[i]["TimeLimit.truncated"] is False
                assert infos[i]["score"] == pytest.approx(float(transition.score), abs=1e-5)
                assert infos[i]["episode"] == {"r": pytest.approx(returns[i], abs=1e-5), "l": 4}
                end = look(after, jnp.array(0.0))
                np.testing.assert_allclose(infos[i]["terminal_observation"], end, rtol=1e-5, atol=1e-5)
                after = begin(environment, after.key)
            left = jnp.array(1.0 - int(after.predicted.step) / 4)
            np.testing.assert_allclose(rows[i], look(after, left), rtol=1e-5, atol=1e-5)
            moments[i] = after
    vec_env.seed(3)
    first = vec_env.reset()
    vec_env.seed(3)
    assert np.array_equal(first, vec_env.reset())
    assert not np.array_equal(first, vec_env.reset()), "without a seed the episodes continue"


def test_only_a_critic_that_may_reads_the_time():
    rows = torch.rand(32, 3 + 2 * 5 + 2 + 1, generator=torch.Generator().manual_seed(0))
    later = rows.clone()
    later[:, -1] += 1.0
    for sees in (False, True):
        policy: Any = experiment_ppo(critic_sees_time=sees).policy
        assert isinstance(policy, ActorAndCritic)
        (values, means), (later_values, later_means) = (
            (policy.predict_values(x).detach(), policy.get_distribution(x).distribution.mean.detach())
            for x in (rows, later)
        )
        torch.testing.assert_close(means, later_means, rtol=1e-6, atol=1e-7)
        # Behind a layer of ReLU a single row may not show the difference.
        assert (float((values - later_values).abs().max()) > 1e-4) == sees


def untimed(run: Path) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in (run / METRICS).read_text().splitlines()]
    return [{k: v for k, v in line.items() if k not in ("elapsed_s", "epochs_per_s")} for line in lines]


def test_a_run_from_end_to_end(tmp_path: Path):
    """Checks where they are due, the best kept, the same weights from the same seed, no torch to read them."""
    checks = []
    outcome = ppo.train(TINY, tmp_path / "a", seed=3, on_validation=lambda check, total: checks.append((check, total)))
    assert [(check.epoch, check.env_steps, total) for check, total in checks] == [
        (2, 256, 600),
        (4, 512, 600),
        (5, 640, 600),
    ]
    held_out = [check.held_out for check, _ in checks]
    assert outcome.best_score == max(held_out)
    assert outcome.best_epoch == checks[int(np.argmax(held_out))][0].epoch
    assert (outcome.epochs, outcome.rollbacks, outcome.stopped) == (5, 0, "")
    assert all(-5 < check.objective < 10 for check, _ in checks)
    experiment, policy, facts = load_run(tmp_path / "a")
    assert experiment == TINY
    assert facts == {"seed": 3, "epoch": outcome.best_epoch, "held_out": outcome.best_score}
    keys = jax.random.split(jax.random.key(3), 4)
    score, _ = eqx.filter_jit(lambda p, e: validate(TINY, p, e, keys[3]))(policy, held_out_episodes(TINY, keys[1]))
    assert float(score) == pytest.approx(outcome.best_score, abs=1e-12), "the file holds the policy of that score"
    assert list((tmp_path / "a").glob("events*"))
    assert ppo.train(TINY, tmp_path / "b", seed=3) == outcome
    assert (tmp_path / "a" / BEST).read_bytes() == (tmp_path / "b" / BEST).read_bytes()
    assert untimed(tmp_path / "a") == untimed(tmp_path / "b")
    with pytest.raises(ValueError, match="exists already"):
        ppo.train(TINY, tmp_path / "a")
    with pytest.raises(ValueError, match="cannot be resumed"):
        stored_run(tmp_path / "a")
    with pytest.raises(ValueError, match=r"training\.algorithm = 'ppo'"):
        training.train(TINY, tmp_path / "c")


def test_a_diverging_training_is_reported(tmp_path: Path):
    """A step so large that weights overflow: one line, and no policy that is no number."""
    wild = replace(TINY, training=replace(TINY.training, learning_rate=1e38, check_every=128))
    outcome = ppo.train(wild, tmp_path / "r", seed=3)
    assert "not finite" in outcome.stopped
    assert outcome.epochs <= 2


def test_a_missing_extra_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setitem(__import__("sys").modules, "stable_baselines3", None)
    with pytest.raises(ValueError, match=r"pip install 'foveate\[ppo\]'"):
        ppo.train(TINY, tmp_path / "r")
    assert not (tmp_path / "r").exists()


def test_settings_are_those_of_stable_baselines():
    """Against PPO's own defaults, as Stable-Baselines3 has them: 2048 steps a rollout, whoever takes them."""
    import inspect

    default = {name: each.default for name, each in inspect.signature(Learner).parameters.items()}
    ours = PPO["ppo"]
    assert ours.environments * ours.rollout_steps == default["n_steps"]
    assert (ours.batch, ours.update_epochs, ours.learning_rate) == (
        default["batch_size"],
        default["n_epochs"],
        default["learning_rate"],
    )
    assert (ours.discount, ours.gae_lambda, ours.clip) == (
        default["gamma"],
        default["gae_lambda"],
        default["clip_range"],
    )
    assert (ours.value_weight, ours.entropy_weight) == (default["vf_coef"], default["ent_coef"])
    assert ours.gradient_bound == default["max_grad_norm"]
    model: Any = ppo.make_ppo(replace(TINY, training=replace(ours, environments=2)), replace(ours, environments=2), 0)
    assert torch.equal(model.policy.log_std.detach(), torch.zeros(2))
    assert model.policy.optimizer.defaults["eps"] == 1e-5


def test_another_learner_is_after_the_same():
    """Keep objective and validation, and change the learner."""
    soft = TrainingSettings(softness=((1.0, 0.3),), noise=True, select="true", held_out=7, epochs=3)
    changed = with_learner(Experiment(training=soft), PPO["ppo"])
    assert changed.training == PPOSettings(
        algorithm="ppo", softness=((1.0, 0.3),), noise=True, select="true", held_out=7
    )
    assert with_learner(changed, TrainingSettings()).training == replace(soft, epochs=1000)
