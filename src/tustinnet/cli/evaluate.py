"""`tustinnet evaluate`: score a model on records."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal
from tustinnet.cli.files import list_input_files, require_figures
from tustinnet.cli.free_runs import (
    FreeRunRequest,
    choose_free_runs,
    compute_bands,
    make_band_options,
)
from tustinnet.cli.models import load_model
from tustinnet.cli.records import load_records

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from jaxtyping import Float
    from matplotlib.figure import Figure

    from tustinnet.channels import Channels
    from tustinnet.data.experiment import Experiment
    from tustinnet.evaluate.bands import Band, BandOptions
    from tustinnet.evaluate.coverage import Coverage
    from tustinnet.evaluate.horizons import HorizonError
    from tustinnet.evaluate.reference import Reference
    from tustinnet.evaluate.scores import Score
    from tustinnet.fitting.inverse_dynamics.record_forces import RecordForces
    from tustinnet.fitting.report import ForceError
    from tustinnet.report.tables import Table


_AHEAD_FIGURE = "ahead"
_MOST_COORDINATES = 3  # whose scores have room beside one another
_STEPS_SHOWN = (1, 2, 5, 10, 20, 50, 100, 200, 500)
_SCORE_KEYS = ("experiment", "rmse", "rmse_after", "coordinate_rmse", "nrmse", "fit_percent")
_Ahead = Annotated[
    int | None,
    typer.Option(min=1, metavar="K", help="Also score predictions k steps ahead, for k = 1..K."),
]
_Figures = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder for a figure of every free run.")
]
_Forces = Annotated[
    bool,
    typer.Option(
        "--forces",
        help="Also compare the forces that each motion needs with those of the actuators.",
    ),
]


def evaluate(
    model: options.Model,
    data: options.Data,
    split: options.JudgedSplit = None,
    start: options.JudgedStart = None,
    horizon: options.JudgedHorizon = None,
    card: options.Card = None,
    follow_links: options.FollowLinks = False,
    system: options.System = None,
    ahead: _Ahead = None,
    forces: _Forces = False,
    figures: _Figures = None,
    band: options.Band = None,
    whole_records: options.WholeRecords = False,
    overwrite: options.Redraw = False,
    json: options.Json = False,
) -> None:
    """Score the free runs of a model: RMSE, NRMSE, fit in percent.

    A free run begins at an initial state (--start) and then uses only the logged inputs.
    """
    terminal.prepare_jax()
    from tustinnet.evaluate.ahead import coordinate_rmse_ahead, rmse_ahead_by_unit
    from tustinnet.evaluate.coverage import compute_coverage
    from tustinnet.evaluate.horizons import errors_over_horizons
    from tustinnet.evaluate.reference import find_reference
    from tustinnet.evaluate.scores import evaluate as score_records
    from tustinnet.fitting.inverse_dynamics.of_model import forces_of_records

    band_options = make_band_options(band, whole=whole_records)
    simulator = load_model(model, system)
    channels = simulator.channels
    data_set = load_records(data, card, follow_links=follow_links)
    runs = choose_free_runs(
        data_set, {model: simulator}, split, start, horizon, has_bands=band is not None
    )
    records = runs.records
    names = [e.name for e in records] + ([] if ahead is None else [_AHEAD_FIGURE])
    names += [_forces_figure_name(e.name) for e in records] if forces else []
    paths = None if figures is None else [figures / f"{name}.png" for name in names]
    inputs = list_input_files(data, card, model, system)
    require_figures("--figures", paths, inputs, overwrite=overwrite)
    training = [e for e in data_set if e.split == "train"]
    along = forces_of_records(simulator, records, training=training) if forces else []
    scores = score_records(simulator, records, runs.start, horizon=runs.horizon)
    is_whole = runs.horizon is None
    whole = scores if is_whole else score_records(simulator, records, runs.start)
    horizons = errors_over_horizons(simulator, records, runs.start, whole)
    reference = horizons[-1].reference if is_whole else find_reference(records, runs.horizon)
    bands, coverage = [], []
    if band_options is not None:
        bands = compute_bands(model, simulator, records, scores, band_options)
        coverage = compute_coverage(records, bands)
    errors = None if ahead is None else coordinate_rmse_ahead(simulator, records, ahead)
    evaluation = _Evaluation(
        runs=runs,
        scores=scores,
        whole=whole,
        horizons=horizons,
        reference=reference,
        band_options=band_options,
        coverage=coverage,
        errors=errors,
        along=along,
        channels=channels,
    )
    runs.print_notes()
    if json:
        terminal.print_json(evaluation.as_plain())
    else:
        evaluation.print_tables()
    if figures is not None:
        from tustinnet.report.drawing import write_figure
        from tustinnet.report.figures import ahead_figure

        for name, figure in _draw(model.stem, records, scores, bands, along):
            write_figure(figure, figures, f"{name}.png")
        if errors is not None:
            figure = ahead_figure({model.stem: rmse_ahead_by_unit(errors, channels)}, channels)
            write_figure(figure, figures, f"{_AHEAD_FIGURE}.png")
        terminal.messages().print(f"figures: {figures}")


@dataclass(frozen=True)
class _Evaluation:
    """What is said of a model on records.

    Attributes:
        runs: the free runs that are judged.
        scores: their scores.
        whole: the scores of whole records.
        horizons: errors over longer and longer free runs.
        reference: what a trivial predictor is off by.
        band_options: of the bands, None without.
        coverage: shares of the motion inside the bands.
        errors: of predictions some steps ahead, None without.
        along: the forces along the records, none unless they are asked for.
        channels: coordinates and inputs.
    """

    runs: FreeRunRequest
    scores: "Sequence[Score]"
    whole: "Sequence[Score]"
    horizons: "Sequence[HorizonError]"
    reference: "Reference"
    band_options: "BandOptions | None"
    coverage: "Sequence[Coverage]"
    errors: "Float[np.ndarray, 'horizon n_q'] | None"
    along: "Sequence[RecordForces]"
    channels: "Channels"

    @property
    def by_split(self) -> "dict[str, list[Score]]":
        """The scores by split."""
        return _group_by_split(self.runs.records, self.scores)

    def as_plain(self) -> dict[str, object]:
        """What `--json` prints."""
        from tustinnet.evaluate.ahead import joint_rmse, rmse_ahead_by_unit
        from tustinnet.evaluate.horizons import seconds_followed
        from tustinnet.evaluate.scores import mean_rmse, mean_rmse_by_unit
        from tustinnet.fitting.inverse_dynamics.record_forces import force_errors

        channels, experiments = self.channels, []
        for e, score in zip(self.runs.records, self.scores, strict=True):
            values = {key: getattr(score, key) for key in _SCORE_KEYS}
            by_unit = score.rmse_by_unit(channels)
            experiments.append({**values, "rmse_by_unit": by_unit, "split": e.split})
        content = {
            **self.runs.as_plain(),
            "coordinates": [c.name for c in channels.coordinates],
            "experiments": experiments,
            "mean": mean_rmse(self.scores),
            "means": {name: mean_rmse(group) for name, group in self.by_split.items()},
            "mean_by_unit": mean_rmse_by_unit(self.scores, channels),
            "reference": self.reference.as_plain(),
            "horizons": [
                {"horizon": h.horizon, "mean_by_unit": h.rmse, "reference": h.reference.as_plain()}
                for h in self.horizons
            ],
            "seconds_followed": seconds_followed(self.runs.records, self.whole),
            "means_by_unit": {
                name: mean_rmse_by_unit(group, channels) for name, group in self.by_split.items()
            },
        }
        if self.band_options is not None:
            content["band"] = {
                "level": self.band_options.level,
                "of": self.band_options.scope,
                "covered": [asdict(share) for share in self.coverage],
            }
        if self.errors is not None:
            by_unit = rmse_ahead_by_unit(self.errors, channels).T.tolist()
            content["ahead"] = {
                "dt": channels.dt,
                "rmse": joint_rmse(self.errors).tolist(),
                "rmse_by_unit": dict(zip(channels.units, by_unit, strict=True)),
            }
        if self.along:
            content["forces"] = [asdict(error) for error in force_errors(self.along)]
        return content

    def print_tables(self) -> None:
        """Prints what is said of the model."""
        from tustinnet.evaluate.horizons import describe_followed
        from tustinnet.evaluate.scores import mean_rmse

        records, channels, label = self.runs.records, self.channels, self.reference.label
        trivial = _group_by_split(records, self.reference.scores)
        terminal.print_tables(
            *_score_tables(self.by_split, channels, self.runs.start, label, trivial)
        )
        terminal.print_tables(_horizon_table(self.horizons, channels))
        terminal.echo(describe_followed(records, self.whole))
        if not mean_rmse(self.scores) < self.reference.mean:
            terminal.echo(f"the model follows these records no better than {label}")
        if self.band_options is not None:
            terminal.print_tables(_band_table(self.coverage, self.band_options, channels))
        if self.errors is not None:
            terminal.print_tables(_ahead_table(self.errors, channels))
        if self.along:
            terminal.print_tables(_forces_table(self.along))


def _draw(
    label: str,
    records: "Sequence[Experiment]",
    scores: "Sequence[Score]",
    bands: "Sequence[Band]",
    along: "Sequence[RecordForces]",
) -> "Iterator[tuple[str, Figure]]":
    """Names and figures of all free runs, and of the forces along records."""
    from tustinnet.report.figures import forces_figure, free_run_figure

    for i, (e, score) in enumerate(zip(records, scores, strict=True)):
        of_run = {label: bands[i]} if bands else {}
        yield e.name, free_run_figure(e, {label: score}, bands=of_run)
    for part in along:
        yield _forces_figure_name(part.record), forces_figure(part)


def _forces_figure_name(record: str) -> str:
    return f"{record}-forces"


def _ahead_table(errors: "Float[np.ndarray, 'horizon n_q']", channels: "Channels") -> "Table":
    """Table of errors of predictions some steps ahead."""
    from tustinnet.evaluate.ahead import rmse_ahead_by_unit
    from tustinnet.report.tables import Table, number

    shown = [*(k for k in _STEPS_SHOWN if k < len(errors)), len(errors)]
    by_unit = rmse_ahead_by_unit(errors, channels)
    rows = [
        [str(k), f"{k * channels.dt:g}", *[number(x, 4) for x in by_unit[k - 1]]] for k in shown
    ]
    columns = ["k", "horizon [s]", *[f"RMSE [{unit}]" for unit in channels.units]]
    return Table(columns, rows, title="k steps ahead")


def _forces_table(along: "Sequence[RecordForces]") -> "Table":
    """Table of the forces that are missing along the records of each split."""
    from tustinnet.fitting.inverse_dynamics.record_forces import force_errors
    from tustinnet.report.fits import force_errors_table

    by_split: dict[str, list[ForceError]] = {}
    for error in force_errors(along):
        by_split.setdefault(error.split or "all", []).append(error)
    return force_errors_table(by_split)


def _group_by_split(
    records: "Sequence[Experiment]", scores: "Sequence[Score]"
) -> "dict[str, list[Score]]":
    """Scores by the split of their records; "all" where there is none."""
    groups: dict[str, list[Score]] = {}
    for e, score in zip(records, scores, strict=True):
        groups.setdefault(e.split or "all", []).append(score)
    return groups


def _horizon_table(errors: "Sequence[HorizonError]", channels: "Channels") -> "Table":
    """Table of mean errors over longer and longer free runs, beside the reference."""
    from tustinnet.report.tables import Table, number

    rows = []
    for e in errors:
        trivial = e.reference.mean_by_unit
        row = ["whole" if e.horizon is None else f"{e.horizon:g} s"]
        for unit in channels.units:
            share = 100 * e.rmse[unit] / trivial[unit] if trivial[unit] else float("nan")
            row += [number(e.rmse[unit]), number(trivial[unit]), number(share, 1)]
        rows.append([*row, e.reference.label])
    columns = ["free runs of"]
    for unit in channels.units:
        columns += [f"RMSE [{unit}]", f"reference [{unit}]", "share [%]"]
    title = "Means over the records, beside what a trivial predictor is off by"
    return Table([*columns, "reference"], rows, title=title)


def _band_table(
    coverage: "Sequence[Coverage]", band_options: "BandOptions", channels: "Channels"
) -> "Table":
    """Table of the share of the motion inside the bands, and of their width."""
    from tustinnet.report.tables import Table, number

    units = {c.name: c.unit for c in channels.coordinates}
    rows = []
    for row in coverage:
        low, high = (f"{100 * end:.0f}" for end in row.interval)
        rows.append(
            [
                row.coordinate,
                row.part,
                f"{100 * row.inside:.1f}",
                f"{low} to {high}",
                f"{row.whole} of {row.records}",
                f"{number(row.width)} {units[row.coordinate]}",
                number(row.width / row.rmse, 1) if row.rmse else "",
                number(row.crps),
            ]
        )
    columns = [
        "coordinate",
        "part",
        "inside [%]",
        "95 % interval",
        "records all inside",
        "width",
        "width / RMSE",
        "CRPS",
    ]
    share = "of the time" if band_options.scope == "time" else "of whole records"
    return Table(columns, rows, title=f"Bands of {100 * band_options.level:g} % {share}")


def _score_tables(
    by_split: "Mapping[str, Sequence[Score]]",
    channels: "Channels",
    start: str,
    label: str,
    reference: "Mapping[str, Sequence[Score]]",
) -> "list[Table]":
    """Tables of the scores of every record and of the means of the splits.

    Where there are many coordinates, their scores are a table of their own, of the means alone.

    Args:
        by_split: scores of the model.
        channels: coordinates of the records.
        start: where the free runs start.
        label: what the reference does.
        reference: its scores.
    """
    from tustinnet.report.tables import Table, number
    from tustinnet.simulate.horizon import horizon_words
    from tustinnet.simulate.starts import start_named

    # any model simulates the samples well that its start was fitted to
    start_samples = start_named(start).seen_samples
    is_wide = channels.n_q > _MOST_COORDINATES
    columns = ["record", "split", *[f"RMSE [{unit}]" for unit in channels.units]]
    if start_samples:
        has_units = len(channels.units) > 1
        columns += [
            f"from sample {start_samples}" + (f" [{unit}]" if has_units else "")
            for unit in channels.units
        ]
    for c in channels.coordinates:
        columns += (
            [f"{c.name}, fit [%]"] if is_wide else [f"{c.name} [{c.unit}]", "NRMSE", "fit [%]"]
        )

    def errors_of(s: "Score") -> list[float]:
        after = s.rmse_after_by_unit(channels).values() if start_samples else ()
        return [*s.rmse_by_unit(channels).values(), *after]

    rows = []
    for split, scores in by_split.items():
        for s in scores:
            row = [s.experiment, split, *map(number, errors_of(s))]
            for error, relative, percent in zip(
                s.coordinate_rmse, s.nrmse, s.fit_percent, strict=True
            ):
                row += [] if is_wide else [number(error), number(relative)]
                row.append(number(percent, 1))
            rows.append(row)
    # scores of training records are optimistic, so each split has a mean of its own
    for name, groups in (("mean", by_split), (f"({label})", reference)):
        for split, scores in groups.items():
            means = [fmean(column) for column in zip(*map(errors_of, scores), strict=True)]
            row = [name, split, *map(number, means)]
            rows.append([*row, *[""] * (len(columns) - len(row))])
    horizon = horizon_words(next(iter(by_split.values()))[0].horizon)
    tables = [Table(columns, rows, title=f"Free runs, start '{start}'{horizon}")]
    if is_wide:
        rows = [
            [
                c.name,
                split,
                number(fmean(s.coordinate_rmse[j] for s in scores)),
                c.unit,
                number(fmean(s.nrmse[j] for s in scores)),
                number(fmean(s.fit_percent[j] for s in scores), 1),
            ]
            for split, scores in by_split.items()
            for j, c in enumerate(channels.coordinates)
        ]
        columns = ["coordinate", "split", "RMSE", "unit", "NRMSE", "fit [%]"]
        tables.append(Table(columns, rows, title="Means over the records"))
    return tables
