"""The table that compares the free runs of several models."""

from collections.abc import Mapping, Sequence

from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.scores import Score, mean_rmse
from tustinnet.report.tables import Table, number, scale_of
from tustinnet.simulate.horizon import horizon_words


def comparison_table(
    records: Sequence[Experiment], scores: Mapping[str, Sequence[Score]], start: str
) -> Table:
    """Table of the RMSE of every record and the mean of every split, with a column for each model.

    Args:
        records: the records.
        scores: the scores of each model's free runs, in the order of the records, by label.
        start: name of the initial states.
    """
    scale = scale_of(s.rmse for model_scores in scores.values() for s in model_scores)
    splits = [e.split or "all" for e in records]
    rows = [
        [e.name, split, *[number(s[i].rmse, scale=scale) for s in scores.values()]]
        for i, (e, split) in enumerate(zip(records, splits, strict=True))
    ]
    for split in dict.fromkeys(splits):
        members = [i for i, other in enumerate(splits) if other == split]
        means = [mean_rmse([s[i] for i in members]) for s in scores.values()]
        rows.append(["mean", split, *[number(mean, scale=scale) for mean in means]])
    horizon = horizon_words(next(iter(scores.values()))[0].horizon)
    title = f"Free-run RMSE [{records[0].channels.unit}], start '{start}'{horizon}"
    return Table(["record", "split", *scores], rows, title=title)
