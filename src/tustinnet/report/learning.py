"""Table and figure of a learning curve."""

import math
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from tustinnet.report.tables import Table, norm_words, number
from tustinnet.selection.learning import LearningCurve

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def learning_table(curve: LearningCurve) -> Table:
    """Table of the median and range over the draws, with a row for each number of records."""
    scale = min((p.rmse for p in curve.points if math.isfinite(p.rmse)), default=1.0)

    def cell(values: list[float]) -> str:
        middle, low, high = (
            number(x, scale=scale) if math.isfinite(x) else "none"
            for x in (median(values), min(values), max(values))
        )
        return f"{middle} ({low}..{high})"

    rows = [
        [str(size), *[cell(curve.by_draw(approach, size)) for approach in curve.approaches]]
        for size in curve.sizes
    ]
    draws, counts = len(curve.scored), sorted(set(curve.scored))
    title = (
        f"Free-run RMSE [{curve.unit}], start '{curve.start}', of {' or '.join(map(str, counts))} "
        f"record{'s' * (counts != [1])} left out; median (range) of {draws} draws"
        f"{norm_words(curve.unit)}"
    )
    return Table(["records", *curve.approaches], rows, title=title)


def learning_figure(curve: LearningCurve) -> "Figure":
    """Figure of the RMSE of records left out against the number of records used."""
    # the table of this module is printed before matplotlib is loaded
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter

    from tustinnet.report.drawing import COLOURS, figure_style

    with figure_style():
        figure = Figure(figsize=(6.0, 3.8), layout="constrained")
        axes = figure.subplots()
        for i, approach in enumerate(curve.approaches):
            rmse = np.array([curve.by_draw(approach, size) for size in curve.sizes])
            is_finite = np.isfinite(rmse)
            high = np.where(is_finite, rmse, -np.inf).max(axis=1)  # -inf where no draw has a model
            # the lines of approaches are apart, so that their bars do not cover
            x = np.array(curve.sizes) * 1.03 ** (i - (len(curve.approaches) - 1) / 2)
            colour = COLOURS[i % len(COLOURS)]
            middle, has_model = np.median(rmse, axis=1), np.isfinite(high)
            middle = np.where(np.isfinite(middle), middle, np.nan)
            axes.plot(x, middle, "o-", color=colour, markersize=4, label=approach)
            low = rmse.min(axis=1)
            axes.vlines(x[has_model], low[has_model], high[has_model], colour, linewidth=0.9)
            for draw, shown in zip(rmse.T, is_finite.T, strict=True):
                axes.plot(x[shown], draw[shown], ".", color=colour, markersize=3, alpha=0.5)
        axes.set_xscale("log", base=2)
        if any(math.isfinite(p.rmse) for p in curve.points):
            axes.set_yscale("log")
            # of a decade; a curve often spans less than one
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 4, 6)))
            axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.set_xticks(curve.sizes, list(map(str, curve.sizes)))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_minor_locator(NullLocator())
        axes.set_xlabel("records used")
        axes.set_ylabel(f"RMSE of records left out [{curve.unit}]")
        axes.set_title(f"Median and range of {len(curve.scored)} draws", loc="left")
        axes.legend()
        return figure
