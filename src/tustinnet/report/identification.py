"""The figure of an identification: parameters in their ranges, correlations of their errors."""

from matplotlib.figure import Figure

from tustinnet.fitting.report import Identification
from tustinnet.report.figures import COLOURS, INPUT, house_style
from tustinnet.report.fits import place


def correlation_figure(result: Identification) -> Figure:
    """Where every parameter stands in its range, with its 95 % interval; error correlations."""
    with house_style():
        estimates = result.estimates
        n = len(estimates)
        figure = Figure(figsize=(9.0, 0.36 * n + 1.6), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.1))
        for i, e in enumerate(estimates):
            left.plot([0, 1], [i, i], color="0.85", linewidth=5, solid_capstyle="butt", zorder=1)
            if e.interval:
                low, high = (place(e, x) for x in e.interval)
                left.plot([low, high], [i, i], color=INPUT, linewidth=5, solid_capstyle="butt")
            left.plot(
                place(e, e.value), i, "o", color=COLOURS[0] if e.bound else "#111111", zorder=3
            )
            if result.refit and e.name in result.refit.values:
                at = place(e, result.refit.values[e.name])
                left.plot(at, i, "x", color="#111111", markersize=7, zorder=3)
        left.set_yticks(range(n), [e.name for e in estimates])
        left.set_xticks([0, 1], ["lower", "upper"])
        left.set_xlim(-0.05, 1.05)
        left.set_ylim(n - 0.5, -0.5)
        left.grid(visible=False)
        left.set_title("value and 95 % interval", loc="left")
        drawn = right.imshow(result.correlation, vmin=-1, vmax=1, cmap="RdBu_r")
        right.set_xticks(range(n), [e.name for e in estimates], rotation=90)
        right.set_yticks(range(n), [e.name for e in estimates])
        right.grid(visible=False)
        right.set_title("correlation of the errors", loc="left")
        cross = "; cross: in the model" if result.refit else ""
        left.set_xlabel(
            f"range, logarithmic where all of it is positive; red: at an end{cross}", fontsize=8
        )
        right.set_xlabel("blank: at an end of its range", fontsize=8)
        figure.suptitle(result.system.name, fontsize=9)
        figure.colorbar(drawn, ax=right, shrink=0.8)
        return figure
