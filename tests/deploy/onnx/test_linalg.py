"""Inverses and log determinants in nodes, against numpy in double precision."""

import numpy as np
import pytest

onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
onnx = pytest.importorskip("onnx", reason="needs the extra onnx")

from foveate.deploy.onnx.graph import Graph  # noqa: E402
from foveate.deploy.onnx.linalg import inverse_spd, log_det_spd  # noqa: E402


def computed(function, matrices):
    """Result of a function of `Graph` for an array of matrices."""
    graph = Graph(17)
    size = matrices.shape[-1]
    graph.finish(function(graph, graph.input("m", ("n", size, size))), "result")
    given = onnx.helper.make_tensor_value_info("m", 1, ["n", size, size])
    result = onnx.helper.make_tensor_value_info("result", 1, None)
    body = onnx.helper.make_graph(graph.nodes, "function", [given], [result], graph.constants)
    model = onnx.helper.make_model(body, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
    return onnxruntime.InferenceSession(model.SerializeToString()).run(None, {"m": matrices})[0]


def matrices_of(size, count=500):
    """Symmetric positive definite matrices whose entries are of very different sizes, some of them nearly singular."""
    rng = np.random.default_rng(size)
    turn = np.linalg.qr(rng.normal(size=(count, size, size)))[0]
    values, scale = 10.0 ** rng.uniform(0, 4, (count, 1, size)), 10.0 ** rng.uniform(-3, 3, (count, size))
    return (scale[:, :, None] * ((turn * values) @ turn.swapaxes(1, 2)) * scale[:, None]).astype(np.float32)


@pytest.mark.parametrize("size", [1, 2, 3, 4, 6, 9])
def test_inverse_and_log_det(size):
    matrices = matrices_of(size)
    exact = matrices.astype(float)
    inverse = np.linalg.inv(exact)
    scale = np.sqrt(np.einsum("nii->ni", inverse))
    # Conditioning that is left where rows and columns have the same scale: no method in single precision is better.
    diagonal = np.sqrt(np.einsum("nii->ni", exact))
    condition = np.linalg.cond(exact / diagonal[:, :, None] / diagonal[:, None])
    error = np.abs(computed(inverse_spd, matrices) - inverse) / scale[:, :, None] / scale[:, None]
    assert (error.max(axis=(1, 2)) < 5 * size * 6e-8 * condition).all()
    log_det = computed(log_det_spd, matrices)
    assert log_det.shape == (len(matrices), 1)
    expected = np.linalg.slogdet(exact)[1]
    assert (np.abs(log_det[:, 0] - expected) < 5 * size * 6e-8 * condition + 1e-6 * (1 + np.abs(expected))).all()


@pytest.mark.parametrize("size", [2, 6])
def test_no_matrix_at_all(size):
    none = np.zeros((0, size, size), np.float32)
    assert computed(inverse_spd, none).shape == none.shape
    assert computed(log_det_spd, none).shape == (0, 1)
