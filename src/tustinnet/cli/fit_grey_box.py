"""`tustinnet fit --model euler-lagrange`: identify a grey-box model."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from tustinnet.cli import terminal

if TYPE_CHECKING:
    from tustinnet.data.dataset import DataSet
    from tustinnet.evaluation.free_run import Score
    from tustinnet.identification.result import Identification
    from tustinnet.identification.search import Settings
    from tustinnet.report.tables import Table


def fit_grey_box(
    data: "DataSet",
    system: str,
    settings: "Settings",
    fixed: Sequence[str],
    begin: Sequence[str],
    out: Path,
    *,
    overwrite: bool,
    json: bool,
    quiet: bool,
) -> None:
    """Identifies, writes model, summary and figures, prints parameters and findings."""
    from tustinnet.artifact.identification import require_free_folder, write_identification
    from tustinnet.evaluation.free_run import evaluate
    from tustinnet.identification.identify import identify
    from tustinnet.report.figures import write_figure
    from tustinnet.report.identification import correlation_figure
    from tustinnet.report.progress import IdentificationProgress
    from tustinnet.simulation.initial_state import default_start
    from tustinnet.systems.registry import load_system

    told = terminal.messages()
    chosen = load_system(system)
    require_free_folder(out, overwrite=overwrite)
    with IdentificationProgress(told, quiet=quiet) as progress:
        result = identify(
            data,
            chosen,
            settings=settings,
            fixed=_values("--fix", fixed, chosen.nominal()),
            start_values=_values("--begin", begin, chosen.nominal()),
            told=progress.told,
        )
    judged = "validation" if "validation" in data.splits else "train"
    records = list(data.split(judged) if data.splits else data)
    start = default_start(records)
    scores = evaluate(result.model, records, start)
    summary = write_identification(out, data, result, judged, start, scores)
    _draw(data, scores, out / "figures")
    write_figure(correlation_figure(result), out / "figures" / "correlation.png")
    if json:
        terminal.print_json(summary)
    else:
        terminal.print_tables(parameter_table(result), _score_table(scores, judged, start))
        for finding in result.findings:
            typer.echo(f"* {finding}")
        told_initial = (
            "chosen by the validation records" if settings.initial == "choose" else "asked"
        )
        typer.echo(
            f"initial states: {result.initial} ({told_initial}); condition "
            f"{result.condition:.3g}; {result.substeps} Runge-Kutta steps a period"
        )
        typer.echo(f"{result.outcome}; {result.seconds:.1f} s")
        typer.echo(f"model: {out / 'model.safetensors'}   figures: {out / 'figures'}")
    if not result.sound:
        told.print(f"error: {result.findings[0] if result.reversed_signs else result.outcome}")
        raise typer.Exit(1)


def parameter_table(result: "Identification") -> "Table":
    """Parameters with the errors to trust and those of J'J."""
    from tustinnet.report.tables import Table

    rows = []
    for e in result.estimates:
        at = f"at the {e.bound} end" if e.bound else ""
        digits = _digits(e.value, e.error)
        interval = "–"
        if e.interval:
            interval = f"{e.interval[0]:.{digits}g}..{e.interval[1]:.{digits}g}"
        rows.append(
            [
                e.name, f"{e.value:.{digits}g}", e.unit, _error(e.error), interval,
                _error(e.naive_error), f"{e.lower:.3g}..{e.upper:.3g} {at}".strip(),
            ]
        )  # fmt: skip
    rows += [[name, f"{value:.4g}", result.system.parameter(name).unit, "held", "", "", ""]
             for name, value in result.held.items()]  # fmt: skip
    columns = ["parameter", "value", "unit", "std. error", "95 %", "error of J'J", "range"]
    source = "how the records disagree" if result.trust == "records" else "J'J"
    return Table(columns, rows, title=f"{result.system.name}; standard errors from {source}")


def _digits(value: float, error: float | None) -> int:
    """Significant digits that show a value to a tenth of its error."""
    if not error or not value:
        return 4
    return int(min(max(4, math.ceil(math.log10(abs(value) / error)) + 2), 12))


def _error(value: float | None) -> str:
    return "–" if value is None else f"{value:.2g}"


def _score_table(scores: Sequence["Score"], judged: str, start: str) -> "Table":
    from tustinnet.evaluation.free_run import mean_rmse
    from tustinnet.report.tables import Table, number

    rows = [[s.experiment, number(s.rmse)] for s in scores]
    rows.append(["mean", number(mean_rmse(scores))])
    return Table(["record", "RMSE"], rows, title=f"{judged} free runs, start '{start}'")


def _values(option: str, given: Sequence[str], nominal: dict[str, float]) -> dict[str, float]:
    """`NAME=VALUE` gives a parameter a value, `NAME` its nominal one."""
    from tustinnet.errors import InputError

    values = {}
    for entry in given:
        name, _, text = entry.partition("=")
        if name in values:
            raise InputError(option, f"'{name}' twice", "once")
        try:
            values[name] = float(text) if text else nominal[name]
        except ValueError:
            raise InputError(option, f"'{entry}'", "NAME or NAME=NUMBER") from None
        except KeyError:
            raise InputError(
                option, f"no parameter '{name}'", f"one of {', '.join(nominal)}"
            ) from None
    return values


def _draw(data: "DataSet", scores: Sequence["Score"], folder: Path) -> None:
    from tustinnet.report.figures import free_run_figure, write_figure

    for score in scores:
        picture = free_run_figure(data[score.experiment], {"Euler-Lagrange": score})
        write_figure(picture, folder / f"{score.experiment}.png")
