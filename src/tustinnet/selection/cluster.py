"""An executor of jobs: the machines of a Ray cluster; a laptop is a cluster of one.

The run's folder is on a place that all machines share, under one path. Workers write below it as
this process would; they are sent the records once, then a job at a time, and only results come
back. JAX is set up in a worker as it is here, so that machines that are alike compute the same.
"""

import logging
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from tustinnet.cores import count_cores
from tustinnet.errors import InputError, convert_errors, describe_error, require_package
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.fitting.listener import SILENT
from tustinnet.selection.jobs import Job, JobResult, RunContext, perform_jobs
from tustinnet.selection.runner import Executor, MakeExecutor
from tustinnet.store.files import PART
from tustinnet.systems.files import find_system

AUTO = "auto"
_CONNECTS = 5.0  # seconds in which somebody listens at the address of a cluster
_ANSWERS = 20.0  # seconds in which a cluster answers, with those that loading Ray takes
_TRIES = 3  # of a job whose workers die
_MOMENT = 0.2  # seconds
_STORE = 2**27  # bytes of shared memory of a cluster of one; more goes to the disk
_PACKAGES = ("tustinnet", "jax", "jaxlib", "numpy")  # of one version everywhere
_QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}

OnMessage = Callable[[str], None]


@contextmanager
def cluster(
    address: str = AUTO, on_message: OnMessage = lambda sentence: None
) -> Iterator[MakeExecutor]:
    """The machines of a Ray cluster, as `select_model` takes them (`executor=`).

    A job is given as many cores as JAX has CPU devices in this process; a machine does as many
    jobs at once as it has cores for. A worker that dies has its job done again by another.

    Args:
        address: `HOST:PORT` of a cluster's head, of which this machine is one; or `auto`: the
            cluster that RAY_ADDRESS names, else this machine alone.
        on_message: called with sentences on jobs that begin and end.

    Yields:
        A function that makes an executor from a `RunContext`. It raises `InputError` where a
        machine lacks the packages, or does not share the run's folder.

    Raises:
        InputError: Ray is not installed, no such cluster, or it does not answer within seconds.
    """
    head = _find_head(address)
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    require_package("ray", "ray", "cluster")
    ray: Any = import_module("ray")
    if head is not None:
        _require_answer(head, address)
    _join(ray, head)
    executors: list[_Workers] = []
    try:

        def make_executor(context: RunContext) -> Executor:
            executors.append(_Workers(ray, context, on_message))
            return executors[-1]

        yield make_executor
    finally:
        for workers in executors:
            workers.close()
        ray.shutdown()


class _Workers:
    """Does jobs in processes of a cluster that this process has joined.

    Args:
        ray: the library.
        context: records, folder, system, scoring.
        on_message: called with sentences on jobs that begin and end.
    """

    def __init__(self, ray: Any, context: RunContext, on_message: OnMessage) -> None:
        self._ray, self._on_message = ray, on_message
        self._running: dict[Future[Any], _Running] = {}
        self._cores = len(jax.devices("cpu"))
        if not self._places:
            raise InputError(
                "cluster",
                f"no machine with {self._cores} cores, which a job is given",
                "a machine with as many",
                "set JAX_NUM_CPU_DEVICES to give a job fewer",
            )
        folder = context.folder.resolve()
        self._mark = folder / f".shared-{uuid.uuid4().hex}{PART}"
        self._mark.touch()
        system = context.system
        system = find_system(system) if isinstance(system, str | Path) else system
        # made anew, it holds nothing that was computed here
        sent = replace(context, folder=folder, system=system)
        self._sent = ray.put(ray.cloudpickle.dumps(sent))
        self._setup = {"mark": str(self._mark), "jax": _jax_settings(), "versions": versions()}
        self._work = ray.remote(num_cpus=self._cores, max_retries=0)(_make_work())

    @property
    def is_free(self) -> bool:
        """Whether a machine has cores left; machines come and go."""
        return len(self._running) < max(1, self._places)

    def submit(self, job: Job, deadline: Deadline = NEVER) -> None:
        """Sends a job."""
        self._on_message(f"{job.label}: begins")
        self._send(_Running(job, deadline, time.monotonic()))

    def result(self) -> JobResult:
        """Waits for the next job that ends."""
        while True:
            # a moment at a time, in Python, so that signals are handled
            while not (done := wait(self._running, _MOMENT, FIRST_COMPLETED).done):
                pass
            future = next(iter(done))
            running = self._running.pop(future)
            name = running.job.label
            try:
                host, result = future.result()
            except self._ray.exceptions.RayTaskError:  # of the job, not of its worker
                raise
            except self._ray.exceptions.RayError as error:
                if running.attempts < _TRIES:
                    self._on_message(f"{name}: its worker died, done again")
                    self._send(replace(running, attempts=running.attempts + 1))
                    continue
                text = (str(error).strip().splitlines() or [""])[0]
                why = f"its worker died {running.attempts} times ({type(error).__name__}: {text})"
                job, seconds = running.job, time.monotonic() - running.started
                return JobResult(job.candidate, job.fold, seconds, "failed", why=why)
            if not isinstance(result, JobResult):
                raise InputError(f"worker on {host}", *result)
            if result.ended == "done":
                new = f"done on {host} in {result.seconds:.1f} s"
                self._on_message(f"{name}: {'was done before' if result.earlier else new}")
            return result

    def close(self) -> None:
        """Removes the file that shows workers that they share the folder."""
        self._mark.unlink(missing_ok=True)

    @property
    def _places(self) -> int:
        """The number of jobs that the machines can do at once."""
        alive = [node for node in self._ray.nodes() if node["Alive"]]
        return sum(int(node["Resources"].get("CPU", 0)) // self._cores for node in alive)

    def _send(self, running: "_Running") -> None:
        order = pickle.dumps((running.job, running.deadline.remaining))
        self._running[self._work.remote(self._sent, order, self._setup).future()] = running


@dataclass(frozen=True)
class _Running:
    """A job that was sent.

    Attributes:
        job: which.
        deadline: when it has to end.
        started: when it was sent first, `time.monotonic()`.
        attempts: how often it was sent.
    """

    job: Job
    deadline: Deadline
    started: float
    attempts: int = 1


# --- in the worker ---


def _make_work() -> Callable[[bytes, bytes, dict[str, Any]], Any]:
    """The function that a worker runs, within another: Ray sends its code, not its name.

    So it can report that the package is missing. JAX is set up before it is loaded; all else is
    sent as bytes that are read by packages that are known to be the same.
    """

    def work(sent: bytes, order: bytes, setup: dict[str, Any]) -> Any:
        import os
        import socket

        host = socket.gethostname()
        os.environ.update(setup["jax"])
        try:
            from tustinnet.selection.cluster import perform_here
        except ImportError as error:
            return host, (
                f"cannot load tustinnet ({error})",
                "the package on every machine",
                "pip install tustinnet there",
            )
        return host, perform_here(sent, order, setup)

    return work


def perform_here(sent: bytes, order: bytes, setup: dict[str, Any]) -> JobResult | tuple[str, ...]:
    """Does a job in a worker.

    Args:
        sent: the `RunContext`, pickled.
        order: the job, and how many seconds remain, pickled.
        setup: `mark`, the file that shows the run's folder; `versions` of packages.

    Returns:
        The job's result; or what is wrong with this machine, what is expected, what to do.
    """
    if (here := versions()) != setup["versions"]:
        other = {n: v for n, v in setup["versions"].items() if here.get(n) != v}
        return (
            "has " + ", ".join(f"{name} {here.get(name)}" for name in other),
            "the versions of the process that asks: "
            + ", ".join(f"{name} {v}" for name, v in other.items()),
        )
    mark = Path(setup["mark"])
    if not mark.is_file():
        return (
            f"does not see {mark.parent} as it is where the run was begun",
            "a folder that all machines share, under one path",
            "choose another folder",
        )
    job, remaining = pickle.loads(order)
    deadline = Deadline.after(remaining)
    return perform_jobs([job], _load_context(sent), lambda prepared: SILENT, deadline)[0]


@lru_cache(maxsize=1)
def _load_context(sent: bytes) -> RunContext:
    """One object for all jobs: a system is loaded once, and its programs compiled once."""
    return pickle.loads(sent)


def versions() -> dict[str, str]:
    """The versions of the packages that results depend on."""
    result = {}
    for name in _PACKAGES:
        try:
            result[name] = version(name)
        except PackageNotFoundError:
            result[name] = "of no version"
    return result


def _jax_settings() -> dict[str, str]:
    """The settings of JAX in this process, as variables of the environment."""
    config: Any = jax.config
    settings = {
        "JAX_PLATFORMS": "cpu",
        "JAX_ENABLE_X64": str(int(config.jax_enable_x64)),
        "JAX_NUM_CPU_DEVICES": str(len(jax.devices("cpu"))),
        "JAX_COMPILATION_CACHE_DIR": config.jax_compilation_cache_dir or "",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": str(
            config.jax_persistent_cache_min_compile_time_secs
        ),
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": str(
            config.jax_persistent_cache_min_entry_size_bytes
        ),
        "XLA_FLAGS": os.environ.get("XLA_FLAGS", ""),
    }
    return {name: value for name, value in settings.items() if value}


# --- joining a cluster ---


def _find_head(address: str) -> str | None:
    """The address of a cluster where somebody listens; None where this machine is to be one."""
    name = os.environ.get("RAY_ADDRESS", "") if address == AUTO else address
    if address == AUTO and name in ("", "local"):
        return None
    parts = re.fullmatch(r"([^\s/:]+|\[[0-9a-fA-F:]+\]):(\d{1,5})", name)
    if parts is None:
        raise InputError(
            _where(name, address),
            "no address",
            "auto, or HOST:PORT of a cluster's head",
            "for instance 10.0.0.5:6379",
        )
    try:
        socket.create_connection((parts[1].strip("[]"), int(parts[2])), _CONNECTS).close()
    except (OSError, OverflowError, UnicodeError) as error:
        raise _no_answer(_where(name, address), describe_error(error)) from None
    return name


def _require_answer(head: str, address: str) -> None:
    """Raises unless a cluster answers Ray's own client in time, which by itself tries for minutes.

    A cluster that refuses it answers, too; joining it then says why.
    """
    command = [sys.executable, "-P", "-m", "ray.scripts.scripts", "status", "--address", head]
    try:
        subprocess.run(command, capture_output=True, timeout=_ANSWERS, check=False)
    except subprocess.TimeoutExpired:
        raise _no_answer(_where(head, address), f"not within {_ANSWERS:g} s") from None


def _where(head: str, address: str) -> str:
    return f"RAY_ADDRESS={head}" if address == AUTO else f"cluster {head}"


def _no_answer(where: str, why: str) -> InputError:
    return InputError(
        where,
        f"does not answer ({why})",
        "the head of a running cluster",
        "start one there: ray start --head --port 6379",
    )


def _join(ray: Any, address: str | None) -> None:
    """Joins a cluster, or makes this machine one; leaves handlers of signals as they are."""
    alone = {"num_cpus": count_cores(), "include_dashboard": False, "object_store_memory": _STORE}
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM)
    remedy = (
        "this machine must be one of it (ray start --address HOST:PORT), and where it asks for a "
        "token, RAY_AUTH_MODE=token be set"
    )
    with (
        convert_errors("cluster", "cannot be joined", "a Ray cluster", remedy if address else ""),
        warnings.catch_warnings(),  # JAX warns of forks; Ray's become other programs at once
    ):
        warnings.simplefilter("ignore")
        if address is None:
            ray.init(address="local", **alone, **quiet)
        else:
            ray.init(address=address, **quiet)
    if main:
        signal.signal(signal.SIGTERM, before)
