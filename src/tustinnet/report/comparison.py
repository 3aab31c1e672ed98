"""The table that compares the free runs of several models."""

from collections.abc import Mapping, Sequence
from statistics import fmean

from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.scores import Score
from tustinnet.report.tables import Table, number, scale_of
from tustinnet.simulate.horizon import horizon_words


def comparison_table(
    records: Sequence[Experiment], scores: Mapping[str, Sequence[Score]], start: str
) -> Table:
    """Table of the RMSE of every record and the mean of every split, a column for each model.

    Where coordinates have different units, each model has a column for each.

    Args:
        records: the records.
        scores: the scores of each model's free runs, in the order of the records, by label.
        start: name of the initial states.
    """
    channels = records[0].channels
    # RMSE of each record (rows) by each model, for coordinates of each unit
    errors = {
        unit: [
            [s[i].rmse_by_unit(channels)[unit] for s in scores.values()]
            for i in range(len(records))
        ]
        for unit in channels.units
    }
    by_model = {
        unit: [scale_of(column) for column in zip(*rows, strict=True)]
        for unit, rows in errors.items()
    }
    # three digits of the best model, too, unless others are a thousand times as far off
    scales = {unit: max(min(sizes), 1e-3 * max(sizes)) for unit, sizes in by_model.items()}

    def cells(chosen: Sequence[int]) -> list[str]:
        """Means over some records: for each model one of each unit."""
        return [
            number(fmean(errors[unit][i][k] for i in chosen), scale=scales[unit])
            for k in range(len(scores))
            for unit in channels.units
        ]

    splits = [e.split or "all" for e in records]
    rows = [
        [e.name, split, *cells([i])]
        for i, (e, split) in enumerate(zip(records, splits, strict=True))
    ]
    for split in dict.fromkeys(splits):
        members = [i for i, other in enumerate(splits) if other == split]
        rows.append(["mean", split, *cells(members)])
    horizon = horizon_words(next(iter(scores.values()))[0].horizon)
    is_mixed = len(channels.units) > 1
    unit = "" if is_mixed else f" [{channels.unit}]"
    columns = [f"{label} [{unit}]" for label in scores for unit in channels.units]
    title = f"Free-run RMSE{unit}, start '{start}'{horizon}"
    return Table(["record", "split", *(columns if is_mixed else scores)], rows, title=title)
