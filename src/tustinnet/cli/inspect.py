"""`tustinnet inspect`: what the records hold, before anything is fitted."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from tustinnet.data.inspection import ExperimentReport
    from tustinnet.report.tables import Table


def inspect(
    data: options.Data,
    card: options.Card = None,
    split: options.Split = None,
    json: options.Json = False,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the records (.png, .svg, .pdf).")
    ] = None,
) -> None:
    """Look at the records: time base, encoders, inputs, rest, suspicious rows."""
    import dataclasses

    from tustinnet.data.catalog import load
    from tustinnet.data.inspection import inspect_experiment

    loaded = load(data, card)
    records = loaded.split(split) if split else loaded
    reports = [inspect_experiment(e) for e in records]
    if figure is not None:
        from tustinnet.report.figures import inspection_figure, write_figure

        write_figure(inspection_figure(list(records), reports), figure)
        terminal.messages().print(f"figure: {figure}")
    if json:
        terminal.print_json(
            {"data": loaded.name, "experiments": [dataclasses.asdict(r) for r in reports]}
        )
        return
    terminal.print_tables(_time_table(reports), _channel_table(reports))
    remarks = _remarks(reports)
    for line in remarks:
        typer.echo(line)


def _time_table(reports: list["ExperimentReport"]) -> "Table":
    from tustinnet.report.tables import Table

    columns = ["record", "split", "samples", "s", "dt [ms]", "recorded [ms]", "jitter [us]", "gaps"]
    return Table(
        [*columns, "at rest", "k_bar"],
        [
            [
                r.name,
                r.split or "–",
                str(r.samples),
                f"{r.seconds:.2f}",
                f"{1e3 * r.dt:.4g}",
                f"{1e3 * r.recording.median_dt:.4g}",
                f"{1e6 * r.recording.jitter:.3g}",
                str(len(r.recording.gaps)),
                f"{r.rest_share:.0%}",
                f"{r.k_bar}{' (card)' if r.k_bar_declared else ''}",
            ]
            for r in reports
        ],
        title="Time and transients",
    )


def _channel_table(reports: list["ExperimentReport"]) -> "Table":
    from tustinnet.report.tables import Table

    first = reports[0]
    columns = ["record"]
    for c in first.coordinates:
        columns += [f"{c.name} range", f"{c.name} count"]
    for i in first.inputs:
        columns += [f"{i.name} rms", "90 % below [Hz]", "saturated"]
    rows = []
    for r in reports:
        row = [r.name]
        for c in r.coordinates:
            row += [f"{c.range[0]:.3g}..{c.range[1]:.3g}", f"{c.count:.6g}" if c.count else "–"]
        for i in r.inputs:
            band = "–" if i.bandwidth is None else f"{i.bandwidth:.3g}"
            row += [f"{i.rms:.3g}", band, f"{i.saturated:.1%}"]
        rows.append(row)
    return Table(columns, rows, title="Coordinates and inputs (rad or m; inputs in their unit)")


def _remarks(reports: list["ExperimentReport"]) -> list[str]:
    """Remarks, those that many records share told once."""
    by_text: dict[str, list[str]] = {}
    for r in reports:
        for text in r.suspicious:
            by_text.setdefault(f"suspicious: {text}", []).append(r.name)
        for text in r.notes:
            if "jitter" not in text:  # the table has it
                by_text.setdefault(f"note: {text}", []).append(r.name)
    return [f"{text}  [{', '.join(names)}]" for text, names in sorted(by_text.items())]
