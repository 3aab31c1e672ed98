"""`tustinnet inspect`: what the records hold, before anything is fitted."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, request, terminal

if TYPE_CHECKING:
    from tustinnet.data.inspection import ExperimentReport, InputReport
    from tustinnet.report.tables import Table

_Figure = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Draw the records (.png, .svg, .pdf).")
]


def inspect(
    data: Annotated[
        str,
        typer.Argument(
            metavar="DATA",
            help="Folder of logs with its data card dataset.toml, a data card, the name of known "
            "data (qube-servo2), or a single file of columns, for which a card is drafted.",
        ),
    ],
    card: options.Card = None,
    split: options.Split = None,
    strict: options.Strict = False,
    json: options.Json = False,
    figure: _Figure = None,
    overwrite: options.Redraw = False,
) -> None:
    """Check the records: sampling, encoders, inputs, suspicious rows."""
    import dataclasses

    from tustinnet.data.catalog import load
    from tustinnet.data.inspection import inspect_experiment
    from tustinnet.data.readers import is_readable

    if is_readable(Path(data)) and not Path(data).is_dir():
        given = {"--card": card, "--split": split, "--strict": strict, "--figure": figure,
                 "--overwrite": overwrite}  # fmt: skip
        _look_at_file(Path(data), [name for name, value in given.items() if value], json=json)
        return
    request.require_figures("--figure", figure, request.list_input_files(data, card), overwrite=overwrite)
    loaded = load(data, card)
    records = loaded if split is None else loaded.split(split)
    reports = [inspect_experiment(e) for e in records]
    if strict:
        require_sound(reports)
    if json:
        terminal.print_json(
            {"data": loaded.name, "experiments": [dataclasses.asdict(r) for r in reports]}
        )
    else:
        _print(reports, loaded.channels.unit)
    if figure is not None:
        from tustinnet.report.figures import inspection_figure, write_figure

        write_figure(inspection_figure(list(records), reports), figure.parent, figure.name)
        terminal.messages().print(f"figure: {figure}")


def _print(reports: "list[ExperimentReport]", unit: str) -> None:
    """Two tables, and a line for each remark."""
    import itertools

    terminal.print_tables(time_table(reports), _channel_table(reports, unit))
    # the table has the jitter
    notes = ((r.name, text) for r in reports for text in r.notes if "jitter" not in text)
    held = (
        (r.name, f"holds an unstable position from {r.held.sample * r.dt:.1f} s on (errors grow "
         f"e-fold in {r.held.e_fold:.2g} s): score it over a horizon")
        for r in reports if r.held
    )  # fmt: skip
    holds = ((r.name, _hold_told(i)) for r in reports for i in r.inputs if i.hold_matters)
    told = (_lines("held", held), _lines("hold", holds), _lines("note", notes))
    for line in (*suspicions(reports), *itertools.chain(*told)):
        typer.echo(line)


def _hold_told(report: "InputReport") -> str:
    return (
        f"{report.name} has power above a tenth of the sampling rate: what it does between samples "
        f'decides the simulation (hold = "{report.hold or "zero-order"}"; others: first-order, '
        'band-limited; or "unknown", and fit of a grey box tries them)'
    )


def _look_at_file(path: Path, options_given: list[str], *, json: bool) -> None:
    """Prints what a file holds that no card describes, and the draft of a card."""
    import dataclasses

    from tustinnet.data.file_inspection import inspect_file
    from tustinnet.errors import InputError
    from tustinnet.report.tables import Table

    if options_given:
        raise InputError(
            options_given[0], f"means nothing to the single file {path}", "a folder or a card",
            "leave it out, or write a card first",
        )  # fmt: skip
    found = inspect_file(path)
    if json:
        terminal.print_json(dataclasses.asdict(found))
        return
    rows = [
        [c.name, c.role, _range(c.range) if c.range else "–", str(c.distinct or "–"), c.remark]
        for c in found.columns
    ]
    sampling = "no column of times found"
    if found.dt is not None and found.jitter is not None:
        sampling = f"every {1e3 * found.dt:.4g} ms, worst deviation {1e3 * found.jitter:.3g} ms"
    title = f"{found.name}: {found.rows} rows; {sampling}; roles are guesses"
    terminal.print_tables(Table(["column", "looks like", "range", "values", "why"], rows, title))
    for note in found.notes:
        typer.echo(f"note: {note}")
    typer.echo(f"\n# draft of a card, to be kept as dataset.toml beside the file\n{found.draft}")


def suspicions(reports: Iterable["ExperimentReport"]) -> list[str]:
    """What looks wrong in records, a line each, told once where many share it."""
    return _lines("suspicious", ((r.name, text) for r in reports for text in r.suspicious))


def require_sound(reports: Iterable["ExperimentReport"]) -> None:
    """Raises where something looks wrong in a record.

    Raises:
        InputError: the first such record, with the first thing that was found.
    """
    from tustinnet.errors import InputError

    for r in reports:
        if r.suspicious:
            raise InputError(
                f"record '{r.name}'", r.suspicious[0], "records in which nothing looks wrong",
                "repair it, or leave --strict out",
            )  # fmt: skip


def _lines(kind: str, remarks: Iterable[tuple[str, str]]) -> list[str]:
    by_text: dict[str, list[str]] = {}
    for name, text in remarks:
        by_text.setdefault(text, []).append(name)
    return [f"{kind}: {text}  [{', '.join(names)}]" for text, names in sorted(by_text.items())]


def time_table(reports: list["ExperimentReport"]) -> "Table":
    """Period, jitter, gaps, share at rest and end of the transient of every record."""
    from tustinnet.report.tables import Table

    return Table(
        [
            "record",
            "split",
            "n",
            "s",
            "dt [ms]",
            "log [ms]",
            "jitter [us]",
            "gaps",
            "rest",
            "k_bar",
        ],
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
        title="Time: period on the grid and in the log, share at rest, end of the transient",
    )


def _channel_table(reports: list["ExperimentReport"], unit: str) -> "Table":
    from tustinnet.report.tables import Table

    rows = []
    for r in reports:
        for c in r.coordinates:
            count = f"{c.count:.6g}" if c.count else "–"
            rows.append([r.name, c.name, _range(c.range), count, "", "", ""])
        for i in r.inputs:
            band = "–" if i.bandwidth is None else f"{i.bandwidth:.3g}"
            size = [f"{i.rms:.3g}", band, f"{i.saturated:.1%}"]
            rows.append([r.name, i.name, _range(i.range), "", *size])
    return Table(
        ["record", "channel", "range", "count", "rms", "90 % below [Hz]", "saturated"],
        rows,
        title=f"Channels: positions in {unit}, inputs in their unit",
    )


def _range(limits: tuple[float, float]) -> str:
    low, high = (value + 0.0 for value in limits)  # no negative zeros
    return f"{low:.3g} .. {high:.3g}"
