"""Figure of a drafted card: every column of a record, and what it was taken for."""

import textwrap

import numpy as np
from matplotlib.figure import Figure

from tustinnet.data.drafting.draft import Draft, DraftColumn
from tustinnet.report.drawing import COLOURS, INPUT, MEASURED, figure_style, plot_line

_COLOURS = {
    "time": COLOURS[4],
    "coordinate": MEASURED,
    "velocity": COLOURS[2],
    "input": INPUT,
    "set point": COLOURS[1],
}
_UNUSED = "#8f8f8f"
_COLUMNS = 2
_LINES = 3  # of a title


def draft_figure(draft: Draft) -> Figure:
    """Figure of every column over time for a typical record, with the reasons for its role."""
    piece = draft.typical
    # thirty columns are drawn, those of the card first
    drawn = sorted(draft.columns, key=lambda c: not c.use)[:30]
    drawn = [column for column in draft.columns if column in drawn]
    rows = -(-len(drawn) // _COLUMNS)
    with figure_style():
        height = 1.75 * rows + 0.9
        figure = Figure(figsize=(11.0, height))
        figure.subplots_adjust(0.07, 0.5 / height, 0.99, 1 - 0.7 / height, hspace=0.55, wspace=0.15)
        panels = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True)
        for axes, column in zip(panels.ravel(), drawn, strict=False):
            values = piece.column(column.name)
            is_shown = column.use or column.role == "set point"
            colour = _COLOURS[column.use or column.role] if is_shown else _UNUSED
            style = "steps-post" if column.use == "input" and column.numbers.levels else "default"
            finite = np.where(np.isfinite(values), values, np.nan)
            plot_line(axes, piece.t, finite, color=colour, linewidth=0.9, drawstyle=style)
            # a given height spares a layout of the ticks
            axes.set_title(_title(column), loc="left", y=1.0, fontsize=7.5, color=colour)
            axes.tick_params(labelsize=7)
            axes.yaxis.set_major_formatter("{x:.5g}")  # without a factor above the axes
        for axes in panels.ravel()[len(drawn) :]:
            axes.set_axis_off()
        for axes in panels.ravel()[: len(drawn)][-_COLUMNS:]:
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
        place = piece.log.place
        rows_text = "" if piece.whole else f", rows {piece.rows[0]} to {piece.rows[1]}"
        more = len(draft.columns) - len(drawn)
        left_out = f"; {more} more columns are not drawn" if more else ""
        title = f"{place}{rows_text}: what each column was taken for{left_out}"
        figure.suptitle(title, y=1 - 0.1 / height, va="top", fontsize=9)
        return figure


def _title(column: DraftColumn) -> str:
    """Name, use, unit and reasons of a column on a few lines."""
    unit = f" [{column.unit}]" if column.unit else ""
    text = f"{column.name}: {column.use or 'not used'}{unit}; {column.because}"
    lines = textwrap.wrap(text, 92)
    return "\n".join(lines[:_LINES]) + (" ..." if len(lines) > _LINES else "")
