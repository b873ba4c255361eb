"""A JAX function as a list of operations: calls opened, constants computed, nothing that the result does not need."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal, Primitive, jaxpr_as_fun

Shape = tuple[Any, ...]
"""Sizes of axes: whole numbers, and symbols where a size is free."""

Kept = Mapping[str, Callable[[Sequence[Shape], Sequence[Shape]], bool]]
"""Names of functions that become one operation, where their arguments and results have certain shapes."""


class NoRule(Exception):
    """Something that has no equivalent in a graph; it is named by the message."""


@dataclass(eq=False)
class Value:
    """A value of the trace; `is_fixed` if it is the same for all inputs, and then its number is `constant`."""

    shape: Shape
    dtype: Any
    is_fixed: bool = False
    constant: np.ndarray | None = None


class Operation(NamedTuple):
    """One primitive, or one call of a function that was kept whole, by name."""

    name: str
    primitive: Primitive
    parameters: dict[str, Any]
    inputs: list[Value]
    outputs: list[Value]


class Trace(NamedTuple):
    """Operations in the order of their use."""

    inputs: list[Value]
    operations: list[Operation]
    output: Value


def is_number(size: Any) -> bool:
    """True for a size that is not free."""
    return isinstance(size, int | np.integer)


def trace(function: Callable, shapes: Sequence[jax.ShapeDtypeStruct], kept: Kept) -> Trace:
    """Trace a function of arrays, some of whose sizes may be symbols (`jax.export.symbolic_shape`), with one result.

    Raises NoRule for random numbers.
    """
    checked = jaxtyping.config.jaxtyping_disable
    # Runtime checks of shapes, where somebody has turned them on, know no symbols.
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        closed = jax.make_jaxpr(function)(*shapes)
    finally:
        jaxtyping.config.update("jaxtyping_disable", checked)
    inputs = [Value(tuple(each.shape), each.dtype) for each in shapes]
    operations: list[Operation] = []
    (output,) = _open(closed, inputs, kept, operations)
    used, needed = [], {output}
    for operation in reversed(operations):
        if not needed.isdisjoint(operation.outputs):
            needed.update(operation.inputs)
            used.append(operation)
    used.reverse()
    if any(operation.name.startswith("random_") for operation in used):
        raise NoRule("random numbers")
    _compute([operation for operation in used if operation.outputs[0].is_fixed])
    return Trace(inputs, [operation for operation in used if not operation.outputs[0].is_fixed], output)


def _open(closed: ClosedJaxpr, arguments: Sequence[Value], kept: Kept, operations: list[Operation]) -> list[Value]:
    """Append the operations of a jaxpr, and of all that it calls; return its results."""
    values = dict(zip(closed.jaxpr.invars, arguments, strict=True))
    for variable, constant in zip(closed.jaxpr.constvars, closed.consts, strict=True):
        values[variable] = _fixed(constant)
    for equation in closed.jaxpr.eqns:
        inputs = [
            _fixed(atom.val, atom.aval) if isinstance(atom, Literal) else values[atom] for atom in equation.invars
        ]
        name, called = _called(equation.primitive.name, equation.params, inputs)
        is_fixed = all(each.is_fixed for each in inputs)
        avals = [variable.aval for variable in equation.outvars]
        is_kept = name in kept and kept[name]([each.shape for each in inputs], [tuple(aval.shape) for aval in avals])
        if called is not None and (is_fixed or not is_kept):
            outputs = _open(called, inputs[len(inputs) - len(called.jaxpr.invars) :], kept, operations)
        else:
            is_fixed = is_fixed and all(is_number(size) for aval in avals for size in aval.shape)
            is_fixed = is_fixed and name != "dim_as_value"  # the number of decisions or of targets
            outputs = [Value(tuple(aval.shape), aval.dtype, is_fixed) for aval in avals]
            operations.append(Operation(name, equation.primitive, equation.params, inputs, outputs))
        values.update(zip(equation.outvars, outputs, strict=True))
    return [_fixed(atom.val, atom.aval) if isinstance(atom, Literal) else values[atom] for atom in closed.jaxpr.outvars]


def _called(primitive: str, parameters: dict[str, Any], inputs: Sequence[Value]) -> tuple[str, ClosedJaxpr | None]:
    """Name of an operation, and the jaxpr that it calls, if it calls one."""
    if primitive == "cond" and "branches_platforms" in parameters:
        # Variants of one computation for different machines: the one for all others.
        return primitive, parameters["branches"][parameters["branches_platforms"].index(None)]
    if primitive == "scan":
        return primitive, _unrolled(parameters, inputs)
    called = parameters.get("jaxpr", parameters.get("call_jaxpr"))
    return (primitive, None) if called is None else (parameters.get("name", called.jaxpr.debug_info.func_name), called)


def _unrolled(parameters: dict[str, Any], inputs: Sequence[Value]) -> ClosedJaxpr:
    """The jaxpr of a loop whose steps follow each other, without a loop. Raises NoRule for a loop backwards."""
    if parameters["reverse"]:
        raise NoRule("a scan backwards")
    constants, carried = parameters["num_consts"], parameters["num_carry"]
    body = jaxpr_as_fun(parameters["jaxpr"])

    def loop(*arguments):
        fixed, carry, each = (
            arguments[:constants],
            list(arguments[constants:][:carried]),
            arguments[constants + carried :],
        )
        kept = []
        for step in range(parameters["length"]):
            results = body(*fixed, *carry, *(jax.lax.index_in_dim(x, step, keepdims=False) for x in each))
            carry = results[:carried]
            kept.append(results[carried:])
        return [*carry, *(jnp.stack(results) for results in zip(*kept, strict=True))]

    return jax.make_jaxpr(loop)(*(jax.ShapeDtypeStruct(each.shape, each.dtype) for each in inputs))


def _fixed(constant: Any, aval: Any = None) -> Value:
    array = np.asarray(constant, None if aval is None else aval.dtype) if not _is_key(constant) else constant
    return Value(tuple(array.shape), array.dtype, True, array)


def _is_key(constant: Any) -> bool:
    return jnp.issubdtype(getattr(constant, "dtype", np.float32), jax.dtypes.prng_key)


def _compute(operations: Sequence[Operation]) -> None:
    """Compute the constants of these operations, in one compiled program."""

    def all_outputs() -> list[list[Any]]:
        known: dict[Value, Any] = {}
        for operation in operations:
            inputs = [known.get(each, each.constant) for each in operation.inputs]
            results = operation.primitive.bind(*inputs, **operation.parameters)
            results = results if operation.primitive.multiple_results else [results]
            known.update(zip(operation.outputs, results, strict=True))
        return [[known[each] for each in operation.outputs] for operation in operations]

    for operation, results in zip(operations, jax.jit(all_outputs)(), strict=True):
        for value, result in zip(operation.outputs, results, strict=True):
            value.constant = np.asarray(result)
