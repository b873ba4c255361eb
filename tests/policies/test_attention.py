"""The paper's network against numpy, and what must not change its decision."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import softmax

from foveate.policies.attention import AttentionPolicy, AttentionSettings
from foveate.policies.inputs import policy_inputs
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import LinearTarget
from foveate.simulation.records import Observation

KEY = jax.random.key(0)
RNG = np.random.default_rng(0)
EYE, NOTHING = np.eye(2), np.zeros((2, 2))


def rows(matrix):
    return tuple(map(tuple, np.asarray(matrix).tolist()))


MOVING = LinearTarget(
    kind="linear",
    A=rows(np.block([[EYE, EYE], [NOTHING, EYE]])),
    B=rows(np.eye(4, 2)),
    W=rows(0.01 * np.eye(4)),
    Z=rows(np.eye(2, 4)),
    prior=rows(np.eye(4)),
)
SCENARIOS = {2: Scenario(), 4: replace(Scenario(), target=MOVING)}


def policy(frame, n_y, **changes):
    """A network with weights from numpy, as large as makes differences show; the default sizes are the paper's."""
    problem, rng = SCENARIOS[n_y].problem(), np.random.default_rng(1)
    shapes = eqx.filter_eval_shape(lambda: AttentionSettings(frame="world", **changes).policy(problem, KEY))
    filled = jax.tree.map(lambda x: jnp.asarray(rng.normal(0, 1.2 / np.sqrt(x.shape[-1]), x.shape)), shapes)
    return replace(filled, frame=frame)


def scene(n, n_y):
    roots = RNG.normal(size=(n, n_y, n_y))
    pose = np.array([1.0, -2.0, 2.2])
    return pose, 3 * RNG.normal(size=(n, n_y)), roots @ np.swapaxes(roots, 1, 2) + np.eye(n_y), np.ones(n, bool)


def seen(pose, mean, information, present):
    arrays = (pose, mean, information, present)
    pose, mean, information, present = (jnp.asarray(x) for x in arrays)
    return Observation(jnp.asarray(0), jnp.asarray(9), pose, mean, information, present, jnp.zeros((len(mean), 2)))


@eqx.filter_jit
def decide(network, pose, mean, information, present):
    return network(seen(pose, mean, information, present), (), KEY)[0]


def by_the_paper(network, agent, targets, present):
    """Section 3.2, with the mask and Emb_b put right: AP_FC, LI_FC, attention over the targets that are there."""

    def layer(linear, x):
        return np.asarray(linear.weight) @ x + np.asarray(linear.bias)

    emb_a = agent
    for linear in network.agent_layers:
        emb_a = np.maximum(layer(linear, emb_a), 0)
    emb_l = []
    for target in targets[present]:
        for linear in network.target_layers:
            target = np.maximum(layer(linear, target), 0)
        emb_l.append(target)
    attention = softmax([emb_a @ emb / network.alpha for emb in emb_l])
    context = np.maximum(sum(a * emb for a, emb in zip(attention, emb_l, strict=True)), 0)
    x = np.concatenate([context, emb_a])
    *hidden, last = network.out_layers
    for linear in hidden:
        x = np.maximum(layer(linear, x), 0)
    return np.tanh(layer(last, x)), attention


@pytest.mark.parametrize(("frame", "n_y", "out"), [("world", 2, (64,)), ("body", 4, (64, 64))])
def test_network_of_the_paper(frame, n_y, out):
    length = {"world": 1.0, "body": 2.5}[frame]
    scale = {"world": "plain", "body": "asinh"}[frame]
    alpha = 40.0 if frame == "world" else 4.0
    network = policy(frame, n_y, out_widths=out, alpha=alpha, length_m=length, information=scale)
    widths = [layer.weight.shape for part in (network.agent_layers, network.target_layers) for layer in part]
    features = n_y + n_y * (n_y + 1) // 2
    assert widths == [(32, 3), (32, 32), (64, features), (32, 64)]
    assert [layer.weight.shape for layer in network.out_layers] == [(b, 64) for b in (*out, 2)]
    pose, mean, information, present = scene(6, n_y)
    present[[1, 4]] = False
    targets = []
    for p, P in zip(mean, information, strict=True):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        R = np.array([[c, -s], [s, c]])
        if frame == "body":
            whole = np.kron(np.eye(n_y // 2), R)
            P = whole.T @ P @ whole
            p = np.concatenate([R.T @ (p[:2] - pose[:2]), R.T @ p[2:]]) if n_y == 4 else R.T @ (p - pose[:2])
        packed = np.array([P[i, j] for i in range(n_y) for j in range(i + 1)])
        if scale == "asinh":
            packed = np.log(packed + np.sqrt(packed**2 + 1))
        targets.append([*(p / length), *packed])
    yaw, half = pose[2], pose[2] / 2
    # log of SE(2): the inverse of the left Jacobian, (w/2) cot(w/2) on the diagonal.
    inverse = np.array([[half / np.tan(half), half], [-half, half / np.tan(half)]])
    agent = np.append(inverse @ pose[:2], yaw) if frame == "world" else np.zeros(3)
    expected, attention = by_the_paper(network, agent, np.array(targets), present)
    assert 0.02 < attention.max() < 0.98
    np.testing.assert_allclose(decide(network, pose, mean, information, present), expected, atol=1e-10)


def test_without_any_target_value_and_gradient_are_those_of_an_empty_context():
    network = policy("world", 2)
    pose, mean, information, present = scene(6, 2)
    present[:] = False
    emb_a = np.array([-0.0])
    weights = [(np.asarray(x.weight), np.asarray(x.bias)) for x in network.agent_layers]
    emb_a = np.asarray(policy_inputs(seen(pose, mean, information, present), network.space, "world")[0])
    for W, b in weights:
        emb_a = np.maximum(W @ emb_a + b, 0)
    hidden, last = network.out_layers
    x = np.maximum(hidden.weight @ np.concatenate([np.zeros(32), emb_a]) + hidden.bias, 0)
    np.testing.assert_allclose(
        decide(network, pose, mean, information, present), np.tanh(last.weight @ x + last.bias), atol=1e-12
    )
    parameters, rest = eqx.partition(network, eqx.is_inexact_array)

    @jax.jit
    def gradient(parameters, mean):
        def total(parameters, mean):
            return jnp.sum(decide(eqx.combine(parameters, rest), pose, mean, information, present))

        return jax.grad(total, (0, 1))(parameters, mean)

    by_parameters, by_mean = gradient(parameters, mean)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(by_parameters))
    np.testing.assert_array_equal(by_mean, 0)
    assert np.abs(by_parameters.out_layers[1].weight).max() > 1e-3, "the agent's own part still learns"
    assert all(not np.any(layer.weight) for layer in by_parameters.target_layers)


@pytest.mark.parametrize("frame", ["body", "world"])
def test_order_and_padding_of_targets_do_not_matter(frame):
    network = policy(frame, 2)
    pose, mean, information, present = scene(6, 2)
    present[5] = False
    decision = decide(network, pose, mean, information, present)
    order = np.array([4, 5, 0, 3, 1, 2])
    np.testing.assert_allclose(
        decide(network, pose, mean[order], information[order], present[order]), decision, atol=1e-13
    )
    mean[5], information[5] = 1e6, 1e9 * np.eye(2)
    np.testing.assert_array_equal(decide(network, pose, mean, information, present), decision)
    alone = decide(network, pose, mean[:5], information[:5], present[:5])
    np.testing.assert_allclose(alone, decision, atol=1e-13)
    other = decide(network, pose, 1.1 * mean, information, present)
    assert np.abs(other - decision).max() > 1e-3, "targets that are there must count"


@pytest.mark.parametrize("n_y", [2, 4])
def test_body_frame_decision_does_not_depend_on_the_world_frame(n_y):
    """The same agent, targets and beliefs, given in a frame that is turned and shifted."""
    pose, mean, information, present = scene(6, n_y)
    turn, shift = 2.7, np.array([40.0, -7.0])
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    whole = np.kron(np.eye(n_y // 2), R)
    there = np.concatenate([shift, np.zeros(n_y - 2)])
    changed = (
        np.append(R @ pose[:2] + shift, pose[2] + turn - 2 * np.pi),
        mean @ whole.T + there,
        whole @ information @ whole.T,
        present,
    )
    network = policy("body", n_y)
    np.testing.assert_allclose(decide(network, *changed), decide(network, pose, mean, information, present), atol=1e-11)
    if n_y == 2:
        seen_in_world = policy("world", n_y)
        difference = decide(seen_in_world, *changed) - decide(seen_in_world, pose, mean, information, present)
        assert np.abs(difference).max() > 1e-3


def test_body_frame_asks_for_states_that_begin_with_the_position():
    odd = replace(MOVING, Z=((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    problem = replace(Scenario(), target=odd, scenes=SceneSettings(drift_m_s=(0.0, 0.0))).problem()
    with pytest.raises(ValueError, match="frame = 'body'"):
        AttentionSettings(frame="body").policy(problem, KEY)


def test_fresh_weights():
    """Every layer is new, uniform within 1 / sqrt(inputs), and differs for another key."""
    small = AttentionSettings(agent_widths=(30,), target_widths=(30,), out_widths=(30,))
    one, other = (small.policy(SCENARIOS[2].problem(), jax.random.key(k)) for k in range(2))
    assert isinstance(one, AttentionPolicy)
    layers = [layer for p in (one, other) for layer in (*p.agent_layers, *p.target_layers, *p.out_layers)]
    for layer in layers:
        assert 0.9 < np.abs(layer.weight).max() * np.sqrt(layer.weight.shape[1]) <= 1
    starts = [float(layer.weight[0, 0]) for layer in layers]
    assert len(set(starts)) == len(starts)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"agent_widths": ()}, "agent_widths = ()"),
        ({"out_widths": (0,)}, "out_widths = (0,)"),
        ({"target_widths": (64, 16)}, "target_widths = (64, 16)"),
        ({"alpha": 0.0}, "alpha = 0.0"),
    ],
)
def test_bad_settings(changes, words):
    with pytest.raises(ValueError, match="expected") as caught:
        AttentionSettings(**changes)
    assert words in str(caught.value)
