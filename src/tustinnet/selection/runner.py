"""The runner of jobs: one after another in this process, or several at once by an executor."""

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass

from tustinnet.errors import InputError, error_message
from tustinnet.fitting.listener import SILENT
from tustinnet.selection.jobs import (
    Job,
    JobResult,
    MakeListener,
    RunContext,
    perform_job,
    perform_jobs,
)


@dataclass(frozen=True)
class Workplace:
    """Where jobs are done.

    Attributes:
        executor: any executor, of threads, processes or machines, that share the run's folder
            under one path; None for this process.
        make_listener: given a job, the listener of its fit in this process.
        on_message: called with a sentence on every job that an executor has done.
        raises: whether an error in a job is raised in this process; otherwise it is its result.
    """

    executor: Executor | None = None
    make_listener: MakeListener = lambda job: SILENT
    on_message: Callable[[str], None] = lambda sentence: None
    raises: bool = False

    @property
    def places(self) -> int:
        """How many jobs can be done at once: as an executor says (`places`), or has workers."""
        executor = self.executor
        return getattr(executor, "places", 0) or getattr(executor, "_max_workers", 1)


def run_jobs(
    choose: Callable[[], Sequence[Job]],
    on_result: Callable[[JobResult], None],
    find_context: Callable[[], RunContext],
    workplace: Workplace,
) -> None:
    """Runs jobs as long as there are any.

    Args:
        choose: the next job, whenever one could begin; of a run in memory also several of one
            candidate, which train together; none where nothing can begin at present.
        on_result: called with every result at once.
        find_context: records, folder, system and scoring of the jobs that begin.
        workplace: where they are done.
    """
    running: dict[Future[JobResult], Job] = {}
    try:
        while True:
            while len(running) < workplace.places and (jobs := choose()):
                if workplace.executor is not None:
                    for job in jobs:
                        context = find_context()
                        running[workplace.executor.submit(perform_job, context, job)] = job
                    continue
                listener = workplace.make_listener(jobs[0])
                for result in perform_jobs(jobs, find_context(), listener, raises=workplace.raises):
                    on_result(result)
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job = running.pop(future)
                result = _take_result(future, job, find_context())
                ended = f"{job.label}: {result.ended} in {result.seconds:.1f} s"
                workplace.on_message(f"{job.label}: was done before" if result.earlier else ended)
                on_result(result)
    finally:
        for future in running:
            future.cancel()


def _take_result(future: Future[JobResult], job: Job, context: RunContext) -> JobResult:
    """The result of a job that an executor has done; a failure where its worker died.

    Raises:
        InputError: a worker of another version, or that does not share the folder.
    """
    try:
        result = future.result()
    except InputError:
        raise
    except Exception as error:  # of any kind: of the worker, as those of a job are its result
        return JobResult(job.candidate, job.fold, 0.0, "failed", why=error_message(error))
    missing = [s.model for s in result.scores if not (context.folder / s.model).is_file()]
    if missing:
        raise InputError(
            "executor",
            f"{context.folder} lacks {missing[0]}, which a worker wrote",
            "a folder that all workers share, under one path",
            "choose another folder",
        )
    return result
