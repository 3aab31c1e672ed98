"""Choice of the records that are drawn where a page or a folder has no room for all of them."""

from collections.abc import Mapping

_MOST_SHOWN = 6  # records that are drawn


def choose_shown_records(rmse: Mapping[str, float]) -> set[str]:
    """Chooses the worst record, the best, and others evenly between; all where there are few.

    Args:
        rmse: RMSE of each record by name.
    """
    worst_first = sorted(rmse, key=lambda name: -rmse[name])
    if len(worst_first) <= _MOST_SHOWN:
        return set(worst_first)
    step = (len(worst_first) - 1) / (_MOST_SHOWN - 1)
    return {worst_first[round(i * step)] for i in range(_MOST_SHOWN)}
