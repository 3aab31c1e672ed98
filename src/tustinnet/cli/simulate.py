"""`tustinnet simulate`: free runs as files."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from tustinnet.report.tables import Table


_Records = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="Only this record; may be repeated.")
]


def simulate(
    model: options.Model,
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the simulations, as CSV.")],
    split: options.Split = None,
    experiment: _Records = None,
    start: options.Start = None,
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
    terminal.prepare_jax()
    from tustinnet.cli.request import make_band_options, bands_of, list_input_files, model_of
    from tustinnet.data.catalog import load
    from tustinnet.evaluate.scores import evaluate
    from tustinnet.report.extrapolation import extrapolation_content, describe_extrapolation
    from tustinnet.simulate.range import Range
    from tustinnet.simulate.starts import default_start
    from tustinnet.store.files import require_outputs, require_writable_folder
    from tustinnet.store.header import read_header
    from tustinnet.store.simulation_file import simulation_name, write_simulation

    asked = make_band_options(band, whole=whole_records)
    simulator = model_of(model, system)
    loaded = load(data, card)
    chosen = loaded if split is None else loaded.split(split)
    records = [chosen[name] for name in experiment] if experiment else list(chosen)
    paths = [out / simulation_name(e) for e in records]
    read = list_input_files(data, card, model, system)
    require_outputs(paths, overwrite=overwrite, read=read)
    begin = default_start(records, simulator) if start is None else start
    scores = evaluate(simulator, records, begin)
    none = [None] * len(records)
    bands = none if asked is None else bands_of(model, simulator, records, scores, asked)
    require_writable_folder(out)
    known, written = Range.from_header(read_header(model), simulator), []
    for e, score, around, path in zip(records, scores, bands, paths, strict=True):
        write_simulation(out, e, score.simulated, around)
        left = None if known is None else known.left(simulator.channels, score.simulated, e.u)
        written.append({"experiment": e.name, "rmse": score.rmse, "file": str(path),
                        "left": None if left is None else extrapolation_content(left, e)})  # fmt: skip
        if left is not None:
            terminal.messages().print(f"note: {e.name}: {describe_extrapolation(left, e)}")
    if json:
        terminal.print_json({"start": begin, "simulations": written})
        return
    terminal.print_tables(_table(written, begin))


def _table(written: list[dict[str, Any]], start: str) -> "Table":
    from tustinnet.report.tables import Table, number

    rows = [[w["experiment"], number(w["rmse"]), w["file"]] for w in written]
    return Table(["record", "RMSE", "file"], rows, title=f"Free runs, start '{start}'")
