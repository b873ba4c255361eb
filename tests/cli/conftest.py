"""Trainings of these tests are of an iteration or two."""

import pytest
from helpers.compilation import compile_least


@pytest.fixture(autouse=True, scope="module")
def compiled_least():
    with pytest.MonkeyPatch.context() as patch:
        compile_least(patch)
        yield
