"""Wrong settings: one line that says what is wrong."""

from collections.abc import Callable

import pytest

from foveate.errors import InputError


def assert_rejected(make: Callable[[], object], words: str) -> None:
    """`make` raises InputError, in one line that has these words."""
    with pytest.raises(InputError) as caught:
        make()
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
