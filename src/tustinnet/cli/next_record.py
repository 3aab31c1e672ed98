"""`tustinnet next-record`: ranks proposed records by the information that they would add."""

from pathlib import Path
from typing import Annotated

import typer

from tustinnet.cli import options, terminal


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
    from tustinnet.cli.request import load_model
    from tustinnet.data.proposals import read_proposals
    from tustinnet.evaluate.bands import find_alternatives
    from tustinnet.evaluate.next_record import rank_proposals
    from tustinnet.report.tables import Table, number
    from tustinnet.store.header import read_header

    simulator, header = load_model(model, system), read_header(model)
    # raises at once where the errors of the model are unknown
    find_alternatives(simulator, header, model)
    candidates = read_proposals(proposals, simulator.channels)
    ranking = rank_proposals(simulator, header, candidates, horizon=horizon)
    if json:
        terminal.print_json(ranking.as_plain())
        return
    rows = [[gain.name, number(gain.value), gain.words] for gain in ranking.gains]
    columns = ["proposal", f"gain [{ranking.unit}]", "largest effect"]
    terminal.print_tables(Table(columns, rows, title=f"By the {ranking.criterion}"))
    typer.echo(f"record next: {ranking.gains[0].name}")
