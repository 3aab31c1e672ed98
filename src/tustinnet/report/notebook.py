"""Records and results as notebooks show them: tables of HTML, frames, pictures."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import asdict, fields
from functools import singledispatch
from html import escape
from io import BytesIO
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tustinnet.channels import Channels
from tustinnet.data.dataset import DataSet
from tustinnet.data.drafting.draft import Draft
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.reference import evaluate, find_reference_if_possible
from tustinnet.evaluate.scores import Score
from tustinnet.finding import Finding
from tustinnet.fitting.report import FitResult, Identification
from tustinnet.fitting.roles import records_without_test
from tustinnet.report.drawing import COLOURS, INPUT, MEASURED, figure_style, plot_line
from tustinnet.report.fits import parameter_table
from tustinnet.report.selection import candidates_frame, candidates_table
from tustinnet.report.tables import Table, number
from tustinnet.selection.choice import Choice
from tustinnet.selection.cross_validation import CrossValidationResult
from tustinnet.simulate.horizon import effective_horizon

_MOST_DRAWN = len(COLOURS)  # records of a set that one picture tells apart
_TRIVIAL = "standing still or constant speed"  # heading of the reference
_STYLES = ("-", "--", ":", "-.")  # of the inputs of a record among others
_PANEL_SIZE = (6.0, 1.3)  # inches


# --- tables ---


@singledispatch
def to_html(shown: Any) -> str:
    """An object as HTML, as a notebook shows it: by default its frame."""
    return to_frame(shown)._repr_html_()


@to_html.register
def _(shown: Experiment) -> str:
    return _record_table([shown], shown.name).html() + _picture(shown)


@to_html.register
def _(shown: DataSet) -> str:
    caption = f"{shown[0].name}, the first of {len(shown)} records"
    figure = f"<figure>{_picture(shown[0])}<figcaption>{escape(caption)}</figcaption></figure>"
    return _record_table(list(shown), shown.name).html() + figure


@to_html.register
def _(shown: Identification) -> str:
    return parameter_table(shown).html() + _sentences(shown.findings)


@to_html.register
def _(shown: FitResult) -> str:
    horizon = "–" if shown.horizon is None else f"{shown.horizon:.3g} s"
    errors = [number(x) for x in (shown.validation_rmse, _reference_rmse(shown))]
    rows = [[shown.recipe.name, str(shown.seed), *errors, horizon, shown.outcome]]
    rmse = f"validation RMSE [{shown.model.channels.unit}]"
    columns = ["recipe", "seed", rmse, _TRIVIAL, "horizon", "outcome", "seconds"]
    table = Table(columns, [[*rows[0], f"{shown.seconds:.1f}"]], f"start '{shown.start}'").html()
    if shown.identification is not None:
        return table + to_html(shown.identification)
    return table + _sentences(shown.findings)


@to_html.register
def _(shown: Draft) -> str:
    columns = ["column", "use", "unit", "because"]
    rows = [[c.name, c.use or "–", c.unit, c.because] for c in shown.columns]
    return Table(columns, rows).html() + f"<pre>{escape(shown.text)}</pre>"


@to_html.register
def _(shown: Choice) -> str:
    return candidates_table(shown).html() + _sentences(shown.findings)


def _record_table(records: Sequence[Experiment], title: str) -> Table:
    rows = [[e.name, e.split or "", str(len(e)), f"{e.seconds:.4g}"] for e in records]
    channels = records[0].channels
    names = [f"{c.name} [{c.unit}]" for c in (*channels.coordinates, *channels.inputs)]
    title = f"{title}: {', '.join(names)}, {1e3 * channels.dt:.4g} ms a sample"
    return Table(["record", "split", "samples", "seconds"], rows, title)


def _reference_rmse(shown: FitResult) -> float | None:
    """Mean RMSE of a trivial predictor over the free runs of the validation records of a fit."""
    if shown.roles is None or shown.validation_rmse is None:
        return None
    records = shown.roles.with_long_validation(shown.fewest_samples).validation
    reference = find_reference_if_possible(records, effective_horizon(shown.horizon, records))
    return None if reference is None else reference.mean


def _sentences(findings: Sequence[Finding]) -> str:
    return Table(["findings"], [[f.text] for f in findings]).html() if findings else ""


def _picture(e: Experiment) -> str:
    """A record as a picture in HTML."""
    with figure_style():
        count = _count_panels(e.channels)
        figure = Figure(
            figsize=(_PANEL_SIZE[0], _PANEL_SIZE[1] * count + 0.4), layout="constrained"
        )
        plot(e, figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
        buffer = BytesIO()
        FigureCanvasAgg(figure).print_png(buffer)
    content = b64encode(buffer.getvalue()).decode()
    return f'<img alt="the record {escape(e.name)}" src="data:image/png;base64,{content}">'


# --- frames ---


@singledispatch
def to_frame(shown: Any) -> pl.DataFrame:
    """An object as a frame."""
    raise NotImplementedError(type(shown).__name__)


@to_frame.register
def _(shown: Experiment) -> pl.DataFrame:
    names = [c.name for c in shown.coordinates]
    columns = {"time": shown.t} | dict(zip(names, shown.q.T, strict=True))
    if shown.v is not None:
        columns |= {f"der_{name}": v for name, v in zip(names, shown.v.T, strict=True)}
    columns |= {i.name: u for i, u in zip(shown.inputs, shown.u.T, strict=True)}
    return pl.DataFrame(columns)


@to_frame.register
def _(shown: DataSet) -> pl.DataFrame:
    frames = [
        to_frame(e).with_columns(record=pl.lit(e.name), split=pl.lit(e.split, pl.String))
        for e in shown
    ]
    return pl.concat(frames, how="diagonal")


@to_frame.register
def _(shown: Identification) -> pl.DataFrame:
    rows = [asdict(estimate) for estimate in shown.estimates]
    refitted = shown.refit.values if shown.refit else {}  # whose errors are not known
    for row in rows:
        row["in_model"] = refitted.get(row["name"], row["value"])
        row["interval_lower"], row["interval_upper"] = row.pop("interval") or (None, None)
    return pl.DataFrame(rows, infer_schema_length=None)


@to_frame.register
def _(shown: FitResult) -> pl.DataFrame:
    if shown.identification is not None:
        return to_frame(shown.identification)
    names = ["seed", "start", "horizon", "validation_rmse", "outcome", "seconds"]
    row = {"recipe": shown.recipe.name} | {n: getattr(shown, n) for n in names}
    return pl.DataFrame([row | {"reference": _reference_rmse(shown)}])


@to_frame.register
def _(shown: Score) -> pl.DataFrame:
    names = [f.name for f in fields(shown) if f.name not in ("simulated", "record")]
    return pl.DataFrame([{n: getattr(shown, n) for n in names}])


@to_frame.register
def _(shown: Draft) -> pl.DataFrame:
    names = ["name", "use", "unit", "role", "because", "margin"]
    return pl.DataFrame([{n: getattr(c, n) for n in names} for c in shown.columns])


@to_frame.register
def _(shown: CrossValidationResult) -> pl.DataFrame:
    rows = [
        {"record": s.record, "fold": s.fold, "seed": s.seed, "start": start, "rmse": rmse}
        for s in shown.scores
        for start, rmse in s.rmse.items()
    ]
    return pl.DataFrame(rows)


@to_frame.register
def _(shown: Choice) -> pl.DataFrame:
    return candidates_frame(shown)


# --- pictures ---


@singledispatch
def plot(shown: Any, axes: Any = None) -> np.ndarray:
    """Draws an object, see `Plotted.plot`."""
    raise NotImplementedError(type(shown).__name__)


@plot.register
def _(shown: Experiment, axes: Any = None) -> np.ndarray:
    return _draw([shown], axes)


@plot.register
def _(shown: DataSet, axes: Any = None) -> np.ndarray:
    panels = _draw(list(shown)[:_MOST_DRAWN], axes)
    if len(shown) > _MOST_DRAWN:
        panels[0].set_title(f"the first {_MOST_DRAWN} of {len(shown)} records", fontsize=9)
    return panels


@plot.register
def _(shown: Score, axes: Any = None) -> np.ndarray:
    if shown.record is None:
        raise InputError("plot", f"a score of '{shown.experiment}' alone", "a score of `evaluate`")
    panels = plot(shown.record, axes)
    t = shown.record.t - shown.record.t[0]
    for j in range(shown.record.channels.n_q):
        plot_line(panels[j], t, shown.simulated[:, j], color=COLOURS[0], label="free run")
    panels[0].legend(fontsize=7)
    return panels


@plot.register
def _(shown: FitResult, axes: Any = None) -> np.ndarray:
    if shown.roles is None:
        raise InputError("plot", "a fit within a selection", "a fit that has its records")
    record = shown.roles.with_long_validation(shown.fewest_samples).ranking[0]
    return plot(evaluate(shown.model, record, shown.start, horizon=shown.horizon)[0], axes)


@plot.register
def _(shown: Choice, axes: Any = None) -> np.ndarray:
    record = records_without_test(shown.context.data)[0]
    return plot(evaluate(shown.model, record, shown.start, horizon=shown.horizon)[0], axes)


def _draw(records: Sequence[Experiment], axes: Any) -> np.ndarray:
    """Draws records over one another, a panel for each coordinate, and one for the inputs."""
    channels = records[0].channels
    count = _count_panels(channels)
    panels = np.atleast_1d(np.asarray(_make_panels(count) if axes is None else axes, object))
    if panels.shape != (count,):
        raise InputError("plot", f"axes of shape {panels.shape}", f"{count} axes, one a panel")
    several, inputs = len(records) > 1, [f"{i.name} [{i.unit}]" for i in channels.inputs]
    for k, e in enumerate(records):
        t = e.t - e.t[0]
        for j, c in enumerate(channels.coordinates):
            colour = COLOURS[k] if several else MEASURED
            plot_line(panels[j], t, e.q[:, j], color=colour, label=e.name)
            panels[j].set_ylabel(f"{c.name} [{c.unit}]")
        for j, name in enumerate(inputs):
            colour = COLOURS[k] if several else (INPUT, *COLOURS)[j % 6]
            style = _STYLES[j % len(_STYLES)] if several else "-"
            label = "_" if k else name  # a style is once in the legend
            plot_line(panels[-1], t, e.u[:, j], color=colour, ls=style, label=label, lw=0.7)
    if len(inputs) > 1:
        panels[-1].legend(fontsize=7)
    if inputs:
        panels[-1].set_ylabel("inputs" if len(inputs) > 1 else inputs[0])
    panels[-1].set_xlabel("time [s]")
    if several:
        panels[0].legend(fontsize=7)
    return panels


def _make_panels(count: int) -> Sequence[Axes]:
    """Panels of a new figure that a notebook or a window shows."""
    from matplotlib import pyplot  # chooses how figures are shown: only where one is asked for

    with figure_style():
        size = (_PANEL_SIZE[0], _PANEL_SIZE[1] * count + 0.6)
        _, axes = pyplot.subplots(count, 1, sharex=True, figsize=size, layout="constrained")
    return axes


def _count_panels(channels: Channels) -> int:
    return channels.n_q + bool(channels.inputs)
