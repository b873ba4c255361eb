"""The pointer network against numpy, and what must not change its decision."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import softmax

from foveate.experiment.presets import QUADROTOR
from foveate.policies.pointer import PADDING_LOG_WEIGHT, PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.target import LinearTarget
from foveate.simulation.records import Observation

KEY = jax.random.key(0)
SMALL = PointerSettings(
    kind="pointer", target_widths=(12, 8), heads=3, context_widths=(10, 9), mode_widths=(7,), modes=2, length_m=2.0
)
SCENARIOS = {"plane": Scenario(), "space": QUADROTOR}


def network(name):
    """Weights from numpy, as large as makes differences show."""
    problem, rng = SCENARIOS[name].problem(), np.random.default_rng(1)
    shapes = eqx.filter_eval_shape(lambda: SMALL.policy(problem, KEY))
    return jax.tree.map(lambda x: jnp.asarray(rng.normal(0, 1.2 / np.sqrt(x.shape[-1]), x.shape)), shapes)


def scene(name, n, seed=0):
    """Rotation and place of the agent; states, information matrices and known inputs of the targets."""
    rng = np.random.default_rng(seed)
    d, n_y = (2, 2) if name == "plane" else (3, 6)
    root = rng.normal(size=(n, n_y, n_y))
    turn = Rotation.from_rotvec([0, 0, 2.2] if d == 2 else [0.3, -0.8, 1.9]).as_matrix()[:d, :d]
    information = root @ np.swapaxes(root, 1, 2) + np.eye(n_y)
    return turn, rng.normal(size=d), 3 * rng.normal(size=(n, n_y)), information, rng.normal(size=(n, d))


def seen(name, turn, place, mean, information, known_input, present=None, left=7):
    if name == "plane":
        pose = np.array([*place, np.arctan2(turn[1, 0], turn[0, 0])])
    else:
        pose = np.block([[turn, place[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    present = np.ones(len(mean), bool) if present is None else present
    arrays = (0, left, pose, mean, information, present, known_input)
    return Observation(*map(jnp.asarray, arrays))


@eqx.filter_jit
def decide(policy, observation):
    return policy(observation, (), KEY)[0]


@eqx.filter_jit
def modes_of(policy, observation):
    return policy.modes(observation)


def chain(layers, x, last_is_plain=False):
    for i, linear in enumerate(layers):
        x = np.asarray(linear.weight) @ x + np.asarray(linear.bias)
        x = x if last_is_plain and i == len(layers) - 1 else np.maximum(x, 0)
    return x


def by_hand(policy, turn, place, mean, information, known_input, left):
    """Target by target, head by head: log weights and actions."""
    d, n_y = len(place), mean.shape[1]
    whole, embeddings = np.kron(np.eye(n_y // d), turn), []
    for p, Y, xi in zip(mean, information, known_input, strict=True):
        state = whole.T @ (p - np.concatenate([place, np.zeros(n_y - d)]))
        packed = np.arcsinh([(whole.T @ Y @ whole)[i, j] for i in range(n_y) for j in range(i + 1)])
        distance = np.sqrt(state[:d] @ state[:d] + 0.01)
        common = [min(left / 10, 3), np.exp(-left / 3), len(mean) / 5]
        x = np.concatenate([state / 2.0, packed, state[:d] / distance, [np.log(distance)], common, turn.T @ xi])
        embeddings.append(chain(policy.encoder.target_layers, x))
    scores = np.array([chain(policy.encoder.query_layers, x, last_is_plain=True) for x in embeddings])
    gathered = np.concatenate([softmax(column) @ np.array(embeddings) for column in scores.T])
    context = chain(policy.context_layers, gathered)
    rows = [chain(policy.mode_layers, np.concatenate([x, context]), last_is_plain=True) for x in embeddings]
    idle = chain(policy.idle_layers, context, last_is_plain=True)
    rows = np.concatenate([np.reshape(rows, (2 * len(mean), -1)), idle[None]])
    return rows[:, 0], np.tanh(rows[:, 1:])


@pytest.mark.parametrize("name", SCENARIOS)
def test_network(name):
    policy, parts = network(name), scene(name, 5)
    observation = seen(name, *parts)
    log_weight, action = by_hand(policy, *parts, left=7)
    modes = modes_of(policy, observation)
    np.testing.assert_allclose(modes.log_weight, log_weight, atol=1e-9)
    np.testing.assert_allclose(modes.action, action, atol=1e-9)
    np.testing.assert_allclose(decide(policy, observation), action[np.argmax(log_weight)], atol=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_padding_and_order_do_not_matter(name):
    policy, (turn, place, *targets) = network(name), scene(name, 6)
    expected = decide(policy, seen(name, turn, place, *(part[:4] for part in targets)))
    order = np.array([5, 2, 0, 4, 3, 1])
    padded = seen(name, turn, place, *(part[order] for part in targets), order < 4)
    np.testing.assert_allclose(decide(policy, padded), expected, atol=1e-12)
    weight = modes_of(policy, padded).log_weight
    np.testing.assert_array_equal(
        np.asarray(weight[:-1]).reshape(6, 2) == PADDING_LOG_WEIGHT, np.stack([order >= 4] * 2, 1)
    )


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_world_frame_does_not_matter(name):
    policy, (turn, place, mean, information, known_input) = network(name), scene(name, 4)
    d, n_y = len(place), mean.shape[1]
    other = Rotation.from_rotvec([0, 0, -0.9] if d == 2 else [1.1, 0.4, -0.6]).as_matrix()[:d, :d]
    whole, shift = np.kron(np.eye(n_y // d), other), np.arange(1.0, d + 1)
    moved = mean @ whole.T + np.concatenate([shift, np.zeros(n_y - d)])
    there = seen(name, other @ turn, other @ place + shift, moved, whole @ information @ whole.T, known_input @ other.T)
    here = seen(name, turn, place, mean, information, known_input)
    np.testing.assert_allclose(decide(policy, there), decide(policy, here), atol=1e-10)


def test_without_targets_only_the_idle_mode_is_left():
    policy, parts = network("plane"), scene("plane", 3)
    nobody = seen("plane", *parts, np.zeros(3, bool))
    other = seen("plane", *scene("plane", 3, seed=5), np.zeros(3, bool))
    modes = modes_of(policy, nobody)
    np.testing.assert_array_equal(decide(policy, nobody), modes.action[-1])
    np.testing.assert_array_equal(decide(policy, nobody), decide(policy, other))


def test_wrong_settings():
    for change, message in (
        ({"target_widths": ()}, "target_widths"),
        ({"context_widths": (0,)}, "context_widths"),
        ({"mode_widths": ()}, "mode_widths"),
        ({"heads": 0}, "heads = 0"),
        ({"modes": 0}, "modes = 0"),
        ({"length_m": 0.0}, "length_m"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(SMALL, **change)
    swapped, eye = ((0.0, 1.0), (1.0, 0.0)), ((1.0, 0.0), (0.0, 1.0))
    target = LinearTarget(kind="linear", A=eye, B=eye, W=eye, Z=swapped, prior=eye)
    still = replace(Scenario().scenes, drift_m_s=(0.0, 0.0))
    with pytest.raises(ValueError, match="begins with the position"):
        SMALL.policy(replace(Scenario(), target=target, scenes=still).problem(), KEY)
