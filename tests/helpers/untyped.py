"""Calls with arguments of wrong types, as users make them, who have no checks of annotations."""

from contextlib import contextmanager

import jaxtyping


@contextmanager
def unchecked():
    """Annotations are not checked inside."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)
