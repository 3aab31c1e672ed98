"""`tustinnet inspect`: the contents of records, before anything is fitted."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tustinnet.cli import options, request, terminal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tustinnet.channels import Hold
    from tustinnet.data.dataset import DataSet
    from tustinnet.data.experiment import Experiment
    from tustinnet.data.inspection import ExperimentReport
    from tustinnet.report.tables import Table

_MOST_NAMED, _FIRST_NAMED = 6, 3  # records that a line names: all of so many, or the first ones

_Figure = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Draw the records (.png, .svg, .pdf).")
]


def inspect(
    data: Annotated[
        str,
        typer.Argument(
            metavar="DATA",
            help="Folder of logs with its data card dataset.toml, a data card, the name of a "
            "published data set (qube-servo2), or a single file of columns, for which a card is "
            "drafted.",
        ),
    ],
    card: options.Card = None,
    follow_links: options.FollowLinks = False,
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
    from tustinnet.data.spoiled import find_without_model
    from tustinnet.errors import InputError

    if is_readable(Path(data)) and not Path(data).is_dir():
        others = {"--card": card, "--split": split, "--strict": strict, "--figure": figure,
                  "--overwrite": overwrite, "--follow-links": follow_links}  # fmt: skip
        for option, value in others.items():
            if value:
                raise InputError(
                    option, f"not applicable to the single file {data}", "a folder or a card",
                    "omit it, or write a card first",
                )  # fmt: skip
        _inspect_file(Path(data), json=json)
        return
    inputs = request.list_input_files(data, card)
    request.require_figures("--figure", figure, inputs, overwrite=overwrite)
    data_set = load(data, card, follow_links=follow_links)
    records = request.records_of_split(data_set, split)
    reports = [inspect_experiment(e) for e in records]
    if strict:
        require_sound(reports)
    if json:
        experiments = [
            dataclasses.asdict(r)
            | {"spoiled": [part.as_plain() for part in find_without_model(e, r)]}
            for e, r in zip(records, reports, strict=True)
        ]
        terminal.print_json({"data": data_set.name, "experiments": experiments})
    else:
        _print_reports(reports, data_set.channels.unit)
        for line in spoiled_lines(records, reports):
            typer.echo(line)
    if figure is not None:
        from tustinnet.report.figures import inspection_figure, write_figure

        write_figure(inspection_figure(list(records), reports), figure.parent, figure.name)
        terminal.messages().print(f"figure: {figure}")


def print_inspection(data: "DataSet") -> None:
    """Prints the inspection of all records of a data set."""
    from tustinnet.data.inspection import inspect_experiment

    _print_reports([inspect_experiment(e) for e in data], data.channels.unit)


def _print_reports(reports: "list[ExperimentReport]", unit: str) -> None:
    """Prints two tables, and a line for each remark."""
    terminal.print_tables(time_table(reports), _channel_table(reports, unit))
    unstable = (
        (r.name, f"holds an unstable position from {r.held.sample * r.dt:.1f} s on (errors grow "
         f"e-fold in {r.held.e_fold:.2g} s): score it over a horizon")
        for r in reports if r.held
    )  # fmt: skip
    holds = (
        (r.name, f"{i.name} has power above a tenth of the sampling rate: its course between "
         f"samples decides the simulation ({_hold_advice(i.hold)})")
        for r in reports for i in r.inputs if i.hold_matters
    )  # fmt: skip
    # the table has the jitter
    notes = ((r.name, text) for r in reports for text in r.notes if "jitter" not in text)
    for line in (
        *suspicions(reports),
        *_merge_remarks("held", unstable, len(reports)),
        *_merge_remarks("hold", holds, len(reports)),
        *_merge_remarks("note", notes, len(reports)),
    ):
        typer.echo(line)


def _hold_advice(hold: "Hold | None") -> str:
    """The way to the hold of an input whose card declares it, declares `unknown`, or none."""
    if hold is None:
        return "no hold declared: `fit` and `cross-validate` determine it"
    if hold == "unknown":
        return 'hold = "unknown": `fit` and `cross-validate` determine it'
    return f'hold = "{hold}" as declared; without this key `fit` determines it'


def _inspect_file(path: Path, *, json: bool) -> None:
    """Prints the contents of a file that no card describes, and the draft of a card."""
    import dataclasses

    from tustinnet.data.file_inspection import inspect_file
    from tustinnet.report.tables import Table

    report = inspect_file(path)
    if json:
        terminal.print_json(dataclasses.asdict(report))
        return
    rows = [
        [c.name, c.role, _range_text(c.range) if c.range else "–", str(c.distinct or "–"), c.remark]
        for c in report.columns
    ]
    sampling = "no column of times found"
    if report.dt is not None and report.jitter is not None:
        sampling = f"every {1e3 * report.dt:.4g} ms, worst deviation {1e3 * report.jitter:.3g} ms"
    title = f"{report.name}: {report.rows} rows; {sampling}; roles are guesses"
    terminal.print_tables(Table(["column", "looks like", "range", "values", "why"], rows, title))
    for note in report.notes:
        typer.echo(f"note: {note}")
    typer.echo("\n# draft of a card; save it as dataset.toml beside the file. For all logs of the "
               f"folder: tustinnet init {path.parent}\n{report.draft}")  # fmt: skip


def suspicions(reports: "Sequence[ExperimentReport]") -> list[str]:
    """Lines about suspicious rows in records; each remark once, with the names of its records."""
    remarks = ((r.name, text) for r in reports for text in r.suspicious)
    return _merge_remarks("suspicious", remarks, len(reports))


def spoiled_lines(
    records: "Iterable[Experiment]", reports: "Iterable[ExperimentReport]"
) -> list[str]:
    """Lines about parts of records that spoil a fit and show without a model."""
    from tustinnet.data.spoiled import find_without_model

    return [
        f"spoiled: {part.sentence}"
        for e, report in zip(records, reports, strict=True)
        for part in find_without_model(e, report)
    ]


def require_sound(reports: Iterable["ExperimentReport"]) -> None:
    """Raises an error with the first remark on suspicious rows, if there are any."""
    from tustinnet.errors import InputError

    for r in reports:
        if r.suspicious:
            raise InputError(
                f"record '{r.name}'", r.suspicious[0], "records without suspicious rows",
                "repair it, or omit --strict",
            )  # fmt: skip


def _merge_remarks(kind: str, remarks: Iterable[tuple[str, str]], total: int) -> list[str]:
    """Lines of remarks: one line for each text, with its records.

    Args:
        kind: what the lines begin with.
        remarks: pairs of record and text.
        total: number of all records.
    """
    by_text: dict[str, list[str]] = {}
    for name, text in remarks:
        by_text.setdefault(text, []).append(name)
    return [
        f"{kind}: {text}  [{_list_records(names, total)}]"
        for text, names in sorted(by_text.items())
    ]


def _list_records(names: "Sequence[str]", total: int) -> str:
    """Names of records in a line; of many the first ones, and how many others."""
    if len(names) <= _MOST_NAMED:
        return ", ".join(names)
    if len(names) == total:
        return f"all {total} records"
    return f"{', '.join(names[:_FIRST_NAMED])} and {len(names) - _FIRST_NAMED} others"


def time_table(reports: list["ExperimentReport"]) -> "Table":
    """Table of period, jitter, gaps, share at rest and end of the transient of every record."""
    from tustinnet.report.tables import Table

    columns = ["record", "split", "n", "s", "dt [ms]", "log [ms]", "jitter [us]", "gaps", "rest",
               "k_bar"]  # fmt: skip
    rows = [
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
    ]
    title = "Time: period on the grid and in the log, share at rest, end of the transient"
    return Table(columns, rows, title=title)


def _channel_table(reports: list["ExperimentReport"], unit: str) -> "Table":
    """Table of the ranges of positions and inputs of every record."""
    from tustinnet.report.tables import Table

    rows = []
    for r in reports:
        for c in r.coordinates:
            count = f"{c.count:.6g}" if c.count else "–"
            rows.append([r.name, c.name, _range_text(c.range), count, "", "", ""])
        for i in r.inputs:
            band = "–" if i.bandwidth is None else f"{i.bandwidth:.3g}"
            size = [f"{i.rms:.3g}", band, f"{i.saturated:.1%}"]
            rows.append([r.name, i.name, _range_text(i.range), "", *size])
    return Table(
        ["record", "channel", "range", "count", "rms", "90 % below [Hz]", "saturated"],
        rows,
        title=f"Channels: positions in {unit}, inputs in their unit",
    )


def _range_text(limits: tuple[float, float]) -> str:
    low, high = (value + 0.0 for value in limits)  # no negative zeros
    return f"{low:.3g} .. {high:.3g}"
