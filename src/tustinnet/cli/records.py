"""Records that verbs read, and what is said of them."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import tustinnet as tn
from tustinnet.cli import terminal
from tustinnet.cli.completion import ALL
from tustinnet.cli.files import list_input_files, require_apart
from tustinnet.cli.findings import assumed_lines, spoiled_lines, warning_lines
from tustinnet.data import catalog, inspection, loading
from tustinnet.simulate.start_names import DERIVED, parse_start
from tustinnet.store import files as disk
from tustinnet.store import run_folder
from tustinnet.wording import counted


def load_records_to_fit(data: str, card: Path | None, out: Path) -> "tn.DataSet":
    """Loads the records of a fit; prints which are left out, and what is wrong with the others."""
    console = terminal.messages()
    folder, located_card = catalog.locate(data, card)
    require_apart(out, folder)
    outputs = [
        out / name
        for name in (
            run_folder.MODEL,
            run_folder.SUMMARY,
            run_folder.LOG,
            run_folder.REPORT,
            run_folder.SPECIFICATION,
        )
    ]
    disk.require_outputs(outputs, overwrite=True, read=list_input_files(data, card))
    records = loading.load_folder(folder, located_card, on_message=console.print)
    kept = leave_out_short([*records], DERIVED.usual, ())
    records = replace(records, experiments=tuple(kept))
    findings = tn.check(records, located_card)
    lines = [*warning_lines(findings, len(records), data, card), *assumed_lines(findings)]
    for line in (*lines, *spoiled_lines(records, map(inspection.held_equilibrium, records))):
        console.print(line)
    return records


def load_records(data: str, card: Path | None, names: Collection[str] = ()) -> "tn.DataSet":
    """Loads the records of a verb that simulates them; prints which are left out.

    As a fit, it leaves out records that cannot be read or used, but not those of some names.
    """
    return loading.load_folder(
        *catalog.locate(data, card),
        on_message=terminal.messages().print,
        required=names,
    )


def print_still_coordinates(experiments: "Sequence[tn.Experiment]") -> None:
    """Prints the names of the coordinates that do not move in any training record."""
    for name in inspection.still_coordinates(experiments):
        terminal.messages().print(
            f"{name} never moves in the training records: nothing can be learnt of it"
        )


def records_of_split(data: "tn.DataSet", split: str | None) -> "tn.DataSet":
    """The records of a split; all of them for `all`, or without a split."""
    return data if split in (None, ALL) else data.split(split)


def leave_out_short(
    records: "list[tn.Experiment]", start: str, names: Sequence[str]
) -> "list[tn.Experiment]":
    """The records that are long enough for a start; prints which are left out.

    Those that were named stay, and all of a split where none is long enough.
    """
    _, fewest = parse_start(start)
    remaining = {e.split for e in records if len(e) >= fewest}
    kept = []
    for e in records:
        if len(e) >= fewest or e.name in names or e.split not in remaining:
            kept.append(e)
        else:
            terminal.messages().print(
                f"left out: {e.name}: {counted(len(e), 'sample')}; expected at least {fewest}"
            )
    return kept
