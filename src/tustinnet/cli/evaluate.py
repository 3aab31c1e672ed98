"""`tustinnet evaluate`: score models on records."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
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
from tustinnet.cli.models import kept_system
from tustinnet.cli.records import load_records
from tustinnet.cli.verb import refuse_options
from tustinnet.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

    from tustinnet.data.dataset import DataSet
    from tustinnet.evaluate.bands import Band, BandOptions
    from tustinnet.evaluate.scores import Score
    from tustinnet.models.contract import Model
    from tustinnet.report.evaluation import Evaluation

_AHEAD_FIGURE, _RESIDUAL_FIGURE = "ahead", "residuals"
_LAGS = 50  # samples
_Systems = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME|FILE",
        help="System of some of the models, each of which takes its own: see fit. May be repeated.",
    ),
]
_Ahead = Annotated[
    int | None,
    typer.Option(min=1, metavar="K", help="Also score predictions k steps ahead, for k = 1..K."),
]
_Figures = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder for a figure of every record.")
]
_Forces = Annotated[
    bool,
    typer.Option(
        "--forces",
        help="Also compare the forces that each motion needs with those of the actuators.",
    ),
]
_Residuals = Annotated[
    bool,
    typer.Option(
        "--residuals",
        help="Also test the errors: whether they are white, and free of what the inputs do.",
    ),
]
_Lags = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="L",
        help=f"With --residuals: largest lag of the correlations, in samples. Default: {_LAGS}.",
    ),
]


def evaluate(
    models: options.Models,
    data: options.Data,
    split: options.JudgedSplit = None,
    start: options.JudgedStart = None,
    horizon: options.JudgedHorizon = None,
    card: options.Card = None,
    follow_links: options.FollowLinks = False,
    system: _Systems = None,
    ahead: _Ahead = None,
    forces: _Forces = False,
    residuals: _Residuals = False,
    lags: _Lags = None,
    figures: _Figures = None,
    band: options.Band = None,
    whole_records: options.WholeRecords = False,
    overwrite: options.Redraw = False,
    json: options.Json = False,
) -> None:
    """Score the free runs of a model, or compare those of several.

    A free run begins at an initial state (--start) and then uses only the logged inputs.
    """
    terminal.prepare_jax()
    from tustinnet.report.page.reported_model import labels
    from tustinnet.store.model_file import load_models
    from tustinnet.systems.files import find_system

    if len(models) > 1:
        of_one = {"--ahead": ahead, "--forces": forces, "--residuals": residuals, "--lags": lags}
        refuse_options(of_one, "to several models", "one model")
        if band is not None and figures is None:
            raise InputError("--band", "no figures, which bands are drawn into", "--figures DIR")
    if not residuals:
        refuse_options({"--lags": lags}, "without residuals", "residuals", "add --residuals")
    band_options = make_band_options(band, whole=whole_records)
    loaded = load_models(models, [find_system(name) for name in system or []], kept_system)
    data_set = load_records(data, card, follow_links=follow_links)
    by_file = dict(zip(models, loaded, strict=True))
    runs = choose_free_runs(
        data_set, by_file, split, start, horizon, has_bands=band_options is not None
    )
    names = [e.name for e in runs.records] + ([] if ahead is None else [_AHEAD_FIGURE])
    names += [_forces_figure_name(e.name) for e in runs.records] if forces else []
    names += [_RESIDUAL_FIGURE] if residuals else []
    paths = None if figures is None else [figures / f"{name}.png" for name in names]
    inputs = list_input_files(data, card, *models, *(system or []))
    require_figures("--figures", paths, inputs, overwrite=overwrite)
    of_files = zip(models, loaded, strict=True)  # one may be there twice
    of_runs = _FreeRuns.compute(runs, dict(zip(labels(models), of_files, strict=True)))
    if band_options is not None:
        of_runs.add_bands(band_options)
    evaluation = None
    if len(models) == 1:
        evaluation = _evaluate_one(
            of_runs,
            data_set,
            band_options,
            ahead=ahead,
            forces=forces,
            lags=(lags or _LAGS) if residuals else None,
        )
    runs.print_notes()
    if json:
        content = of_runs.as_plain() if evaluation is None else evaluation.as_plain()
        terminal.print_json({**runs.as_plain(), **content})
    elif evaluation is None:
        of_runs.print_table()
    else:
        for part in evaluation.parts():
            terminal.echo(part) if isinstance(part, str) else terminal.print_tables(part)
    if figures is not None:
        from tustinnet.report.drawing import write_figure

        of_one = () if evaluation is None else _draw(next(iter(of_runs.models)), evaluation)
        for name, figure in (*of_runs.draw(), *of_one):
            write_figure(figure, figures, f"{name}.png")
        terminal.messages().print(f"figures: {figures}")


@dataclass
class _FreeRuns:
    """Free runs of some models on the same records.

    Attributes:
        runs: the records, and where free runs start.
        models: file and model, by label.
        scores: their scores, by label.
        bands: their bands, by label; empty without.
    """

    runs: FreeRunRequest
    models: "Mapping[str, tuple[Path, Model]]"
    scores: "dict[str, list[Score]]"
    bands: "dict[str, list[Band]]"

    @classmethod
    def compute(
        cls, runs: FreeRunRequest, models: "Mapping[str, tuple[Path, Model]]"
    ) -> "_FreeRuns":
        """Simulates the records by each model."""
        from tustinnet.evaluate.scores import evaluate as score_records

        scores = {}
        for label, (path, model) in models.items():
            try:
                scores[label] = score_records(model, runs.records, runs.start, horizon=runs.horizon)
            except InputError as error:  # names the model
                if len(models) == 1:
                    raise
                raise InputError(path, str(error)) from error
        return cls(runs, models, scores, {})

    def add_bands(self, band_options: "BandOptions") -> None:
        """Adds the bands of each model."""
        for label, (path, model) in self.models.items():
            self.bands[label] = compute_bands(
                path, model, self.runs.records, self.scores[label], band_options
            )

    def as_plain(self) -> dict[str, object]:
        """The errors of each model as plain values."""
        from tustinnet.evaluate.scores import mean_rmse, mean_rmse_by_unit, rmse_by_record

        return {
            "models": {
                label: {
                    "file": str(path),
                    "mean": mean_rmse(self.scores[label]),
                    "mean_by_unit": mean_rmse_by_unit(
                        self.scores[label], self.runs.records[0].channels
                    ),
                    "rmse": rmse_by_record(self.scores[label]),
                }
                for label, (path, _) in self.models.items()
            }
        }

    def print_table(self) -> None:
        """Prints the errors of each model, and those of a trivial predictor."""
        from tustinnet.evaluate.reference import find_reference
        from tustinnet.report.comparison import comparison_table

        records = self.runs.records
        reference = find_reference(records, self.runs.horizon)
        columns = {**self.scores, f"({reference.label})": reference.scores}
        terminal.print_tables(comparison_table(records, columns, self.runs.start))

    def draw(self) -> "Iterator[tuple[str, Figure]]":
        """Name and figure of each record with the free runs of all models."""
        from tustinnet.report.figures import free_run_figure

        for i, e in enumerate(self.runs.records):
            scores = {label: of_model[i] for label, of_model in self.scores.items()}
            bands = {label: of_model[i] for label, of_model in self.bands.items()}
            yield e.name, free_run_figure(e, scores, bands=bands)


def _evaluate_one(
    of_runs: _FreeRuns,
    data: "DataSet",
    band_options: "BandOptions | None",
    *,
    ahead: int | None,
    forces: bool,
    lags: int | None,
) -> "Evaluation":
    """All that is said of one model.

    Args:
        of_runs: its free runs.
        data: all records, of which those of training show what least squares do.
        band_options: of the bands, None without.
        ahead: steps up to which predictions are scored, None for none.
        forces: whether forces along the records are compared.
        lags: largest lag of the tests of its errors, None for no tests.
    """
    from tustinnet.evaluate.ahead import coordinate_rmse_ahead
    from tustinnet.evaluate.coverage import compute_coverage
    from tustinnet.evaluate.horizons import errors_over_horizons
    from tustinnet.evaluate.reference import find_reference
    from tustinnet.evaluate.residuals import residual_reports
    from tustinnet.evaluate.scores import evaluate as score_records
    from tustinnet.fitting.inverse_dynamics.of_model import forces_of_records
    from tustinnet.report.evaluation import Evaluation
    from tustinnet.store.model_file import read_downweighted

    ((label, (path, model)),) = of_runs.models.items()
    runs, scores = of_runs.runs, of_runs.scores[label]
    records, start, is_whole = runs.records, runs.start, runs.horizon is None
    training = [e for e in data if e.split == "train"]
    whole = scores if is_whole else score_records(model, records, start)
    horizons = errors_over_horizons(model, records, start, whole)
    names = {e.name for e in records}
    return Evaluation(
        channels=model.channels,
        records=records,
        start=start,
        scores=scores,
        whole=whole,
        horizons=horizons,
        reference=horizons[-1].reference if is_whole else find_reference(records, runs.horizon),
        band_options=band_options,
        coverage=compute_coverage(records, of_runs.bands[label]) if band_options else [],
        ahead=None if ahead is None else coordinate_rmse_ahead(model, records, ahead),
        along=forces_of_records(model, records, training=training) if forces else [],
        residuals=[]
        if lags is None
        else residual_reports(model, records, start, lags, horizon=runs.horizon),
        downweighted=[s for s in read_downweighted(path) if s.record in names],
    )


def _draw(label: str, evaluation: "Evaluation") -> "Iterator[tuple[str, Figure]]":
    """Names and figures of what else was asked of a model, beside its free runs."""
    from tustinnet.evaluate.ahead import rmse_ahead_by_unit
    from tustinnet.report.figures import ahead_figure, forces_figure
    from tustinnet.report.residuals import residual_figure

    channels = evaluation.channels
    for part in evaluation.along:
        yield _forces_figure_name(part.record), forces_figure(part)
    if evaluation.ahead is not None:
        errors = {label: rmse_ahead_by_unit(evaluation.ahead, channels)}
        yield _AHEAD_FIGURE, ahead_figure(errors, channels)
    if evaluation.residuals:
        title = f"Residuals of {len(evaluation.records)} free runs, start '{evaluation.start}'"
        yield _RESIDUAL_FIGURE, residual_figure(evaluation.residuals, channels, title)


def _forces_figure_name(record: str) -> str:
    return f"{record}-forces"
