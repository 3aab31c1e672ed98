"""The runner of jobs: in their order, in this process or wherever an executor has room."""

from collections.abc import Callable, Sequence
from typing import Protocol

from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.fitting.listener import SILENT
from tustinnet.selection.jobs import Job, JobResult, MakeJobListener, RunContext, perform_jobs


class Executor(Protocol):
    """Does jobs, in any order, several at once where it can."""

    @property
    def is_free(self) -> bool:
        """Whether another job could begin now."""
        ...

    def submit(self, job: Job, deadline: Deadline) -> None:
        """Takes a job that has to end in time."""
        ...

    def result(self) -> JobResult:
        """Waits for the next job that ends, of those that were taken."""
        ...


MakeExecutor = Callable[[RunContext], Executor]


class InProcess:
    """Does jobs in this process: one at a time, or in memory all of a candidate together.

    Args:
        context: records, folder, system, scoring.
        make_job_listener: given a job, the `make_listener` of `perform_jobs`.
        raises: whether an error in a job is raised; otherwise it is the job's result.
        together: whether jobs that could begin at the same time train as one program, each on its
            own fold; for runs in memory.
    """

    def __init__(
        self,
        context: RunContext,
        make_job_listener: MakeJobListener = lambda job: lambda prepared: SILENT,
        *,
        raises: bool = False,
        together: bool = False,
    ) -> None:
        self._context, self._make_job_listener = context, make_job_listener
        self._raises, self._together = raises, together
        self._waiting: list[Job] = []
        self._deadline = NEVER
        self._results: list[JobResult] = []

    @property
    def is_free(self) -> bool:
        """Whether no job waits, or together with those that wait others could be done."""
        return not self._results and (self._together or not self._waiting)

    def submit(self, job: Job, deadline: Deadline = NEVER) -> None:
        """Takes a job; it is done when its result is needed."""
        self._waiting.append(job)
        self._deadline = deadline

    def result(self) -> JobResult:
        """Does the first job that waits, and the others of its candidate."""
        if not self._results:
            candidate = self._waiting[0].candidate
            jobs = [job for job in self._waiting if job.candidate == candidate]
            self._waiting = [job for job in self._waiting if job.candidate != candidate]
            self._results = perform_jobs(
                jobs,
                self._context,
                self._make_job_listener(jobs[0]),
                self._deadline,
                raises=self._raises,
            )
        return self._results.pop(0)


def run_jobs(
    jobs: Sequence[Job],
    executor: Executor,
    deadline: Deadline = NEVER,
    *,
    prepare: Callable[[Job], Job | None] = lambda job: job,
    on_result: Callable[[JobResult], None] = lambda result: None,
) -> list[JobResult]:
    """Runs jobs in their order, each as soon as those are done that it waits for.

    Args:
        jobs: the jobs.
        executor: where they are done.
        deadline: when each of them has to end.
        prepare: called with a job just before it begins; returns it complete, with the model that
            it corrects, or None to leave it out.
        on_result: called with every result at once.

    Returns:
        The results, in the order in which the jobs ended.
    """
    waiting, running, results = list(jobs), set[tuple[str, int]](), list[JobResult]()
    while waiting or running:
        index = None
        if executor.is_free:
            busy = running | {(job.candidate, job.fold) for job in waiting}
            index = next(
                (
                    i
                    for i, job in enumerate(waiting)
                    if not any((name, job.fold) in busy for name in job.waits_for)
                ),
                None,
            )
        if index is not None:
            job = prepare(waiting.pop(index))
            if job is not None:
                running.add((job.candidate, job.fold))
                executor.submit(job, deadline)
            continue
        result = executor.result()
        running.remove((result.candidate, result.fold))
        results.append(result)
        on_result(result)
    return results
