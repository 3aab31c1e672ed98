"""`tustinnet residuals`: tests of the errors of free runs."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal
from tustinnet.cli.files import list_input_files, require_figures
from tustinnet.cli.free_runs import choose_free_runs
from tustinnet.cli.models import load_model
from tustinnet.cli.records import load_records

if TYPE_CHECKING:
    from tustinnet.channels import Channels
    from tustinnet.evaluate.residuals import ResidualReport
    from tustinnet.report.tables import Table


def residuals(
    model: options.Model,
    data: options.Data,
    split: options.JudgedSplit = None,
    start: options.JudgedStart = None,
    horizon: options.JudgedHorizon = None,
    lags: Annotated[
        int, typer.Option(min=1, metavar="L", help="Largest lag of the correlations, in samples.")
    ] = 50,
    card: options.Card = None,
    follow_links: options.FollowLinks = False,
    system: options.System = None,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the correlations (.png, .svg, .pdf).")
    ] = None,
    overwrite: options.Redraw = False,
    json: options.Json = False,
) -> None:
    """Test the residuals of free runs.

    Their autocorrelation (whiteness) and their correlation with the inputs are compared with
    99 % bounds.
    """
    terminal.prepare_jax()
    from tustinnet.evaluate.residuals import residual_reports
    from tustinnet.report.residuals import downweighted_table, residual_figure
    from tustinnet.simulate.horizon import horizon_words
    from tustinnet.store.model_file import read_downweighted

    inputs = list_input_files(data, card, model, system)
    require_figures("--figure", figure, inputs, overwrite=overwrite)
    simulator = load_model(model, system)
    channels = simulator.channels
    runs = choose_free_runs(
        load_records(data, card, follow_links=follow_links),
        {model: simulator},
        split,
        start,
        horizon,
    )
    records, horizon = runs.records, runs.horizon
    reports = residual_reports(simulator, records, runs.start, lags, horizon=horizon)
    names = {e.name for e in records}
    downweighted = [s for s in read_downweighted(model) if s.record in names]
    title = f"Residuals of {len(records)} free runs, start '{runs.start}'{horizon_words(horizon)}"
    runs.print_notes()
    if json:
        coordinates = []
        for r in reports:
            content = {**dataclasses.asdict(r), "white": r.is_white}
            coordinates.append(
                {k: v.tolist() if hasattr(v, "tolist") else v for k, v in content.items()}
            )
        terminal.print_json(
            {
                **runs.as_plain(),
                "lags": lags,
                "coordinates": coordinates,
                "downweighted": [dataclasses.asdict(s) for s in downweighted],
            }
        )
    else:
        terminal.print_tables(_residual_table(reports, channels, title))
        if downweighted:
            terminal.print_tables(downweighted_table(downweighted))
        for r in reports:
            terminal.echo(f"{r.coordinate}: {r.sentence}")
    if figure is not None:
        from tustinnet.report.drawing import write_figure

        write_figure(residual_figure(reports, channels, title), figure.parent, figure.name)
        terminal.messages().print(f"figure: {figure}")


def _residual_table(
    reports: "Sequence[ResidualReport]", channels: "Channels", title: str
) -> "Table":
    """Table of size, whiteness and correlation with the inputs, a row for each coordinate."""
    from tustinnet.report.tables import Table, number

    rows = [
        [
            r.coordinate,
            number(r.rms),
            number(r.mean),
            number(float(r.autocorrelation[1])),
            number(r.white_bound),
            f"{100 * r.outside:.0f} %",
            *[f"{100 * share:.0f} %" for share in r.cross_outside],
        ]
        for r in reports
    ]
    crossed = [f"outside, {i.name}" for i in channels.inputs[: len(reports[0].cross)]]
    columns = ["coordinate", "RMS", "mean", "lag 1", "99 % bound", "outside, own", *crossed]
    return Table(columns, rows, title=title)
