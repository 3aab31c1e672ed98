"""Learning curves: a table and a figure."""

import math
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from tustinnet.report.tables import Table, number
from tustinnet.selection.learning import LearningCurve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TICKS = (1, 1.5, 2, 3, 4, 6)  # of a decade; a curve often spans less than one
_APART = 1.03  # factor between the lines of two approaches, so that their bars do not cover


def learning_table(curve: LearningCurve) -> Table:
    """Median over the draws and their range, a row for each number of records."""
    finite = [p.rmse for p in curve.points if math.isfinite(p.rmse)]
    scale = min(finite, default=1.0)

    def told(values: list[float]) -> str:
        middle, low, high = (
            number(x, scale=scale) if math.isfinite(x) else "none"
            for x in (median(values), min(values), max(values))
        )
        return f"{middle} ({low}..{high})"

    rows = [
        [str(size), *[told(curve.by_draw(approach, size)) for approach in curve.approaches]]
        for size in curve.sizes
    ]
    draws, left = len(curve.scored), sorted(set(curve.scored))
    title = (
        f"Free-run RMSE [{curve.unit}], start '{curve.start}', of {' or '.join(map(str, left))} "
        f"records left out; median (range) of {draws} draws"
    )
    return Table(["records", *curve.approaches], rows, title=title)


def learning_figure(curve: LearningCurve) -> "Figure":
    """RMSE of records left out against the number of records: medians, ranges, every draw."""
    # the table of this module is printed before matplotlib is loaded
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter

    from tustinnet.report.figures import COLOURS, house_style

    with house_style():
        figure = Figure(figsize=(6.0, 3.8), layout="constrained")
        axes = figure.subplots()
        for i, approach in enumerate(curve.approaches):
            each = np.array([curve.by_draw(approach, size) for size in curve.sizes])
            known = np.isfinite(each)
            high = np.where(known, each, -np.inf).max(axis=1)  # -inf where no draw has a model
            at = np.array(curve.sizes) * _APART ** (i - (len(curve.approaches) - 1) / 2)
            colour = COLOURS[i % len(COLOURS)]
            middle, found = np.median(each, axis=1), np.isfinite(high)
            middle = np.where(np.isfinite(middle), middle, np.nan)
            axes.plot(at, middle, "o-", color=colour, markersize=4, label=approach)
            axes.vlines(at[found], each.min(axis=1)[found], high[found], colour, linewidth=0.9)
            for draw, sound in zip(each.T, known.T, strict=True):
                axes.plot(at[sound], draw[sound], ".", color=colour, markersize=3, alpha=0.5)
        axes.set_xscale("log", base=2)
        if any(math.isfinite(p.rmse) for p in curve.points):
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=_TICKS))
            axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.set_xticks(curve.sizes, list(map(str, curve.sizes)))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_minor_locator(NullLocator())
        axes.set_xlabel("records that anything was made from")
        axes.set_ylabel(f"RMSE of records left out [{curve.unit}]")
        axes.set_title(f"Median and range of {len(curve.scored)} draws", loc="left")
        axes.legend()
        return figure
