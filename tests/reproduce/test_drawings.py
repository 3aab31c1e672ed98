"""The paper's drawings: what is on them, and that it all lies apart and within."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.path import Path

from tustinnet.report.drawing import write_figure
from tustinnet.reproduce.drawings import architecture_figure, mechanism_figure

both = pytest.mark.parametrize("draw", [mechanism_figure, architecture_figure])


def labels(figure):
    FigureCanvasAgg(figure).draw()  # an extent is known only once it is drawn
    return [text for axes in figure.axes for text in axes.texts if text.get_text()]


@pytest.mark.thorough
@both
@pytest.mark.parametrize("ending", [".png", ".svg"])
def test_drawings_are_written(tmp_path, draw, ending):
    figure = draw()
    assert isinstance(figure, Figure)
    path = tmp_path / f"drawing{ending}"
    write_figure(figure, path.parent, path.name)
    start = b"\x89PNG" if ending == ".png" else b"<?xml"
    assert path.read_bytes().startswith(start)


@pytest.mark.parametrize(
    ("draw", "expected"),
    [
        (
            mechanism_figure,
            [
                r"\theta",
                r"\alpha",
                "L_r",
                "l_p",
                r"\tau(U)",
                "$g$",
                "encoder cable",
                "elastic force on the arm",
                "centre line",
                "upright",
                "motor",
                "arm axis",
            ],
        ),
        (
            architecture_figure,
            [
                r"\sin q_k",
                r"\cos q_k",
                "u_k",
                r"x_k = [",
                r"\phi_1",
                r"\phi_M",
                "W_{M+1}",
                r"\tau_s",
                "z^{-1}",
                r"q_{k+1} = q_k + \tau_s",
                r"\dfrac{v_k + v_{k+1}}{2}",
                "x_{k+1} = [",
                "trapezoidal rule",
            ],
        ),
    ],
)
def test_drawings_name_what_they_show(draw, expected):
    texts = [label.get_text() for label in labels(draw())]
    missing = [wanted for wanted in expected if not any(wanted in text for text in texts)]
    assert not missing


@both
def test_nothing_is_drawn_outside_the_figure(draw):
    figure = draw()
    canvas = figure.bbox
    artists = [a for axes in figure.axes for a in (*axes.lines, *axes.patches)]
    for artist in (*labels(figure), *artists):
        extent = artist.get_window_extent()
        assert canvas.x0 <= extent.x0 <= extent.x1 <= canvas.x1, artist
        assert canvas.y0 <= extent.y0 <= extent.y1 <= canvas.y1, artist


@both
def test_labels_lie_apart(draw):
    for one, other in combinations(labels(draw()), 2):
        assert not one.get_window_extent().overlaps(other.get_window_extent()), (one, other)


@both
def test_no_line_runs_through_a_label(draw):
    figure = draw()
    extents = [label.get_window_extent() for label in labels(figure)]
    lines = [line for a in figure.axes for line in a.lines if line.get_linestyle() != "None"]
    for artist in (*lines, *(patch for axes in figure.axes for patch in axes.patches)):
        path = artist.get_path().transformed(artist.get_transform())
        # piece by piece: the jump from one to the next would count as a line
        for course in map(Path, path.to_polygons(closed_only=False)):
            assert not any(course.intersects_bbox(e, filled=False) for e in extents), artist


def test_boxes_hold_their_texts_and_lie_apart():
    figure = architecture_figure()
    texts = [label.get_window_extent() for label in labels(figure)]
    boxes = [p.get_window_extent() for p in figure.axes[0].patches if isinstance(p, Rectangle)]
    for box, text in ((b, t) for b in boxes for t in texts):
        if box.overlaps(text):
            assert box.x0 < text.x0 < text.x1 < box.x1
            assert box.y0 < text.y0 < text.y1 < box.y1
    for one, other in combinations(boxes, 2):
        shared = np.minimum(one.max, other.max) - np.maximum(one.min, other.min)
        assert shared.min() < 1, "boxes share more than an edge"
