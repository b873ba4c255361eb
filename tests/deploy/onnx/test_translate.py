"""Functions translated operation by operation, run by onnxruntime, against the same functions in JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.export import symbolic_shape

from foveate.geometry.linalg import inverse_spd, log_det_spd
from foveate.policies.layers import masked_softmax

onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
onnx = pytest.importorskip("onnx", reason="needs the extra onnx")

from foveate.deploy.onnx.decision import KEPT  # noqa: E402
from foveate.deploy.onnx.graph import Graph  # noqa: E402
from foveate.deploy.onnx.trace import NoRule, trace  # noqa: E402
from foveate.deploy.onnx.translate import translate  # noqa: E402

TABLE = np.array([[0.0, 1.0], [-2.0, 3.0], [0.5, -0.5]], np.float32)
WEIGHT = np.random.default_rng(1).normal(size=(4, 3)).astype(np.float32)
NAMES = ("x", "there", "k", "matrix")


def model_of(function, opset=17):
    """ONNX model of a function of b decisions: x (n, 3), there (n,) bool, k () int, matrix (n, 2, 2) symmetric."""
    with jax.enable_x64(False):
        b, n = symbolic_shape("b, n")
        shapes = [((b, n, 3), jnp.float32), ((b, n), jnp.bool_), ((b,), jnp.int32), ((b, n, 2, 2), jnp.float32)]
        traced = trace(jax.vmap(function), [jax.ShapeDtypeStruct(*each) for each in shapes], KEPT)
    graph = Graph(opset)
    graph.finish(translate(graph, traced, NAMES), "result")
    types = dict(zip(NAMES, (1, 9, 7, 1), strict=True))
    values = dict(zip(NAMES, traced.inputs, strict=True))
    inputs = [
        onnx.helper.make_tensor_value_info(name, types[name], [str(size) for size in values[name].shape])
        for name in NAMES
        if graph.reads(name)
    ]
    kind = {"f": 1, "i": 7, "b": 9}[np.dtype(traced.output.dtype).kind]
    output = onnx.helper.make_tensor_value_info("result", kind, [None] * len(traced.output.shape))
    body = onnx.helper.make_graph(graph.nodes, "function", inputs, [output], graph.constants)
    versions = [onnx.helper.make_opsetid("", opset)]
    model = onnx.helper.make_model(
        body, opset_imports=versions, ir_version=onnx.helper.find_min_ir_version_for(versions)
    )
    onnx.checker.check_model(model, full_check=True)
    return model


def numbers(n, seed=0):
    """Arguments for two decisions about n targets, with zeros, negative and equal numbers among them."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, n, 2, 2))
    return {
        "x": np.round(rng.normal(size=(2, n, 3)) * 2).astype(np.float32) / 2 + 0.0,  # no -0.0
        "there": rng.random((2, n)) < 0.6,
        "k": rng.integers(0, 5, 2),
        "matrix": (root @ root.swapaxes(-1, -2) + 0.1 * np.eye(2)).astype(np.float32),
    }


FUNCTIONS = {
    "entry by entry": lambda x, there, k, m: jnp.tanh(x) * jnp.exp(-jnp.abs(x)) - jnp.arcsinh(x) / (1.5 + jnp.cos(x)),
    "angles": lambda x, there, k, m: jnp.arctan2(x[:, 0], x[:, 1]) + 10 * jnp.arctan2(0.0, x[:, 2]),
    "lengths": lambda x, there, k, m: jnp.hypot(x[:, 0], x[:, 1]) + jnp.sqrt(jnp.sum(x**2, -1)) + x[:, 2] ** 3,
    "limits": lambda x, there, k, m: jnp.clip(x, -0.6, 0.7) + jnp.maximum(x, 0.0) + jnp.minimum(0.3, x) + jnp.sign(x),
    "finite": lambda x, there, k, m: jnp.where(jnp.isfinite(1.0 / x), 1.0 / x, 7.0),
    "logic": lambda x, there, k, m: (there & (x[:, 0] > 0)) | ~(x[:, 1] <= 0) | (x[:, 2] != 0.5),
    "a choice of truths": lambda x, there, k, m: jnp.where(x[:, 0] > 0, there, x[:, 1] >= 0),
    "all and any": lambda x, there, k, m: jnp.stack([jnp.all(x > -1, -1), jnp.any(x == 0, -1)]),
    "all and any of none": lambda x, there, k, m: jnp.stack([jnp.all(there), jnp.any(there)]),
    "sums of none": lambda x, there, k, m: jnp.sum(x, axis=0) + jnp.sum(there),
    "extremes of none": lambda x, there, k, m: jnp.max(x, axis=0, initial=-5.0) - jnp.min(x, initial=9.0),
    "softmax of none": lambda x, there, k, m: masked_softmax(x[:, 0], there) @ x,
    "mean of a whole number": lambda x, there, k, m: jnp.log1p(jnp.sum(there).astype(x.dtype)) + k % 3 - k // 2,
    "layers": lambda x, there, k, m: jax.vmap(lambda row: jax.nn.relu(WEIGHT @ row + 1.0))(x),
    "products": lambda x, there, k, m: (x @ WEIGHT.T).T @ x,
    "pairs": lambda x, there, k, m: jnp.sum(jnp.exp(-jnp.sum((x[:, None] - x[None]) ** 2, -1)), -1),
    "order": lambda x, there, k, m: jnp.stack([x.T, jnp.cos(x).T], axis=1)[:, 0] * jnp.array([[1.0], [2.0], [3.0]]),
    "number of targets": lambda x, there, k, m: x + jnp.arange(x.shape[0])[:, None] - x.shape[0],
    "joined": lambda x, there, k, m: jnp.concatenate([x, jnp.ones((x.shape[0], 2)), x[:, 1:]], -1)[:, 2:6].reshape(-1),
    "part of a matrix": lambda x, there, k, m: (
        m[:, *jnp.tril_indices(2)] @ jnp.ones(3) + jnp.diagonal(m, 0, 1, 2)[:, 0]
    ),
    "row of a table": lambda x, there, k, m: jnp.asarray(TABLE)[jnp.argmax(x, axis=-1)],
    "row that is largest": lambda x, there, k, m: jnp.append(x, jnp.ones((1, 3)), 0)[
        jnp.argmax(jnp.append(x[:, 0], 0.25))
    ],
    "row by number": lambda x, there, k, m: jnp.asarray(TABLE)[k % 3] - jnp.asarray(TABLE)[jnp.argmin(TABLE[:, 0] * k)],
    "inverse": lambda x, there, k, m: inverse_spd(m)[:, 0] * log_det_spd(m)[:, None],
    # vmap puts its own axis last here, and the matrix is still found.
    "inverse of columns": lambda x, there, k, m: jax.vmap(inverse_spd, in_axes=2, out_axes=1)(jnp.moveaxis(m, 0, 2)),
    "loop": lambda x, there, k, m: jnp.concatenate(
        [part.reshape(-1) for part in jax.lax.scan(lambda s, i: (s * 0.5 + i * x, s[:, 0] - i), x, TABLE[:, 0])]
    ),
    "whole numbers": lambda x, there, k, m: jnp.round(x) + jnp.round(x + 0.3),
    "constant": lambda x, there, k, m: jnp.cumsum(jnp.asarray(TABLE), axis=0),
    "input": lambda x, there, k, m: x,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_computes_as_jax(name):
    function = FUNCTIONS[name]
    live = onnxruntime.InferenceSession(model_of(function).SerializeToString())
    for n in (0, 1, 5):
        given = numbers(n)
        with jax.enable_x64(False):
            expected = np.asarray(jax.jit(jax.vmap(function))(*(jnp.asarray(given[key]) for key in NAMES)))
        got = live.run(None, {each.name: given[each.name] for each in live.get_inputs()})[0]
        assert got.shape == expected.shape
        np.testing.assert_allclose(got, expected, rtol=2e-6, atol=2e-6)


def kinds(function):
    return [node.op_type for node in model_of(function).graph.node]


def test_nothing_is_computed_twice_or_in_vain():
    def wasteful(x, there, k, m):
        del there, k
        unused = jnp.tan(m)
        turned = jnp.tanh(x.T + jnp.log(jnp.cosh(3.0)))  # a constant
        return jnp.where(False, jnp.sum(unused), 1.0) * (turned.T + jnp.tanh(x + jnp.log(jnp.cosh(3.0)))) - 0.0

    assert sorted(kinds(wasteful)) == ["Add", "Add", "Identity", "Tanh"]


def test_an_operation_without_a_rule_is_named():
    with pytest.raises(NoRule, match="sort"):
        model_of(lambda x, there, k, m: jnp.sort(x, axis=0))
    with pytest.raises(NoRule, match="scan backwards"):
        model_of(lambda x, there, k, m: jax.lax.scan(lambda s, i: (s + i, s), x, TABLE[:, 0], reverse=True)[1])
    with pytest.raises(NoRule, match="size 2\\*n"):
        model_of(lambda x, there, k, m: x + 2 * x.shape[0])
    with pytest.raises(NoRule, match="random numbers"):
        model_of(lambda x, there, k, m: x + jax.random.normal(jax.random.key(0), (3,)))
