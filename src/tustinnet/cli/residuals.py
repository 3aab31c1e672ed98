"""`tustinnet residuals`: what is left in the errors of the free runs."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from tustinnet.channels import Channels
    from tustinnet.evaluate.residuals import ResidualReport
    from tustinnet.report.tables import Table


def residuals(
    model: options.Model,
    data: options.Data,
    split: options.Split = None,
    start: options.Start = None,
    horizon: options.Horizon = None,
    lags: Annotated[
        int, typer.Option(min=1, metavar="L", help="Largest lag of the correlations, in samples.")
    ] = 50,
    card: options.Card = None,
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
    from tustinnet.cli.request import files_of, judged_records, model_of, require_figures
    from tustinnet.evaluate.residuals import residual_reports
    from tustinnet.report.residuals import downweighted_table, residual_figure
    from tustinnet.simulate.horizon import over
    from tustinnet.store.model_file import read_downweighted

    require_figures("--figure", figure, files_of(data, card, model, system), overwrite=overwrite)
    judged = model_of(model, system)
    records, begin = judged_records(data, card, split, start, [judged])
    reports = residual_reports(judged, records, begin, lags, horizon=horizon)
    names = {e.name for e in records}
    spoilt = [s for s in read_downweighted(model) if s.record in names]
    title = f"Residuals of {len(records)} free runs, start '{begin}'{over(horizon)}"
    if json:
        weights = [dataclasses.asdict(s) for s in spoilt]
        terminal.print_json(
            {
                "start": begin,
                "horizon": horizon,
                "lags": lags,
                "coordinates": [_plain(r) for r in reports],
                "downweighted": weights,
            }
        )
    else:
        terminal.print_tables(_table(reports, judged.channels, title))
        if spoilt:
            terminal.print_tables(downweighted_table(spoilt))
        for r in reports:
            typer.echo(f"{r.coordinate}: {r.sentence}")
    if figure is not None:
        from tustinnet.report.figures import write_figure

        write_figure(residual_figure(reports, judged.channels, title), figure.parent, figure.name)
        terminal.messages().print(f"figure: {figure}")


def _plain(report: "ResidualReport") -> dict[str, Any]:
    content = {**dataclasses.asdict(report), "white": report.is_white}
    return {k: v.tolist() if hasattr(v, "tolist") else v for k, v in content.items()}


def _table(reports: "Sequence[ResidualReport]", channels: "Channels", title: str) -> "Table":
    from tustinnet.report.tables import Table, number

    rows = [
        [
            r.coordinate, number(r.rms), number(r.mean), number(float(r.autocorrelation[1])),
            number(r.white_bound), f"{100 * r.outside:.0f} %",
            *[f"{100 * share:.0f} %" for share in r.cross_outside],
        ]
        for r in reports
    ]  # fmt: skip
    crossed = [f"outside, {i.name}" for i in channels.inputs[: len(reports[0].cross)]]
    columns = ["coordinate", "RMS", "mean", "lag 1", "99 % bound", "outside, own", *crossed]
    return Table(columns, rows, title=title)
