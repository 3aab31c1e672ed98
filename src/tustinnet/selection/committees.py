"""Committees of candidates: shares chosen on folds, scored on folds that did not choose."""

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tustinnet.errors import InputError, error_message
from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.families.committee import committee
from tustinnet.families.family import family_of
from tustinnet.finding import make_finding
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.models.contract import Model
from tustinnet.selection.jobs import FitScore, RunContext
from tustinnet.selection.plan import SelectionPlan
from tustinnet.selection.ranking import CandidateResult
from tustinnet.selection.scoring import RmseByStart, WhichStarts

_CLOSE = 3.0  # times the error of the best: no quarter of a model further off makes it better
_FEWEST_FOLDS = 2  # to choose shares on one and score them on the other
_PARTS = 4  # shares of two are multiples of one over this
_COARSE = 2  # of more than two: free runs of many members take long

Shares = tuple[float, ...]  # of each candidate of a committee


@dataclass(frozen=True)
class CommitteeResult:
    """A committee, scored on folds.

    Attributes:
        result: its scores; each fold's with the shares that the other folds chose.
        shares: those that all folds together choose, by candidate.
    """

    result: CandidateResult
    shares: Mapping[str, float]


def score_committees(
    plan: SelectionPlan,
    remaining: Sequence[CandidateResult],
    context: RunContext,
    on_message: Callable[[str], None],
    deadline: Deadline = NEVER,
) -> dict[str, CommitteeResult]:
    """Scores the committees of a plan whose candidates remain, and those of several seeds.

    Args:
        plan: the plan.
        remaining: the candidates that remain, the best first.
        context: the models, and how they are scored.
        on_message: called with sentences on committees that are left out.
        deadline: after it no committee is begun.
    """
    by_name = {r.name: r for r in remaining}
    close = [r.name for r in remaining if _is_close(r, remaining[0])]
    committees: dict[str, tuple[str, ...]] = {
        f"{r.name}, seeds averaged": (r.name,)
        for r in remaining
        if any(len(fits) > 1 for fits in r.fits_by_fold.values())
    }
    of_best = {average.name for average in plan.committees if average.best is not None}
    for average in plan.committees:
        if average.best is not None and len(close) < 2 <= len(by_name):
            far_off = make_finding(
                "committee far off", committee=average.name, factor=_CLOSE, best=close[0]
            )
            on_message(far_off.text)
            continue
        members = average.members_among(close if average.best is not None else list(by_name))
        if members and members not in committees.values():
            committees[average.name] = members
    results = {}
    for name, members in committees.items():
        try:
            scored = score_committee(name, [by_name[m] for m in members], context, deadline)
        except Exception as error:  # of any kind: committees that were scored before are not lost
            on_message(
                make_finding("committee failed", committee=name, why=error_message(error)).text
            )
            continue
        if scored is None:
            on_message(make_finding("committee unjudged", committee=name).text)
        elif name in of_best and 1.0 in scored.shares.values():
            on_message(make_finding("committee no better", committee=name).text)
        else:
            results[name] = scored
    return results


def score_committee(
    name: str, members: Sequence[CandidateResult], context: RunContext, deadline: Deadline = NEVER
) -> CommitteeResult | None:
    """Scores a committee on the folds that all of its candidates have.

    In every fold its members are the candidates' models of that fold, none of which has seen the
    records that it is scored on. Seeds of a candidate count the same.

    Args:
        name: the name of the committee.
        members: the results of its candidates.
        context: where the models are, and how they are scored.
        deadline: after it no fold is begun.

    Returns:
        None where time was up before the first fold was scored, and for several candidates that
        have one fold in common: their shares would be chosen by nothing.
    """
    started = time.monotonic()
    options, models = _possible_shares(len(members)), dict[int, list[Model]]()
    folds = sorted(set.intersection(*(set(r.fits_by_fold) for r in members)))
    fewest = _FEWEST_FOLDS if len(members) > 1 else 1
    if len(folds) < fewest:
        return None

    def score(fold: int, shares: Shares, which: WhichStarts = "deciding") -> RmseByStart:
        weights = member_weights([r.fits_by_fold[fold] for r in members], shares)
        model = combine(models[fold], weights)
        return context.scoring.score(model, None, context.splits[fold], context.data, which)

    scored: dict[int, list[RmseByStart]] = {}

    for fold in folds:
        if deadline.remaining <= 0:
            break
        models[fold] = [context.load_model(s.model) for r in members for s in r.fits_by_fold[fold]]
        missing = len(options) * max(fewest - len(scored), 1) + len(scored)
        rows = _score_in_time(options, partial(score, fold), deadline, missing, bool(scored))
        if rows is None:
            break
        scored[fold] = rows
    if len(scored) < fewest:
        return None

    def best_option(chosen_on: Sequence[int]) -> int:
        """The shares with the lowest mean RMSE over some folds; equal ones of none."""
        if not chosen_on:
            return 0
        means = []
        for i in range(len(options)):
            rows = [next(iter(scored[f][i].values())) for f in chosen_on]
            means.append(mean_and_error(x for rmse in rows for x in rmse.values())[0])
        return int(np.argmin(np.where(np.isfinite(means), means, np.inf)))

    scores = {}
    for fold in scored:
        i = best_option([f for f in scored if f != fold])
        rmse = scored[fold][i] | score(fold, options[i], "others")
        scores[fold] = (FitScore(0, "", "", None, rmse),)
    # one fold alone would choose on what it is scored on
    best = options[best_option(list(scored) if len(scored) > 1 else [])]
    shares = {r.name: share for r, share in zip(members, best, strict=True)}
    # the time of its members is that of other candidates
    return CommitteeResult(CandidateResult(name, scores, time.monotonic() - started), shares)


def _score_in_time(
    options: Sequence[Shares],
    score: Callable[[Shares], RmseByStart],
    deadline: Deadline,
    missing: int,
    is_compiled: bool,
) -> list[RmseByStart] | None:
    """The scores of all options in a fold; None where not enough folds could be scored in time.

    Args:
        options: the shares.
        score: scores a committee with some shares.
        deadline: when scores have to be there.
        missing: how many scores have to be there then, those of the options among them.
        is_compiled: whether a committee was scored before: a first one takes longer.
    """
    rows = list[RmseByStart]()
    for shares in options:
        begun = time.monotonic()
        rows.append(score(shares))
        seconds = time.monotonic() - begun if is_compiled else 0.0
        is_compiled = True
        if len(rows) < len(options) and (missing - len(rows)) * seconds > deadline.remaining:
            return None
    return rows


def _is_close(result: CandidateResult, best: CandidateResult) -> bool:
    """Whether a candidate is little enough worse than the best for an average of the two."""
    ours, theirs = result.rmse(), best.rmse()
    shared = [record for record in ours if record in theirs]
    mean, of_best = (mean_and_error(rmse[r] for r in shared)[0] for rmse in (ours, theirs))
    return result is best or bool(mean <= _CLOSE * of_best)


def member_weights(fits: Sequence[Sequence[FitScore]], shares: Sequence[float]) -> list[float]:
    """The weight of every model, where each candidate has a share and its fits count the same."""
    pairs = zip(fits, shares, strict=True)
    return [share / len(scores) for scores, share in pairs for _ in scores]


def _possible_shares(count: int) -> list[Shares]:
    """The shares that are compared, equal ones first."""
    most = _PARTS if count <= 2 else _COARSE
    parts = [p for p in itertools.product(range(most + 1), repeat=count) if sum(p) == most]
    shares = [tuple(part / most for part in p) for p in parts]
    equal = tuple(1 / count for _ in range(count))
    return [equal, *(s for s in shares if s != equal)]


def combine(members: Sequence[Model], weights: Sequence[float]) -> Model:
    """A committee of models, or the only one.

    Raises:
        InputError: models that cannot be averaged, as those of several systems.
    """
    equations = (family_of(model).equations(model) for model in members)
    systems = dict.fromkeys(e.system.name for e in equations if e is not None)
    if len(systems) > 1:
        raise InputError(
            "committee",
            f"members of the systems {', '.join(systems)}",
            "members of one system",
            "a model file is of one system at most",
        )
    return members[0] if len(members) == 1 else committee(members, weights)
