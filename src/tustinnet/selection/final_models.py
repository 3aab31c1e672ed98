"""Final models of candidates: committees of folds, and parameters from all records."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from tustinnet.errors import InputError, error_message
from tustinnet.families.committee import committee
from tustinnet.fitting.fit import MakeListener
from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Task
from tustinnet.models.contract import Model
from tustinnet.selection.committees import CommitteeResult, member_weights
from tustinnet.selection.deadline import NEVER, Deadline, OutOfTime
from tustinnet.selection.folds import FoldSplit, records_without_test
from tustinnet.selection.jobs import FitScore, Job, RunContext, make_job_task
from tustinnet.selection.plan import SelectionPlan
from tustinnet.selection.ranking import CandidateResult, find_simplest, rank
from tustinnet.store.kept_system import CANDIDATES
from tustinnet.store.run import fit_in_folder

WHOLE = "all-records"  # the folder of an identification from all records


@dataclass(frozen=True)
class Candidates:
    """The results of a plan's rounds, and of the committees after them.

    Attributes:
        plan: the plan.
        results: of each candidate, from the simplest to the most complex.
        remaining: the names of those that remain after the last round.
        committees: the committees of them that were scored, by name.
    """

    plan: SelectionPlan
    results: tuple[CandidateResult, ...]
    remaining: tuple[str, ...]
    committees: Mapping[str, CommitteeResult]

    @property
    def all_results(self) -> tuple[CandidateResult, ...]:
        """Candidates, then committees."""
        return (*self.results, *(c.result for c in self.committees.values()))

    @property
    def choosable(self) -> list[CandidateResult]:
        """The candidates that remain and the committees, from the simplest on."""
        names = {*self.remaining, *self.committees}
        return [r for r in self.all_results if r.name in names]

    def result(self, name: str) -> CandidateResult:
        """The result of a candidate or committee."""
        return next(r for r in self.all_results if r.name == name)

    def members(self, name: str) -> list[tuple[CandidateResult, float]]:
        """The candidates that a committee, or a candidate by itself, is made of; their shares."""
        shares = self.committees[name].shares if name in self.committees else {name: 1.0}
        return [(r, shares[r.name]) for r in self.results if shares.get(r.name)]


@dataclass(frozen=True)
class FinalModel:
    """A model that a candidate or committee was made into.

    Attributes:
        model: the model.
        origin: how it was made, in words.
        header: the header of its fit, where it was one.
    """

    model: Model
    origin: str
    header: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class FinalModels:
    """The models of all that can be chosen.

    Attributes:
        models: by candidate or committee.
        best: the name of the best one.
        simplest: the name of the simplest that is as good.
    """

    models: Mapping[str, FinalModel]
    best: str
    simplest: str


def make_final_models(
    candidates: Candidates,
    context: RunContext,
    make_listener: Callable[[Job], MakeListener],
    deadline: Deadline = NEVER,
) -> FinalModels:
    """Makes the models of what can be chosen: the best of them, the simplest that is as good.

    The parameters of a system are identified from all records where its model is chosen.
    """
    choosable = candidates.choosable
    best = rank(choosable)[0]
    simplest = find_simplest(choosable, best)
    models = {r.name: _average_folds(candidates, r.name, context) for r in choosable}
    for name in {best.name: best, simplest.name: simplest}:
        if name in candidates.committees:
            continue
        recipe = candidates.plan.candidate(name).content
        if recipe.family.trains:
            continue
        job = Job(name, recipe, fold=0, is_final=True)
        models[name] = _identify_from_all(models[name], job, context, make_listener(job), deadline)
    return FinalModels(models, best.name, simplest.name)


def _average_folds(candidates: Candidates, name: str, context: RunContext) -> FinalModel:
    """The committee of all models of a candidate, or of the candidates of a committee."""
    members = candidates.members(name)
    scores: list[Sequence[FitScore]] = [r.models for r, _ in members]
    models = [context.load_model(s.model) for member in scores for s in member]
    if len(models) == 1:
        return FinalModel(models[0], "the model of one fold")
    weights = member_weights(scores, [share for _, share in members])
    folds = len({fold for r, _ in members for fold in r.folds})
    count = "one fold" if folds == 1 else f"{folds} folds"
    origin = f"the average of {len(models)} models of {count}"
    if len(members) > 1:
        parts = [f"{len(r.models)} of {r.name} ({100 * share:.0f} %)" for r, share in members]
        origin += f": {', '.join(parts)}"
    try:
        return FinalModel(committee(models, weights), origin)
    except InputError as error:  # as where delays were searched for: each has another value
        return FinalModel(models[0], f"the model of one fold; no average: {error}")


def _identify_from_all(
    averaged: FinalModel,
    job: Job,
    context: RunContext,
    make_listener: MakeListener,
    deadline: Deadline,
) -> FinalModel:
    """The system identified from all records; or the average of folds where that fails."""
    records = tuple(records_without_test(context.data))
    task = make_job_task([job], replace(context, drawn=(FoldSplit((), Roles(records, ())),)))

    def listen(prepared: TrainingPlan | Task) -> Listener:
        return deadline.limit_search(make_listener(prepared))

    try:
        folder = context.folder / CANDIDATES / job.candidate / WHOLE
        fit = fit_in_folder(folder, task, listen, resume=False)[0]
    except OutOfTime:
        why = "no time was left to identify it from all records"
    except Exception as error:  # of any kind: the models of the folds are there
        why = f"not identified from all records: {error_message(error)}"
    else:
        origin = f"identified from all {len(records)} records"
        return FinalModel(fit.model, origin, fit.as_header())
    return replace(averaged, origin=f"{averaged.origin}; {why}")
