"""Jobs: a candidate fitted to one fold, its free runs scored on the records left out.

Whatever is fitted to be scored on other records is a job: the folds of a selection and of a
cross-validation, the draws of a learning curve. A job of a run with a folder is done where its
folder has a `scores.json`. The folders are the truth: whoever finds the file there, of the same
job, need not do it again.
"""

import hashlib
import json
import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError, error_message
from tustinnet.evaluate.reference import Reference, find_reference
from tustinnet.evaluate.scores import Score, score_runs, scores_header
from tustinnet.families.family import family_of
from tustinnet.fits.deadline import Deadline
from tustinnet.fits.in_folder import fit_in_folder
from tustinnet.fits.timing import refine_delays
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.identify import UnfinishedSearchError
from tustinnet.fitting.inverse_dynamics.along import find_obstacle
from tustinnet.fitting.inverse_dynamics.column_mistakes import COLUMN_MISTAKES
from tustinnet.fitting.inverse_dynamics.of_model import unexplained_forces
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import IdentificationRecipe, Recipe
from tustinnet.fitting.report import OUT_OF_TIME, FitResult, data_header
from tustinnet.fitting.roles import records_without_test
from tustinnet.fitting.task import Fold, Member, Origin, Task, begin_with, resolve_system
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.selection.folds import FoldSplit, split_into_folds
from tustinnet.selection.plan import Candidate
from tustinnet.selection.scoring import RmseByStart, Scorer
from tustinnet.store.checkpoint import fingerprint
from tustinnet.store.files import (
    remove_partial_files,
    require_writable_folder,
    to_json,
    write_into,
)
from tustinnet.store.kept_system import CANDIDATES, system_header
from tustinnet.store.model_file import load_model, read_system_name, save
from tustinnet.store.run_folder import MODEL, SCORES
from tustinnet.systems.files import AnySystem, SystemFile, SystemTemplate, find_system
from tustinnet.systems.loading import load_system_or_template

SPENT = "its share of the budget was spent"
NO_STAGE = f"{SPENT} before a stage of its search was finished"
LEFT_OUT = "left out"  # where files name a split: records that a model was not fitted to

Ended = Literal["done", "out of time", "failed"]


@dataclass(frozen=True, eq=False)
class Job:
    """A candidate to be fitted to one fold.

    Attributes:
        candidate: its name.
        recipe: its recipe.
        fold: the fold whose records it is scored on, an index of the run's splits.
        seeds: those that train together; an identification has the seed 0.
        physics: the model that a network corrects, as `FitScore.model` names it, or None.
        origin: the model that the fit begins with, as `FitScore.model` names it, or None.
        limit: how long it may take [s]; what is done by then is scored.
        continues: whether it goes on from where it was stopped before.
        is_final: whether it fits all training records instead of a fold's.
    """

    candidate: str
    recipe: Recipe
    fold: int
    seeds: tuple[int, ...] = (0,)
    physics: str | None = None
    origin: str | None = None
    limit: float = math.inf
    continues: bool = False
    is_final: bool = False

    @property
    def label(self) -> str:
        """Candidate and records of the fit, for people."""
        return (
            f"{self.candidate}, {'all training records' if self.is_final else f'fold {self.fold}'}"
        )

    @property
    def name(self) -> str:
        """The name of its folder below that of the candidate."""
        return f"fold-{self.fold}-seeds-{'-'.join(map(str, self.seeds))}"

    @property
    def folder(self) -> str:
        """The path of its folder below that of the run."""
        return f"{CANDIDATES}/{self.candidate}/{self.name}"


MakeListener = Callable[[Job], Listener]  # from a job to the listener of its fit


@dataclass(frozen=True)
class FitScore:
    """A model that a job has made, and how it simulates the records left out.

    Attributes:
        seed: its seed.
        outcome: why the fit ended.
        model: the model file, below the run's folder.
        horizon: over how long its fit compared [s], None for whole records.
        rmse: of every record left out, by start [rad or m].
        unexplained: share of the inputs' force at each coordinate that equations of motion do not
            explain along these records; of other models, and where forces tell nothing, none.
        column_mistakes: what forces along the records say of their columns: exchanged, in another
            unit, of the other sign.
        substeps: integration steps in a period; 1 of a model that is not integrated.
    """

    seed: int
    outcome: str
    model: str
    horizon: float | None
    rmse: RmseByStart
    unexplained: Mapping[str, float] = field(default_factory=dict)
    column_mistakes: tuple[str, ...] = ()
    substeps: int = 1

    @property
    def is_out_of_time(self) -> bool:
        """Whether the fit was stopped at its time limit."""
        return self.outcome.startswith(OUT_OF_TIME)


@dataclass(frozen=True)
class JobResult:
    """The scores of a job, or the reason why it has none.

    Attributes:
        candidate: of which candidate.
        fold: of which fold.
        seconds: time it took.
        ended: whether it was done. A job that is `out of time` may have scores: of the best weights
            when the deadline came, or of the last finished stage of an identification.
        scores: of every seed, where there are any.
        why: the reason where it was not done.
        earlier: whether it was found done.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    candidate: str
    fold: int
    seconds: float
    ended: Ended
    scores: tuple[FitScore, ...] = ()
    why: str = ""
    earlier: bool = False


_RESULT = TypeAdapter(JobResult)


@dataclass(frozen=True)
class RunContext:
    """Records, system and scoring that all jobs of a run share.

    Attributes:
        data: the records.
        scoring: how free runs are scored.
        folder: the run's folder.
        models: models by the name of their file, of a run that keeps all in memory and writes
            nothing; None of a run with a folder.
        system: the system that is given, or None.
        resume: whether to go on from checkpoints of jobs that were not finished.
        drawn: the splits that jobs are fitted to; None for the folds of the records.
        cutoff: frequency up to which forces of equations of motion are compared beside free runs
            [Hz]; None where they are not.
        delays: names of the inputs whose delays identifications refine.
    """

    data: DataSet
    scoring: Scorer
    folder: Path = Path()
    models: dict[str, Model] | None = None
    system: AnySystem | SystemTemplate | None = None
    resume: bool = False
    drawn: tuple[FoldSplit, ...] | None = None
    cutoff: float | None = None
    delays: tuple[str, ...] = ()

    @cached_property
    def splits(self) -> tuple[FoldSplit, ...]:
        """Records to fit to and to score, which jobs name by their index."""
        if self.drawn is not None:
            return self.drawn
        return tuple(split_into_folds(self.data, self.scoring.folds))

    @cached_property
    def loaded_system(self) -> LagrangianSystem | SystemTemplate | None:
        """The system that is given, its file run once.

        Raises:
            InputError: it cannot be run, or defines no system that can be computed.
        """
        return None if self.system is None else load_system_or_template(self.system)

    def __getstate__(self) -> dict[str, Any]:
        """The fields that a worker is sent: nothing computed here, and the system's file itself."""
        state = {f.name: getattr(self, f.name) for f in fields(self)}
        if isinstance(self.system, str | Path):
            state["system"] = find_system(self.system)
        return state | {"folder": self.folder.resolve()}

    def with_changes(self, **changes: Any) -> "RunContext":
        """Copy of the context with other fields than `system`; the system's file is not run again.

        Args:
            changes: the fields that change, by name.
        """
        other = replace(self, **changes)
        # programs are kept by the system: another copy of it would be compiled anew
        vars(other)["loaded_system"] = self.loaded_system
        return other

    def recipe_of(self, candidate: Candidate) -> Recipe:
        """The recipe by which a candidate is fitted to these records.

        Where forces are compared, and pieces of records scored, a search that begins with what
        forces say is over these.
        """
        horizon = self.scoring.horizon
        if horizon is None or self.cutoff is None:
            return candidate.content
        return candidate.recipe_over(horizon)

    @cached_property
    def motion_within_turns(self) -> float:
        """Root mean square of the positions about their means, without whole turns [rad or m]."""
        squares = 0.0
        for i, coordinate in enumerate(self.data.channels.coordinates):
            q = np.concatenate([e.q[:, i] - e.q[:, i].mean() for e in self.data])
            if coordinate.kind == "angular":
                turns = np.exp(1j * np.concatenate([e.q[:, i] for e in self.data]))
                within = np.angle(turns * np.exp(-1j * np.angle(turns.mean())))
                q = min(q, within, key=np.std)
            squares += float(np.mean(q**2))
        return math.sqrt(squares) or 1.0

    @cached_property
    def reference(self) -> Reference:
        """The better trivial predictor over the free runs that are scored."""
        return find_reference(records_without_test(self.data), self.scoring.horizon)

    @cached_property
    def lost_error(self) -> float:
        """The RMSE from which on a free run is lost [rad or m].

        What the records move; over pieces of them, at most what the better trivial predictor has.
        """
        if self.scoring.horizon is None:
            return self.motion_within_turns
        return min(self.motion_within_turns, self.reference.mean) or self.motion_within_turns

    @property
    def system_file(self) -> SystemFile | None:
        """The system's file, where it is in one."""
        return self.system if isinstance(self.system, SystemFile) else None

    def system_for(self, recipe: Recipe) -> LagrangianSystem | SystemTemplate | None:
        """The system that a recipe identifies: the given one, unless it makes one for records."""
        named = resolve_system(recipe, None)
        return (
            named
            if isinstance(named, SystemTemplate)
            else resolve_system(recipe, self.loaded_system)
        )

    def system_header(self, model: Model) -> dict[str, Any]:
        """The entry in a model's file on the file of the system that is given; {} without it."""
        equations, given = family_of(model).equations(model), self.loaded_system
        is_given = equations is not None and given and equations.system.name == given.name
        return system_header(self.system_file) if is_given else {}

    def load_model(self, name: str) -> Model:
        """The model of a file below the run's folder."""
        if self.models is not None:
            return self.models[name]
        path, given = self.folder / name, self.loaded_system
        is_given = given is not None and read_system_name(path) == given.name
        return load_model(path, given if is_given else None)

    def evaluate_folds(
        self,
        fits_by_fold: Mapping[int, Sequence[FitScore]],
        start: str,
        horizon: float | None,
        names: Collection[str] | None = None,
    ) -> dict[str, Score]:
        """Free runs of records by the models of the first seed that were not fitted to them.

        Args:
            fits_by_fold: what was fitted.
            start: where the free runs start.
            horizon: how long a free run lasts at most [s], None for whole records.
            names: the records; None for all that the folds have.
        """
        scores: dict[str, Score] = {}
        for first, *_ in fits_by_fold.values():
            scored = first.rmse[start]
            records = [self.data[name] for name in scored if names is None or name in names]
            if records:
                runs = score_runs(self.load_model(first.model), records, start, horizon=horizon)
                scores |= {score.experiment: score for score in runs}
        return scores

    def score(self, model: Model, fit_horizon: float | None, fold: int) -> RmseByStart:
        """RMSE of the records that a fold leaves out, by start."""
        split = self.splits[fold]
        return self.scoring.score(model, fit_horizon, split, self.data) if split.scored else {}


def perform_jobs(
    jobs: Sequence[Job],
    context: RunContext,
    listener: Listener,
    *,
    raises: bool = False,
) -> list[JobResult]:
    """Fits the models of jobs and scores each on the records that it was not fitted to.

    In a folder, models, logs and checkpoints are below the job's folder; `scores.json` is written
    last. A training that its limit stops is scored with its best weights so far, an
    identification with the model of its last finished stage.

    Args:
        jobs: a job; or, of a run in memory, several of one candidate, which train together.
        context: records, folder, system, scoring.
        listener: functions that are called while they go on.
        raises: whether errors are raised; otherwise they are results.

    Returns:
        A result a job.
    """
    started = time.monotonic()
    deadline = Deadline.after(min(job.limit for job in jobs))
    listener = replace(listener, should_stop=deadline.comes_within)

    def spent() -> float:
        return (time.monotonic() - started) / len(jobs)

    try:
        task = make_job_task(jobs, context)
        if context.models is not None:
            fits = fit_task(task, listener)
            return [_score_fits(job, context, fits, spent) for job in jobs]
        (job,) = jobs
        digest = _fit_digest(task, context)
        earlier = _find_earlier_result(job, context, digest)
        if earlier is not None:
            result = earlier
        else:
            folder = context.folder / job.folder
            require_writable_folder(folder)
            remove_partial_files(folder)
            resume = context.resume or job.continues
            fits = fit_in_folder(folder, task, listener, resume=resume)
            result = _score_fits(job, context, fits, spent)
    except UnfinishedSearchError:
        return [JobResult(j.candidate, j.fold, spent(), "out of time", why=NO_STAGE) for j in jobs]
    except BaseException as error:  # of any kind: the others go on, and the reason is reported
        if raises or isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        why = error_message(error)
        return [JobResult(j.candidate, j.fold, spent(), "failed", why=why) for j in jobs]
    if result.scores:
        plain = _RESULT.dump_python(result, mode="json", exclude={"earlier"})
        content = {"fit": digest, "judging": context.scoring.as_plain(), "result": plain}
        write_into(context.folder, f"{job.folder}/{SCORES}", to_json(content))
    return [result]


def perform_job(context: RunContext, job: Job) -> JobResult:
    """Does a job in silence, as a worker does it; see `perform_jobs`."""
    return perform_jobs([job], context, SILENT)[0]


def make_job_task(jobs: Sequence[Job], context: RunContext) -> Task:
    """The task of jobs of one candidate; all folds are in it, so that each compiles alike."""
    first = jobs[0]
    by_fold = {
        job.fold: (
            None if job.physics is None else context.load_model(job.physics),
            None
            if job.origin is None
            else Origin(context.load_model(job.origin), fits_records=not job.is_final),
        )
        for job in jobs
    }
    folds = tuple(
        Fold(split.roles_for(first.recipe), *by_fold.get(f, by_fold[first.fold]))
        for f, split in enumerate(context.splits)
    )
    members = tuple(Member(seed, fold=job.fold) for job in jobs for seed in job.seeds)
    system = context.system_for(first.recipe)
    recipe, origin = first.recipe, by_fold[first.fold][1]
    if origin is not None:
        recipe = begin_with(recipe, origin.model, system, context.data)
        train = context.splits[first.fold].roles_for(recipe).train
        recipe = _begin_by_group(recipe, origin.model, train)
    return Task(refine_delays(recipe, context.delays), folds, members, system)


def _begin_by_group(recipe: Recipe, origin: Model, records: Sequence[Experiment]) -> Recipe:
    """The recipe of an identification that begins with values by group, too.

    Of groups that the records have: the origin was fitted to records of the same machine.
    """
    equations = family_of(origin).equations(origin)
    if equations is None or not isinstance(recipe, IdentificationRecipe):
        return recipe
    names = {
        p.for_group(group).name
        for p in equations.system.grouped
        for group in {e.group(str(p.per)) for e in records}
        if group
    }
    values = {name: float(x) for name, x in equations.values.items() if name in names}
    return recipe.with_begin({**recipe.model.begin, **values})


def _fit_digest(task: Task, context: RunContext) -> str:
    """The digest of a job's fit, whatever it is scored by."""
    digest = hashlib.sha256(str(context.scoring.folds).encode())
    for member in task.members:
        digest.update(fingerprint(task, member).encode())
    if context.system_file is not None:
        digest.update(context.system_file.sha256.encode())
    elif task.system is not None:
        digest.update(task.system.name.encode())
    return digest.hexdigest()


def _find_earlier_result(job: Job, context: RunContext, digest: str) -> JobResult | None:
    """The result in the job's folder, of this very fit; None where there is none.

    Where it was scored otherwise its models are scored again. A fit that the deadline stopped
    counts within the same run; a resumed run goes on with a training, and repeats an
    identification.
    """
    path = context.folder / job.folder / SCORES
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["fit"] != digest:
            return None
        for score in content["result"]["scores"]:  # a number that is not finite is null in a file
            score["rmse"] = {
                start: {name: math.inf if x is None else x for name, x in rmse.items()}
                for start, rmse in score["rmse"].items()
            }
        result, scoring = _RESULT.validate_python(content["result"]), content["judging"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    if result.ended != "done" and (context.resume or job.continues):
        return None
    if not all((context.folder / s.model).is_file() for s in result.scores):
        return None
    result = replace(result, earlier=True)
    if scoring == context.scoring.as_plain():
        return result
    scores = [
        replace(s, rmse=context.score(context.load_model(s.model), s.horizon, job.fold))
        for s in result.scores
    ]
    return replace(result, scores=tuple(scores))


def _score_fits(
    job: Job,
    context: RunContext,
    fits: Sequence[FitResult],
    spent: Callable[[], float],
) -> JobResult:
    """Keeps the models of a job and scores each on the records that were left out."""
    fits = [fit for fit in fits if fit.member.fold == job.fold]
    scores = []
    for fit in sorted(fits, key=lambda fit: job.seeds.index(fit.seed)):
        if fit.is_out_of_time and not _has_useful_model(fit):
            continue
        rmse = context.score(fit.model, fit.horizon, job.fold)
        model = f"{job.folder}/{fit.member.name}/{MODEL}"
        if context.models is not None:
            context.models[model] = fit.model
        else:
            start, of_start = next(iter(rmse.items()))
            split, channels = context.splits[job.fold], context.data.channels
            horizon = context.scoring.used_horizon(fit.horizon, split)
            header = {
                **fit.as_header(),
                "data": data_header(context.data.name, split.roles.all),
                "scores": scores_header(LEFT_OUT, start, channels, horizon, of_start),
                **context.system_header(fit.model),
            }
            save(fit.model, context.folder / model, **header)
        scores.append(
            FitScore(
                fit.seed,
                fit.outcome,
                model,
                fit.horizon,
                rmse,
                unexplained=_unexplained_forces(job, fit, context),
                column_mistakes=tuple(f.text for f in fit.findings if f.code in COLUMN_MISTAKES),
                substeps=fit.model.substeps if isinstance(fit.model, Discretised) else 1,
            )
        )
    ended: Ended = "out of time" if any(f.is_out_of_time for f in fits) else "done"
    if ended == "done":
        return JobResult(job.candidate, job.fold, spent(), ended, tuple(scores))
    scored = "best weights so far are" if job.recipe.family.resumable else "last finished stage is"
    why = f"{SPENT}: its {scored} scored" if scores else SPENT
    return JobResult(job.candidate, job.fold, spent(), ended, tuple(scores), why)


def _unexplained_forces(job: Job, fit: FitResult, context: RunContext) -> Mapping[str, float]:
    """Shares of forces along the records left out that the equations of a fit do not explain."""
    equations = None if fit.identification is None else family_of(fit.model).equations(fit.model)
    records = context.splits[job.fold].scored
    if context.cutoff is None or equations is None or find_obstacle(equations.system, records):
        return {}
    try:
        return unexplained_forces(equations, records, context.cutoff)
    except InputError:  # records too short for it: free runs decide anyway
        return {}


def _has_useful_model(fit: FitResult) -> bool:
    """Whether a training that was stopped has done an epoch, and no validation error diverged.

    A search has a model wherever it was stopped.
    """
    training = fit.details.get("training")
    if training is None:
        return True
    started = training["kept_epoch"] > 0 or len(training["epochs"]) > 1
    return started and (fit.validation_rmse is None or math.isfinite(fit.validation_rmse))
