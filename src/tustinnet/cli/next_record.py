"""`tustinnet next-record`: which of some proposed records would tell the most."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from tustinnet.evaluate.next_record import ProposalRanking
    from tustinnet.report.tables import Table


def next_record(
    model: options.Model,
    proposals: Annotated[
        Path, typer.Argument(metavar="PROPOSALS", help="TOML file of records that could be made.")
    ],
    horizon: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="For a committee: compare members over segments of this length. Default: whole "
            "records.",
        ),
    ] = None,
    system: options.System = None,
    json: options.Json = False,
) -> None:
    """Rank proposed records by how much a model would gain.

    PROPOSALS has tables [[proposals]] with name, start (initial values by coordinate), and either
    seconds (without inputs) or inputs (a file with a column for each input). The first record of
    the ranking should be recorded next.
    """
    terminal.prepare_jax()
    from tustinnet.cli.request import model_of
    from tustinnet.data.proposals import read_proposals
    from tustinnet.evaluate.bands import find_alternatives
    from tustinnet.evaluate.next_record import rank_proposals
    from tustinnet.store.header import read_header

    judged, header = model_of(model, system), read_header(model)
    find_alternatives(judged, header, model)  # says at once what knows nothing of its errors
    asked = read_proposals(proposals, judged.channels)
    found = rank_proposals(judged, header, asked, horizon=horizon)
    if json:
        terminal.print_json(found.as_plain())
        return
    terminal.print_tables(_table(found))
    typer.echo(f"record next: {found.gains[0].name}")


def _table(found: "ProposalRanking") -> "Table":
    from tustinnet.report.tables import Table, number

    rows = [[of.name, number(of.value), of.words] for of in found.gains]
    columns = ["proposal", f"tells [{found.unit}]", "most of all"]
    return Table(columns, rows, title=f"By the {found.criterion}")
