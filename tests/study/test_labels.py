"""Labels of points: by the boxes that matplotlib draws, none covers another label or a point."""

import itertools

import numpy as np
from matplotlib.text import Annotation

from foveate.io.figures import new_figure
from foveate.study.labels import place_labels


def drawn(points, names, levels=()):
    """Boxes of the labels and of the points, in pixels."""
    figure = new_figure(4.0, 4.0)
    axes = figure.subplots()
    axes.plot(*np.transpose(points), "o", ms=6)
    figure.draw_without_rendering()
    place_labels(axes, [(*point, name) for point, name in zip(points, names, strict=True)], levels)
    figure.draw_without_rendering()
    texts = [each for each in axes.texts if isinstance(each, Annotation)]
    boxes = {text.get_text(): super(Annotation, text).get_window_extent() for text in texts}
    return axes, boxes


def test_a_label_stands_beside_its_point():
    axes, boxes = drawn([(0.0, 0.0), (5.0, 5.0)], ["one", "two"])
    for (x, y), name in (((0.0, 0.0), "one"), ((5.0, 5.0), "two")):
        px, py = axes.transData.transform((x, y))
        assert boxes[name].x0 - px < 0.2 * axes.get_figure().dpi
        assert boxes[name].y0 < py < boxes[name].y1


def test_labels_of_a_cluster_cover_neither_each_other_nor_the_points():
    rng = np.random.default_rng(1)
    points = [(0.0, 0.0), (10.0, 10.0), *(5.0 + rng.uniform(-0.5, 0.5, (6, 2)))]
    names = [f"method-{i}" for i in range(8)]
    axes, boxes = drawn(points, names)
    for one, other in itertools.combinations(boxes.values(), 2):
        assert not one.overlaps(other)
    for point in axes.transData.transform(points):
        assert not any(box.contains(*point) for box in boxes.values())


def test_a_label_keeps_clear_of_a_line():
    points = [(0.0, 0.0), (5.0, 5.0), (10.0, 10.0)]
    axes, boxes = drawn(points, ["a", "on-the-line", "c"], levels=[5.0])
    y = axes.transData.transform((0.0, 5.0))[1]
    assert not boxes["on-the-line"].y0 < y < boxes["on-the-line"].y1


def test_nothing_to_label():
    axes = new_figure(3.0, 3.0).subplots()
    place_labels(axes, [])
    assert not axes.texts
