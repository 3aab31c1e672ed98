"""`tustinnet evaluate`: score models on records."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.cli import devices, options, terminal
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
from tustinnet.evaluate import ahead as predictions_ahead
from tustinnet.evaluate import bands as free_run_bands
from tustinnet.evaluate import coverage
from tustinnet.evaluate import horizons as error_horizons
from tustinnet.evaluate import reference as references
from tustinnet.evaluate import residuals as residual_tests
from tustinnet.evaluate import scores as scoring
from tustinnet.fitting.inverse_dynamics import of_model as model_forces
from tustinnet.report import comparison, drawing
from tustinnet.report import evaluation as evaluation_report
from tustinnet.report import figures as result_figures
from tustinnet.report import residuals as residual_report
from tustinnet.report.page import reported_model
from tustinnet.store import header, model_file
from tustinnet.systems import files as system_files
from tustinnet.wording import counted

_AHEAD_FIGURE, _RESIDUAL_FIGURE = "ahead", "residuals"
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
        help="With --residuals: largest lag of the correlations, in samples. Default: 50, or as "
        "many as the shortest record has.",
    ),
]


def evaluate(
    models: options.Models,
    data: options.Data,
    split: options.JudgedSplit = None,
    start: options.JudgedStart = None,
    horizon: options.JudgedHorizon = None,
    band: options.Band = None,
    residuals: _Residuals = False,
    figures: _Figures = None,
    card: options.Card = None,
    system: _Systems = None,
    ahead: _Ahead = None,
    forces: _Forces = False,
    lags: _Lags = None,
    whole_records: options.WholeRecords = False,
    overwrite: options.Redraw = False,
    json: options.Json = False,
) -> None:
    """Score the free runs of a model, or compare those of several.

    A free run begins at an initial state (--start) and then uses only the logged inputs.
    """
    devices.prepare_jax()
    if len(models) > 1:
        of_one = {"--ahead": ahead, "--forces": forces, "--residuals": residuals, "--lags": lags}
        refuse_options(of_one, "to several models", "one model")
        if band is not None and figures is None:
            raise InputError("--band", "no figures, which bands are drawn into", "--figures DIR")
    if not residuals:
        refuse_options({"--lags": lags}, "without residuals", "residuals", "add --residuals")
    band_options = make_band_options(band, whole=whole_records)
    loaded = model_file.load_models(
        models, [system_files.find_system(name) for name in system or []], kept_system
    )
    data_set = load_records(data, card)
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
    of_runs = _FreeRuns.compute(
        runs, dict(zip(reported_model.labels(models), of_files, strict=True))
    )
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
            residuals=residuals,
            lags=lags,
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
        of_one = () if evaluation is None else _draw(next(iter(of_runs.models)), evaluation)
        for name, figure in (*of_runs.draw(), *of_one):
            drawing.write_figure(figure, figures, f"{name}.png")
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
    models: "Mapping[str, tuple[Path, tn.Model]]"
    scores: "dict[str, list[scoring.Score]]"
    bands: "dict[str, list[free_run_bands.Band]]"

    @classmethod
    def compute(
        cls, runs: FreeRunRequest, models: "Mapping[str, tuple[Path, tn.Model]]"
    ) -> "_FreeRuns":
        """Simulates the records by each model."""
        scores = {}
        for label, (path, model) in models.items():
            try:
                scores[label] = scoring.score_runs(
                    model, runs.records, runs.start, horizon=runs.horizon
                )
            except InputError as error:  # names the model
                if len(models) == 1:
                    raise
                raise InputError(path, str(error)) from error
        return cls(runs, models, scores, {})

    def add_bands(self, band_options: "free_run_bands.BandOptions") -> None:
        """Adds the bands of each model."""
        for label, (path, model) in self.models.items():
            self.bands[label] = compute_bands(
                path, model, self.runs.records, self.scores[label], band_options
            )

    def as_plain(self) -> dict[str, object]:
        """The errors of each model as plain values."""
        return {
            "models": {
                label: {
                    "file": str(path),
                    "mean": tn.mean_rmse(self.scores[label]),
                    "mean_by_unit": scoring.mean_rmse_by_unit(
                        self.scores[label], self.runs.records[0].channels
                    ),
                    "rmse": scoring.rmse_by_record(self.scores[label]),
                }
                for label, (path, _) in self.models.items()
            }
        }

    def print_table(self) -> None:
        """Prints the errors of each model, and those of a trivial predictor."""
        records = self.runs.records
        reference = references.find_reference(records, self.runs.horizon)
        columns = {**self.scores, f"({reference.label})": reference.scores}
        terminal.print_tables(comparison.comparison_table(records, columns, self.runs.start))

    def draw(self) -> "Iterator[tuple[str, drawing.Figure]]":
        """Name and figure of each record with the free runs of all models."""
        for i, e in enumerate(self.runs.records):
            scores = {label: of_model[i] for label, of_model in self.scores.items()}
            bands = {label: of_model[i] for label, of_model in self.bands.items()}
            yield e.name, result_figures.free_run_figure(e, scores, bands=bands)


def _evaluate_one(
    of_runs: _FreeRuns,
    data: "tn.DataSet",
    band_options: "free_run_bands.BandOptions | None",
    *,
    ahead: int | None,
    forces: bool,
    residuals: bool,
    lags: int | None,
) -> "evaluation_report.Evaluation":
    """All that is said of one model.

    Args:
        of_runs: its free runs.
        data: all records, of which those of training show what least squares do.
        band_options: of the bands, None without.
        ahead: steps up to which predictions are scored, None for none.
        forces: whether forces along the records are compared.
        residuals: whether its errors are tested.
        lags: largest lag of these tests, None for the usual one.
    """
    ((label, (path, model)),) = of_runs.models.items()
    runs, scores = of_runs.runs, of_runs.scores[label]
    records, start, is_whole = runs.records, runs.start, runs.horizon is None
    training = [e for e in data if e.split == "train"]
    whole = scores if is_whole else scoring.score_runs(model, records, start, horizon=None)
    horizons = error_horizons.errors_over_horizons(model, records, start, whole)
    names = {e.name for e in records}
    finite = [e for e, score in zip(records, scores, strict=True) if math.isfinite(score.rmse)]
    if residuals and len(finite) < len(records):
        lost = ", ".join(e.name for e in records if e not in finite)
        terminal.messages().print(f"note: no residuals of {lost}: the free run diverges")
    return evaluation_report.Evaluation(
        channels=model.channels,
        records=records,
        start=start,
        scores=scores,
        whole=whole,
        horizons=horizons,
        reference=horizons[-1].reference
        if is_whole
        else references.find_reference(records, runs.horizon),
        band_options=band_options,
        coverage=coverage.compute_coverage(records, of_runs.bands[label]) if band_options else [],
        ahead=None
        if ahead is None
        else predictions_ahead.coordinate_rmse_ahead(model, records, ahead),
        along=model_forces.forces_of_records(
            model, records, header.cutoff_in_header(tn.read_header(path)), training=training
        )
        if forces
        else [],
        residuals=residual_tests.residual_reports(model, finite, start, lags, horizon=runs.horizon)
        if residuals and finite
        else [],
        downweighted=[s for s in model_file.read_downweighted(path) if s.record in names],
    )


def _draw(
    label: str, evaluation: "evaluation_report.Evaluation"
) -> "Iterator[tuple[str, drawing.Figure]]":
    """Names and figures of what else was asked of a model, beside its free runs."""
    channels = evaluation.channels
    for part in evaluation.along:
        yield _forces_figure_name(part.record), result_figures.forces_figure(part)
    if evaluation.ahead is not None:
        errors = {label: predictions_ahead.rmse_ahead_by_unit(evaluation.ahead, channels)}
        yield _AHEAD_FIGURE, result_figures.ahead_figure(errors, channels)
    if evaluation.residuals:
        count = sum(math.isfinite(score.rmse) for score in evaluation.scores)
        title = f"Residuals of {counted(count, 'free run')}, start '{evaluation.start}'"
        yield (
            _RESIDUAL_FIGURE,
            residual_report.residual_figure(evaluation.residuals, channels, title),
        )


def _forces_figure_name(record: str) -> str:
    return f"{record}-forces"
