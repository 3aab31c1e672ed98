"""Some of many records, where a page or a folder has no room for all of them."""

from collections.abc import Mapping

MOST = 6  # records that are drawn


def some_of(rmse: Mapping[str, float], most: int = MOST) -> set[str]:
    """The worst of some records, the best, and others evenly between; all where there are few.

    Args:
        rmse: of each record by name.
        most: how many.
    """
    worst_first = sorted(rmse, key=lambda name: -rmse[name])
    if len(worst_first) <= most:
        return set(worst_first)
    step = (len(worst_first) - 1) / (most - 1)
    return {worst_first[round(i * step)] for i in range(most)}
