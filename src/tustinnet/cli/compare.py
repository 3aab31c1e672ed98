"""`tustinnet compare`: several models on the same records."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tustinnet.cli import options, request, terminal

if TYPE_CHECKING:
    from tustinnet.data.experiment import Experiment
    from tustinnet.evaluate.bands import Band
    from tustinnet.evaluate.scores import Score
    from tustinnet.models.contract import Model


_Systems = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE.py",
        help="System file of some of the models; each model is matched with its file; "
        "may be repeated.",
    ),
]


def compare(
    models: options.Models,
    data: options.Data,
    split: options.Split = None,
    start: options.Start = None,
    horizon: options.Horizon = None,
    card: options.Card = None,
    system: _Systems = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for figures: every record with the free runs of all models."
        ),
    ] = None,
    band: options.Band = None,
    whole_records: options.WholeRecords = False,
    overwrite: options.Redraw = False,
    json: options.Json = False,
) -> None:
    """Compare the free runs of several models in a table and figures."""
    terminal.prepare_jax()
    from tustinnet.errors import InputError
    from tustinnet.report.comparison import comparison_table
    from tustinnet.report.page.reported_model import labels
    from tustinnet.store.model_file import load_models
    from tustinnet.systems.files import find_system

    asked = request.make_band_options(band, whole=whole_records)
    if asked is not None and figures is None:
        raise InputError("--band", "no figures, which bands are drawn into", "--figures DIR")
    given = [find_system(which) for which in system or []]
    loaded = load_models(models, given, request.kept_system)
    records, begin = request.load_records_and_start(data, card, split, start, loaded)
    drawn = None if figures is None else [figures / f"{e.name}.png" for e in records]
    read = request.list_input_files(data, card, *models, *(system or []))
    request.require_figures("--figures", drawn, read, overwrite=overwrite)
    scores = {
        label: _scores(path, model, records, begin, horizon)
        for label, path, model in zip(labels(models), models, loaded, strict=True)
    }
    bands = {} if asked is None else {
        label: request.bands_of(path, model, records, scores[label], asked)
        for label, path, model in zip(scores, models, loaded, strict=True)
    }  # fmt: skip
    if json:
        content = _content(models, scores)
        terminal.print_json({"start": begin, "horizon": horizon, "models": content})
    else:
        terminal.print_tables(comparison_table(records, scores, begin))
    if figures is not None:
        _draw(figures, records, scores, bands)
        terminal.messages().print(f"figures: {figures}")


def _draw(
    folder: Path,
    records: "list[Experiment]",
    scores: "dict[str, list[Score]]",
    bands: "dict[str, list[Band]]",
) -> None:
    from tustinnet.report.figures import free_run_figure, write_figure

    for i, e in enumerate(records):
        runs = {label: found[i] for label, found in scores.items()}
        around = {label: of[i] for label, of in bands.items()}
        write_figure(free_run_figure(e, runs, bands=around), folder, f"{e.name}.png")


def _scores(
    path: Path, model: "Model", records: "list[Experiment]", start: str, horizon: float | None
) -> "list[Score]":
    from tustinnet.errors import InputError
    from tustinnet.evaluate.scores import evaluate

    try:
        return evaluate(model, records, start, horizon=horizon)
    except InputError as error:  # which of the models it was
        raise InputError(path, str(error)) from error


def _content(models: list[Path], scores: "dict[str, list[Score]]") -> dict[str, Any]:
    from tustinnet.evaluate.scores import mean_rmse, rmse_by_record

    return {
        label: {
            "file": str(path),
            "mean": mean_rmse(scores[label]),
            "rmse": rmse_by_record(scores[label]),
        }
        for label, path in zip(scores, models, strict=True)
    }
