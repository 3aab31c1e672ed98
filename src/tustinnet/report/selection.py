"""Selections: the table of candidates, their figure, free runs of what was chosen."""

import math
from typing import TYPE_CHECKING

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.evaluate.scores import Score, evaluate
from tustinnet.report.some import some_of
from tustinnet.report.tables import Table, number, scale_of
from tustinnet.selection.choice import Choice
from tustinnet.selection.ranking import CandidateResult, paired_difference

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def candidates_table(choice: Choice) -> Table:
    """What was found of every candidate and committee, the best first, those left out last."""
    scored = _in_order(choice)
    best, starts = choice.result(choice.best), choice.starts
    told = {s.name: [mean_and_error(s.rmse(start=start).values()) if start in s.starts else None
                     for start in starts] for s in scored}  # fmt: skip
    scale = scale_of(mean[0] for of in told.values() for mean in of if mean is not None)
    rows = []
    for s in scored:
        than = paired_difference(s, best)
        scored_on = len(s.rmse())
        against = (
            "" if s is best else f"{_signed(than.mean, scale)} ± {_in(than.standard_error, scale)}"
        )
        if against and than.records != scored_on:
            against += f" (on {than.records})"
        means = [_plus_minus(mean, scale) for mean in told[s.name]]
        seeds = len({m.seed for m in s.models})
        rows.append([s.name, *means, against, str(scored_on), str(len(s.folds)), str(seeds),
                     f"{s.seconds:.0f}"])  # fmt: skip
    empty = [""] * (len(starts) + 4)
    rows += [
        [f"{s.name}: {s.why or 'not tried'}", *empty, f"{s.seconds:.0f}"]
        for s in choice.candidates.results
        if not s.folds
    ]
    unit = choice.unit
    columns = ["candidate", *[f"RMSE [{unit}], {start}" for start in starts],
               f"worse than {best.name} by", "records", "folds", "seeds", "seconds"]  # fmt: skip
    title = "free runs of records that a model was not fitted to, mean ± standard error"
    return Table(columns, rows, title=title)


def _in_order(choice: Choice) -> list[CandidateResult]:
    """Those that were scored: what could be chosen, the best first, then what was left behind."""
    choosable = [s.name for s in choice.candidates.choosable]
    best = choice.result(choice.best)

    def place(s: CandidateResult) -> tuple[bool, bool, float]:
        mean = paired_difference(s, best).mean
        return s is not best, s.name not in choosable, math.inf if math.isnan(mean) else mean

    return sorted((s for s in choice.candidates.all_results if s.folds), key=place)


def _in(value: float, scale: float) -> str:
    return number(value, scale=scale)


def _signed(value: float, scale: float) -> str:
    return ("+" if value >= 0 else "") + number(value, scale=scale)


def _plus_minus(mean: tuple[float, float] | None, scale: float) -> str:
    if mean is None:
        return ""
    return f"{_in(mean[0], scale)} ± {_in(mean[1], scale)}"


def candidates_figure(choice: Choice) -> "Figure":
    """Mean and standard error of every candidate, each record a point."""
    # the table of this module is printed before matplotlib is loaded
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    from tustinnet.report.figures import COLOURS, house_style

    scored = _in_order(choice)[::-1]
    with house_style():
        figure = Figure(figsize=(7.0, 0.42 * len(scored) + 1.3), layout="constrained")
        axes = figure.subplots()
        for i, s in enumerate(scored):
            values = [x for x in s.rmse().values() if math.isfinite(x)]
            mean, error = mean_and_error(values or [math.nan])
            chosen = s.name == choice.best
            colour = COLOURS[0] if chosen else COLOURS[4]
            axes.plot(values, [i] * len(values), "o", color=colour, alpha=0.3, markersize=3)
            axes.errorbar(mean, i, xerr=error, fmt="s", color=colour, capsize=3, markersize=5)
        axes.set_yticks(range(len(scored)), [s.name for s in scored])
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
    """Free runs to draw: by record and label, of models that were not fitted to the record.

    Of the chosen one and the simplest as good, those of the first seed; of a committee that of its
    largest part. At most 6 records: the worst, and others down to the best.
    """
    labels = dict.fromkeys([_largest(choice, choice.best), _largest(choice, choice.simplest)])
    wanted = some_of(choice.result(choice.best).rmse())
    found: dict[str, dict[str, Score]] = {}
    for label in labels:
        for models in choice.result(label).folds.values():
            first = models[0]
            start, rmse = next(iter(first.rmse.items()))
            records = [choice.context.data[name] for name in rmse if name in wanted]
            if not records:
                continue
            model, horizon = choice.context.load_model(first.model), choice.context.scoring.horizon
            for score in evaluate(model, records, start, horizon=horizon):
                found.setdefault(score.experiment, {})[label] = score
    return found


def _largest(choice: Choice, name: str) -> str:
    """A candidate, of a committee the one that counts most."""
    return max(choice.candidates.members(name), key=lambda member: member[1])[0].name
