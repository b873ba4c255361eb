"""Grouping: the standard library's groupby of sorted items as oracle."""

import itertools

from foveate.io.grouping import group_by


def test_groups_equal_groupby_of_sorted_items():
    words = ["pear", "fig", "plum", "apple", "kiwi", "nut", "grape"]
    groups = group_by(words, len)
    assert groups == {size: list(group) for size, group in itertools.groupby(sorted(words, key=len), len)}
    assert list(groups) == [4, 3, 5]
    assert group_by([], len) == {}
