"""Who does jobs: this process, one after the other."""

from collections.abc import Callable
from typing import Protocol

from tustinnet.selection.jobs import Job, JobResult, Workplace, perform
from tustinnet.store.run import Tell


class Executor(Protocol):
    """Does jobs, in any order, several at once where it can."""

    @property
    def free(self) -> bool:
        """Whether another job could begin now."""
        ...

    def submit(self, job: Job) -> None:
        """Takes a job."""
        ...

    def result(self) -> JobResult:
        """Waits for the next job that ends, of those that were taken."""
        ...


class InProcess:
    """Does one job at a time, in this process.

    Args:
        at: what all jobs share.
        tell: given a job, what `perform` tells of it.
    """

    def __init__(self, at: Workplace, tell: Callable[[Job], Tell]) -> None:
        self._at, self._tell = at, tell
        self._job: Job | None = None

    @property
    def free(self) -> bool:
        """Whether no job waits."""
        return self._job is None

    def submit(self, job: Job) -> None:
        """Takes a job; it is done when its result is asked for."""
        self._job = job

    def result(self) -> JobResult:
        """Does the job that waits."""
        assert self._job is not None
        job, self._job = self._job, None
        return perform(job, self._at, self._tell(job))
