"""From the operations of a trace to the nodes of a graph."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from foveate.deploy.onnx import arithmetic, linalg, shapes
from foveate.deploy.onnx.graph import Graph, Tensor, constant
from foveate.deploy.onnx.indexing import drop, gather
from foveate.deploy.onnx.trace import NoRule, Operation, Trace, Value, is_number

Rule = Callable[..., Tensor]

SAME_NAME = (
    *(
        "add",
        "sub",
        "mul",
        "div",
        "max",
        "min",
        "neg",
        "exp",
        "log",
        "tanh",
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
    ),
    *("sqrt", "abs", "sign", "floor", "ceil", "asinh", "erf", "and", "or", "not", "pow"),
)
OTHER_NAME = {"eq": "Equal", "le": "LessOrEqual", "gt": "Greater", "ge": "GreaterOrEqual", "logistic": "Sigmoid"}


def _node(kind: str, **attributes: object) -> Rule:
    """The rule of an operation that is one node."""
    return lambda graph, operation, *x: graph.elementwise(kind, *x, **attributes)


ELEMENTWISE: dict[str, Rule] = {
    **{name: _node(name.capitalize()) for name in SAME_NAME},
    **{name: _node(kind) for name, kind in OTHER_NAME.items()},
    "ne": lambda graph, operation, a, b: graph.elementwise("Not", graph.elementwise("Equal", a, b)),
    "lt": arithmetic.less,
    "max": arithmetic.larger,
    "rem": _node("Mod", fmod=1),
    "square": lambda graph, operation, x: graph.elementwise("Mul", x, x),
    "integer_pow": arithmetic.integer_pow,
    "rsqrt": lambda graph, operation, x: graph.elementwise("Reciprocal", graph.elementwise("Sqrt", x)),
    "log1p": lambda graph, operation, x: graph.elementwise("Log", graph.elementwise("Add", x, 1.0)),
    "is_finite": lambda graph, operation, x: graph.elementwise("Less", graph.elementwise("Abs", x), np.inf),
    "round": arithmetic.round_,
    "atan2": arithmetic.atan2,
    "hypot": arithmetic.hypot,
    "select_n": arithmetic.select_n,
    "convert_element_type": arithmetic.convert,
    "stop_gradient": lambda graph, operation, x: x,
    "copy": lambda graph, operation, x: x,
}


def broadcast_in_dim(graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """New axes; numbers are not repeated before an operation needs them all."""
    rank, places = len(operation.outputs[0].shape), operation.parameters["broadcast_dimensions"]
    new = [axis for axis in range(rank) if axis not in places]
    spare = len(x.shape) - len(operation.inputs[0].shape)
    while spare and new and new[-1] == rank - 1:
        new, rank, spare = new[:-1], rank - 1, spare - 1
    return shapes.unsqueeze(graph, x, new)


def stack(graph: Graph, operation: Operation, *parts: Tensor) -> Tensor:
    """Columns side by side, as a new axis."""
    axis, shape = operation.parameters["axis"], operation.outputs[0].shape
    last = len(shape) - 1
    joined = shapes.concatenate(graph, parts, last, (*shape[:axis], *shape[axis + 1 :], len(parts)))
    return graph.transpose(joined, [*range(axis), last, *range(axis, last)])


def transpose(graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """Axes in another order."""
    order = operation.parameters["permutation"]
    return graph.transpose(x, [*order, *range(len(order), len(x.shape))])


def slice_(graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """A part along every axis, without strides."""
    starts, stops = (operation.parameters[f"{end}_indices"] for end in ("start", "limit"))
    for axis, (size, start, stop) in enumerate(zip(operation.inputs[0].shape, starts, stops, strict=True)):
        if (start, stop) != (0, size):
            x = shapes.cut(graph, x, axis, start, stop)
    return x


def reshape(graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """The same numbers in another shape."""
    return shapes.reshape(graph, graph.expand(x, operation.inputs[0].shape), operation.outputs[0].shape)


def concatenate(graph: Graph, operation: Operation, *parts: Tensor) -> Tensor:
    """Tensors one after the other."""
    axis, whole = operation.parameters["dimension"], []
    for part, value in zip(parts, operation.inputs, strict=True):
        whole.append(graph.expand(part, (*part.shape[:axis], value.shape[axis], *part.shape[axis + 1 :])))
    return shapes.concatenate(graph, whole, axis, operation.outputs[0].shape)


def iota(graph: Graph, operation: Operation) -> Tensor:
    """0, 1, .. along an axis of a free size."""
    shape, axis = operation.parameters["shape"], operation.parameters["dimension"]
    count = constant(shape[axis]) if is_number(shape[axis]) else graph.size(shape[axis], ())
    numbers = graph.node("Range", [0, count, 1], (shape[axis],))
    return shapes.unsqueeze(graph, numbers, [other for other in range(len(shape)) if other != axis])


def of_matrices(function: Callable[[Graph, Tensor], Tensor], graph: Graph, operation: Operation, x: Tensor) -> Tensor:
    """A function of symmetric matrices, the only axes of x whose sizes are not free."""
    shape, result = operation.inputs[0].shape, operation.outputs[0].shape
    order = sorted(range(len(shape)), key=lambda axis: is_number(shape[axis]))
    value = function(graph, graph.transpose(graph.expand(x, shape), order))
    own = iter(range(len(shape) - 2, len(value.shape)))
    free = [shape[axis] for axis in order[:-2]]
    places = [next(own) if is_number(size) else free.index(size) for size in result]
    return graph.transpose(value, [*places, *own])


WITH_SPARE_AXES: dict[str, Rule] = {
    "broadcast_in_dim": broadcast_in_dim,
    "squeeze": lambda graph, operation, x: drop(graph, x, operation.parameters["dimensions"]),
    "transpose": transpose,
    "slice": slice_,
    "reduce_sum": partial(arithmetic.reduce, "ReduceSum"),
    "reduce_max": partial(arithmetic.extreme, "ReduceMax"),
    "reduce_min": partial(arithmetic.extreme, "ReduceMin"),
    "reduce_or": partial(arithmetic.extreme_bool, "ReduceMax"),
    "reduce_and": partial(arithmetic.extreme_bool, "ReduceMin"),
}
PLAIN: dict[str, Rule] = {
    "reshape": reshape,
    "concatenate": concatenate,
    "gather": gather,
    "iota": iota,
    "dim_as_value": lambda graph, operation: graph.size(operation.parameters["dim"], ()),
    "argmax": partial(arithmetic.place, "ArgMax"),
    "argmin": partial(arithmetic.place, "ArgMin"),
    "dot_general": arithmetic.dot_general,
    "small_product": arithmetic.small_product,
    "inverse_spd": partial(of_matrices, linalg.inverse_spd),
    "log_det_spd": partial(of_matrices, linalg.log_det_spd),
}


def translate(graph: Graph, trace: Trace, names: Sequence[str]) -> Tensor:
    """Make the nodes of all operations, from inputs of these names; return the result.

    Tensors may have axes of size 1 after those of the trace: the numbers of a target, (b, n), are the columns (b, n, 1)
    of its features, and need not be reshaped all the time. Raises NoRule for an operation without a rule.
    """
    made = {value: graph.input(name, value.shape) for name, value in zip(names, trace.inputs, strict=True)}

    def tensor(value: Value, spare: int = 0) -> Tensor:
        return _with_spare(graph, known(value), len(value.shape), spare)

    def known(value: Value) -> Tensor:
        if 0 in value.shape:
            return constant(np.zeros([0 if size == 0 else 1 for size in value.shape]))
        return constant(value.constant) if value.is_fixed else made[value]

    for operation in trace.operations:
        name, output, inputs_ = operation.name, operation.outputs[0], operation.inputs
        if 0 in output.shape:
            continue
        if name in ELEMENTWISE:
            spare = _least_work(graph, [(known(each), len(each.shape)) for each in inputs_])
            made[output] = ELEMENTWISE[name](graph, operation, *(tensor(each, spare) for each in inputs_))
        elif name in WITH_SPARE_AXES:
            made[output] = WITH_SPARE_AXES[name](graph, operation, *map(known, inputs_))
        elif name in PLAIN:
            made[output] = PLAIN[name](graph, operation, *map(tensor, inputs_))
        elif name == "stack":
            made[output] = stack(graph, operation, *(tensor(each, 1) for each in inputs_))
        else:
            raise NoRule(name)
        assert len(made[output].shape) >= len(output.shape) or made[output].shape == (), (operation, made[output])
    return graph.expand(tensor(trace.output), trace.output.shape)


def _with_spare(graph: Graph, x: Tensor, rank: int, spare: int) -> Tensor:
    """A tensor with this number of axes of size 1 after its own `rank`."""
    if x.shape == () or len(x.shape) == rank + spare:
        return x
    if len(x.shape) > rank + spare:
        return shapes.squeeze(graph, x, range(rank + spare, len(x.shape)))
    return shapes.unsqueeze(graph, x, range(len(x.shape), rank + spare))


def _least_work(graph: Graph, inputs: Sequence[tuple[Tensor, int]]) -> int:
    """The number of spare axes that needs the fewest new nodes, if all inputs shall have it."""
    counts = {len(x.shape) - rank for x, rank in inputs if x.constant is None}

    def nodes(spare: int) -> int:
        wrong = [(x, rank) for x, rank in inputs if x.constant is None and len(x.shape) != rank + spare]
        return sum(len(x.shape) < rank + spare or not shapes.is_squeezed_free(graph, x) for x, rank in wrong)

    return min(sorted(counts, reverse=True), key=nodes, default=0)
