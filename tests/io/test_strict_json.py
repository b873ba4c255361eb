"""What Python's JSON parser takes beyond JSON is rejected; all else is what the parser of Python makes of it."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foveate.errors import InputError
from foveate.io.strict_json import MAX_DEPTH, parse_json

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=100, deadline=None)
@given(value=VALUES)
def test_json_is_read_as_python_does(value):
    assert parse_json(json.dumps(value)) == value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"a": 1, "b": {"digest": "x", "digest": null}}', "the key 'digest' is given twice"),
        ("[NaN]", "NaN is not JSON"),
        ('{"a": -Infinity}', "-Infinity is not JSON"),
        ("1e999", "the number 1e999 is too large"),
        ("9" * 5000, "is too large"),
        ("[" * (MAX_DEPTH + 2) + "]" * (MAX_DEPTH + 2), "lists and objects in one another"),
        ('{"a":' * 990 + "1" + "}" * 990, "lists and objects in one another"),
        ("[" * 200_000, "lists and objects in one another"),
    ],
)
def test_what_is_not_strict_is_one_short_line(text, words):
    with pytest.raises(InputError, match=words) as caught:
        parse_json(text)
    assert len(str(caught.value)) < 200


def test_the_deepest_that_is_read():
    text = "[" * MAX_DEPTH + "1" + "]" * MAX_DEPTH
    assert parse_json(text) == json.loads(text)
