"""Less compilation in tests that run each program once, on next to nothing."""

import pytest


def compile_least(patch: pytest.MonkeyPatch) -> None:
    """Compile trainings and verdicts with the options of the suite, not with those of real ones."""
    patch.setattr("foveate.learning.loop.PLANAR_COMPILER_OPTIONS", {})
    patch.setattr("foveate.evaluation.held_out.PLANAR_COMPILER_OPTIONS", {})


def time_no_decision(patch: pytest.MonkeyPatch) -> None:
    """Say that decisions take a millisecond: timing one compiles its policy once more."""
    for module in ("evaluation.evaluate", "evaluation.planners", "recordings.replay"):
        patch.setattr(f"foveate.{module}.decision_time", lambda *_, **__: 1e-3)
