"""Nodes that move numbers and do not change them: the order of axes, parts, and their joining."""

from collections.abc import Iterable, Sequence

import numpy as np

from foveate.deploy.onnx.graph import Graph, Origin, Tensor, constant
from foveate.deploy.onnx.trace import Shape, is_number


def unsqueeze(graph: Graph, x: Tensor, axes: Iterable[int]) -> Tensor:
    """New axes of size 1, at these places of the result."""
    if not (axes := sorted(map(int, axes))):
        return x
    if x.constant is not None:
        return constant(np.expand_dims(x.constant, tuple(axes)))
    origin, sizes = graph.origin(x), list(x.shape)
    for axis in axes:
        sizes.insert(axis, 1)
    shape = tuple(sizes)
    if origin.kind == "Transpose" and axes[0] >= len(x.shape):
        order = (*origin.attributes["perm"], *axes)
        return graph.transpose(unsqueeze(graph, origin.inputs[0], axes), order)
    if origin.kind == "Squeeze" and np.asarray(origin.inputs[1].source).tolist() == axes:
        return origin.inputs[0]
    if _is_reduced(origin, axes, keepdims=0):
        return graph.node(origin.kind, origin.inputs, shape, **origin.attributes | {"keepdims": 1})
    return graph.node("Unsqueeze", [x, np.array(axes)], shape)


def squeeze(graph: Graph, x: Tensor, axes: Iterable[int]) -> Tensor:
    """Without these axes, of size 1."""
    if not (axes := sorted(map(int, axes))):
        return x
    if x.constant is not None:
        return constant(np.squeeze(x.constant, tuple(axes)))
    origin, shape = graph.origin(x), tuple(size for axis, size in enumerate(x.shape) if axis not in axes)
    if origin.kind == "Unsqueeze" and np.asarray(origin.inputs[1].source).tolist() == axes:
        return origin.inputs[0]
    if _is_reduced(origin, axes, keepdims=1):
        return graph.node(origin.kind, origin.inputs, shape, **origin.attributes | {"keepdims": 0})
    if origin.kind == "Gather" and axes == [origin.attributes["axis"]] and origin.inputs[1].shape == (1,):
        return graph.node("Gather", [origin.inputs[0], origin.inputs[1].source[0]], shape, axis=axes[0])
    return graph.node("Squeeze", [x, np.array(axes)], shape)


def is_squeezed_free(graph: Graph, x: Tensor) -> bool:
    """True if `squeeze` makes no node of its own, but another one."""
    return graph.origin(x).kind in ("Gather", "Unsqueeze", "ReduceSum", "ReduceMax", "ReduceMin")


def cut(graph: Graph, x: Tensor, axis: int, start: int, stop: int) -> Tensor:
    """Entries start .. stop - 1 along an axis."""
    if x.shape[axis] == 1 or (start, stop) == (0, x.shape[axis]):
        return x
    if x.constant is not None:
        return constant(np.take(x.constant, range(start, stop), axis))
    origin, place = graph.origin(x), 0
    for part in origin.inputs if origin.kind == "Concat" and origin.attributes["axis"] == axis else ():
        if not is_number(part.shape[axis]):
            break
        if place <= start and stop <= place + part.shape[axis]:
            return cut(graph, part, axis, start - place, stop - place)
        place += part.shape[axis]
    shape = (*x.shape[:axis], stop - start, *x.shape[axis + 1 :])
    if stop - start == 1:
        return graph.node("Gather", [x, np.array([start])], shape, axis=axis)
    return graph.node("Slice", [x, *(np.array([each]) for each in (start, stop, axis))], shape)


def reshape(graph: Graph, x: Tensor, shape: Shape) -> Tensor:
    """The same numbers in another shape, with at most one free size that x does not have at the same place."""
    if [size for size in x.shape if size != 1] == [size for size in shape if size != 1]:
        x = squeeze(graph, x, [axis for axis, size in enumerate(x.shape) if size == 1])
        return unsqueeze(graph, x, [axis for axis, size in enumerate(shape) if size == 1])
    if x.constant is not None and all(map(is_number, shape)):
        return constant(x.constant.reshape(shape))
    sizes = [
        size if is_number(size) else 0 if axis < len(x.shape) and x.shape[axis] == size else -1
        for axis, size in enumerate(shape)
    ]
    return graph.node("Reshape", [x, np.array(sizes)], shape)


def concatenate(graph: Graph, parts: Sequence[Tensor], axis: int, shape: Shape) -> Tensor:
    """Tensors one after the other along an axis, where they are together as long as `shape` is."""
    parts = [part for part in parts if part.shape[axis] != 0]
    if len(parts) == 1:
        return parts[0]
    if order := graph.order(parts):
        back = [int(place) for place in np.argsort(order)]
        joined = concatenate(graph, graph.unordered(parts, order), order[axis], tuple(shape[place] for place in back))
        return graph.transpose(joined, order)
    common = [next((part.shape[i] for part in parts if part.shape[i] != 1), 1) for i in range(len(shape))]
    whole = [graph.expand(part, (*common[:axis], part.shape[axis], *common[axis + 1 :])) for part in parts]
    return graph.node("Concat", whole, (*common[:axis], shape[axis], *common[axis + 1 :]), axis=axis)


def _is_reduced(origin: Origin, axes: Sequence[int], keepdims: int) -> bool:
    """True for a sum or a maximum along these axes."""
    if origin.attributes.get("keepdims") != keepdims or not origin.kind.startswith("Reduce"):
        return False
    own = origin.attributes["axes"] if "axes" in origin.attributes else origin.inputs[1].source
    return list(own) == list(axes)
