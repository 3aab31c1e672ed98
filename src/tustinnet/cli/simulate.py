"""`tustinnet simulate`: free runs as files."""

from pathlib import Path
from typing import Annotated, Any

import typer

import tustinnet as tn
from tustinnet.cli import devices, options, terminal
from tustinnet.cli.files import list_input_files, require_no_new_records
from tustinnet.cli.free_runs import choose_free_runs, compute_bands, make_band_options
from tustinnet.cli.models import load_model
from tustinnet.cli.records import load_records
from tustinnet.evaluate import bands as free_run_bands
from tustinnet.evaluate import scores as scoring
from tustinnet.report import extrapolation, tables
from tustinnet.simulate import horizon as horizons
from tustinnet.simulate import range as training_ranges
from tustinnet.store import files as disk
from tustinnet.store import simulation_file

_Records = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="Only this record; may be repeated.")
]


def simulate(
    model: options.Model,
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the simulations, as CSV.")],
    split: options.JudgedSplit = None,
    experiment: _Records = None,
    start: options.JudgedStart = None,
    horizon: options.JudgedHorizon = None,
    band: options.Band = None,
    whole_records: options.WholeRecords = False,
    card: options.Card = None,
    system: options.System = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Simulate records as free runs; one CSV file for each.

    A free run begins at an initial state (--start) and then uses only the logged inputs.
    """
    devices.prepare_jax()
    band_options = make_band_options(band, whole=whole_records)
    simulator = load_model(model, system)
    data_set = load_records(data, card, experiment or ())
    runs = choose_free_runs(
        data_set,
        {model: simulator},
        split,
        start,
        horizon,
        names=experiment or (),
        has_bands=band is not None,
    )
    records = runs.records
    paths = [out / simulation_file.simulation_name(e) for e in records]
    inputs = list_input_files(data, card, model, system)
    disk.require_outputs(paths, overwrite=overwrite, read=inputs)
    require_no_new_records(paths, data, card)
    with disk.lock_folder(out):
        disk.require_outputs(paths, overwrite=overwrite)  # another command may have been faster
        scores = scoring.score_runs(simulator, records, runs.start, horizon=runs.horizon)
        bands: list[free_run_bands.Band | None] = [None] * len(records)
        if band_options is not None:
            bands = [*compute_bands(model, simulator, records, scores, band_options)]
        runs.print_notes()
        training_range = training_ranges.Range.from_header(tn.read_header(model), simulator)
        simulations: list[dict[str, Any]] = []
        for e, score, run_band, path in zip(records, scores, bands, paths, strict=True):
            simulation_file.write_simulation(out, e, score.simulated, run_band)
            content = {"experiment": e.name, "rmse": score.rmse, "file": str(path), "left": None}
            point = None
            if training_range is not None:
                point = training_range.extrapolation_point(simulator.channels, score.simulated, e.u)
            if point is not None:
                content["left"] = extrapolation.extrapolation_content(point, e.dt)
                terminal.messages().print(
                    f"note: {e.name}: {extrapolation.describe_extrapolation(point, e.dt)}"
                )
            simulations.append(content)
    if json:
        terminal.print_json({**runs.as_plain(), "simulations": simulations})
        return
    rows = [[w["experiment"], tables.number(w["rmse"]), w["file"]] for w in simulations]
    title = f"Free runs, start '{runs.start}'{horizons.horizon_words(runs.horizon)}"
    terminal.print_tables(tables.Table(["record", "RMSE", "file"], rows, title=title))
