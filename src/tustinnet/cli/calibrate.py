"""`tustinnet calibrate`: bands for a model."""

from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.cli import devices, options, terminal
from tustinnet.cli.completion import ALL
from tustinnet.cli.files import list_input_files
from tustinnet.cli.free_runs import choose_free_runs
from tustinnet.cli.models import load_model
from tustinnet.cli.records import load_records
from tustinnet.errors import InputError
from tustinnet.evaluate import bands
from tustinnet.store import files as disk
from tustinnet.store import kept_system, model_file
from tustinnet.wording import counted


def calibrate(
    model: options.Model,
    data: options.Data,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File for the calibrated model (.safetensors).")
    ],
    split: options.Split = None,
    start: options.JudgedStart = None,
    horizon: options.JudgedHorizon = None,
    card: options.Card = None,
    follow_links: options.FollowLinks = False,
    system: options.System = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Give a model bands around its free runs.

    The width of the bands follows from the errors on records that were not used to fit the model.
    """
    devices.prepare_jax()
    inputs = list_input_files(data, card, model, system)
    disk.require_outputs([out], overwrite=overwrite, read=inputs, endings=model_file.ENDINGS)
    system_copy = kept_system.find_system_copy(model)
    kept_system.require_copy_fits(system_copy, out.parent, [out])
    simulator = load_model(model, system)
    header = tn.read_header(model)
    others = bands.find_alternatives(simulator, header, model)
    runs = choose_free_runs(
        load_records(data, card, follow_links=follow_links),
        {model: simulator},
        split or ALL,
        start,
        horizon,
    )
    if runs.fitted:
        raise InputError(
            "calibrate",
            f"{', '.join(runs.fitted[:3])}, which {model} was fitted to",
            "records that it was not fitted to",
            "select them by --split",
        )
    records, start = runs.records, runs.start
    predictions = bands.predict(simulator, others, records, start, horizon=runs.horizon)
    calibration = bands.calibrate_bands(predictions, records, start, runs.horizon)
    model_file.copy_with_header(model, out, **{bands.KEY: calibration.as_header()})
    if system_copy is not None:
        kept_system.write_system_copy(system_copy, out.parent)
    runs.print_notes()
    if json:
        terminal.print_json(
            {
                "file": str(out),
                "start": start,
                "records": calibration.records,
                "highest_level": calibration.highest_level,
            }
        )
        return
    terminal.messages().print(
        f"{out}: bands from {counted(len(records), 'record')}, start '{start}'; "
        f"their highest level is {100 * calibration.highest_level:.1f} %"
    )
