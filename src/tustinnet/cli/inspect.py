"""`tustinnet inspect`: the contents of records, before anything is fitted."""

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet import channels
from tustinnet.check import report as check_report
from tustinnet.cli import options, terminal
from tustinnet.cli.files import list_input_files, require_figures
from tustinnet.cli.findings import describe_findings, merge_remarks, require_sound, spoiled_lines
from tustinnet.cli.records import records_of_split
from tustinnet.cli.verb import refuse_options
from tustinnet.data import card as cards
from tustinnet.data import catalog, loading, readers, spoiled
from tustinnet.data.drafting import draft as drafting
from tustinnet.report import drawing, tables
from tustinnet.report import figures as result_figures
from tustinnet.wording import counted

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
    split: options.Split = None,
    strict: options.Strict = False,
    json: options.Json = False,
    figure: _Figure = None,
    overwrite: options.Redraw = False,
) -> None:
    """Check the records: sampling, sensors, inputs, copies, and what they can tell."""
    if readers.is_readable(Path(data)) and not Path(data).is_dir():
        others = {
            "--card": card,
            "--split": split,
            "--strict": strict,
            "--figure": figure,
            "--overwrite": overwrite,
        }
        refuse_options(
            others,
            f"to the single file {data}",
            "a folder or a card",
            "omit it, or write a card first",
        )
        _inspect_file(Path(data), json=json)
        return
    inputs = list_input_files(data, card)
    require_figures("--figure", figure, inputs, overwrite=overwrite)
    folder, located_card = catalog.locate(data, card)
    data_set = loading.load_folder(folder, located_card)
    records = records_of_split(data_set, split)
    inspection = check_report.inspect_records(records, located_card)
    if json:
        experiments = [
            dataclasses.asdict(r)
            | {"spoiled": [part.as_plain() for part in spoiled.find_without_model(e, r.held)]}
            for e, r in zip(records, inspection.reports, strict=True)
        ]
        findings = [f.as_plain() for f in inspection.findings]
        terminal.print_json(
            {"data": data_set.name, "experiments": experiments, "findings": findings}
        )
    else:
        _print_inspection(records, inspection)
    if figure is not None:
        image = result_figures.inspection_figure(list(records), list(inspection.reports))
        drawing.write_figure(image, figure.parent, figure.name)
        terminal.messages().print(f"figure: {figure}")
    if strict:
        require_sound(inspection.findings)


def print_inspection(data: "tn.DataSet", card: "cards.Card | None" = None) -> None:
    """Prints the inspection of all records of a data set."""
    _print_inspection(data, check_report.inspect_records(data, card))


def _print_inspection(records: "tn.DataSet", inspection: "check_report.Inspection") -> None:
    """Prints two tables, the findings by severity, and a line for each remark."""
    reports = list(inspection.reports)
    terminal.print_tables(time_table(reports), _channel_table(reports, records.channels.unit))
    unstable = (
        (
            r.name,
            f"holds an unstable position from {r.held.sample * r.dt:.1f} s on (errors grow "
            f"e-fold in {r.held.e_fold:.2g} s): score it over a horizon",
        )
        for r in reports
        if r.held
    )
    holds = (
        (
            r.name,
            f"{i.name} has power above a tenth of the sampling rate: its course between "
            f"samples decides the simulation ({_hold_advice(i.hold)})",
        )
        for r in reports
        for i in r.inputs
        if i.hold_matters
    )
    # the table has the jitter
    notes = ((r.name, text) for r in reports for text in r.notes if "jitter" not in text)
    for line in (
        *describe_findings(inspection.findings, len(reports)),
        *merge_remarks("held", unstable, len(reports)),
        *merge_remarks("hold", holds, len(reports)),
        *merge_remarks("note", notes, len(reports)),
        *spoiled_lines(records, [r.held for r in reports]),
    ):
        terminal.echo(line)


def _hold_advice(hold: "channels.Hold | None") -> str:
    """The way to the hold of an input whose card declares it, declares `unknown`, or none."""
    if hold is None:
        return "no hold declared: `fit` and `cross-validate` determine it"
    if hold == "unknown":
        return 'hold = "unknown": `fit` and `cross-validate` determine it'
    return f'hold = "{hold}" as declared; without this key `fit` determines it'


def _inspect_file(path: Path, *, json: bool) -> None:
    """Prints the contents of a file that no card describes, and the draft of a card."""
    draft = drafting.draft_file(path)
    if json:
        terminal.print_json({"name": path.name} | draft_as_plain(draft))
        return
    rows = [
        [c.name, c.role, _range_text(r) if r else "–", str(c.numbers.distinct or "–"), c.because]
        for c in draft.columns
        for r in [c.numbers.range]
    ]
    rows += [[name, "no numbers", "–", "–", text] for name, text in draft.texts.items()]
    sampling = "no column of times found"
    if draft.clock.column is not None:
        worst = f"{1e3 * draft.clock.worst:.3g} ms"
        sampling = f"every {1e3 * draft.dt:.4g} ms, worst deviation {worst}"
    title = f"{path.name}: {counted(draft.rows, 'row')}; {sampling}; roles are guesses"
    terminal.print_tables(
        tables.Table(["column", "looks like", "range", "values", "why"], rows, title)
    )
    for note in draft.notes:
        terminal.echo(f"note: {note}")
    terminal.echo(
        "\n# draft of a card; save it as dataset.toml beside the file. For all logs of the "
        f"folder: tustinnet init {path.parent}\n{draft.text}"
    )


def draft_as_plain(draft: "tn.Draft") -> dict[str, object]:
    """A draft as plain values."""
    return {
        "text": draft.text,
        "columns": [
            {
                "name": c.name,
                "role": c.role,
                "use": c.use,
                "unit": c.unit,
                "range": c.numbers.range,
                "because": c.because,
            }
            for c in draft.columns
        ],
        "assumed": {q.text: q.assumption for q in draft.questions},
        "notes": list(draft.notes),
    }


def time_table(reports: list["check_report.ExperimentReport"]) -> "tables.Table":
    """Table of period, jitter, gaps, share at rest and end of the transient of every record."""
    columns = [
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
    ]
    rows = [
        [
            r.name,
            r.split or "–",
            str(r.samples),
            f"{r.seconds:.2f}",
            f"{1e3 * r.dt:.4g}",
            f"{1e3 * r.recording.median_dt:.4g}",
            f"{round(1e6 * r.recording.jitter, 3):.3g}",
            str(len(r.recording.gaps)),
            f"{r.rest_share:.0%}",
            f"{r.k_bar}{' (card)' if r.k_bar_declared else ''}",
        ]
        for r in reports
    ]
    title = "Time: period on the grid and in the log, share at rest, end of the transient"
    return tables.Table(columns, rows, title=title)


def _channel_table(reports: list["check_report.ExperimentReport"], unit: str) -> "tables.Table":
    """Table of the ranges of positions and inputs of every record."""
    rows = []
    for r in reports:
        for c in r.coordinates:
            count = f"{c.count:.6g}" if c.count else "–"
            rows.append([r.name, c.name, _range_text(c.range), count, "", "", ""])
        for i in r.inputs:
            band = "–" if i.bandwidth is None else f"{i.bandwidth:.3g}"
            size = [f"{i.rms:.3g}", band, f"{i.saturated:.1%}"]
            rows.append([r.name, i.name, _range_text(i.range), "", *size])
    return tables.Table(
        ["record", "channel", "range", "count", "rms", "90 % below [Hz]", "at its ends"],
        rows,
        title=f"Channels: positions in {unit}, inputs in their unit",
    )


def _range_text(limits: tuple[float, float]) -> str:
    low, high = (value + 0.0 for value in limits)  # no negative zeros
    return f"{low:.3g} .. {high:.3g}"
