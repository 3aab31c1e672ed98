"""Records for folds: as they are, or cut where there are too few of them."""

from dataclasses import replace
from itertools import pairwise

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluate.folds import taking_part

_FEWEST = 3  # records that folds need: one is scored, one chooses, the others train
_PIECES = 6  # that fewer records are cut into, all together
_SHORTEST = 100  # samples of a piece


def for_folds(data: DataSet) -> tuple[DataSet, str]:
    """Records that can be dealt into folds, and what was done to them, in a sentence.

    One or two records are cut in time into pieces of the same length, six in all.

    Raises:
        InputError: the pieces would be too short.
    """
    known = taking_part(data)
    if len(known) >= _FEWEST:
        return replace(data, experiments=tuple(known)), ""
    if not known:
        raise InputError(data.name, "test records alone", "records to fit to")
    each = _PIECES // len(known)
    pieces = []
    for e in known:
        edges = [round(i * len(e) / each) for i in range(each + 1)]
        if edges[1] < _SHORTEST:
            raise InputError(
                e.name, f"{len(e)} samples: cut into {each} to be judged, {edges[1]} each",
                f"at least {_SHORTEST} in a piece", "record longer, or name a recipe (--recipe)",
            )  # fmt: skip
        pieces += [
            replace(e[a:b], name=f"{e.name}[{a}:{b}]", split=None) for a, b in pairwise(edges)
        ]
    told = (
        f"{len(known)} record{'s' * (len(known) > 1)}, cut into {len(pieces)} pieces in time: each "
        "is scored by models that did not see it, but pieces of one record are alike, so that the "
        "figures flatter"
    )
    return replace(data, experiments=tuple(pieces)), told
