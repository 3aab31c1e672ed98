"""From the candidates that are left to models: committees, and parameters from all records."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from tustinnet.errors import InputError, error_message
from tustinnet.evaluate.folds import taking_part
from tustinnet.families.committee import committee
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Fold, Task, resolve_system
from tustinnet.models.contract import Model
from tustinnet.selection.averages import Judged, judge_average, weights_of
from tustinnet.selection.clock import OutOfTime
from tustinnet.selection.jobs import Job, SeedScore, Workplace, loaded
from tustinnet.selection.plan import SelectionPlan
from tustinnet.selection.ranking import Standing, ranked, simplest
from tustinnet.store.kept_system import CANDIDATES
from tustinnet.store.run import Tell, fit_in

WHOLE = "all-records"  # the folder of an identification from all records


@dataclass(frozen=True)
class Found:
    """What the rounds of a plan, and the committees after them, came to.

    Attributes:
        plan: the plan.
        candidates: what was found of each, from the simplest to the most complex.
        left: the names of those that are left.
        averages: the committees of them that were judged, by name.
    """

    plan: SelectionPlan
    candidates: tuple[Standing, ...]
    left: tuple[str, ...]
    averages: Mapping[str, Judged]

    @property
    def standings(self) -> tuple[Standing, ...]:
        """Candidates, then committees."""
        return (*self.candidates, *(judged.standing for judged in self.averages.values()))

    @property
    def choosable(self) -> list[Standing]:
        """The candidates that are left and the committees, from the simplest on."""
        return [s for s in self.standings if s.name in self.left or s.name in self.averages]

    def standing(self, name: str) -> Standing:
        """That of a candidate or committee."""
        return next(s for s in self.standings if s.name == name)

    def members(self, name: str) -> list[tuple[Standing, float]]:
        """The candidates that a committee, or a candidate by itself, is made of; their shares."""
        shares = self.averages[name].shares if name in self.averages else {name: 1.0}
        return [(s, shares[s.name]) for s in self.candidates if shares.get(s.name)]


@dataclass(frozen=True)
class Final:
    """A model that a candidate or committee was made into.

    Attributes:
        model: the model.
        words: what it was made of.
        about: what its file says of the fit, where it was one.
    """

    model: Model
    words: str
    about: Mapping[str, Any] = field(default_factory=dict)


def judge_averages(
    plan: SelectionPlan, left: Sequence[Standing], at: Workplace, say: Callable[[str], None]
) -> dict[str, Judged]:
    """Judges the committees of a plan whose candidates are left, and those of several seeds."""
    by_name = {s.name: s for s in left}
    wanted: dict[str, tuple[str, ...]] = {
        f"{s.name}, seeds averaged": (s.name,)
        for s in left
        if any(len(models) > 1 for models in s.folds.values())
    }
    chosen = {average.name for average in plan.committees if average.best is not None}
    for average in plan.committees:
        members = average.among(list(by_name))
        if members and members not in wanted.values():
            wanted[average.name] = members
    found = {}
    for name, members in wanted.items():
        try:
            judged = judge_average(name, [by_name[of] for of in members], at)
        except Exception as error:  # of any kind: what was judged before is not lost
            say(f"{name}: left out, {error_message(error)}")
            continue
        if judged is None:
            say(f"{name}: not judged, no time was left for it")
        elif name in chosen and 1.0 in judged.shares.values():
            say(f"{name}: left out, one of them alone is as good")
        else:
            found[name] = judged
    return found


def final_models(
    found: Found, at: Workplace, tell: Callable[[Job], Tell]
) -> tuple[dict[str, Final], str, str]:
    """The models of what can be chosen, the best of them, the simplest that is as good.

    The parameters of a system are identified from all records where its model is chosen.
    """
    choosable = found.choosable
    best = ranked(choosable)[0]
    plain = simplest(choosable, best)
    models = {s.name: _averaged(found, s.name, at) for s in choosable}
    for standing in {best.name: best, plain.name: plain}.values():
        models[standing.name] = _whole(found, standing, models[standing.name], at, tell)
    return models, best.name, plain.name


def _averaged(found: Found, name: str, at: Workplace) -> Final:
    """The committee of all models of a candidate, or of the candidates of a committee."""
    members = found.members(name)
    models: list[Sequence[SeedScore]] = [s.models for s, _ in members]
    each = [loaded(of.model, at) for some in models for of in some]
    if len(each) == 1:
        return Final(each[0], "the model of one fold")
    weights = weights_of(models, [share for _, share in members])
    parts = [f"{len(s.models)} of {s.name} ({100 * share:.0f} %)" for s, share in members]
    folds = sorted({fold for s, _ in members for fold in s.folds})
    of = "one fold" if len(folds) == 1 else f"{len(folds)} folds"
    told = f"the average of {len(each)} models of {of}"
    try:
        together = committee(each, weights)
    except InputError as error:  # as where delays were searched for: each has found another
        return Final(each[0], f"the model of one fold; no average: {error}")
    return Final(together, f"{told}: {', '.join(parts)}" if parts[1:] else told)


def _whole(
    found: Found, standing: Standing, averaged: Final, at: Workplace, tell: Callable[[Job], Tell]
) -> Final:
    """A system identified from all records; what has weights, or was not, stays averaged."""
    if standing.name in found.averages:
        return averaged
    recipe = found.plan.candidate(standing.name).content
    if recipe.family.trains:
        return averaged
    records = tuple(taking_part(at.data))
    task = Task(
        recipe, (Fold(Roles(records, ())),), system=resolve_system(recipe, at.loaded_system)
    )
    folder = at.folder / CANDIDATES / standing.name / WHOLE
    job = Job(standing.name, recipe, fold=0)
    try:
        result = fit_in(folder, task, at.clock.within(tell(job)), resume=False)[0]
    except OutOfTime:
        why = "no time was left to identify it from all records"
    except Exception as error:  # of any kind: the models of the folds are there
        why = f"not identified from all records: {error_message(error)}"
    else:
        words = f"identified from all {len(records)} records"
        return Final(result.model, words, result.as_header())
    return replace(averaged, words=f"{averaged.words}; {why}")
