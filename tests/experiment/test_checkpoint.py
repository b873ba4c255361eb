"""Weights come back bit for bit, or one line says which file is wrong and how."""

import json
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.experiment.checkpoint import (
    VERSION,
    load_run,
    load_tree,
    policy_shape,
    save_tree,
    stored_facts,
    write_config,
)
from foveate.experiment.experiment import Experiment
from foveate.experiment.run_folder import BEST
from foveate.io.npz import load_arrays, save_arrays
from foveate.policies.attention import AttentionSettings

WIDTHS = {"agent_widths": (3, 4), "target_widths": (5, 4), "out_widths": (3,)}
EXPERIMENT = Experiment(policy=AttentionSettings(**WIDTHS))


@pytest.fixture(scope="module")
def policy():
    """A network whose weights hold every kind of number that a weight may be: tiny, huge, -0."""
    rng = np.random.default_rng(0)
    fresh = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape), x.dtype), policy_shape(EXPERIMENT))
    odd = jnp.array([5e-324, 3e38, -0.0, -3e38])
    return eqx.tree_at(lambda p: p.agent_layers[1].bias, fresh, odd)


def leaves(tree):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(eqx.filter(tree, eqx.is_array))]


def same(one, other):
    return all(
        (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
        for a, b in zip(leaves(one), leaves(other), strict=True)
    )


def zeros(tree):
    return jax.tree.map(lambda x: jnp.zeros_like(x) if eqx.is_array(x) else x, tree)


def test_round_trip_bit_for_bit(tmp_path, policy):
    path, facts = tmp_path / "a.npz", {"epoch": 3, "held_out": 1 / 3, "note": "ü"}
    save_tree(path, policy, EXPERIMENT, "policy", facts)
    back, found = load_tree(path, zeros(policy), "policy")
    assert same(back, policy)
    assert not same(back, zeros(policy))
    assert jax.tree.structure(back) == jax.tree.structure(policy)
    assert found == facts
    save_tree(tmp_path / "b.npz", back, EXPERIMENT, "policy", facts)
    assert (tmp_path / "b.npz").read_bytes() == path.read_bytes()


def test_any_tree(tmp_path):
    tree = {"a": (jnp.arange(3), jnp.array(True)), "b": [jnp.array(2.5, jnp.float32), None, "text", 7]}
    save_tree(tmp_path / "t.npz", tree, EXPERIMENT, "training", {})
    back, _ = load_tree(tmp_path / "t.npz", zeros(tree), "training")
    assert same(back, tree)
    assert back["b"][1:] == [None, "text", 7]


def test_a_run_folder(tmp_path, policy):
    (tmp_path / BEST).parent.mkdir()
    write_config(tmp_path, EXPERIMENT)
    save_tree(tmp_path / BEST, policy, EXPERIMENT, "policy", {"epoch": 2})
    experiment, back, facts = load_run(tmp_path)
    assert experiment == EXPERIMENT
    assert same(back, policy)
    assert facts == {"epoch": 2}
    (tmp_path / BEST).unlink()
    assert "best.npz" in rejection(lambda: load_run(tmp_path), tmp_path)
    assert "no such run folder" in rejection(lambda: load_run(tmp_path / "none"), tmp_path)


def rejection(load, place):
    with pytest.raises(ValueError, match=re.escape(str(place))) as caught:
        load()
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


@pytest.fixture
def saved(tmp_path, policy):
    save_tree(tmp_path / "best.npz", policy, EXPERIMENT, "policy", {})
    return tmp_path / "best.npz"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({**WIDTHS, "agent_widths": (2, 4)}, "agent_layers.0.weight has shape (3, 3): expected (2, 3)"),
        ({**WIDTHS, "out_widths": (3, 3)}, "no array 'out_layers.2.bias'"),
        ({**WIDTHS, "agent_widths": (4,)}, "unknown array 'agent_layers.1.bias'"),
    ],
)
def test_another_network(saved, changes, words):
    other = policy_shape(Experiment(policy=AttentionSettings(**changes)))
    assert words in rejection(lambda: load_tree(saved, other, "policy"), saved)


def test_another_kind(saved, policy):
    assert "'foveate-training'" in rejection(lambda: load_tree(saved, policy, "training"), saved)


def test_a_newer_version(saved, policy):
    header, arrays = load_arrays(saved, "policy", VERSION)
    save_arrays(saved, arrays, {**header, "version": VERSION + 1})
    assert f"version {VERSION + 1}" in rejection(lambda: load_tree(saved, policy, "policy"), saved)


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (np.complex64(1), "has the type complex64"),
        (np.str_("1"), "has the type <U1"),
        (np.int64(1), "has the type int64"),
        (np.nan, "is not finite"),
        (-np.inf, "is not finite"),
    ],
)
def test_weights_are_finite_real_numbers(saved, policy, number, words):
    header, arrays = load_arrays(saved, "policy", VERSION)
    name, shape = "agent_layers.1.bias", arrays["agent_layers.1.bias"].shape
    save_arrays(saved, {**arrays, name: np.full(shape, number)}, header)
    said = rejection(lambda: load_tree(saved, policy, "policy"), saved)
    assert words in said
    assert name in said


def test_weights_that_only_float64_holds_are_rejected_in_float32(saved, policy):
    header, arrays = load_arrays(saved, "policy", VERSION)
    save_arrays(saved, {**arrays, "agent_layers.1.bias": np.full(4, 1e39)}, header)
    single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32) if eqx.is_array(x) else x, policy)
    assert "a number too large for float32" in rejection(lambda: load_tree(saved, single, "policy"), saved)
    whole = {"count": np.array(2**40)}
    save_tree(saved, whole, EXPERIMENT, "training", {})
    narrow = {"count": jnp.zeros((), jnp.int32)}
    assert "a number too large for int32" in rejection(lambda: load_tree(saved, narrow, "training"), saved)


def test_the_state_of_a_training_may_be_infinite_but_not_its_weights(tmp_path):
    path, infinite = tmp_path / "last.npz", jnp.array(-jnp.inf)
    tree = {"best": {"policy": {"weight": jnp.ones(2)}}, "best_score": infinite}
    save_tree(path, tree, EXPERIMENT, "training", {})
    assert load_tree(path, tree, "training")[0]["best_score"] == infinite
    save_tree(path, {**tree, "best": {"policy": {"weight": jnp.array([1, jnp.nan])}}}, EXPERIMENT, "training", {})
    assert "best.policy.weight is not finite" in rejection(lambda: load_tree(path, tree, "training"), path)


@pytest.mark.parametrize(("missing", "words"), [("facts", "no facts"), ("experiment", "no experiment")])
def test_a_header_without_its_parts(saved, policy, missing, words):
    header, arrays = load_arrays(saved, "policy", VERSION)
    for value in (None, [], 3):
        save_arrays(saved, arrays, {**header, missing: value})
        assert words in rejection(lambda: load_tree(saved, policy, "policy", ["x"]), saved)
    del header[missing]
    save_arrays(saved, arrays, header)
    assert words in rejection(lambda: load_tree(saved, policy, "policy", ["x"]), saved)
    assert words in rejection(lambda: stored_facts(saved, "policy"), saved)


def test_cut_and_damaged_files(saved, policy):
    whole = saved.read_bytes()
    for size in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        saved.write_bytes(whole[:size])
        rejection(lambda: load_tree(saved, policy, "policy"), saved)
    for place in range(0, len(whole), 97):
        flipped = bytearray(whole)
        flipped[place] ^= 0x10
        saved.write_bytes(bytes(flipped))
        rejected = None
        try:
            back, _ = load_tree(saved, policy, "policy")
        except ValueError as error:
            rejected = str(error)
        if rejected is None:
            assert same(back, policy), f"a flipped bit in byte {place} went unnoticed"
        else:
            assert rejected.startswith(str(saved))
            assert len(rejected.splitlines()) == 1


def test_something_else(tmp_path, policy):
    path = tmp_path / "best.npz"
    path.write_text(json.dumps({"format": "foveate-policy"}))
    assert "not an .npz" in rejection(lambda: load_tree(path, policy, "policy"), path)


def test_a_checkpoint_beside_the_settings_of_another_experiment(tmp_path, policy):
    """Same shapes, other meaning: the policy was trained on body-frame inputs, config.toml now says world."""
    (tmp_path / BEST).parent.mkdir()
    save_tree(tmp_path / BEST, policy, EXPERIMENT, "policy", {})
    write_config(tmp_path, Experiment(policy=AttentionSettings(frame="world", **WIDTHS)))
    rejection(lambda: load_run(tmp_path), tmp_path)
