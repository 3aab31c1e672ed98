"""Figures of records, free runs and trainings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from tustinnet.channels import Channels
from tustinnet.check.report import ExperimentReport
from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.bands import Band
from tustinnet.evaluate.scores import Score
from tustinnet.fitting.inverse_dynamics.record_forces import RecordForces
from tustinnet.report.drawing import COLOURS, INPUT, LONG_LINE, MEASURED, figure_style, plot_line
from tustinnet.report.page.signals import bounded
from tustinnet.report.tables import amounts
from tustinnet.simulate.horizon import horizon_words
from tustinnet.wording import percent

_DASHES = ("-.", "--", ":", (0, (6, 1, 1, 1, 1, 1)), "--")
_LEGEND_WIDTH = 118  # characters of a legend that fit below a figure, 7 of a column for its line
_PANEL, _PANEL_WITH_ERROR = 1.9, 3.1  # in: height for a coordinate


def free_run_figure(
    experiment: Experiment,
    runs: Mapping[str, Score],
    styles: Mapping[str, tuple[str, object]] | None = None,
    recorded: str = "measured",
    bands: Mapping[str, Band] | None = None,
) -> Figure:
    """Figure of measured and simulated positions of one record, with a panel for each coordinate.

    Where lines cover each other, further panels show the errors: of long records, of which only the
    extremes are drawn, of free runs over a horizon, and where every error is small.

    Args:
        experiment: the record.
        runs: scores of the free runs by label.
        styles: colour and line style by label.
        recorded: label of the record's own line.
        bands: bands around the free runs by label.
    """
    e, is_long = experiment, len(experiment) > LONG_LINE
    n_q = e.channels.n_q
    horizon = next((score.horizon for score in runs.values()), None)
    nrmse = np.array([score.nrmse for score in runs.values()])
    # below this NRMSE the lines of measured and simulated positions are one
    has_errors = is_long or horizon is not None or bool(np.nanmax(nrmse, initial=0.0) < 0.1)
    # below the positions of three coordinates errors would make the figure too high
    is_beside = has_errors and n_q >= 3
    columns, rows_each = (2, 1) if is_beside else (1, 2 if has_errors else 1)
    height = _PANEL if is_beside else _PANEL_WITH_ERROR if has_errors else _PANEL
    with figure_style():
        figure = Figure(
            figsize=(11.0 if is_beside else 7.0, height * n_q + 0.5), layout="constrained"
        )
        panels = figure.subplots(
            rows_each * n_q,
            columns,
            sharex=True,
            squeeze=False,
            height_ratios=(5, 3) * n_q if rows_each == 2 else None,
        )
        position_panels = panels[::rows_each, 0]
        error_panels: Any = panels[:, 1] if is_beside else panels[1::2, 0]
        t = e.t - e.t[0]
        for j, (axes, coordinate) in enumerate(zip(position_panels, e.coordinates, strict=True)):
            plot_line(axes, t, e.q[:, j], color=MEASURED, label=recorded, linewidth=1.4)
            for i, (label, score) in enumerate(runs.items()):
                colour, dash = (styles or {}).get(
                    label, (COLOURS[i % len(COLOURS)], _DASHES[i % len(_DASHES)])
                )
                legend = f"{label} (RMSE {amounts(score.rmse_by_unit(e.channels))})"
                line = bounded(score.simulated[:, j], e.q[:, j])
                if (band := (bands or {}).get(label)) is not None:
                    _draw_band(axes, t, band, j, e, colour)
                if is_long:
                    plot_line(axes, t, line, color=colour, label=legend, linewidth=0.7, alpha=0.8)
                else:
                    axes.plot(t, line, color=colour, linestyle=dash, label=legend)
                if has_errors:
                    error = line - e.q[:, j]
                    plot_line(error_panels[j], t, error, color=colour, linewidth=0.7, alpha=0.8)
            axes.set_ylabel(f"{coordinate.name} [{coordinate.unit}]")
            if has_errors:
                error_panels[j].set_ylabel(f"error [{coordinate.unit}]")
        figure.align_ylabels()
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        starts = sorted({score.start for score in runs.values()})
        title = f"{e.name}: free run, start '{', '.join(starts)}'{horizon_words(horizon)}"
        position_panels[0].set_title(title, loc="left")
        if is_beside:
            error_panels[0].set_title("simulated less measured", loc="left")
        handles, labels = position_panels[0].get_legend_handles_labels()
        # as many columns as the figure's width has room for
        legend_columns = max(1, min(len(labels), 3, _LEGEND_WIDTH // (max(map(len, labels)) + 7)))
        figure.legend(handles, labels, loc="outside lower center", ncols=legend_columns, fontsize=8)
        return figure


def _draw_band(
    axes: Axes, t: Float[np.ndarray, " n"], band: Band, j: int, e: Experiment, colour: str
) -> None:
    """Draws the band of coordinate `j`, from where the free run begins."""
    after = slice(band.prediction.first, None)
    low, high = (bounded(end[after, j], e.q[after, j]) for end in (band.low, band.high))
    label = f"{100 * band.level:g} % of {'the time' if band.scope == 'time' else 'whole records'}"
    axes.fill_between(t[after], low, high, color=colour, alpha=0.2, linewidth=0, label=label)


def training_figure(histories: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Figure of loss, validation RMSE and learning rate against epochs, with the kept epoch marked.

    Args:
        histories: the lines of each training log, by name of the training.
    """
    with figure_style():
        figure = Figure(figsize=(7.0, 5.2), layout="constrained")
        panels = figure.subplots(3, 1, sharex=True, height_ratios=(2, 2, 1))
        quantities = {"loss": "training loss", "validation": "validation RMSE", "rate": "rate"}
        for axes, (key, label) in zip(panels, quantities.items(), strict=True):
            for i, (name, lines) in enumerate(histories.items()):
                values = np.array([e[key] for e in lines], dtype=float)  # None becomes NaN
                colour = COLOURS[i % len(COLOURS)]
                epochs = np.arange(1, len(values) + 1)
                axes.plot(epochs, values, color=colour, linewidth=0.9, label=name)
                kept_epoch = _find_kept_epoch(lines)
                kept = kept_epoch + 1, values[kept_epoch]
                axes.plot(*kept, "o", color=colour, markersize=5, clip_on=False)
            axes.set_ylabel(label)
            y = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.lines])
            y = y[np.isfinite(y)]
            # values that differ by a smaller factor are drawn on a linear axis
            if y.size and y.min() > 0 and y.max() > 3 * y.min():
                axes.set_yscale("log")
                axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
                axes.yaxis.set_minor_formatter(NullFormatter())
            for begin in _find_stage_begins(next(iter(histories.values()))):
                axes.axvline(begin + 0.5, color="0.6", linewidth=0.8, linestyle=":")
        panels[-1].set_xlabel("epoch (all stages)")
        if len(histories) > 1:
            panels[0].legend(ncols=5, loc="upper right")
        return figure


def _find_kept_epoch(lines: Sequence[Mapping[str, Any]]) -> int:
    """Index of the line at which the last stage's best score was last improved."""
    begin = max(_find_stage_begins(lines), default=0)
    best = [np.inf, *(np.inf if e["best"] is None else e["best"] for e in lines[begin:])]
    improvements = [k for k in range(1, len(best)) if best[k] < best[k - 1]]
    return begin + (improvements[-1] - 1 if improvements else 0)


def _find_stage_begins(lines: Sequence[Mapping[str, Any]]) -> list[int]:
    return [k for k in range(1, len(lines)) if lines[k]["stage"] != lines[k - 1]["stage"]]


def ahead_figure(
    errors: Mapping[str, Float[np.ndarray, "horizon n_units"]], channels: Channels
) -> Figure:
    """Figure of the k-step-ahead RMSE against the horizon, with a panel for each unit.

    Args:
        errors: RMSE by number of steps and unit, by label.
        channels: sampling period and units.
    """
    n = len(channels.units)
    with figure_style():
        figure = Figure(figsize=(5.0, 3.2 if n == 1 else 2.3 * n + 0.5), layout="constrained")
        panels = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
        for k, (axes, unit) in enumerate(zip(panels, channels.units, strict=True)):
            for i, (label, rmse) in enumerate(errors.items()):
                t = np.arange(1, len(rmse) + 1) * channels.dt
                axes.plot(t, rmse[:, k], color=COLOURS[i % len(COLOURS)], label=label)
            axes.set_ylabel(f"k-step-ahead RMSE [{unit}]")
            axes.set_ylim(bottom=0)
        panels[-1].set_xlabel("horizon [s]")
        panels[0].legend()
        return figure


def forces_figure(forces: RecordForces) -> Figure:
    """Figure of the forces of actuators and of those that a record's motion needs by a model.

    Args:
        forces: the forces.
    """
    n, t = len(forces.coordinates), forces.t
    with figure_style():
        figure = Figure(figsize=(7.0, _PANEL * n + 0.5), layout="constrained")
        panels = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
        lines = (
            ("actuators", forces.applied, MEASURED),
            ("needed by the model", forces.needed, COLOURS[0]),
            ("missing", forces.missing, COLOURS[-1]),
        )
        for k, (axes, error) in enumerate(zip(panels, forces.errors, strict=True)):
            for label, values, colour in lines:
                plot_line(axes, t, values[:, k], color=colour, label=label)
            axes.set_ylabel(f"{error.coordinate} [{error.unit}]")
            axes.set_title(f"missing {percent(error.share, 3)} %", loc="right")
        title = f"{forces.record}: forces up to {forces.cutoff:.3g} Hz"
        panels[0].set_title(title, loc="left")
        panels[-1].set_xlabel("time [s]")
        figure.align_ylabels()
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(lines), fontsize=8)
        return figure


def inspection_figure(
    experiments: Sequence[Experiment], reports: Sequence[ExperimentReport]
) -> Figure:
    """Figure of every record: positions with `k_bar` marked, and the inputs if there are any."""
    with figure_style():
        first = experiments[0]
        columns = len(first.coordinates) + (1 if first.inputs else 0)
        figure = Figure(
            figsize=(3.2 * columns + 0.6, 1.15 * len(experiments) + 0.7), layout="constrained"
        )
        panels = figure.subplots(len(experiments), columns, squeeze=False)
        for row, (e, report) in enumerate(zip(experiments, reports, strict=True)):
            t = e.t - e.t[0]
            for j, coordinate in enumerate(e.coordinates):
                axes = panels[row, j]
                plot_line(axes, t, e.q[:, j], color=MEASURED, linewidth=0.8)
                if report.k_bar < len(e):
                    resting = report.coordinates[j].resting
                    reach = report.coordinates[j].excursion_threshold
                    axes.axhspan(resting - reach, resting + reach, color="#2e8b57", alpha=0.18)
                    axes.axvline(t[report.k_bar], color=COLOURS[0], linewidth=0.9)
                for begin, end in report.recording.gaps:
                    axes.axvspan(begin - e.t[0], end - e.t[0], color=COLOURS[1], alpha=0.5)
                if row == 0:
                    axes.set_title(f"{coordinate.name} [{coordinate.unit}]", fontsize=9)
            for i, channel in enumerate(e.inputs):
                panels[row, -1].plot(
                    t,
                    e.u[:, i],
                    linewidth=0.6,
                    color=(INPUT, *COLOURS)[i % 6],
                    label=channel.name,
                    drawstyle="steps-post" if channel.hold in (None, "zero-order") else "default",
                )
            panels[row, 0].set_ylabel(e.name, rotation=0, ha="right", va="center", fontsize=8)
        if first.inputs:
            units = ", ".join(dict.fromkeys(c.unit for c in first.inputs))
            panels[0, -1].set_title(f"inputs [{units}]")
            panels[0, -1].legend(fontsize=7, loc="upper right", frameon=True, framealpha=0.8)
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        if any(report.k_bar < len(e) for e, report in zip(experiments, reports, strict=True)):
            figure.suptitle(
                "red: k_bar, the end of the transient; green: excursions that count as rest",
                fontsize=8,
            )
        return figure
