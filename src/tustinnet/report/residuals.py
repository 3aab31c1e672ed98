"""Figure of residuals, and table of down-weighted stretches."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tustinnet.channels import Channels
from tustinnet.evaluate.residuals import LAG_CONFIDENCE, ResidualReport
from tustinnet.fitting.report import Stretch
from tustinnet.report.tables import Table, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BAND = "#2e8b57"


def residual_figure(reports: Sequence[ResidualReport], channels: Channels, title: str) -> "Figure":
    """Figure of autocorrelations and correlations with the inputs, a row for each coordinate.

    The 99 % bounds are shaded.

    Args:
        reports: results of `residual_reports`.
        channels: inputs and period.
        title: a line above.
    """
    # the table of this module is printed before matplotlib is loaded
    from matplotlib.figure import Figure

    from tustinnet.report.drawing import figure_style

    dt = channels.dt
    with figure_style():
        crossed = len(reports[0].cross)
        columns = 1 + crossed
        figure = Figure(figsize=(3.6 * columns, 2.1 * len(reports) + 0.8), layout="constrained")
        panels = figure.subplots(len(reports), columns, squeeze=False)
        for row, report in zip(panels, reports, strict=True):
            lags = len(report.autocorrelation) - 1
            _stems(row[0], np.arange(lags + 1) * dt, report.autocorrelation, report.white_bound)
            row[0].set_ylabel(f"{report.coordinate}\nRMS {report.rms:.3g}")
            for k in range(crossed):
                times = np.arange(-lags, lags + 1) * dt
                _stems(row[1 + k], times, report.cross[k], float(report.cross_bound[k]))
        panels[0][0].set_title("autocorrelation", loc="left")
        for k in range(crossed):
            panels[0][1 + k].set_title(f"correlation with {channels.inputs[k].name}", loc="left")
        for axes in panels[-1]:
            axes.set_xlabel("lag [s]")
        shaded = f"shaded: {100 * LAG_CONFIDENCE:.0f} % of the lags of residuals with nothing left"
        figure.suptitle(f"{title}; {shaded}", fontsize=8)
        return figure


def residual_table(reports: Sequence[ResidualReport], channels: Channels) -> Table:
    """Table of size, whiteness and correlation with the inputs, a row for each coordinate."""
    rows = [
        [
            r.coordinate,
            number(r.rms),
            number(r.mean),
            number(float(r.autocorrelation[1])),
            number(r.white_bound),
            f"{100 * r.outside:.0f} %",
            *[f"{100 * share:.0f} %" for share in r.cross_outside],
        ]
        for r in reports
    ]
    crossed = [f"outside, {i.name}" for i in channels.inputs[: len(reports[0].cross)]]
    columns = ["coordinate", "RMS", "mean", "lag 1", "99 % bound", "outside, own", *crossed]
    return Table(columns, rows, title="Residuals of the free runs")


def downweighted_table(stretches: Sequence[Stretch]) -> Table:
    """Table of the stretches that weighed less than half in a robust identification."""
    rows = [[s.record, f"{s.begin:.5g}", f"{s.end:.5g}", f"{s.weight:.2g}"] for s in stretches]
    return Table(
        ["record", "from [s]", "to [s]", "weight"], rows, title="Down-weighted in identification"
    )


def _stems(axes: "Axes", times: np.ndarray, values: np.ndarray, bound: float) -> None:
    from tustinnet.report.drawing import COLOURS, INPUT

    axes.axhspan(-bound, bound, color=_BAND, alpha=0.2)
    axes.axhline(0, color="0.5", linewidth=0.6)
    outside = np.abs(values) > bound
    colours = np.where(outside, COLOURS[0], INPUT)
    axes.vlines(times, 0, values, colors=colours.tolist(), linewidth=1.2)
    reach = max(float(np.abs(values).max()), bound) * 1.1
    axes.set_ylim(-reach if values.min() < 0 else -0.15 * reach, reach)
