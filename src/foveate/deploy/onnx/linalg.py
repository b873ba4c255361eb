"""Inverse and log determinant of small symmetric positive definite matrices, of all targets at once.

ONNX has no inverse. Written out entry by entry, as `geometry.linalg` does for XLA, it would be hundreds of nodes, each
of which costs half a microsecond.
"""

import numpy as np

from foveate.deploy.onnx.graph import Graph, Tensor
from foveate.deploy.onnx.shapes import cut, reshape, squeeze, unsqueeze


def inverse_spd(graph: Graph, matrix: Tensor) -> Tensor:
    """M^-1 of matrices (.., k, k) by sweeping (Goodnight 1979, "A tutorial on the SWEEP operator"), row by row.

    Step k subtracts (c - e)(c - e)^T / c_k, where c is column k and e the unit vector. All together they leave
    2 I - M^-1. The 2 costs no digits: M is scaled to ones on its diagonal first, and then M^-1 has no less there.
    """
    size, rank = matrix.shape[-1], len(matrix.shape)
    if size == 1:
        return graph.elementwise("Reciprocal", matrix)
    if size == 2:
        adjugate, det = _adjugate(graph, matrix)
        return reshape(graph, graph.elementwise("Div", adjugate, det), matrix.shape)
    swept, scale = _scaled(graph, matrix)
    for k, unit in enumerate(np.eye(size)):
        row = cut(graph, swept, rank - 2, k, k + 1)
        change = graph.elementwise("Sub", row, unit)
        column = graph.transpose(change, [*range(rank - 2), rank - 1, rank - 2])
        share = graph.elementwise("Div", change, cut(graph, row, rank - 1, k, k + 1))
        swept = graph.elementwise("Sub", swept, graph.elementwise("Mul", column, share))
    return graph.elementwise("Div", graph.elementwise("Sub", 2.0 * np.eye(size), swept), scale)


def log_det_spd(graph: Graph, matrix: Tensor) -> Tensor:
    """log det M of matrices (.., k, k), shape (.., 1)."""
    size, rank = matrix.shape[-1], len(matrix.shape)
    if size == 1:
        return squeeze(graph, graph.elementwise("Log", matrix), [rank - 1])
    if size == 2:
        return graph.elementwise("Log", _adjugate(graph, matrix)[1])
    scaled, _ = _scaled(graph, matrix)
    det = unsqueeze(graph, graph.node("Det", [scaled], matrix.shape[:-2]), [rank - 2])
    logs = graph.elementwise("Log", _diagonal(graph, matrix))
    total = graph.node("ReduceSum", [logs, np.array([rank - 2])], det.shape, keepdims=1)
    return graph.elementwise("Add", graph.elementwise("Log", det), total)


def _adjugate(graph: Graph, matrix: Tensor) -> tuple[Tensor, Tensor]:
    """The four numbers of the adjugate [[d, -b], [-b, a]] of [[a, b], [b, d]], and its determinant (.., 1)."""
    flat = reshape(graph, matrix, (*matrix.shape[:-2], 4))
    swapped = graph.node("Gather", [flat, np.array([3, 1, 2, 0])], flat.shape, axis=len(flat.shape) - 1)
    adjugate = graph.elementwise("Mul", swapped, np.array([1.0, -1.0, -1.0, 1.0]))
    products = graph.elementwise("Mul", flat, adjugate)
    return adjugate, graph.node("MatMul", [products, np.full((4, 1), 0.5)], (*flat.shape[:-1], 1))


def _diagonal(graph: Graph, matrix: Tensor) -> Tensor:
    size = matrix.shape[-1]
    flat = reshape(graph, matrix, (*matrix.shape[:-2], size**2))
    places = np.arange(size) * (size + 1)
    return graph.node("Gather", [flat, places], (*flat.shape[:-1], size), axis=len(flat.shape) - 1)


def _scaled(graph: Graph, matrix: Tensor) -> tuple[Tensor, Tensor]:
    """M_ij / s_ij, and s_ij = sqrt(M_ii M_jj)."""
    root, rank = graph.elementwise("Sqrt", _diagonal(graph, matrix)), len(matrix.shape)
    scale = graph.elementwise("Mul", unsqueeze(graph, root, [rank - 1]), unsqueeze(graph, root, [rank - 2]))
    return graph.elementwise("Div", matrix, scale), scale
