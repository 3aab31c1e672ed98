"""Jobs: a candidate fitted to one fold, its free runs scored on the records left out.

A job is done where its folder has a `scores.json`. What is in the folders is the truth: whoever
finds the file there, of the same job, need not do it again.
"""

import hashlib
import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from tustinnet.data.dataset import DataSet
from tustinnet.errors import error_message
from tustinnet.evaluate.folds import Deal, dealt, taking_part, used_by
from tustinnet.evaluate.scores import evaluate, rmse_by_record, scores_header
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.report import FitResult, data_header
from tustinnet.fitting.task import Fold, Member, Task, resolve_system
from tustinnet.models.contract import Model
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.selection.clock import Clock, OutOfTime
from tustinnet.simulate.starts import default_start
from tustinnet.store.checkpoint import fingerprint
from tustinnet.store.files import require_writable_folder, sweep, to_json, write_into
from tustinnet.store.kept_system import CANDIDATES, header_of
from tustinnet.store.model_file import load_model, save, system_of
from tustinnet.store.run import MODEL, Tell, fit_in
from tustinnet.systems.files import AnySystem, SystemFile, SystemTemplate, load_system_or_template

SCORES = "scores.json"
SPENT = "the budget was spent"
_EVERY = slice(None)
LEFT_OUT = "left out"  # where files name a split: records that a model was not fitted to

Ended = Literal["done", "out of time", "failed"]


@dataclass(frozen=True)
class Judging:
    """How candidates are compared.

    Attributes:
        folds: into how many folds the records are dealt.
        start: where free runs start; models that need a warm-up start with theirs.
        horizon: how long a free run lasts at most [s], None for whole records.
    """

    folds: int
    start: str
    horizon: float | None = None


@dataclass(frozen=True)
class Job:
    """A candidate to be fitted to one fold.

    Attributes:
        candidate: its name.
        recipe: its recipe.
        fold: the fold whose records it is scored on.
        seeds: those that train together; an identification has the seed 0.
        physics: the model file that a network corrects, below the run's folder, or None.
    """

    candidate: str
    recipe: Recipe
    fold: int
    seeds: tuple[int, ...] = (0,)
    physics: str | None = None

    @property
    def name(self) -> str:
        """Its folder below that of the candidate."""
        return f"fold-{self.fold}-seeds-{'-'.join(map(str, self.seeds))}"

    @property
    def folder(self) -> str:
        """Its folder below that of the run."""
        return f"{CANDIDATES}/{self.candidate}/{self.name}"


@dataclass(frozen=True)
class SeedScore:
    """A model that a job has made, and how it simulates the records left out.

    Attributes:
        seed: its seed.
        outcome: why the fit ended.
        model: the model file, below the run's folder.
        horizon: over how long its fit compared [s], None for whole records.
        rmse: of every record left out, by start [rad or m].
    """

    seed: int
    outcome: str
    model: str
    horizon: float | None
    rmse: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class JobResult:
    """What a job came to.

    Attributes:
        candidate: of which candidate.
        fold: of which fold.
        seconds: time it took.
        ended: whether it was done.
        scores: of every seed, where it was.
        why: what went wrong, where it was not.
        needs: how long it would have taken [s], as far as that is known, where time was up.
        earlier: whether it was found done.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    candidate: str
    fold: int
    seconds: float
    ended: Ended
    scores: tuple[SeedScore, ...] = ()
    why: str = ""
    needs: float | None = None
    earlier: bool = False


_RESULT = TypeAdapter(JobResult)


@dataclass(frozen=True)
class Workplace:
    """What all jobs of a run share.

    Attributes:
        folder: the run's folder.
        data: the records.
        judging: how candidates are compared.
        system: the system that is given, or None.
        clock: when time is up.
        resume: whether to go on from checkpoints of jobs that were begun.
    """

    folder: Path
    data: DataSet
    judging: Judging
    system: AnySystem | None = None
    clock: Clock = field(default_factory=Clock)
    resume: bool = False

    @cached_property
    def loaded_system(self) -> LagrangianSystem | SystemTemplate | None:
        """The system that is given, its file run once."""
        return None if self.system is None else load_system_or_template(self.system)

    def run_system_file(self) -> None:
        """Runs the system's file, if one is given: what is wrong with it is told once, at first.

        Raises:
            InputError: it cannot be run, or says no system that can be computed.
        """
        _ = self.loaded_system

    @cached_property
    def motion(self) -> float:
        """Root mean square of the positions about each record's mean [rad or m]."""
        q = np.concatenate([e.q - e.q.mean(axis=0) for e in self.data])
        return float(np.sqrt(np.mean(np.sum(q**2, axis=1)))) or 1.0

    @property
    def system_file(self) -> SystemFile | None:
        """The system's file, where it is in one."""
        return self.system if isinstance(self.system, SystemFile) else None


def perform(job: Job, at: Workplace, tell: Tell) -> JobResult:
    """Does a job, or finds it done.

    Models, logs and checkpoints are below the job's folder; `scores.json` is written last.

    Args:
        job: what to do.
        at: where, with what.
        tell: given the plan of a training, or the task of an identification, returns who is told
            while it goes on.
    """
    begun = time.monotonic()
    try:
        task, deal = _task(job, at)
        of = _digest(task, at)
        found = _done_before(job, at, of)
        if found is None:
            folder = at.folder / job.folder
            require_writable_folder(folder)
            sweep(folder)
            results = fit_in(folder, task, at.clock.within(tell), resume=at.resume)
            scores = _scored(job, at, results, deal)
            found = JobResult(job.candidate, job.fold, time.monotonic() - begun, "done", scores)
    except OutOfTime as stop:
        spent = time.monotonic() - begun
        why, needs = SPENT, None if stop.left is None else spent + stop.left
        return JobResult(job.candidate, job.fold, spent, "out of time", why=why, needs=needs)
    except Exception as error:  # of any kind: the others go on, and whoever waits is told why
        spent = time.monotonic() - begun
        return JobResult(job.candidate, job.fold, spent, "failed", why=error_message(error))
    told = _RESULT.dump_python(found, mode="json", exclude={"earlier"})
    content = {"fit": of, "judging": asdict(at.judging), "result": told}
    write_into(at.folder, f"{job.folder}/{SCORES}", to_json(content))
    return found


def _task(job: Job, at: Workplace) -> tuple[Task, Deal]:
    """What is fitted; all folds are in it, so that each compiles to the same program."""
    deals = dealt(at.data, at.judging.folds)
    physics = None if job.physics is None else loaded(job.physics, at)
    folds = tuple(Fold(used_by(deal.roles, job.recipe), physics) for deal in deals)
    members = tuple(Member(seed, fold=job.fold) for seed in job.seeds)
    own = resolve_system(job.recipe, at.loaded_system)
    return Task(job.recipe, folds, members, own), deals[job.fold]


def _digest(task: Task, at: Workplace) -> str:
    """What a finished job belongs to: its fit, whatever it was judged by."""
    digest = hashlib.sha256(str(at.judging.folds).encode())
    for member in task.members:
        digest.update(fingerprint(task, member).encode())
    if at.system_file is not None:
        digest.update(at.system_file.sha256.encode())
    elif task.system is not None:
        digest.update(task.system.name.encode())
    return digest.hexdigest()


def _done_before(job: Job, at: Workplace, of: str) -> JobResult | None:
    """The result that is there already, of this very fit; None where there is none.

    Where it was judged otherwise its models are judged again.
    """
    try:
        content = json.loads((at.folder / job.folder / SCORES).read_text(encoding="utf-8"))
        if content["fit"] != of:
            return None
        found, before = _read_result(content["result"]), content["judging"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    if not all((at.folder / s.model).is_file() for s in found.scores):
        return None
    found = replace(found, earlier=True)
    if before == asdict(at.judging):
        return found
    names = list(next(iter(found.scores[0].rmse.values())))
    scores = [replace(s, rmse=judged(loaded(s.model, at), at, names)) for s in found.scores]
    return replace(found, scores=tuple(scores))


def _read_result(content: Any) -> JobResult:
    """A result as its file has it, where a number that is not finite is null."""
    for score in content["scores"]:
        score["rmse"] = {
            start: {name: math.inf if x is None else x for name, x in of.items()}
            for start, of in score["rmse"].items()
        }
    return _RESULT.validate_python(content)


def _scored(
    job: Job, at: Workplace, results: Sequence[FitResult], deal: Deal
) -> tuple[SeedScore, ...]:
    """Writes the models and scores each on the records that were left out."""
    found = []
    for result in results:
        rmse = judged(result.model, at, [e.name for e in deal.scored])
        model = f"{job.folder}/{result.member.name}/{MODEL}"
        save(result.model, at.folder / model, **_header(result, at, deal, rmse))
        found.append(SeedScore(result.seed, result.outcome, model, result.horizon, rmse))
    return tuple(found)


def starts_of(model: Model, at: Workplace) -> tuple[str, ...]:
    """Where free runs of a model start: first the start that judges, then the usual one."""
    usual = default_start(list(at.data), model)
    return (usual,) if model.warm_up else tuple(dict.fromkeys((at.judging.start, usual)))


def judged(
    model: Model, at: Workplace, names: Sequence[str], starts: slice = _EVERY
) -> dict[str, dict[str, float]]:
    """RMSE of some records by start, of all starts or some; that which judges comes first.

    All records run, whoever is asked for, so that models that are alike share a program.
    """
    known = taking_part(at.data)
    found = {}
    for start in starts_of(model, at)[starts]:
        of = rmse_by_record(evaluate(model, known, start, horizon=at.judging.horizon))
        found[start] = {name: of[name] for name in names}
    return found


def _header(
    result: FitResult, at: Workplace, deal: Deal, rmse: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """What a model file says beside the model."""
    start, of = next(iter(rmse.items()))
    return {
        **result.as_header(),
        "data": data_header(at.data.name, deal.roles.all),
        "scores": scores_header(LEFT_OUT, start, at.data.channels, at.judging.horizon, of),
        **(header_of(at.system_file) if result.recipe.family.needs else {}),
    }


def loaded(model: str, at: Workplace) -> Model:
    """The model of a file below the run's folder."""
    path = at.folder / model
    return load_model(path, at.loaded_system if system_of(path) else None)
