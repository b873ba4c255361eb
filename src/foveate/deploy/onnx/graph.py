"""An ONNX graph under construction: equal nodes are made once, and changes of shape that undo each other not at all.

Numbers are float32 or int64. Sizes of axes may be free: the number of decisions b and of targets n, which may be 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from onnx import NodeProto, TensorProto, helper, numpy_helper

from foveate.deploy.onnx.trace import NoRule, Shape, is_number


@dataclass(frozen=True, eq=False)
class Tensor:
    """Name of a node's output, or a constant; of size 1 along an axis along which it is the same everywhere."""

    source: str | np.ndarray
    shape: Shape

    @property
    def constant(self) -> np.ndarray | None:
        """The constant, if it is one."""
        return None if isinstance(self.source, str) else self.source


NEUTRAL = {"Add": 0.0, "Sub": 0.0, "Mul": 1.0, "Div": 1.0, "Max": -np.inf, "Min": np.inf, "And": True, "Or": False}
"""Numbers that these kinds of nodes return the other number with; the second number, of Sub and Div."""


class Origin(NamedTuple):
    """The node that a tensor is the output of."""

    kind: str
    inputs: tuple[Tensor, ...]
    attributes: dict[str, Any]


def constant(value: Any) -> Tensor:
    """A constant: int64 for whole numbers, bool, else float32."""
    array = np.asarray(value)
    kinds = {"i": np.int64, "u": np.int64, "b": np.bool_}
    array = array.astype(kinds.get(array.dtype.kind, np.float32))
    return Tensor(array, array.shape)


class Graph:
    """Nodes and constants for one version of ONNX's operator set."""

    def __init__(self, opset: int) -> None:
        self.opset = opset
        self.nodes: list[NodeProto] = []
        self.constants: list[TensorProto] = []
        self._names: dict[tuple, str] = {}
        self._made: dict[tuple, Tensor] = {}
        self._origins: dict[str, Origin] = {}
        self._holders: dict[Any, tuple[Tensor, int]] = {}

    def input(self, name: str, shape: Shape) -> Tensor:
        """An input of the graph."""
        return self._hold(Tensor(name, shape))

    def node(self, kind: str, inputs: Sequence[Any], shape: Shape, **attributes: Any) -> Tensor:
        """Add a node, unless there is an equal one; inputs that are not tensors become constants."""
        tensors = tuple(each if isinstance(each, Tensor) else constant(each) for each in inputs)
        names = tuple(map(self._name, tensors))
        key = (kind, names, tuple(attributes.items()))
        if key not in self._made:
            output = f"{kind}_{len(self.nodes)}"
            self.nodes.append(helper.make_node(kind, names, [output], name=output, **attributes))
            self._origins[output] = Origin(kind, tensors, attributes)
            self._made[key] = self._hold(Tensor(output, tuple(shape)))
        return self._made[key]

    def origin(self, tensor: Tensor) -> Origin:
        """The node of a tensor; without a kind for an input or a constant."""
        none = Origin("", (), {})
        return self._origins.get(tensor.source, none) if isinstance(tensor.source, str) else none

    def elementwise(self, kind: str, *inputs: Any, **attributes: Any) -> Tensor:
        """Add a node on tensors or numbers whose shapes are broadcast; none where it would change nothing."""
        tensors = [each if isinstance(each, Tensor) else constant(each) for each in inputs]
        if order := self.order(tensors):
            return self.transpose(self.elementwise(kind, *self.unordered(tensors, order), **attributes), order)
        rank = max(len(each.shape) for each in tensors)
        shapes = [(1,) * (rank - len(each.shape)) + each.shape for each in tensors]
        shape = tuple(next((size for size in sizes if size != 1), 1) for sizes in zip(*shapes, strict=True))
        if kind == "Sub" and tensors[0] is tensors[1]:
            return constant(np.zeros((1,) * rank))
        if kind == "Where" and self._is_chosen(tensors):
            return tensors[1]
        if len(tensors) == 2 and kind in NEUTRAL:
            for kept, other in (tensors, tensors[::-1]) if kind not in ("Sub", "Div") else (tensors,):
                if other.constant is not None and (other.constant == NEUTRAL[kind]).all() and kept.shape == shape:
                    return kept
        return self.node(kind, tensors, shape, **attributes)

    def transpose(self, x: Tensor, order: Sequence[int]) -> Tensor:
        """Axes in another order."""
        order = tuple(map(int, order))
        origin = self.origin(x)
        if order == tuple(range(len(order))):
            return x
        if x.constant is not None:
            return constant(x.constant.transpose(order))
        if origin.kind == "Transpose":
            return self.transpose(origin.inputs[0], [origin.attributes["perm"][axis] for axis in order])
        return self.node("Transpose", [x], tuple(x.shape[axis] for axis in order), perm=order)

    def order(self, tensors: Sequence[Tensor]) -> tuple[int, ...] | None:
        """The order into which all these tensors, but the constants, were transposed, if it is the same.

        What is done to all alike can be done before: often the next operation transposes them back.
        """
        orders = {self.origin(each).attributes.get("perm") for each in tensors if each.constant is None}
        (order,) = orders if len(orders) == 1 else (None,)
        fits = order and all(len(each.shape) in (0, len(order)) for each in tensors)
        return order if fits else None

    def unordered(self, tensors: Sequence[Tensor], order: Sequence[int]) -> list[Tensor]:
        """Tensors before they were transposed, and constants to match."""
        back = np.argsort(order).tolist()
        return [
            self.origin(each).inputs[0] if each.constant is None else self.transpose(each, back) if each.shape else each
            for each in tensors
        ]

    def size(self, size: Any, shape: tuple[()] | tuple[int] = (1,)) -> Tensor:
        """A number of decisions or targets. Raises NoRule where no tensor has that size."""
        if size not in self._holders:
            raise NoRule(f"the size {size}")
        holder, axis = self._holders[size]
        sizes = self.node("Shape", [holder], (len(holder.shape),))
        return self.node("Gather", [sizes, np.full(shape, axis)], shape, axis=0)

    def expand(self, tensor: Tensor, shape: Shape) -> Tensor:
        """Repeat a tensor along its axes of size 1, up to `shape`."""
        if tensor.shape == tuple(shape):
            return tensor
        if all(map(is_number, shape)) and tensor.constant is not None:
            return constant(np.broadcast_to(tensor.constant, shape))
        sizes = [np.array([each]) if is_number(each) else self.size(each) for each in shape]
        return self.node("Expand", [tensor, self.node("Concat", sizes, (len(shape),), axis=0)], shape)

    def finish(self, result: Tensor, name: str) -> None:
        """Give the result its name, and drop nodes and constants that it does not need."""
        needed, kept = {self._name(result)}, []
        for node in reversed(self.nodes):
            if node.output[0] in needed:
                needed.update(node.input)
                kept.append(node)
        last = helper.make_node("Identity", [self._name(result)], [name], name=name)
        self.nodes = [*reversed(kept), last]
        self.constants = [each for each in self.constants if each.name in needed]

    def reads(self, name: str) -> bool:
        """True if a node has this input."""
        return any(name in node.input for node in self.nodes)

    def _is_chosen(self, tensors: Sequence[Tensor]) -> bool:
        """True if the second tensor has the third already where the first does not hold."""
        inner = self.origin(tensors[1])
        same = [self._name(inner.inputs[i]) == self._name(tensors[i]) for i in (0, 2) if inner.kind == "Where"]
        return bool(same) and all(same)

    def _name(self, tensor: Tensor) -> str:
        if isinstance(tensor.source, str):
            return tensor.source
        array = tensor.source.copy(order="C")
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._names:
            self._names[key] = f"constant_{len(self.constants)}"
            self.constants.append(numpy_helper.from_array(array, self._names[key]))
        return self._names[key]

    def _hold(self, tensor: Tensor) -> Tensor:
        """Remember where a free size can be read."""
        for axis, size in enumerate(tensor.shape):
            if not is_number(size):
                self._holders.setdefault(size, (tensor, axis))
        return tensor
