"""Frame, table and figure of the candidates of a selection, and free runs of the chosen one."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.evaluate.scores import Score
from tustinnet.report.shown_records import choose_shown_records
from tustinnet.report.tables import Table, norm_words, number, scale_of
from tustinnet.selection.choice import Choice
from tustinnet.selection.ranking import CandidateResult, paired_difference
from tustinnet.store.files import write_into
from tustinnet.store.run_folder import TABLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SMALL = 1e-4  # below it errors have an exponent


def candidates_frame(choice: Choice) -> pl.DataFrame:
    """Frame of the candidates that have scores, the best first, and of the trivial predictor.

    `difference` is how much worse than the chosen one a candidate is on the records of both.
    """
    best, rows = choice.result(choice.best), []
    for s in _sort_scored(choice):
        difference, shares = paired_difference(s, best), list(s.unexplained.values())
        row: dict[str, Any] = {"name": s.name, "is_chosen": s is best}
        row |= dict(zip(("rmse", "standard_error"), mean_and_error(s.rmse().values()), strict=True))
        row |= {
            "start": s.start,
            "difference": difference.mean,
            "difference_error": difference.standard_error,
            "difference_records": difference.records,
            "unexplained": float(np.mean(shares)) if shares else None,
            "records": len(s.rmse()),
            "lost": sum(not x <= s.lost for x in s.rmse().values()),
            "folds": len(s.fits_by_fold),
            "seconds": s.seconds,
        }
        rows.append(row)
    if choice.reference.mean < math.inf:
        mean, error = mean_and_error(choice.reference.rmse.values())
        label = f"({choice.reference.label})"
        rows.append({"name": label, "is_chosen": False, "rmse": mean, "standard_error": error})
    return pl.DataFrame(rows, infer_schema_length=None)


def write_table(choice: Choice) -> None:
    """Writes the table of the candidates with the findings into the folder of a choice."""
    findings = "".join(f"* {finding}\n" for finding in choice.findings)
    write_into(choice.context.folder, TABLE, f"{candidates_table(choice).markdown()}\n{findings}")


def candidates_table(choice: Choice) -> Table:
    """Table of the candidates that have scores, the best first."""
    candidates = candidates_frame(choice).rows(named=True)
    by_forces = any(c["unexplained"] is not None for c in candidates)

    def cell(mean: float | None, error: float) -> str:
        if mean is None:
            return ""
        # errors of candidates differ by many powers of ten
        scale = scale_of([mean, error])
        if 0 < scale < _SMALL:
            return f"{mean:.3g} ± {error:.2g}"
        return f"{number(mean, scale=scale)} ± {number(error, scale=scale)}"

    def against_best(c: dict[str, Any]) -> str:
        if c["is_chosen"] or c["difference"] is None or math.isinf(c["difference"]):
            return ""
        sign = "+" if c["difference"] >= 0 else ""
        shared, most = c["difference_records"], max(c["records"], candidates[0]["records"])
        on_fewer = f" (on {shared})" if shared < most else ""
        return sign + cell(c["difference"], c["difference_error"]) + on_fewer

    def text(value: float | None, factor: float = 1, digits: str = "d") -> str:
        return "" if value is None else f"{factor * value:{digits}}"

    rows = [
        [
            c["name"],
            cell(c["rmse"], c["standard_error"]),
            c["start"] or "",
            against_best(c),
            *[text(c["unexplained"], 100, ".2g")] * by_forces,
            text(c["records"]) + (f", {c['lost']} lost" if c["lost"] else ""),
            text(c["folds"]),
            text(c["seconds"], 1, ".0f"),
        ]
        for c in candidates
    ]
    unit = choice.unit
    columns = [
        "candidate",
        f"RMSE [{unit}]",
        "start",
        f"difference to {choice.best}",
        *["unexplained force [%]"] * by_forces,
        "records",
        "folds",
        "seconds",
    ]
    title = "free runs of records that a model was not fitted to, mean ± standard error"
    title += norm_words(unit)
    if any(c["lost"] for c in candidates):
        title += "; a lost one is further off than records move, and is compared as just that far"
    return Table(columns, rows, title=title)


def _sort_scored(choice: Choice) -> list[CandidateResult]:
    """Candidates with scores: the best first, those that cannot be chosen last."""
    choosable = [s.name for s in choice.candidates.choosable]
    best = choice.result(choice.best)

    def rank(s: CandidateResult) -> tuple[bool, bool, float]:
        mean = paired_difference(s, best).mean
        return s is not best, s.name not in choosable, math.inf if math.isnan(mean) else mean

    return sorted((s for s in choice.candidates.results if s.fits_by_fold), key=rank)


def candidates_figure(choice: Choice) -> "Figure":
    """Figure of mean and standard error of every candidate, with a point for each record."""
    # the table of this module is printed before matplotlib is loaded
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    from tustinnet.report.drawing import COLOURS, figure_style

    results = _sort_scored(choice)[::-1]
    with figure_style():
        figure = Figure(figsize=(7.0, 0.42 * len(results) + 1.3), layout="constrained")
        axes = figure.subplots()
        for i, s in enumerate(results):
            values = [x for x in s.rmse().values() if math.isfinite(x)]
            mean, error = mean_and_error(values or [math.nan])
            colour = COLOURS[0] if s.name == choice.best else COLOURS[4]
            axes.plot(values, [i] * len(values), "o", color=colour, alpha=0.3, markersize=3)
            axes.errorbar(mean, i, xerr=error, fmt="s", color=colour, capsize=3, markersize=5)
        axes.set_yticks(range(len(results)), [s.name for s in results])
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel(f"free-run RMSE [{choice.unit}] of records not fitted to")
        axes.set_title(
            f"{choice.context.data.name}: mean, standard error, each record a point", loc="left"
        )
        axes.grid(visible=False, axis="y")
    return figure


def free_runs(choice: Choice) -> dict[str, dict[str, Score]]:
    """Free runs to draw, by record and label, of models that were not fitted to the record.

    They are those of the chosen candidate and of the simplest that is as good. At most 6 records
    are drawn, from the worst to the best.
    """
    labels = dict.fromkeys((choice.best, choice.simplest))
    shown_names = choose_shown_records(choice.result(choice.best).rmse())
    runs: dict[str, dict[str, Score]] = {}
    for label in labels:
        result, context = choice.result(label), choice.context
        scores = context.evaluate_folds(
            result.fits_by_fold, result.start, context.scoring.horizon, shown_names
        )
        for name, score in scores.items():
            runs.setdefault(name, {})[label] = score
    return runs
