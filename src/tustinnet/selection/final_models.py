"""Final models of candidates: averages of folds, and parameters from all records.

What is delivered has been simulated: an average or a second identification is another model than
those that the folds scored.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError, error_message
from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.evaluate.scores import Score, rmse_by_record, score_runs
from tustinnet.families.committee import committee
from tustinnet.families.family import family_of
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.fits.in_folder import fit_in_folder
from tustinnet.fitting.identify import UnfinishedSearchError
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.roles import Roles, records_without_test
from tustinnet.models.contract import Model
from tustinnet.selection.folds import FoldSplit
from tustinnet.selection.jobs import Job, MakeListener, RunContext, make_job_task
from tustinnet.selection.plan import SelectionPlan
from tustinnet.selection.ranking import CandidateResult, paired_difference
from tustinnet.store.kept_system import CANDIDATES

WHOLE = "all-records"  # the folder of an identification from all records
_AS_PROMISED = 1.5  # times the error that folds promise: more is another model than was scored


@dataclass(frozen=True)
class SelectionResults:
    """The results of a plan's candidates.

    Attributes:
        plan: the plan.
        results: of each candidate, from the simplest to the most complex.
        remaining: the names of those that can be chosen.
    """

    plan: SelectionPlan
    results: tuple[CandidateResult, ...]
    remaining: tuple[str, ...]

    @property
    def choosable(self) -> list[CandidateResult]:
        """The candidates that can be chosen, from the simplest on."""
        return [r for r in self.results if r.name in self.remaining]

    def result(self, name: str) -> CandidateResult:
        """The result of a candidate."""
        return next(r for r in self.results if r.name == name)


@dataclass(frozen=True)
class FinalModel:
    """A model that a candidate was made into.

    Attributes:
        model: the model.
        origin: how it was made, in words.
        header: the header of its fit, where it was one.
        records: those it was made from, where these are not all.
    """

    model: Model
    origin: str
    header: Mapping[str, Any] = field(default_factory=dict)
    records: Sequence[Experiment] = ()


class WholeRecords(NamedTuple):
    """The best candidate by its free runs of whole records.

    Attributes:
        best: the candidate.
        scores: its free runs of whole records, by models that were not fitted to them.
        alike: names of the candidates of which these decided; empty where nothing was to decide.
    """

    best: CandidateResult
    scores: Mapping[str, Score]
    alike: tuple[str, ...] = ()


def compare_whole_records(
    candidates: SelectionResults,
    best: CandidateResult,
    context: RunContext,
    deadline: Deadline = NEVER,
) -> WholeRecords:
    """Runs the best candidate along whole records, and what pieces of these do not tell from it.

    Of several that are as good over pieces the one is the best whose free runs of whole records
    are off least; what is further off than the records move is lost.

    Args:
        candidates: the results of the candidates.
        best: the best one by what was scored.
        context: the records, and how they were scored.
        deadline: after it no other candidate is run.
    """

    def run(result: CandidateResult) -> Mapping[str, Score]:
        return context.evaluate_folds(result.fits_by_fold, result.start, None)

    whole = {best.name: run(best)}
    for other in candidates.choosable if context.scoring.horizon is not None else ():
        difference = paired_difference(other, best)
        is_as_good = difference.records > 1 and difference.mean <= difference.standard_error
        has_all = other is not best and other.fits_by_fold.keys() >= best.fits_by_fold.keys()
        if is_as_good and has_all and not deadline.has_passed():
            whole[other.name] = run(other)
    if len(whole) == 1:
        return WholeRecords(best, whole[best.name])
    most = context.motion_within_turns
    errors = {
        name: np.mean([np.fmin(score.rmse, most) for score in scores.values()])
        for name, scores in whole.items()
    }
    name = min(errors, key=lambda name: errors[name])
    return WholeRecords(candidates.result(name), whole[name], tuple(whole))


def make_final_models(
    candidates: SelectionResults,
    best: CandidateResult,
    simplest: CandidateResult,
    context: RunContext,
    make_listener: MakeListener,
    deadline: Deadline = NEVER,
) -> dict[str, FinalModel]:
    """Makes the models of what can be chosen, by name.

    The best and the simplest that is as good have simulated all records: where the errors are far
    above what folds promise, the next way to make the model is taken.

    Args:
        candidates: the results of the candidates.
        best: the chosen one.
        simplest: the simplest that is as good.
        context: where the models are, and how they were scored.
        make_listener: given the job of an identification from all records, returns its
            listener.
        deadline: after it nothing is identified from all records.
    """
    models = {}
    for result in candidates.choosable:
        is_tried = result.name in (best.name, simplest.name)
        listeners = make_listener if is_tried else None
        ways = _possible_models(candidates, result, context, listeners, deadline)
        models[result.name] = (
            _first_as_promised(ways, result, context, deadline) if is_tried else next(ways)
        )
    return models


def _possible_models(
    candidates: SelectionResults,
    result: CandidateResult,
    context: RunContext,
    make_listener: MakeListener | None,
    deadline: Deadline,
) -> Iterator[FinalModel]:
    """The ways to make the model of a candidate, those to be preferred first.

    Parameters are identified from all records (unless there is no `make_listener`). Weights of
    all folds are averaged. Models of single folds come last, the one with the lowest error first.
    """
    fits, why = result.fits, ""
    single = sorted(fits, key=lambda fit: mean_and_error(fit.rmse[result.start].values())[0])
    recipe = context.recipe_of(candidates.plan.candidate(result.name))
    if recipe.family.averages_folds and len(fits) > 1:
        try:
            average = _average([context.load_model(fit.model) for fit in fits])
            yield FinalModel(average, f"the average of the models of {len(fits)} folds")
        except InputError as error:  # as where delays were searched for: each has another value
            why = f"; no average: {error}"
    if not recipe.family.averages_folds and make_listener is not None:
        job = Job(result.name, recipe, fold=0, origin=single[0].model, is_final=True)
        made = _identify_from_all(job, context, make_listener(job), deadline)
        if isinstance(made, FinalModel):
            yield made
        else:
            why = f"; {made}"
    for fit in single:
        fold = next(k for k, fits in result.fits_by_fold.items() if fit in fits)
        records = context.splits[fold].roles.all
        origin = f"the model of one fold{why}"
        yield FinalModel(context.load_model(fit.model), origin, records=records)


def _average(models: Sequence[Model]) -> Model:
    """The average of the models of folds.

    Raises:
        InputError: models that cannot be averaged, as those that correct several systems.
    """
    equations = (family_of(model).equations(model) for model in models)
    systems = dict.fromkeys(e.system.name for e in equations if e is not None)
    if len(systems) > 1:
        raise InputError(
            "average",
            f"models of the systems {', '.join(systems)}",
            "models of one system",
            "a model file is of one system at most",
        )
    return committee(models)


def _first_as_promised(
    ways: Iterator[FinalModel], result: CandidateResult, context: RunContext, deadline: Deadline
) -> FinalModel:
    """The first model whose free runs of all records are about as good as folds promise.

    Where none is, or time is up, the one with the lowest error of those that were tried. Records
    that a model was fitted to are among them: its error is lower than the promised one unless
    something is wrong with it.
    """
    records, tried = records_without_test(context.data), list[tuple[float, FinalModel]]()
    start, promised = result.start, result.mean
    for way in ways:
        scores = score_runs(way.model, records, start, horizon=context.scoring.horizon)
        error = mean_and_error(rmse_by_record(scores).values())[0]
        tried.append((error if math.isfinite(error) else math.inf, way))
        is_late = deadline.has_passed() and math.isfinite(error)
        if is_late or error <= _AS_PROMISED * promised:
            break
    final = min(tried, key=lambda pair: pair[0])[1]
    if final is tried[0][1]:
        return final
    origin = (
        f"{final.origin}; {tried[0][1].origin} was discarded, its free runs of all records are "
        f"{tried[0][0] / promised:.2g} times as far off as folds promise"
    )
    return replace(final, origin=origin)


def _identify_from_all(
    job: Job, context: RunContext, listener: Listener, deadline: Deadline
) -> FinalModel | str:
    """The system identified from all records, from the values of a fold on; or why it was not."""
    records = tuple(records_without_test(context.data))
    drawn = (FoldSplit((), Roles(records, ())),)
    task = make_job_task([job], context.with_changes(drawn=drawn))
    folder = context.folder / CANDIDATES / job.candidate / WHOLE
    why = "no time was left to identify it from all records"
    try:
        (fit,) = fit_in_folder(
            folder, task, replace(listener, should_stop=deadline.comes_within), resume=False
        )
    except UnfinishedSearchError:
        return why
    except Exception as error:  # of any kind: the models of the folds are there
        return f"not identified from all records: {error_message(error)}"
    # an unfinished search is no match for those of the folds that were finished
    if fit.is_out_of_time:
        return why
    return FinalModel(fit.model, f"identified from all {len(records)} records", fit.as_header())
