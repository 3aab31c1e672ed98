"""`tustinnet calibrate`: bands for a model."""

from pathlib import Path
from typing import Annotated

import typer

from tustinnet.cli import options, terminal


def calibrate(
    model: options.Model,
    data: options.Data,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File for the calibrated model (.safetensors).")
    ],
    split: options.Split = None,
    start: options.Start = None,
    horizon: options.Horizon = None,
    card: options.Card = None,
    system: options.System = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Give a model bands around its free runs.

    The width of the bands follows from the errors on records that were not used to fit the model.
    """
    terminal.prepare_jax()
    from tustinnet.cli.request import files_of, judged_records, model_of
    from tustinnet.errors import InputError
    from tustinnet.evaluate.bands import KEY, calibrate_bands, find_alternatives, predict
    from tustinnet.store.files import require_outputs
    from tustinnet.store.header import read_header, records_in_header
    from tustinnet.store.kept_system import find_system_copy, require_copy_fits, write_system_copy
    from tustinnet.store.model_file import ENDINGS, copy_with_header

    read = files_of(data, card, model, system)
    require_outputs([out], overwrite=overwrite, read=read, endings=ENDINGS)
    judged = model_of(model, system)
    header = read_header(model)
    others = find_alternatives(judged, header, model)
    records, begin = judged_records(data, card, split, start, [judged])
    made_from = records_in_header(header)
    if seen := [e.name for e in records if e.sha256 in made_from]:
        raise InputError(
            "calibrate", f"{', '.join(seen[:3])}, which {model} was made from",
            "records that it never saw", "name them by --split",
        )  # fmt: skip
    made = predict(judged, others, records, begin, horizon=horizon)
    found = calibrate_bands(made, records, begin, horizon)
    copy = find_system_copy(model)
    if not overwrite:
        require_copy_fits(copy, out.parent)
    copy_with_header(model, out, **{KEY: found.as_header()})
    if copy is not None:
        write_system_copy(copy, out.parent)
    if json:
        terminal.print_json({"file": str(out), "start": begin, "records": found.records,
                             "highest_level": found.highest_level})  # fmt: skip
        return
    terminal.messages().print(
        f"{out}: bands from {len(records)} records, start '{begin}'; they can promise at most "
        f"{100 * found.highest_level:.1f} %"
    )
