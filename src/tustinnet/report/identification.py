"""The figure of an identification: parameters in their ranges, correlations of their errors."""

from matplotlib.figure import Figure

from tustinnet.fitting.report import Identification
from tustinnet.report.figures import COLOURS, INPUT, figure_style
from tustinnet.report.fits import position_in_range

_MOST_NAMED = 30  # parameters that all have their names at the matrix
_NAMED = 15  # names at a larger one


def correlation_figure(result: Identification) -> Figure:
    """Figure of the parameters in their ranges with 95 % intervals, and of error correlations."""
    with figure_style():
        estimates = result.estimates
        n = len(estimates)
        figure = Figure(figsize=(9.0, 0.36 * n + 1.6), layout="constrained")
        ranges, correlations = figure.subplots(1, 2, width_ratios=(1, 1.1))
        for i, e in enumerate(estimates):
            ranges.plot([0, 1], [i, i], color="0.85", linewidth=5, solid_capstyle="butt", zorder=1)
            if e.interval:
                low, high = (position_in_range(e, x) for x in e.interval)
                ranges.plot([low, high], [i, i], color=INPUT, linewidth=5, solid_capstyle="butt")
            colour = COLOURS[0] if e.bound else "#111111"
            ranges.plot(position_in_range(e, e.value), i, "o", color=colour, zorder=3)
            if result.refit and e.name in result.refit.values:
                position = position_in_range(e, result.refit.values[e.name])
                ranges.plot(position, i, "x", color="#111111", markersize=7, zorder=3)
        ranges.set_yticks(range(n), [e.name for e in estimates])
        ranges.set_xticks([0, 1], ["lower", "upper"])
        ranges.set_xlim(-0.05, 1.05)
        ranges.set_ylim(n - 0.5, -0.5)
        ranges.grid(visible=False)
        ranges.set_title("value and 95 % interval", loc="left")
        image = correlations.imshow(result.correlation, vmin=-1, vmax=1, cmap="RdBu_r")
        # with many parameters every few have their name, as there is no room for more
        named = range(0, n, 1 if n <= _MOST_NAMED else -(-n // _NAMED))
        correlations.set_xticks(named, [estimates[i].name for i in named], rotation=90)
        correlations.set_yticks(named, [estimates[i].name for i in named])
        correlations.grid(visible=False)
        correlations.set_title("correlation of the errors", loc="left")
        cross = "; cross: in the model" if result.refit else ""
        ranges.set_xlabel(
            f"range, logarithmic where all of it is positive; red: at a bound{cross}", fontsize=8
        )
        correlations.set_xlabel("blank: at a bound of its range", fontsize=8)
        figure.suptitle(result.system.name, fontsize=9)
        figure.colorbar(image, ax=correlations, shrink=0.8)
        return figure
