"""Count the multiply-adds of a network's dense layers, whatever they are applied to, from its traced program."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

from foveate.scenario.scenes import SceneSettings

PROGRAM = (ClosedJaxpr, Jaxpr)
"""What an equation has for a function, the body of a loop or a branch."""


def multiply_adds(network: Callable[..., Any], *inputs: Any) -> int:
    """Multiply-adds of the products with parameters of `network` in one call: its dense layers, and nothing else.

    Products of two computed arrays, such as attention, are not counted; nor are those of a gradient.
    """
    arrays, static = eqx.partition(network, eqx.is_array)
    traced = jax.make_jaxpr(lambda arrays, *inputs: eqx.combine(arrays, static)(*inputs))(arrays, *inputs)
    parameters = len(jax.tree.leaves(arrays))
    return _count(traced.jaxpr, [i < parameters for i in range(len(traced.jaxpr.invars))])[0]


def per_episode(count: Callable[[int], float], scenes: SceneSettings) -> float:
    """Expected sum over the real steps of an episode of `count`, which takes the number of targets."""
    numbers = range(scenes.targets_min, scenes.targets_max + 1)
    return sum(count(n) * scenes.horizon(n) for n in numbers) / len(numbers)


def _count(jaxpr: Jaxpr, are_parameters: Sequence[bool]) -> tuple[int, list[bool]]:
    """Multiply-adds of a program, and which of its results depend on parameters alone."""
    known = dict(zip(jaxpr.invars, are_parameters, strict=True))
    total = 0

    def of(variable: Any) -> bool:
        return isinstance(variable, Literal) or known.get(variable, False)

    for equation in jaxpr.eqns:
        flags = [of(variable) for variable in equation.invars]
        # A layer may use a part of a weight, or its transpose; a constant alone is no parameter.
        is_derived = all(flags) and any(not isinstance(variable, Literal) for variable in equation.invars)
        results = [is_derived] * len(equation.outvars)
        if equation.primitive.name == "dot_general":
            total += _product(equation) if any(flags) else 0
            results = [False]
        elif inner := [part for part in jax.tree.leaves(list(equation.params.values())) if isinstance(part, PROGRAM)]:
            counts = [_count(*_opened(program, flags)) for program in inner]
            # Of the branches of a condition the dearest.
            total += max(count for count, _ in counts) * equation.params.get("length", 1)
            results = counts[0][1] if len(counts[0][1]) == len(results) else [False] * len(results)
        known.update(zip(equation.outvars, results, strict=True))
    return total, [of(variable) for variable in jaxpr.outvars]


def _opened(program: ClosedJaxpr | Jaxpr, flags: list[bool]) -> tuple[Jaxpr, list[bool]]:
    """A program inside of an equation, and which of its inputs, the last ones of the equation, are parameters."""
    jaxpr = program.jaxpr if isinstance(program, ClosedJaxpr) else program
    return jaxpr, flags[len(flags) - len(jaxpr.invars) :]


def _product(equation: JaxprEqn) -> int:
    """Multiply-adds of a product: entries of the result times the length of the sums."""
    (contracted, _), _ = equation.params["dimension_numbers"]
    factor: Any = equation.invars[0].aval
    result: Any = equation.outvars[0].aval
    return math.prod(result.shape) * math.prod(factor.shape[axis] for axis in contracted)
