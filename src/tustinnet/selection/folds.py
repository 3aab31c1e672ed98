"""Records split into folds: those that are scored, those that train, those that choose."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.roles import Roles, records_without_test

FOLDS = 5  # unless another number is given, or there are fewer records
_FEWEST = 3  # records that folds need: one is scored, one chooses, the others train
_PIECES = 6  # that fewer records are cut into at most, all together
_SHORTEST_PIECE = 50  # samples of such a piece
_SHORTEST = 100  # samples of a record unless there are many such
_LITTLE = 0.1  # of all samples, that short records have which are left out


@dataclass(frozen=True)
class FoldSplit:
    """A fold: the records to score, those that choose, those that train.

    Attributes:
        scored: records that no model of the fold is fitted to; may be none.
        roles: records that models are fitted to.
    """

    scored: tuple[Experiment, ...]
    roles: Roles

    def roles_for(self, recipe: Recipe) -> Roles:
        """The records to fit to as a recipe uses them.

        Those that would choose train, too, where the recipe leaves them nothing to choose.
        """
        return self.roles if recipe.needs_validation else Roles(self.roles.all, ())


def kind_of(name: str) -> str:
    """The kind of a record: the letters that its name begins with."""
    kind = re.match("[a-zA-Z]*", name)
    return kind.group() if kind else ""


def usual_folds(records: int) -> int:
    """Into how many folds some records are split where nobody says it."""
    return max(_FEWEST, min(FOLDS, records))


def split_into_folds(data: DataSet, folds: int | None = None) -> list[FoldSplit]:
    """Splits records into folds as cards are dealt, those of a kind one after the other.

    Records are of a kind whose names begin with the same letters. Each fold is scored once; the
    next one chooses the weights of the models that score it, the others train them. Records of
    the split `test` take part in nothing.

    Args:
        data: the records.
        folds: how many; by default 5, or as many as there are records.

    Raises:
        InputError: fewer than 3 folds, or fewer records than folds.
    """
    records = records_without_test(data)
    folds = folds or usual_folds(len(records))
    if not 3 <= folds <= len(records):
        raise InputError(
            "`folds=`",
            f"{folds} folds of {len(records)} records",
            f"3 to {len(records)}" if len(records) >= 3 else "at least 3 records",
            "one fold is scored, one chooses, the others train",
        )

    def order(e: Experiment) -> tuple[str, str, str]:
        return kind_of(e.name), str(e.split), e.name

    ordered = sorted(records, key=order)
    piles = [tuple(ordered[f::folds]) for f in range(folds)]
    splits = []
    for f, scored in enumerate(piles):
        chooses = (f + 1) % folds
        train = tuple(e for i, pile in enumerate(piles) if i not in (f, chooses) for e in pile)
        splits.append(FoldSplit(scored, Roles(train, piles[chooses])))
    return splits


def prepare_for_folds(data: DataSet) -> tuple[DataSet, list[Finding]]:
    """Records that can be split into folds, and findings on what was done to them.

    A few short records beside long ones are left out: most models cannot begin on them. One or two
    records are cut in time into pieces of the same length, six in all.

    Raises:
        InputError: the pieces would be too short.
    """
    records, findings = records_without_test(data), list[Finding]()
    short = [e for e in records if len(e) < _SHORTEST]
    if 0 < sum(map(len, short)) < _LITTLE * sum(map(len, records)):
        records = [e for e in records if len(e) >= _SHORTEST]
        findings.append(make_finding("short records", records=names_of(short), fewest=_SHORTEST))
    if len(records) >= _FEWEST:
        return replace(data, experiments=tuple(records)), findings
    if not records:
        raise InputError(data.name, "test records alone", "records to fit to")
    shortest = min(records, key=len)
    count = min(_PIECES // len(records), len(shortest) // _SHORTEST_PIECE)
    if count * len(records) < _FEWEST:
        raise InputError(
            shortest.name,
            f"{len(shortest)} samples, too few to be cut into pieces to be judged by",
            f"pieces of at least {_SHORTEST_PIECE}, {_FEWEST} in all",
            "record longer, or name a recipe (`recipe=`)",
        )
    pieces: list[Experiment] = []
    for e in records:
        edges = [round(i * len(e) / count) for i in range(count + 1)]
        pieces += [
            replace(e[a:b], name=f"{e.name}[{a}:{b}]", split=None) for a, b in pairwise(edges)
        ]
    findings.append(make_finding("cut into pieces", records=len(records), pieces=len(pieces)))
    return replace(data, experiments=tuple(pieces)), findings


def are_cut(records: Sequence[Experiment]) -> bool:
    """Whether records of one or two files are what a card cut these into, row to row."""
    begins = {(e.source, e.first_row) for e in records if e.source and e.first_row}
    follow = [e for e in records if (e.source, e.first_row + len(e)) in begins]
    return len({e.source for e in records}) < _FEWEST and 2 * len(follow) >= len(records)


def names_of(records: Sequence[Experiment]) -> list[str]:
    """The names of records."""
    return [e.name for e in records]
