"""Tables of fits: members of a training, parameters of an identification, folds."""

import math
from collections.abc import Mapping, Sequence

from tustinnet.evaluate.scores import rmse_by_record
from tustinnet.fitting.report import Estimate, Identification
from tustinnet.report.tables import Table, number, numbers, scale_of
from tustinnet.selection.cross_validation import CrossValidationResult
from tustinnet.simulate.horizon import over
from tustinnet.store.run import Run


def members_table(run: Run) -> Table:
    """Every member of a training, and the spread where there are several."""
    unit, several = run.roles.train[0].channels.unit, len(run.members) > 1
    rows = [
        [
            of.result.member.name.removeprefix("seed-"),
            mean,
            " + ".join(map(str, of.result.told("windows"))),
            " + ".join(map(str, of.result.told("epochs"))),
            str(of.result.told("kept_epoch")),
            f"{of.result.seconds:.0f}",
            of.result.outcome.split(":")[0],
        ]
        for of, mean in zip(run.members, numbers([of.mean for of in run.members]), strict=True)
    ]
    if several:
        spread = run.spread()
        median, low, high = numbers([spread["median"], spread["min"], spread["max"]])
        whole = f"{sum(of.result.seconds for of in run.members):.0f} in all"
        rows.append(["median (range)", f"{median} ({low}..{high})", "", "", "", whole, ""])
    seconds = "share of seconds" if several else "seconds"
    return Table(
        ["seed", f"mean RMSE [{unit}]", "windows", "epochs", "kept", seconds, "outcome"],
        rows,
        title=f"{run.best.result.recipe.name}, {run.judging_split} free runs, start '{run.start}'"
        + over(run.best.scores[0].horizon),
    )


def parameter_table(result: Identification) -> Table:
    """Parameters with the errors to trust and those of J'J."""
    rows = [estimate_cells(e) for e in result.estimates]
    rows += [[name, f"{value:.4g}", result.system.parameter(name).unit, "fixed", "", "", ""]
             for name, value in result.fixed.items()]  # fmt: skip
    refined = result.refined and result.refined.values
    title = f"{result.system.name}; {estimates_title(result.trust, refined)}"
    return estimates_table(rows, refined, title)


ESTIMATE_COLUMNS = ("parameter", "value", "unit", "std. error", "95 %", "error of J'J", "range")


def estimates_table(
    rows: Sequence[Sequence[str]], refined: Mapping[str, float] | None, title: str = ""
) -> Table:
    """Rows of `ESTIMATE_COLUMNS`, and the values of the model where others than those found."""
    if refined is None:
        return Table(ESTIMATE_COLUMNS, rows, title)
    told = [[*row, f"{refined[row[0]]:.4g}" if row[0] in refined else row[1]] for row in rows]
    return Table((*ESTIMATE_COLUMNS, "in the model"), told, title)


def estimate_cells(e: Estimate) -> list[str]:
    """One parameter, a cell for each of `ESTIMATE_COLUMNS`."""
    at = f"at the {e.bound} end" if e.bound else ""
    digits = _digits(e.value, e.error)
    interval = "–"
    if e.interval:
        interval = f"{e.interval[0]:.{digits}g}..{e.interval[1]:.{digits}g}"
    return [
        e.name, f"{e.value:.{digits}g}", e.unit, _error(e.error), interval,
        _error(e.naive_error), f"{e.lower:.3g}..{e.upper:.3g} {at}".strip(),
    ]  # fmt: skip


def estimates_title(trust: str, refined: Mapping[str, float] | None) -> str:
    """Where errors are from, as `Identification.trust` names it, and which value is which."""
    source = "how the records disagree" if trust == "records" else "J'J"
    title = f"standard errors from {source}"
    if refined is not None:
        title += "; value: what the search found, in the model: fitted once more to free runs"
    return title


def place(e: Estimate, value: float) -> float:
    """Where a value stands in a parameter's range, 0..1; by logarithms where that is positive."""
    if e.lower > 0:
        share = math.log(max(value, e.lower) / e.lower) / math.log(e.upper / e.lower)
    else:
        share = (value - e.lower) / (e.upper - e.lower)
    return min(max(share, 0.0), 1.0)


def _digits(value: float, error: float | None) -> int:
    """Significant digits that show a value to a tenth of its error."""
    if not error or not value:
        return 4
    return int(min(max(4, math.ceil(math.log10(abs(value) / error)) + 2), 12))


def _error(value: float | None) -> str:
    return "–" if value is None else f"{value:.2g}"


def judged_table(run: Run) -> Table:
    """The free runs that judge the best model of a run."""
    best = run.best
    title = f"{run.judging_split} free runs, start '{run.start}'{over(best.scores[0].horizon)}"
    return _by_record({**rmse_by_record(best.scores), "mean": best.mean}, title)


def fitted_table(run: Run) -> Table:
    """What the best model of a run leaves of each training record."""
    found = run.best.result.identification
    begin = (
        f"free runs, start '{run.start}'{over(run.best.scores[0].horizon)}"
        if found is None
        else "from the initial states found"
        + (" by the search, with its values" if found.refined else "")
        + _scaled(run)
    )
    return _by_record(run.training_rmse, f"train, {begin}")


def _scaled(run: Run) -> str:
    """What an identification measures by, where its coordinates are angles and lengths."""
    kinds = {c.kind for c in run.roles.train[0].channels.coordinates}
    return ", each coordinate over its spread" if len(kinds) > 1 else ""


def _by_record(rmse: Mapping[str, float], title: str) -> Table:
    told = numbers(list(rmse.values()))
    return Table(["record", "RMSE"], [list(row) for row in zip(rmse, told, strict=True)], title)


def folds_table(found: CrossValidationResult) -> Table:
    """Every record's mean over the seeds, by start, and the means with their standard errors."""
    summary = found.summary()
    by_start = {start: found.means(start) for start in summary}
    folds = {s.record: s.fold for s in found.scores}
    scale = scale_of(value for means in by_start.values() for value in means.values())

    def told(value: float) -> str:
        return number(value, scale=scale)

    rows = [
        [record, str(fold), *[told(means[record]) for means in by_start.values()]]
        for record, fold in folds.items()
    ]
    means = [f"{told(s['mean'])} ± {told(s['standard_error'])}" for s in summary.values()]
    rows.append(["mean ± standard error", "", *means])
    seeds = [" ".join(told(x) for x in s["by_seed"].values()) for s in summary.values()]
    if len(next(iter(summary.values()))["by_seed"]) > 1:
        rows.append(["each seed", "", *seeds])
    columns = ["record", "fold", *[f"from {start}" for start in by_start]]
    title = f"{found.recipe}: free-run RMSE [{found.unit}] of models that never saw the record"
    return Table(columns, rows, title=title)
