"""Bands of what was chosen, calibrated on the records that each fold left out."""

from collections.abc import Sequence

from tustinnet.errors import InputError
from tustinnet.evaluate.bands import Calibration, Guess, calibrated, guesses
from tustinnet.evaluate.folds import dealt
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model
from tustinnet.selection.averages import as_one, weights_of
from tustinnet.selection.ending import Final, Found
from tustinnet.selection.jobs import Workplace, loaded
from tustinnet.store.header import read_header


def calibrated_on_folds(found: Found, name: str, made: Final, at: Workplace) -> Calibration | None:
    """Bands of a candidate or committee.

    The models of each fold, put together as the chosen one is, simulate the records that none of
    them has seen. The chosen model has seen all records: its own errors are rather smaller.

    Args:
        found: what the selection found.
        name: the candidate or committee.
        made: what it was made into.
        at: where the models are, and how they were compared.

    Returns:
        None where the models of a fold, or the chosen one, do not say how sure they are, where
        free runs leave all bounds, and where time was up.
    """
    if not family_of(made.model).alternatives(made.model, dict(made.about)):
        return None
    members = found.members(name)
    shares = [share for _, share in members]
    folds = sorted(set.intersection(*(set(s.folds) for s, _ in members)))
    deals, start = dealt(at.data, at.judging.folds), found.standing(name).starts[0]
    told: list[Guess] = []
    for fold in folds:
        scores = [s.folds[fold] for s, _ in members]
        files = [of.model for some in scores for of in some]
        of_fold = as_one([loaded(file, at) for file in files], weights_of(scores, shares))
        others = _alternatives(of_fold, files, at)
        if not others or at.clock.left <= 0:
            return None
        records, horizon = deals[fold].scored, at.judging.horizon
        told += guesses(of_fold, others, records, start, horizon=horizon)
    try:
        records = [e for fold in folds for e in deals[fold].scored]
        return calibrated(told, records, start, at.judging.horizon)
    except InputError:
        return None


def _alternatives(model: Model, files: Sequence[str], at: Workplace) -> Sequence[Model]:
    """Models that the records of a fold would allow as well."""
    header = read_header(at.folder / files[0]) if len(files) == 1 else {}
    return family_of(model).alternatives(model, header)
