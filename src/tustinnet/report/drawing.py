"""Style, colours and files of all figures, and lines of many samples."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tustinnet.report.page.signals import find_extremes
from tustinnet.store.files import FIGURE_ENDINGS, require_outputs, write_into

MEASURED = "#111111"
INPUT = "#5b7fa6"
COLOURS = ("#c0392b", "#e08e0b", "#2e8b57", "#7d3c98", "#5d6d7e")
_BINS = 1200  # fewest along a line of a figure, more than it has pixels
LONG_LINE = 4 * _BINS  # samples; of a longer line only the extremes are drawn
_DOTS = 150  # an inch
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.titlesize": 9,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "svg.hashsalt": "tustinnet",
    "text.parse_math": False,  # a name with $ is a name
    "text.usetex": False,  # nor does it reach LaTeX, whatever a `matplotlibrc` says
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Style of all figures, within the context; matplotlib's settings outside stay as they are."""
    with mpl.rc_context(cast(Any, _STYLE)):
        yield


def write_figure(figure: Figure, folder: Path, name: str) -> None:
    """Writes a figure into a folder, in the format of its ending, completely or not at all.

    Raises:
        InputError: another ending than .png, .svg or .pdf, or the file cannot be written.
    """
    require_outputs([folder / name], overwrite=True, endings=FIGURE_ENDINGS)
    buffer, ending = BytesIO(), Path(name).suffix[1:].lower()
    if ending == "png":
        figure.set_dpi(_DOTS)
        FigureCanvasAgg(figure).print_png(buffer)  # `savefig` draws twice, to lay out first
    else:
        # the bytes say nothing of when they were written, and are the same each time
        metadata = {"Date" if ending == "svg" else "CreationDate": None}
        with figure_style():
            figure.savefig(buffer, format=ending, dpi=_DOTS, metadata=metadata)
    write_into(folder, name, buffer.getvalue())


def plot_line(
    axes: Axes, t: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], **style: Any
) -> None:
    """Draws a line; of a long one only extremes of intervals narrower than a pixel of a PNG."""
    if len(y) > LONG_LINE:
        samples = find_extremes(y[:, None], len(y) // _BINS)
        t, y = t[samples], y[samples]
    axes.plot(t, y, **style)
