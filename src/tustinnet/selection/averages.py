"""Committees of candidates: shares chosen on folds, judged on folds that did not choose."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.families.committee import committee
from tustinnet.models.contract import Model
from tustinnet.selection.jobs import SeedScore, Workplace, judged, loaded
from tustinnet.selection.ranking import Standing

_PARTS = 4  # shares of two are multiples of one over this
_COARSE = 2  # of more than two: free runs of many members take long

Shares = tuple[float, ...]  # of each candidate of a committee
_ByStart = dict[str, dict[str, float]]  # RMSE of records by start, first the one that judges


@dataclass(frozen=True)
class Judged:
    """A committee, judged on folds.

    Attributes:
        standing: its scores; each fold's with the shares that the other folds chose.
        shares: those that all folds together choose, by candidate.
    """

    standing: Standing
    shares: Mapping[str, float]


def judge_average(name: str, members: Sequence[Standing], at: Workplace) -> Judged | None:
    """Judges a committee on the folds that all of its candidates have.

    In every fold its members are the candidates' models of that fold, none of which has seen the
    records that it is scored on. Seeds of a candidate count the same.

    Args:
        name: what the committee is called.
        members: the standings of its candidates.
        at: where the models are, and how they are compared.

    Returns:
        None where time was up before the first fold was judged.
    """
    folds = sorted(set.intersection(*(set(s.folds) for s in members)))
    tried = _compositions(len(members))
    begun: dict[int, _OfFold] = {}
    found: dict[int, list[_ByStart]] = {}
    for fold in folds:
        if at.clock.left <= 0:
            break
        begun[fold] = of_fold = _OfFold([s.folds[fold] for s in members], at)
        found[fold] = [of_fold.by_start(shares, slice(1)) for shares in tried]
    if not found:
        return None
    scores = {}
    for fold, of_fold in begun.items():
        i = _best(found, [f for f in found if f != fold])
        rmse = found[fold][i] | of_fold.by_start(tried[i], slice(1, None))
        scores[fold] = (SeedScore(0, "", "", None, rmse),)
    # one fold alone would choose on what it is judged on
    best = tried[_best(found, list(found) if len(found) > 1 else [])]
    named = {s.name: share for s, share in zip(members, best, strict=True)}
    return Judged(Standing(name, scores, sum(s.seconds for s in members)), named)


class _OfFold:
    """The models of some candidates in a fold, put together with one share or another.

    Args:
        models: of each candidate.
        at: where they are, and how they are compared.
    """

    def __init__(self, models: Sequence[Sequence[SeedScore]], at: Workplace) -> None:
        self._models, self._at = models, at
        self._members = [loaded(model.model, at) for of in models for model in of]
        self._names = list(next(iter(models[0][0].rmse.values())))

    def by_start(self, shares: Shares, starts: slice) -> _ByStart:
        """RMSE of the records left out, by start, from some starts; the first one judges."""
        together = as_one(self._members, weights_of(self._models, shares))
        return judged(together, self._at, self._names, starts)


def weights_of(models: Sequence[Sequence[SeedScore]], shares: Sequence[float]) -> list[float]:
    """What every model counts, where each candidate has a share and its models count the same."""
    return [share / len(of) for of, share in zip(models, shares, strict=True) for _ in of]


def _compositions(count: int) -> list[Shares]:
    """The shares that are tried, equal ones first."""
    most = _PARTS if count <= 2 else _COARSE
    parts = [p for p in itertools.product(range(most + 1), repeat=count) if sum(p) == most]
    tried = [tuple(part / most for part in p) for p in parts]
    equal = tuple(1 / count for _ in range(count))
    return [equal, *(shares for shares in tried if shares != equal)]


def as_one(members: Sequence[Model], weights: Sequence[float]) -> Model:
    """A committee of models, or the only one."""
    return members[0] if len(members) == 1 else committee(members, weights)


def _best(found: Mapping[int, Sequence[_ByStart]], folds: Sequence[int]) -> int:
    """The shares with the lowest mean RMSE over the records of some folds; equal ones of none."""
    if not folds:
        return 0
    count = len(next(iter(found.values())))
    means = []
    for i in range(count):
        values = [x for f in folds for x in next(iter(found[f][i].values())).values()]
        means.append(mean_and_error(values)[0])
    return int(np.argmin(np.where(np.isfinite(means), means, np.inf)))
