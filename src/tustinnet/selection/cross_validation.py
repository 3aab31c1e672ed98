"""Cross-validation by jobs: each fold is fitted wherever an executor has room."""

from collections.abc import Callable, Sequence
from pathlib import Path

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluate.folds import Question, Validated, dealt, fold_scores, starts_asked
from tustinnet.selection.executors import Executor
from tustinnet.selection.jobs import SCORES, Job, JobResult, Judging, Workplace, loaded
from tustinnet.store.kept_system import CANDIDATES
from tustinnet.systems.files import AnySystem

_PHYSICS, _RECIPE = "physics", "recipe"  # what the folders of jobs are called


def cross_validate_by_jobs(
    data: DataSet,
    asked: Question,
    folder: Path,
    executor: Callable[[Workplace], Executor],
    system: AnySystem | None = None,
) -> Validated:
    """Does what `cross_validate` does, a job for every fold.

    Jobs that are done below the folder already, of the same fit, are not done again.

    Args:
        data: the records; the split `test` stays out.
        asked: what to fit, how often.
        folder: where jobs write models and logs, below `candidates`.
        executor: where the jobs are done, as `cluster` gives it.
        system: the system of the question as it was named, for workers to load.

    Raises:
        InputError: as `cross_validate`; a job that failed.
    """
    deals, starts = dealt(data, asked.folds), starts_asked(data, asked)
    at = Workplace(folder, data, Judging(len(deals), starts[0]), system)
    do, found = executor(at), []
    physics: dict[int, str] = {}
    if asked.physics is not None:
        found += _done(do, [Job(_PHYSICS, asked.physics, fold) for fold in range(len(deals))])
        physics = {result.fold: result.scores[0].model for result in found}
    seeds = asked.seeds if asked.recipe.family.trains else (0,)
    jobs = [
        Job(_RECIPE, asked.recipe, fold, seeds, physics.get(fold)) for fold in range(len(deals))
    ]
    fits = sorted(_done(do, jobs), key=lambda result: result.fold)
    scores = [
        score
        for result in fits
        for of in result.scores
        for score in fold_scores(
            loaded(of.model, at), (result.fold, of.seed), of.horizon,
            deals[result.fold].scored, data, asked,
        )
    ]  # fmt: skip
    return Validated(
        recipe=asked.recipe.name,
        unit=data.channels.unit,
        scores=tuple(scores),
        outcomes={f"fold {r.fold}, seed {of.seed}": of.outcome for r in fits for of in r.scores},
        seconds=sum(result.seconds for result in (*found, *fits)),
    )


def forget(folder: Path, results: Sequence[str], *, jobs: bool) -> None:
    """Removes the results of an earlier validation by name, and perhaps the scores of its jobs.

    What is interrupted then leaves no results of another validation.
    """
    for name in results:
        (folder / name).unlink(missing_ok=True)
    for name in (_PHYSICS, _RECIPE) if jobs else ():
        for path in (folder / CANDIDATES / name).glob(f"*/{SCORES}"):
            path.unlink()


def _done(executor: Executor, jobs: Sequence[Job]) -> list[JobResult]:
    """What jobs came to, in the order in which they ended."""
    waiting, found = list(jobs), []
    while len(found) < len(jobs):
        if waiting and executor.free:
            executor.submit(waiting.pop(0))
            continue
        result = executor.result()
        if result.ended != "done":
            raise InputError(f"fold {result.fold}", result.why)
        found.append(result)
    return found
