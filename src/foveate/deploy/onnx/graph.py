"""ONNX nodes of the parts of a network: dense layers, softmax over targets, inputs in the agent's frame, log(T)^v.

Every array has a leading batch axis b; n, the number of targets, is free too and may be 0. All numbers are float32.
"""

from typing import Any, NamedTuple

import numpy as np
from onnx import NodeProto, TensorProto, helper, numpy_helper

from foveate.geometry.space import Space
from foveate.policies.inputs import Scale

LOWEST = np.finfo(np.float32).min
"""Score of absent targets. Not -inf: the softmax of nothing else is NaN."""

COTANGENT = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000)
"""Coefficients of (1 - (a/2) cot(a/2)) / a^2 as a series in a^2; at 1 rad the next term is below 1e-11."""


class Graph:
    """Nodes and constants of a graph under construction."""

    def __init__(self) -> None:
        self.nodes: list[NodeProto] = []
        self.constants: list[TensorProto] = []

    def __call__(self, kind: str, *inputs: Any, output: str = "", **attributes: Any) -> str:
        """Add a node and return the name of its output; inputs that are not names become constants."""
        names = [each if isinstance(each, str) else self.constant(each) for each in inputs]
        output = output or f"{kind}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, names, [output], name=output, **attributes))
        return output

    def constant(self, value: Any) -> str:
        """Add a constant, int64 for whole numbers, else float32; return its name."""
        array, name = np.asarray(value), f"constant_{len(self.constants)}"
        array = np.ascontiguousarray(array.astype(np.int64 if array.dtype.kind in "iu" else np.float32))
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def dense(self, x: str, layer: Any) -> str:
        """W x + b along the last axis."""
        return self("Add", self("MatMul", x, np.asarray(layer.weight).T), np.asarray(layer.bias))

    def relu_layers(self, x: str, layers: Any) -> str:
        """Dense layers with a ReLU after each."""
        for layer in layers:
            x = self("Relu", self.dense(x, layer))
        return x

    def softmax_mean(self, targets: str, scores: str) -> str:
        """Mean (b, h, e) of the present targets (b, n, e), weighted by softmax of scores (b, h, n); 0 without any."""
        present = self("Unsqueeze", "present", [1])
        weights = self("Softmax", self("Where", present, scores, LOWEST), axis=-1)
        # If all are absent, all have the lowest score, and the softmax is uniform instead of 0.
        return self("MatMul", self("Where", present, weights, 0.0), targets)


class BodyInputs(NamedTuple):
    """Names of the targets' inputs in the agent's frame: state (b, n, n_y), packed information (b, n, p), rotation.

    `rotation` is R (b, d, d), body to world: `vector_body = vector_world @ rotation`.
    """

    mean: str
    information: str
    rotation: str


def body_inputs(graph: Graph, space: Space, state_size: int) -> BodyInputs:
    """Mean and information matrix of every target, rotated into the agent's frame (as `policies.inputs`)."""
    d, order = space.dimension, state_size // space.dimension
    if d == 2:
        yaw = graph("Gather", "pose", [2], axis=1)
        numbers = graph("Concat", graph("Cos", yaw), graph("Sin", yaw), axis=1)
        basis = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]]], float)  # R = cos I + sin J
        pose, position_entries = "pose", [0, 1]
    else:
        pose = numbers = graph("Reshape", "pose", [-1, 16])
        position_entries = [3, 7, 11]
        basis = np.eye(16).reshape(16, 4, 4)[:, :3, :3]
    # R and diag(R, R, ..) are linear in `numbers`, the position in the pose: each is a product with a constant matrix.
    state_basis = np.stack([np.kron(np.eye(order), part).ravel() for part in basis])
    state_rotation = graph("Reshape", graph("MatMul", numbers, state_basis), [-1, 1, state_size, state_size])
    rotation = graph("Reshape", graph("MatMul", numbers, basis.reshape(len(basis), -1)), [-1, d, d])
    to_position = np.zeros((3 if d == 2 else 16, state_size))
    to_position[position_entries, range(d)] = 1.0
    position = graph("Unsqueeze", graph("MatMul", pose, to_position), [1])
    mean = graph("MatMul", graph("Sub", "mean", position), graph("Squeeze", state_rotation, [1]))
    half = graph("MatMul", "information", state_rotation)
    information = graph("MatMul", graph("Transpose", state_rotation, perm=[0, 1, 3, 2]), half)
    return BodyInputs(mean, packed(graph, information, state_size), rotation)


def packed(graph: Graph, information: str, state_size: int) -> str:
    """Pack the lower triangle row by row: (b, n, n_y, n_y) to (b, n, p)."""
    rows, columns = np.tril_indices(state_size)
    flat = graph("Reshape", information, [0, 0, state_size**2])
    return graph("Gather", flat, rows * state_size + columns, axis=2)


def features(graph: Graph, mean: str, information: str, length_m: float, scale: Scale) -> str:
    """Features of each target, from its mean and information; zeros where none is present."""
    scaled = graph("Asinh", information) if scale == "asinh" else information
    return only_present(graph, graph("Concat", graph("Div", mean, length_m), scaled, axis=2))


def only_present(graph: Graph, values: str) -> str:
    """Set values to zero where no target is present."""
    return graph("Where", graph("Unsqueeze", "present", [2]), values, 0.0)


def logarithm(graph: Graph, space: Space) -> str:
    """log(T)^v of the pose, shape (b, n_u), as `Space.log`.

    In the plane [R(-w/2) position / sinc(w/2); w], w the yaw wrapped to (-pi, pi].
    """
    if space.dimension == 3:
        return _spatial_logarithm(graph)
    yaw = graph("Gather", "pose", [2], axis=1)
    turns = graph("Ceil", graph("Div", graph("Sub", yaw, np.pi), 2 * np.pi))
    w = graph("Sub", yaw, graph("Mul", turns, 2 * np.pi))
    half = graph("Mul", w, 0.5)
    cos, sin = graph("Cos", half), graph("Sin", half)
    zero = graph("Equal", half, 0.0)
    sinc = graph("Where", zero, 1.0, graph("Div", sin, graph("Where", zero, 1.0, half)))
    x, y = (graph("Div", graph("Gather", "pose", [i], axis=1), sinc) for i in (0, 1))
    ahead = graph("Add", graph("Mul", cos, x), graph("Mul", sin, y))
    left = graph("Sub", graph("Mul", cos, y), graph("Mul", sin, x))
    return graph("Concat", ahead, left, w, axis=1)


def _quaternion(graph: Graph) -> tuple[str, str]:
    """q_w >= 0 (b, 1) and n (b, 3) of the pose's rotation: the row of 4 q q^T with the largest diagonal, scaled."""
    outer = np.zeros((16, 16))  # maps the 16 numbers of the pose to those of 4 q q^T - I

    def put(place: tuple[int, int], *terms: tuple[int, int, int]) -> None:
        for sign, i, j in terms:
            for row, column in {place, place[::-1]}:
                outer[4 * i + j, 4 * row + column] += sign

    for row, signs in enumerate(((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))):
        put((row, row), *((sign, i, i) for i, sign in enumerate(signs)))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1)), start=1):
        put((0, k), (1, j, i), (-1, i, j))
    for i, j in ((0, 1), (0, 2), (1, 2)):
        put((i + 1, j + 1), (1, i, j), (1, j, i))
    numbers = graph("MatMul", graph("Reshape", "pose", [-1, 16]), outer)
    rows = graph("Reshape", graph("Add", numbers, np.eye(4).ravel()), [-1, 4, 4])
    diagonal = graph("Gather", graph("Reshape", rows, [-1, 16]), [0, 5, 10, 15], axis=1)
    largest = graph("ArgMax", diagonal, axis=1, keepdims=1)
    row = graph("GatherND", rows, largest, batch_dims=1)
    first = graph("Gather", row, [0], axis=1)
    row = graph("Mul", row, graph("Where", graph("Less", first, 0.0), -1.0, 1.0))
    unit = graph("Div", row, graph("Sqrt", graph("ReduceSum", graph("Mul", row, row), [1])))
    return graph("Gather", unit, [0], axis=1), graph("Gather", unit, [1, 2, 3], axis=1)


def _spatial_logarithm(graph: Graph) -> str:
    """[J(w)^-1 position; w]: w = 4 atan(|n| / (1 + q_w)) n / |n|, J^-1 p = p - w x p / 2 + c w x (w x p)."""
    q_w, n = _quaternion(graph)
    sine = graph("Sqrt", graph("ReduceSum", graph("Mul", n, n), [1]))
    tangent = graph("Div", sine, graph("Add", q_w, 1.0))
    tiny = graph("Less", tangent, 1e-6)
    safe = graph("Where", tiny, 1.0, tangent)
    ratio = graph("Where", tiny, 1.0, graph("Div", graph("Atan", safe), safe))
    w = graph("Mul", n, graph("Div", graph("Mul", ratio, 4.0), graph("Add", q_w, 1.0)))
    square = graph("ReduceSum", graph("Mul", w, w), [1])
    small = graph("Less", square, 1.0)
    series = graph.constant(COTANGENT[-1])
    for term in COTANGENT[-2::-1]:
        series = graph("Add", graph("Mul", series, graph("Where", small, square, 0.0)), term)
    angle = graph("Sqrt", graph("Where", small, 1.0, square))
    cotangent = graph("Div", graph("Mul", graph("Mul", angle, 0.5), q_w), graph("Where", small, 1.0, sine))
    closed = graph("Div", graph("Sub", 1.0, cotangent), graph("Where", small, 1.0, square))
    c = graph("Where", small, series, closed)
    position = graph("Gather", graph("Reshape", "pose", [-1, 16]), [3, 7, 11], axis=1)
    once = _cross(graph, w, position)
    twice = _cross(graph, w, once)
    v = graph("Add", graph("Sub", position, graph("Mul", once, 0.5)), graph("Mul", c, twice))
    return graph("Concat", v, w, axis=1)


def _cross(graph: Graph, a: str, b: str) -> str:
    """a x b of rows (b, 3)."""
    (a_1, a_2), (b_1, b_2) = ([graph("Gather", x, order, axis=1) for order in ([1, 2, 0], [2, 0, 1])] for x in (a, b))
    return graph("Sub", graph("Mul", a_1, b_2), graph("Mul", a_2, b_1))
