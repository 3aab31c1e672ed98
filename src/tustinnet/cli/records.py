"""Records that verbs read, and what is said of them."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tustinnet.cli import terminal
from tustinnet.cli.completion import ALL
from tustinnet.cli.files import list_input_files, require_apart
from tustinnet.cli.findings import assumed_lines, require_sound, spoiled_lines, warning_lines
from tustinnet.wording import counted

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.data.dataset import DataSet
    from tustinnet.data.experiment import Experiment


def load_records_to_fit(
    data: str,
    card: Path | None,
    out: Path,
    console: "Console",
    *,
    strict: bool,
    follow_links: bool,
) -> "DataSet":
    """Loads the records of a fit; prints which are left out, or with `strict` refuses them."""
    from tustinnet.check.check import check
    from tustinnet.data.catalog import locate
    from tustinnet.data.inspection import held_equilibrium
    from tustinnet.data.loading import load_folder
    from tustinnet.simulate.start_rules import DerivedStart
    from tustinnet.store.files import require_outputs
    from tustinnet.store.run_folder import LOG, MODEL, REPORT, SPECIFICATION, SUMMARY

    folder, located_card = locate(data, card)
    require_apart(out, folder)
    outputs = [out / name for name in (MODEL, SUMMARY, LOG, REPORT, SPECIFICATION)]
    require_outputs(outputs, overwrite=True, read=list_input_files(data, card))
    records = load_folder(
        folder,
        located_card,
        on_message=None if strict else console.print,
        follow_links=follow_links,
    )
    if not strict:
        kept = leave_out_short([*records], DerivedStart.usual_name(), ())
        records = replace(records, experiments=tuple(kept))
    findings = check(records, located_card)
    if strict:
        require_sound(findings)
    lines = [*warning_lines(findings, len(records), data, card), *assumed_lines(findings)]
    for line in (*lines, *spoiled_lines(records, map(held_equilibrium, records))):
        console.print(line, highlight=False, soft_wrap=True)
    return records


def load_records(
    data: str, card: Path | None, names: "Collection[str]" = (), *, follow_links: bool
) -> "DataSet":
    """Loads the records of a verb that simulates them; prints which are left out.

    As a fit, it leaves out records that cannot be read or used, but not those of some names.
    """
    from tustinnet.data.catalog import locate
    from tustinnet.data.loading import load_folder

    return load_folder(
        *locate(data, card),
        on_message=terminal.messages().print,
        required=names,
        follow_links=follow_links,
    )


def print_still_coordinates(experiments: "Sequence[Experiment]", console: "Console") -> None:
    """Prints the names of the coordinates that do not move in any training record."""
    from tustinnet.data.inspection import still_coordinates

    for name in still_coordinates(experiments):
        console.print(f"{name} never moves in the training records: nothing can be learnt of it")


def records_of_split(data: "DataSet", split: str | None) -> "DataSet":
    """The records of a split; all of them for `all`, or without a split."""
    return data if split in (None, ALL) else data.split(split)


def leave_out_short(
    records: "list[Experiment]", start: str, names: Sequence[str]
) -> "list[Experiment]":
    """The records that are long enough for a start; prints which are left out.

    Those that were named stay, and all of a split where none is long enough.
    """
    from tustinnet.simulate.start_rules import start_named

    fewest = start_named(start).samples
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
