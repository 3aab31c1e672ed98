"""The table of free runs of several models."""

from collections.abc import Mapping, Sequence

from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.scores import Score, mean_rmse
from tustinnet.report.tables import Table, number, scale_of
from tustinnet.simulate.horizon import horizon_words


def comparison_table(
    records: Sequence[Experiment], scores: Mapping[str, Sequence[Score]], start: str
) -> Table:
    """RMSE of every record and of every split, a column a model.

    Args:
        records: the records.
        scores: their free runs, by what the models are called.
        start: where these start.
    """
    scale = scale_of(s.rmse for found in scores.values() for s in found)

    def told(value: float) -> str:
        return number(value, scale=scale)

    rows = [
        [e.name, e.split or "all", *[told(found[i].rmse) for found in scores.values()]]
        for i, e in enumerate(records)
    ]
    for name in dict.fromkeys(e.split or "all" for e in records):
        inside = [i for i, e in enumerate(records) if (e.split or "all") == name]
        groups = [mean_rmse([found[i] for i in inside]) for found in scores.values()]
        rows.append(["mean", name, *map(told, groups)])
    horizon = horizon_words(next(iter(scores.values()))[0].horizon)
    title = f"Free-run RMSE [{records[0].channels.unit}], start '{start}'{horizon}"
    return Table(["record", "split", *scores], rows, title=title)
