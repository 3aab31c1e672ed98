"""Tables of fits: members of a training, parameters of an identification, folds."""

import math
from collections.abc import Mapping, Sequence
from statistics import median

from tustinnet.evaluate.scores import mean_rmse_by_unit
from tustinnet.fits.run import Run
from tustinnet.fitting.report import (
    BaseParameterEstimate,
    Estimate,
    ForceError,
    Identification,
)
from tustinnet.report.comparison import comparison_table
from tustinnet.report.tables import Table, norm_words, number, numbers, scale_of
from tustinnet.selection.cross_validation import CrossValidationResult
from tustinnet.simulate.horizon import horizon_words
from tustinnet.store.run_folder import SUMMARY


def members_table(run: Run) -> Table:
    """Table of the members of a training, with median and range where there are several."""
    units, is_several = run.channels.units, len(run.members) > 1
    means = [mean_rmse_by_unit(member.scores, run.channels) for member in run.members]
    columns = [[mean[unit] for mean in means] for unit in units]
    rows = []
    for member, cells in zip(run.members, zip(*map(numbers, columns), strict=True), strict=True):
        result = member.result
        rows.append(
            [
                result.member.name.removeprefix("seed-"),
                *cells,
                # least squares have none of these
                " + ".join(map(str, result.detail("windows") or ())),
                " + ".join(map(str, result.detail("epochs") or ())),
                "" if (kept := result.detail("kept_epoch")) is None else str(kept),
                f"{result.seconds:.0f}",
                result.outcome.split(":")[0],
            ]
        )
    if is_several:
        cells = []
        for column in columns:
            middle, low, high = numbers([median(column), min(column), max(column)])
            cells.append(f"{middle} ({low}..{high})")
        total = f"{run.seconds:.0f} in all"
        rows.append(["median (range)", *cells, "", "", "", total, ""])
    seconds = "share of seconds" if is_several else "seconds"
    return Table(
        [
            "seed",
            *[f"mean RMSE [{unit}]" for unit in units],
            "windows",
            "epochs",
            "kept",
            seconds,
            "outcome",
        ],
        rows,
        title=f"{run.best.result.recipe.name}, {run.judging_split} free runs, start '{run.start}'"
        + horizon_words(run.best.scores[0].horizon),
    )


def parameter_table(result: Identification) -> Table:
    """Table of identified parameters, with their standard errors and those of J'J.

    Of many those that the records tell about, and those at a bound.
    """
    shown, others = split_informed(result.estimates)
    rows = [estimate_cells(e) for e in shown]
    has_room = not is_many([*result.estimates, *result.fixed])
    if has_room:
        rows += [
            [name, f"{value:.4g}", result.system.parameter(name).unit, "fixed", "", "", ""]
            for name, value in result.fixed.items()
        ]
    refined = result.refit and result.refit.values
    title = f"{result.system.name}; {estimates_title(result.trust, refined)}"
    left_out = []
    if others:
        left_out.append(f"{len(others)} that the records tell little about")
    if result.fixed and not has_room:
        left_out.append(f"{len(result.fixed)} fixed ones")
    if left_out:
        title += f"; without {' and '.join(left_out)}, which are in {SUMMARY}"
    return estimates_table(rows, refined, title)


def is_many(parameters: Sequence[object]) -> bool:
    """Whether there are too many parameters for a table to have them all."""
    return len(parameters) > 30


def split_informed(estimates: Sequence[Estimate]) -> tuple[list[Estimate], list[Estimate]]:
    """Estimates to show first, and those of many that the records tell little about."""
    if not is_many(estimates):
        return list(estimates), []
    return [e for e in estimates if e.is_informed], [e for e in estimates if not e.is_informed]


def base_parameter_table(estimates: Sequence[BaseParameterEstimate], title: str = "") -> Table:
    """Table of base parameters with 95 % intervals."""
    rows = []
    for b in estimates:
        half = (b.interval[1] - b.interval[0]) / 2 if b.interval else 0.0
        digits = digits_of(b.value, half / 2)
        interval = "–"
        if b.interval:
            interval = f"{b.interval[0]:.{digits}g}..{b.interval[1]:.{digits}g}"
        rows.append([b.expression, f"{b.value:.{digits}g}", b.unit, interval])
    return Table(["base parameter", "value", "unit", "95 %"], rows, title)


def force_errors_table(errors: Mapping[str, Sequence[ForceError]]) -> Table:
    """Table of the forces that are missing at each coordinate, beside trivial references.

    Args:
        errors: the errors by what they are of, as a split.
    """
    rows = [
        [
            label,
            e.coordinate,
            f"{e.size:.3g} {e.unit}" if e.is_driven else f"none; needs {e.size:.3g} {e.unit}",
            *[
                "–" if share is None or not e.is_driven else number(100 * share, 2)
                for share in (e.share, e.moving, e.by_least_squares, e.by_file)
            ],
        ]
        for label, own in errors.items()
        for e in own
    ]
    bands = sorted({f"{e.cutoff:.3g} Hz" for own in errors.values() for e in own})
    columns = ["of", "coordinate", "actuators", "missing [%]", "moving [%]"]
    columns += ["least squares [%]", "first values [%]"]
    title = "Forces that a motion needs and its actuators do not give, root mean squares"
    return Table(columns, rows, f"{title}, up to {', '.join(bands)}")


ESTIMATE_COLUMNS = ("parameter", "value", "unit", "std. error", "95 %", "error of J'J", "range")


def estimates_table(
    rows: Sequence[Sequence[str]], refined: Mapping[str, float] | None, title: str = ""
) -> Table:
    """Table of parameters, with a further column where the model has other values than the search.

    Args:
        rows: cells of `ESTIMATE_COLUMNS`.
        refined: the model's values by name, where they were fitted once more after the search.
        title: a line above.
    """
    if refined is None:
        return Table(ESTIMATE_COLUMNS, rows, title)
    rows = [[*row, f"{refined[row[0]]:.4g}" if row[0] in refined else row[1]] for row in rows]
    return Table((*ESTIMATE_COLUMNS, "in the model"), rows, title)


def estimate_cells(e: Estimate) -> list[str]:
    """Cells of one parameter, one for each of `ESTIMATE_COLUMNS`."""
    digits = digits_of(e.value, e.error)
    error, naive_error = ("–" if x is None else f"{x:.2g}" for x in (e.error, e.naive_error))
    interval = "–"
    if e.interval:
        interval = f"{e.interval[0]:.{digits}g}..{e.interval[1]:.{digits}g}"
    bound = f"at the {e.bound} bound" if e.bound else ""
    return [
        e.name,
        f"{e.value:.{digits}g}",
        e.unit,
        error,
        interval,
        naive_error,
        f"{e.lower:.3g}..{e.upper:.3g} {bound}".strip(),
    ]


def digits_of(value: float, error: float | None) -> int:
    """Significant digits, 4 to 12, that show a value to a tenth of its error."""
    if not error or not value or not math.isfinite(value / error):
        return 4
    return int(min(max(4, math.ceil(math.log10(abs(value) / error)) + 2), 12))


def estimates_title(trust: str, refined: Mapping[str, float] | None) -> str:
    """Title of a table of parameters: the source of the errors and the meaning of the values.

    Args:
        trust: the source of the errors, as in `Identification.trust`.
        refined: the values that were fitted once more after the search, if there are any.
    """
    source = "J'J" if trust == "residuals" else f"the differences between {trust}"
    title = f"standard errors from {source}"
    if refined is not None:
        title += "; value: result of the search, in the model: fitted once more to free runs"
    return title


def position_in_range(e: Estimate, value: float) -> float:
    """Position of a value in a parameter's range, 0..1; logarithmic where the range is positive."""
    if e.lower > 0:
        share = math.log(max(value, e.lower) / e.lower) / math.log(e.upper / e.lower)
    else:
        share = (value - e.lower) / (e.upper - e.lower)
    return min(max(share, 0.0), 1.0)


def validation_table(run: Run) -> Table:
    """Table of the free runs that score the best model of a run."""
    scores = {run.best.result.recipe.name: run.best.scores}
    return comparison_table(run.roles.ranking, scores, run.start)


def training_table(run: Run) -> Table:
    """Table of the error of the best model of a run on each training record."""
    identification = run.best.result.identification
    if identification is None:
        scores = {run.best.result.recipe.name: run.training_scores}
        return comparison_table(run.roles.train, scores, run.start)
    title = (
        "train, forces that are missing, relative to the actuators'"
        if identification.force_errors
        else "train, from the identified initial states"
    )
    if identification.refit:
        title += ", with the values of the search"
    kinds = {c.kind for c in run.channels.coordinates}
    if len(kinds) > 1 and not identification.force_errors:
        title += ", each coordinate relative to its spread"
    cells = numbers(list(identification.rmse.values()))
    rows = [list(row) for row in zip(identification.rmse, cells, strict=True)]
    return Table(["record", "RMSE"], rows, title)


def folds_table(result: CrossValidationResult) -> Table:
    """Table of a cross-validation: every record's mean over the seeds, by start, and the means."""
    summary = result.summary()
    by_start = {start: result.means(start) for start in summary}
    folds = {s.record: s.fold for s in result.scores}
    scale = scale_of(value for means in by_start.values() for value in means.values())

    def cell(value: float) -> str:
        return number(value, scale=scale)

    rows = [
        [record, str(fold), *[cell(means[record]) for means in by_start.values()]]
        for record, fold in folds.items()
    ]
    means = [f"{cell(s['mean'])} ± {cell(s['standard_error'])}" for s in summary.values()]
    rows.append(["mean ± standard error", "", *means])
    if len(next(iter(summary.values()))["by_seed"]) > 1:
        seeds = [" ".join(cell(x) for x in s["by_seed"].values()) for s in summary.values()]
        rows.append(["each seed", "", *seeds])
    columns = ["record", "fold", *[f"from {start}" for start in by_start]]
    title = f"{result.recipe}: free-run RMSE [{result.unit}] of models not fitted to the record"
    title += norm_words(result.unit)
    return Table(columns, rows, title=title)
