"""`tustinnet compare`: several models on the same records."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal
from tustinnet.cli.files import list_input_files, require_figures
from tustinnet.cli.free_runs import choose_free_runs, compute_bands, make_band_options
from tustinnet.cli.models import kept_system
from tustinnet.cli.records import load_records
from tustinnet.errors import InputError

if TYPE_CHECKING:
    from tustinnet.evaluate.bands import Band
    from tustinnet.evaluate.scores import Score


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
    split: options.JudgedSplit = None,
    start: options.JudgedStart = None,
    horizon: options.JudgedHorizon = None,
    card: options.Card = None,
    follow_links: options.FollowLinks = False,
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
    from tustinnet.evaluate.scores import (
        evaluate,
        mean_rmse,
        mean_rmse_by_unit,
        rmse_by_record,
    )
    from tustinnet.report.comparison import comparison_table
    from tustinnet.report.page.reported_model import labels
    from tustinnet.store.model_file import load_models
    from tustinnet.systems.files import find_system

    band_options = make_band_options(band, whole=whole_records)
    if band_options is not None and figures is None:
        raise InputError("--band", "no figures, which bands are drawn into", "--figures DIR")
    systems = [find_system(name) for name in system or []]
    loaded_models = load_models(models, systems, kept_system)
    by_file = dict(zip(models, loaded_models, strict=True))
    runs = choose_free_runs(
        load_records(data, card, follow_links=follow_links),
        by_file,
        split,
        start,
        horizon,
        has_bands=band is not None,
    )
    records = runs.records
    paths = None if figures is None else [figures / f"{e.name}.png" for e in records]
    inputs = list_input_files(data, card, *models, *(system or []))
    require_figures("--figures", paths, inputs, overwrite=overwrite)
    scores: dict[str, list[Score]] = {}
    bands: dict[str, list[Band]] = {}
    for label, path, model in zip(labels(models), models, loaded_models, strict=True):
        try:
            scores[label] = evaluate(model, records, runs.start, horizon=runs.horizon)
        except InputError as error:  # names the model
            raise InputError(path, str(error)) from error
    if band_options is not None:
        for label, path, model in zip(scores, models, loaded_models, strict=True):
            bands[label] = compute_bands(path, model, records, scores[label], band_options)
    runs.print_notes()
    if json:
        content = {
            label: {
                "file": str(path),
                "mean": mean_rmse(scores[label]),
                "mean_by_unit": mean_rmse_by_unit(scores[label], records[0].channels),
                "rmse": rmse_by_record(scores[label]),
            }
            for label, path in zip(scores, models, strict=True)
        }
        terminal.print_json({**runs.as_plain(), "models": content})
    else:
        terminal.print_tables(comparison_table(records, scores, runs.start))
    if figures is not None:
        from tustinnet.report.drawing import write_figure
        from tustinnet.report.figures import free_run_figure

        for i, e in enumerate(records):
            run_scores = {label: model_scores[i] for label, model_scores in scores.items()}
            run_bands = {label: model_bands[i] for label, model_bands in bands.items()}
            write_figure(free_run_figure(e, run_scores, bands=run_bands), figures, f"{e.name}.png")
        terminal.messages().print(f"figures: {figures}")
