"""The figure of an identification: parameters in their ranges, correlations of their errors."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from tustinnet.fitting.report import Identification
from tustinnet.report.drawing import COLOURS, INPUT, figure_style
from tustinnet.report.fits import position_in_range

MOST_DRAWN = 30  # parameters that have room for their names
_FEWEST_DRAWN = 10  # where no correlation is strong
_STRONG = 0.5  # correlation that is worth a place among many
_WIDTH = 9.0  # in
_ROW_HEIGHT, _MANY_ROW, _TOP_AND_BOTTOM = (
    0.36,
    0.24,
    1.6,
)  # in: height of a parameter, of one of many


def correlation_figure(result: Identification) -> Figure:
    """Figure of parameters in their ranges with 95 % intervals, and of error correlations.

    Of many parameters those with the most correlated errors are drawn, alike ones together, and
    those at a bound.
    """
    drawn = choose_parameters(result)
    is_part = len(drawn) < len(result.estimates)
    estimates = [result.estimates[i] for i in drawn]
    n = len(estimates)
    with figure_style():
        height = (_MANY_ROW if is_part else _ROW_HEIGHT) * n + _TOP_AND_BOTTOM
        size = 7 if is_part else None
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        # of many, a row of the matrix is beside the range of its parameter, which has the name
        ratios = (1, 1.6) if is_part else (1, 1.1)
        ranges, correlations = figure.subplots(1, 2, width_ratios=ratios, sharey=is_part)
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
        names = [e.name for e in estimates]
        ranges.set_yticks(range(n), names, fontsize=size)
        ranges.set_xticks([0, 1], ["lower", "upper"])
        ranges.set_xlim(-0.05, 1.05)
        ranges.set_ylim(n - 0.5, -0.5)
        ranges.grid(visible=False)
        ranges.set_title("value and 95 % interval", loc="left")
        matrix = result.correlation[np.ix_(drawn, drawn)]
        aspect = "auto" if is_part else "equal"
        image = correlations.imshow(matrix, vmin=-1, vmax=1, cmap="RdBu_r", aspect=aspect)
        correlations.set_xticks(range(n), names, rotation=90, fontsize=size)
        if not is_part:
            correlations.set_yticks(range(n), names, fontsize=size)
        correlations.grid(visible=False)
        correlations.set_title("correlation of the errors", loc="left")
        cross = "; cross: in the model" if result.refit else ""
        legend = f"range, logarithmic where all of it is positive; red: at a bound{cross}"
        ranges.set_xlabel(legend.replace("; ", ";\n") if is_part else legend, fontsize=8)
        correlations.set_xlabel("blank: at a bound of its range", fontsize=8)
        title = result.system.name
        if is_part:
            title += (
                f": {n} of {len(result.estimates)} parameters, those with the most correlated "
                "errors and those at a bound"
            )
        figure.suptitle(title, fontsize=9)
        figure.colorbar(image, ax=correlations, shrink=0.8)
        return figure


def choose_parameters(result: Identification) -> Sequence[int]:
    """Indices of the parameters to draw, all where they are few.

    Of many those whose errors are most correlated with that of another, in the order of a
    clustering by correlation, and then those at a bound.
    """
    n = len(result.estimates)
    if n <= MOST_DRAWN:
        return range(n)
    size = np.nan_to_num(np.abs(result.correlation))
    np.fill_diagonal(size, 0.0)
    strongest = size.max(axis=1)
    at_bound = [i for i, e in enumerate(result.estimates) if e.bound]
    room = max(MOST_DRAWN - len(at_bound), _FEWEST_DRAWN)
    order = [int(i) for i in np.argsort(-strongest, kind="stable") if i not in at_bound]
    count = sum(strongest[i] >= _STRONG for i in order)
    chosen = sorted(order[: min(room, max(count, _FEWEST_DRAWN))])
    return [*_cluster(chosen, size), *at_bound[: MOST_DRAWN - _FEWEST_DRAWN]]


def _cluster(chosen: Sequence[int], size: np.ndarray) -> list[int]:
    """Some parameters in the order of a clustering by the sizes of their correlations."""
    if len(chosen) < 3:
        return list(chosen)
    # loading takes time that few figures need
    from scipy.cluster.hierarchy import leaves_list, linkage
    from scipy.spatial.distance import squareform

    distance = 1.0 - np.clip(size[np.ix_(chosen, chosen)], 0.0, 1.0)
    np.fill_diagonal(distance, 0.0)
    distance = (distance + distance.T) / 2
    leaves = leaves_list(linkage(squareform(distance), "average", optimal_ordering=True))
    return [chosen[i] for i in leaves]
