"""The rule of `lax.gather`, which is what JAX makes of indexing: parts at fixed places, and rows chosen by an index."""

from collections.abc import Sequence

from foveate.deploy.onnx.graph import Graph, Tensor, constant
from foveate.deploy.onnx.shapes import cut, reshape, squeeze, unsqueeze
from foveate.deploy.onnx.trace import NoRule, Operation


def gather(graph: Graph, operation: Operation, x: Tensor, indices: Tensor) -> Tensor:
    """Nodes of `lax.gather`, with indices within bounds. Raises NoRule for what no policy has needed."""
    numbers, sizes = operation.parameters["dimension_numbers"], operation.parameters["slice_sizes"]
    offsets = [int(axis) for axis in numbers.offset_dims]
    shape, collapsed = operation.inputs[0].shape, list(map(int, numbers.collapsed_slice_dims))
    # An index along an axis that is taken whole can only be 0.
    places = [(i, int(axis)) for i, axis in enumerate(numbers.start_index_map) if sizes[axis] != shape[axis]]
    last, axes = len(indices.shape) - 1, [axis for _, axis in places]
    if indices.constant is not None and last == 0:
        for i, axis in places:
            start = int(indices.constant[i])
            x = cut(graph, x, axis, start, start + sizes[axis])
        return drop(graph, x, collapsed)
    chosen = [squeeze(graph, cut(graph, indices, last, i, i + 1), [last]) for i, _ in places]
    if len(axes) == 2 and collapsed == axes == [axes[0], axes[0] + 1] and indices.constant is not None:
        # Two indices of a matrix are one of its numbers row by row.
        x = reshape(graph, x, (*x.shape[: axes[0]], shape[axes[0]] * shape[axes[1]], *x.shape[axes[1] + 1 :]))
        chosen = [constant(shape[axes[1]] * chosen[0].source + chosen[1].source)]
        axes = collapsed = axes[:1]
    if len(axes) != 1 or sizes[axes[0]] != 1:
        raise NoRule("gather along several axes")
    (index,), (axis,) = chosen, axes
    if numbers.operand_batching_dims:
        if (axis, *numbers.operand_batching_dims, *numbers.start_indices_batching_dims) != (1, 0, 0):
            raise NoRule("gather in another order of axes")
        result = _each_its_own(graph, operation, x, index)
    else:
        result = graph.node("Gather", [x, index], (*x.shape[:axis], *index.shape, *x.shape[axis + 1 :]), axis=axis)
        result = graph.transpose(result, _order(offsets, len(result.shape), axis, len(index.shape)))
    gone = [each for each in (*collapsed, *numbers.operand_batching_dims) if each < axis]
    return result if axis in collapsed else unsqueeze(graph, result, [offsets[axis - len(gone)]])


def drop(graph: Graph, x: Tensor, axes: Sequence[int]) -> Tensor:
    """Without these axes of size 1, except for the last ones: those a tensor keeps until an operation minds them."""
    rank = len(x.shape)
    while rank - 1 in axes:
        rank -= 1
    return squeeze(graph, x, [axis for axis in axes if axis < rank])


def _each_its_own(graph: Graph, operation: Operation, x: Tensor, index: Tensor) -> Tensor:
    """Row `index[b, ..]` of every `x[b]`."""
    x, index = graph.expand(x, operation.inputs[0].shape), unsqueeze(graph, index, [len(index.shape)])
    return graph.node("GatherND", [x, index], (*index.shape[:-1], *x.shape[2:]), batch_dims=1)


def _order(offset_dims: Sequence[int], rank: int, axis: int, indices: int) -> list[int]:
    """Where the axes of the result are in x with `axis` replaced by those of the index."""
    own = iter([i for i in range(rank) if not axis <= i < axis + indices])
    by_index = iter(range(axis, axis + indices))
    return [next(own) if i in offset_dims else next(by_index) for i in range(rank)]
