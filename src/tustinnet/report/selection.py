"""Table and figure of the candidates of a selection, and free runs of the chosen one."""

import math
from typing import TYPE_CHECKING

import numpy as np

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.evaluate.scores import Score
from tustinnet.report.shown_records import choose_shown_records
from tustinnet.report.tables import Table, norm_words, number, scale_of
from tustinnet.selection.choice import Choice
from tustinnet.selection.ranking import CandidateResult, paired_difference

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def candidates_table(choice: Choice) -> Table:
    """Table of the candidates that have scores, the best first."""
    results = _sort_scored(choice)
    best, starts = choice.result(choice.best), choice.starts
    means = {
        s.name: [
            mean_and_error(s.rmse(start=start).values()) if start in s.starts else None
            for start in starts
        ]
        for s in results
    }
    scale = scale_of(mean[0] for cells in means.values() for mean in cells if mean is not None)

    def cell(mean: float, error: float) -> str:
        return f"{number(mean, scale=scale)} ± {number(error, scale=scale)}"

    def unexplained(s: CandidateResult) -> str:
        """Mean over the coordinates of the force that is not explained, empty where not known."""
        shares = list(s.unexplained.values())
        return f"{100 * float(np.mean(shares)):.2g}" if shares else ""

    lost = {s.name: sum(not x <= s.lost for x in s.rmse().values()) for s in results}
    rows, by_forces = [], any(s.unexplained for s in results)
    for s in results:
        difference, count = paired_difference(s, best), len(s.rmse())
        against = ""
        if s is not best:
            sign = "+" if difference.mean >= 0 else ""
            against = sign + cell(difference.mean, difference.standard_error)
            if difference.records < max(count, len(best.rmse())):
                against += f" (on {difference.records})"
        rows.append(
            [
                s.name,
                *["" if mean is None else cell(*mean) for mean in means[s.name]],
                against,
                *[unexplained(s)] * by_forces,
                f"{count}, {lost[s.name]} lost" if lost[s.name] else str(count),
                str(len(s.fits_by_fold)),
                f"{s.seconds:.0f}",
            ]
        )
    if choice.reference.mean < math.inf:
        mean = cell(*mean_and_error(choice.reference.rmse.values()))
        empty = [""] * (len(rows[0]) - 2 - len(starts))
        rows.append([f"({choice.reference.label})", mean, *[""] * (len(starts) - 1), *empty, ""])
    unit = choice.unit
    columns = [
        "candidate",
        *[f"RMSE [{unit}], {start}" for start in starts],
        f"worse than {best.name} by",
        *["unexplained force [%]"] * by_forces,
        "records",
        "folds",
        "seconds",
    ]
    title = "free runs of records that a model was not fitted to, mean ± standard error"
    title += norm_words(unit)
    if any(lost.values()):
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
        fits, horizon = choice.result(label).fits_by_fold, choice.context.scoring.horizon
        for name, score in choice.context.evaluate_folds(fits, horizon, shown_names).items():
            runs.setdefault(name, {})[label] = score
    return runs
