"""Rules of operations that compute: entry by entry, sums and maxima, and products of matrices.

A rule makes the nodes of one operation, from its inputs. The axes of these are the operation's, and after them there
may be more of size 1 (see `translate`).
"""

import jax
import numpy as np
from onnx import TensorProto

from foveate.deploy.onnx.graph import Graph, Tensor, constant
from foveate.deploy.onnx.shapes import squeeze, unsqueeze
from foveate.deploy.onnx.trace import NoRule, Operation, is_number

TYPES = {"f": TensorProto.FLOAT, "i": TensorProto.INT64, "u": TensorProto.INT64, "b": TensorProto.BOOL}
"""Types of numbers in the graph, by NumPy's letter."""


def atan2(graph: Graph, operation: Operation, y: Tensor, x: Tensor) -> Tensor:
    """The angle of (x, y) from atan(y / x); 0 at the origin."""
    op = graph.elementwise
    # The quotient may be infinite, but not 0 / 0.
    safe = op("Where", op("Equal", x, 0.0), np.finfo(np.float32).tiny, x)
    behind = op("Where", op("Less", y, 0.0), -np.pi, np.pi)
    return op("Add", op("Atan", op("Div", y, safe)), op("Where", op("Less", x, 0.0), behind, 0.0))


def hypot(graph: Graph, operation: Operation, x: Tensor, y: Tensor) -> Tensor:
    """sqrt(x^2 + y^2)."""
    op = graph.elementwise
    return op("Sqrt", op("Add", op("Mul", x, x), op("Mul", y, y)))


def round_(graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """The nearest whole number, of two the even one, as ONNX has it. Raises NoRule for another way of rounding."""
    if operation.parameters["rounding_method"] != jax.lax.RoundingMethod.TO_NEAREST_EVEN:
        raise NoRule("round, away from zero")
    return graph.elementwise("Round", x)


def integer_pow(graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """x^y."""
    y = operation.parameters["y"]
    return graph.elementwise("Mul", x, x) if y == 2 else graph.elementwise("Pow", x, float(y))


def less(graph: Graph, operation: Operation, a: Tensor, b: Tensor) -> Tensor:
    """a < b; known for the place of a maximum or minimum, of which JAX asks whether it counts from the end."""
    if graph.origin(a).kind in ("ArgMax", "ArgMin") and b.constant is not None and not b.constant.any():
        return constant(False)
    return graph.elementwise("Less", a, b)


def larger(graph: Graph, operation: Operation, a: Tensor, b: Tensor) -> Tensor:
    """max(a, b)."""
    for this, other in ((a, b), (b, a)):
        if this.constant is not None and this.shape == () and not this.constant and this.constant.dtype == np.float32:
            return graph.elementwise("Relu", other)
    return graph.elementwise("Max", a, b)


def select_n(graph: Graph, operation: Operation, which: Tensor, no: Tensor, yes: Tensor) -> Tensor:
    """`yes` where `which` holds, else `no`."""
    if which.constant is not None and which.shape == ():
        return yes if which.constant else no
    if operation.outputs[0].dtype == bool:  # which runtimes do not choose from
        op = graph.elementwise
        return op("Or", op("And", which, yes), op("And", op("Not", which), no))
    return graph.elementwise("Where", which, yes, no)


def convert(graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """Numbers of another type."""
    old, new = (np.dtype(each.dtype).kind for each in (operation.inputs[0], operation.outputs[0]))
    if TYPES[old] == TYPES[new]:
        return x
    return graph.elementwise("Cast", x, to=TYPES[new]) if x.constant is None else constant(x.constant.astype(new))


def reduce(kind: str, graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """Sum, maximum or minimum along some axes, by the kind of node."""
    axes, whole, rank = sorted(map(int, operation.parameters["axes"])), list(x.shape), len(operation.inputs[0].shape)
    for axis in axes:
        whole[axis] = operation.inputs[0].shape[axis]
    x = graph.expand(x, tuple(whole))
    order = graph.order([x])
    (x,), order = (graph.unordered([x], order), order) if order else ([x], tuple(range(len(whole))))
    along = sorted(order[axis] for axis in axes)
    attributes = {} if kind == "ReduceSum" or graph.opset >= 18 else {"axes": tuple(along)}
    inputs = [x] if attributes else [x, np.array(along)]
    shape = tuple(1 if axis in along else size for axis, size in enumerate(x.shape))
    result = graph.transpose(graph.node(kind, inputs, shape, keepdims=1, **attributes), order)
    return result if axes == [*range(rank - len(axes), rank)] else squeeze(graph, result, axes)


def extreme(kind: str, graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """Maximum or minimum along some axes, infinite of nothing."""
    free = [axis in operation.parameters["axes"] and not is_number(size) for axis, size in enumerate(x.shape)]
    if any(free):
        # One number more: runtimes do not agree on the maximum of none.
        ends = np.array([0] * len(free) + free, int)
        x = graph.node("Pad", [x, ends, -np.inf if kind == "ReduceMax" else np.inf], x.shape)
    return reduce(kind, graph, operation, x)


def extreme_bool(kind: str, graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """True where all are (the minimum), or one is (the maximum)."""
    number = graph.elementwise("Cast", x, to=TensorProto.FLOAT)
    return graph.elementwise("Greater", extreme(kind, graph, operation, number), 0.0)


def place(kind: str, graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """The place of the first of the largest (ArgMax), or of the smallest (ArgMin), along an axis."""
    axis = int(operation.parameters["axes"][0])
    x = graph.expand(x, operation.inputs[0].shape)
    return graph.node(kind, [x], (*x.shape[:axis], *x.shape[axis + 1 :]), axis=axis, keepdims=0)


def dot_general(graph: Graph, operation: Operation, a: Tensor, b: Tensor) -> Tensor:
    """Products of matrices along one axis of each. Raises NoRule along several."""
    (along, (batch_a, batch_b)) = operation.parameters["dimension_numbers"]
    if [len(each) for each in along] != [1, 1]:
        raise NoRule("dot_general along several axes")
    a, b = graph.expand(a, operation.inputs[0].shape), graph.expand(b, operation.inputs[1].shape)
    rows = [axis for axis in range(len(a.shape)) if axis not in (*along[0], *batch_a)]
    columns = [axis for axis in range(len(b.shape)) if axis not in (*along[1], *batch_b)]
    if not batch_a and len(rows) == 1 and (len(columns) > 1 or a.constant is not None):
        # ONNX multiplies many rows by one matrix on their right.
        product = _matmul(graph, graph.transpose(b, [*columns, *along[1]]), graph.transpose(a, [*along[0], *rows]))
        return graph.transpose(product, [len(columns), *range(len(columns))])
    if len(columns) > 1 or (batch_a and len(rows) > 1):
        raise NoRule("dot_general with several free axes")
    left, right = graph.transpose(a, [*batch_a, *rows, *along[0]]), graph.transpose(b, [*batch_b, *along[1], *columns])
    left = left if rows else unsqueeze(graph, left, [len(batch_a)])
    right = right if columns else unsqueeze(graph, right, [len(right.shape)])
    product = _matmul(graph, left, right)
    return squeeze(graph, product, [len(batch_a)] * (not rows) + [len(product.shape) - 1] * (not columns))


def small_product(graph: Graph, operation: Operation, a: Tensor, b: Tensor) -> Tensor:
    """`geometry.linalg.multiply`, of equal ranks."""
    return _matmul(graph, a, b)


def _matmul(graph: Graph, a: Tensor, b: Tensor) -> Tensor:
    """Products of matrices; none by the unit matrix."""
    for matrix, other in ((a, b), (b, a)):
        if matrix.constant is not None and matrix.constant.size == matrix.shape[-1] ** 2 == matrix.shape[-2] ** 2:
            square = matrix.constant.reshape(matrix.shape[-2:])
            if np.array_equal(square, np.eye(len(square))) and len(other.shape) >= len(matrix.shape):
                return other
    batch = (1,) * (len(a.shape) - len(b.shape)) + b.shape[:-2]
    sizes = tuple(n if m == 1 else m for m, n in zip(a.shape[:-2], batch, strict=True))
    return graph.node("MatMul", [a, b], (*sizes, a.shape[-2], b.shape[-1]))
