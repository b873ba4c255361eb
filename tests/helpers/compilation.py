"""Less compilation in tests that run each program once, on next to nothing."""

import gc
import threading

import pytest
from jax._src.interpreters import mlir
from jax._src.lib.mlir import ir


def compile_least(patch: pytest.MonkeyPatch) -> None:
    """Compile trainings and verdicts with the options of the suite, not with those of real ones."""
    patch.setattr("foveate.learning.loop.PLANAR_COMPILER_OPTIONS", {})
    patch.setattr("foveate.evaluation.held_out.PLANAR_COMPILER_OPTIONS", {})


def time_no_decision(patch: pytest.MonkeyPatch) -> None:
    """Say that decisions take a millisecond: timing one compiles its policy once more."""
    for module in ("evaluation.evaluate", "evaluation.planners", "recordings.replay"):
        patch.setattr(f"foveate.{module}.decision_time", lambda *_, **__: 1e-3)


def share_context() -> None:
    """Lower all programs of a thread in one MLIR context: JAX makes one for each, which costs 4 ms and keeps 1.2 MB.

    But not one that is compiled while another is lowered: in the same context it would be inserted into that one. Nor
    those of two threads, as of a training and of one that was interrupted, whose compilation goes on for a while.
    """
    fresh, own = mlir.make_ir_context, threading.local()

    def make():
        try:
            _ = ir.InsertionPoint.current
        except ValueError:
            if not hasattr(own, "context"):
                own.context = fresh()
            return own.context
        return fresh()

    mlir.make_ir_context = make


def collect_seldom() -> None:
    """Look for garbage less often: tracing makes millions of objects, and nearly all go without being looked for."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)
