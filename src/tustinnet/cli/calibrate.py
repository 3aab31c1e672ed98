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
    from tustinnet.cli.request import list_input_files, load_records_and_start, model_of
    from tustinnet.errors import InputError
    from tustinnet.evaluate.bands import KEY, alternatives_of, calibrated, guesses
    from tustinnet.store.files import require_outputs
    from tustinnet.store.header import read_header, records_in
    from tustinnet.store.kept_system import keep, kept_with, require_room
    from tustinnet.store.model_file import ENDINGS, copy_with

    read = list_input_files(data, card, model, system)
    require_outputs([out], overwrite=overwrite, read=read, endings=ENDINGS)
    judged = model_of(model, system)
    header = read_header(model)
    others = alternatives_of(judged, header, model)
    records, begin = load_records_and_start(data, card, split, start, [judged])
    made_from = records_in(header)
    if seen := [e.name for e in records if e.sha256 in made_from]:
        raise InputError(
            "calibrate", f"{', '.join(seen[:3])}, which {model} was made from",
            "records that it never saw", "name them by --split",
        )  # fmt: skip
    made = guesses(judged, others, records, begin, horizon=horizon)
    found = calibrated(made, records, begin, horizon)
    copy = kept_with(model)
    if not overwrite:
        require_room(copy, out.parent)
    copy_with(model, out, **{KEY: found.as_header()})
    if copy is not None:
        keep(copy, out.parent)
    if json:
        terminal.print_json({"file": str(out), "start": begin, "records": found.records,
                             "highest_level": found.most})  # fmt: skip
        return
    terminal.messages().print(
        f"{out}: bands from {len(records)} records, start '{begin}'; they can promise at most "
        f"{100 * found.most:.1f} %"
    )
