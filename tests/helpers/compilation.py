"""Compilation of trainings and verdicts in tests that run them once, on next to nothing."""

import pytest


def compile_least(patch: pytest.MonkeyPatch) -> None:
    """Leave their compiler options to JAX: of the suite, which compiles quickly, and not of real trainings."""
    patch.setattr("foveate.learning.loop.PLANAR_COMPILER_OPTIONS", {})
    patch.setattr("foveate.evaluation.held_out.PLANAR_COMPILER_OPTIONS", {})
