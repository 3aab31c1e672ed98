"""Who does jobs: the machines of a Ray cluster; a laptop is a cluster of one.

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
from tustinnet.fitting.listener import Listener
from tustinnet.selection.clock import Clock
from tustinnet.selection.executors import Executor
from tustinnet.selection.jobs import Job, JobResult, Workplace, perform
from tustinnet.store.files import PART
from tustinnet.systems.files import find_system

AUTO = "auto"
_ANSWERS = 5.0  # seconds in which the address of a cluster answers
# what HTTP/2 begins with (RFC 9113, 3.4), which the head of a cluster speaks: settings for settings
_SETTINGS = b"\x04"
_GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(3) + _SETTINGS + bytes(5)
_TRIES = 3  # of a job whose workers die
_MOMENT = 0.2  # seconds
_STORE = 2**27  # bytes of shared memory of a cluster of one; more goes to the disk
_PACKAGES = ("tustinnet", "jax", "jaxlib", "numpy")  # of one version everywhere
_QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}

Say = Callable[[str], None]


@contextmanager
def cluster(
    address: str = AUTO, say: Say = lambda sentence: None
) -> Iterator[Callable[[Workplace], Executor]]:
    """The machines of a Ray cluster, as `select_model` takes them (`executor=`).

    A job is given as many cores as JAX has CPU devices in this process; a machine does as many
    jobs at once as it has cores for. A worker that dies has its job done again by another.

    Args:
        address: `HOST:PORT` of a cluster's head, of which this machine is one; or `auto`: the
            cluster that RAY_ADDRESS names, else this machine alone.
        say: who is told, in sentences, which jobs begin and end.

    Yields:
        What makes an executor of what all jobs share. It raises `InputError` where a machine
        lacks the packages, or does not share the run's folder.

    Raises:
        InputError: Ray is not installed, no such cluster, or it does not answer within seconds.
    """
    found = _found(address)
    ray, made = _ray(), []
    _join(ray, found)
    try:

        def executor(at: Workplace) -> Executor:
            made.append(_Workers(ray, at, say))
            return made[-1]

        yield executor
    finally:
        for workers in made:
            workers.close()
        ray.shutdown()


class _Workers:
    """Does jobs in processes of a cluster that this process has joined.

    Args:
        ray: the library.
        at: what all jobs share.
        say: who is told which jobs begin and end.
    """

    def __init__(self, ray: Any, at: Workplace, say: Say) -> None:
        self._ray, self._say, self._clock = ray, say, at.clock
        self._running: dict[Future[Any], _Running] = {}
        self._cores = len(jax.devices("cpu"))
        if not self._places:
            raise InputError(
                "cluster", f"no machine with {self._cores} cores, which a job is given",
                "a machine with as many", "set JAX_NUM_CPU_DEVICES to give a job fewer",
            )  # fmt: skip
        folder = at.folder.resolve()
        self._mark = folder / f".shared-{uuid.uuid4().hex}{PART}"
        self._mark.touch()
        system = find_system(at.system) if isinstance(at.system, str | Path) else at.system
        # made anew, it holds nothing that was computed here; time is told job by job
        sent = replace(at, folder=folder, system=system, clock=Clock())
        self._sent = ray.put(ray.cloudpickle.dumps(sent))
        self._about = {"mark": str(self._mark), "jax": _jax_settings(), "versions": versions()}
        self._work = ray.remote(num_cpus=self._cores, max_retries=0)(_work())

    @property
    def free(self) -> bool:
        """Whether a machine has cores left; machines come and go."""
        return len(self._running) < max(1, self._places)

    def submit(self, job: Job) -> None:
        """Sends a job."""
        self._say(f"{_named(job)}: begins")
        self._send(_Running(job, time.monotonic()))

    def result(self) -> JobResult:
        """Waits for the next job that ends."""
        while True:
            ended = self._next()
            of = self._running.pop(ended)
            try:
                host, found = ended.result()
            except self._ray.exceptions.RayTaskError:  # of the job, not of its worker
                raise
            except self._ray.exceptions.RayError as error:
                lost = self._lost(of, error)
                if lost is not None:
                    return lost
                continue
            if not isinstance(found, JobResult):
                raise InputError(f"worker on {host}", *found)
            if found.ended == "done":
                told = f"done on {host} in {found.seconds:.1f} s"
                self._say(f"{_named(of.job)}: {'was done before' if found.earlier else told}")
            return found

    def close(self) -> None:
        """Takes away the mark that the folder is shared."""
        self._mark.unlink(missing_ok=True)

    @property
    def _places(self) -> int:
        """How many jobs the machines can do at once."""
        alive = [node for node in self._ray.nodes() if node["Alive"]]
        return sum(int(node["Resources"].get("CPU", 0)) // self._cores for node in alive)

    def _next(self) -> Future[Any]:
        """Waits for a job; in Python, a moment at a time, so that signals are heard."""
        while True:
            if done := wait(self._running, _MOMENT, FIRST_COMPLETED).done:
                return next(iter(done))

    def _send(self, of: "_Running") -> None:
        order = pickle.dumps((of.job, self._clock.left))
        self._running[self._work.remote(self._sent, order, self._about).future()] = of

    def _lost(self, of: "_Running", error: Exception) -> JobResult | None:
        """Sends a job again whose worker died; what to tell of it, where that is in vain."""
        if of.tried < _TRIES:
            self._say(f"{_named(of.job)}: its worker died, done again")
            self._send(replace(of, tried=of.tried + 1))
            return None
        told = str(error).strip().splitlines() or [""]
        why = f"its worker died {of.tried} times ({type(error).__name__}: {told[0]})"
        spent = time.monotonic() - of.begun
        return JobResult(of.job.candidate, of.job.fold, spent, "failed", why=why)


@dataclass(frozen=True)
class _Running:
    """A job that was sent.

    Attributes:
        job: which.
        begun: when it was sent first, `time.monotonic()`.
        tried: how often it was sent.
    """

    job: Job
    begun: float
    tried: int = 1


def _named(job: Job) -> str:
    return f"{job.candidate}, fold {job.fold}"


# --- in the worker ---


def _work() -> Callable[[bytes, bytes, dict[str, Any]], Any]:
    """What a worker does, a function within another: Ray sends its code, not its name.

    So it can tell where the package is missing. What it is told about JAX is said before JAX is
    loaded; all else is sent as bytes that are read by packages that are known to be the same.
    """

    def work(sent: bytes, order: bytes, about: dict[str, Any]) -> Any:
        import os
        import socket

        host = socket.gethostname()
        os.environ.update(about["jax"])
        try:
            from tustinnet.selection.cluster import perform_here
        except ImportError as error:
            return host, (f"cannot load tustinnet ({error})", "the package on every machine",
                          "pip install tustinnet there")  # fmt: skip
        return host, perform_here(sent, order, about)

    return work


def perform_here(sent: bytes, order: bytes, about: dict[str, Any]) -> JobResult | tuple[str, ...]:
    """Does a job in a worker.

    Args:
        sent: the `Workplace`, pickled.
        order: the job, and how many seconds are left, pickled.
        about: `mark`, the file that tells the run's folder; `versions` of packages.

    Returns:
        What the job came to; or what is wrong with this machine, what is expected, what to do.
    """
    if (here := versions()) != about["versions"]:
        other = {n: v for n, v in about["versions"].items() if here.get(n) != v}
        return (
            "has " + ", ".join(f"{name} {here.get(name)}" for name in other),
            "the versions of the process that asks: "
            + ", ".join(f"{name} {v}" for name, v in other.items()),
        )
    mark = Path(about["mark"])
    if not mark.is_file():
        return (
            f"does not see {mark.parent} as it is where the run was begun",
            "a folder that all machines share, under one path",
            "choose another --out",
        )
    job, left = pickle.loads(order)
    clock = Clock(None if left == float("inf") else time.monotonic() + left)
    return perform(job, _workplace(sent), clock.within(lambda prepared: Listener()))


@lru_cache(maxsize=1)
def _workplace(sent: bytes) -> Workplace:
    """The same object for all jobs: a system is loaded once, and its programs compiled once."""
    return pickle.loads(sent)


def versions() -> dict[str, str]:
    """Of the packages that results depend on."""
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "of no version"
    return found


def _jax_settings() -> dict[str, str]:
    """How JAX is set up here, as variables of the environment."""
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


def _ray() -> Any:
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    require_package("ray", "ray", "cluster")
    return import_module("ray")


def _found(address: str) -> str | None:
    """The address of a cluster that answers; None where this machine is to be one."""
    named = os.environ.get("RAY_ADDRESS", "") if address == AUTO else address
    if address == AUTO and named in ("", "local"):
        return None
    where = f"RAY_ADDRESS={named}" if address == AUTO else f"cluster {named}"
    parts = re.fullmatch(r"([^\s/:]+|\[[0-9a-fA-F:]+\]):(\d{1,5})", named)
    if parts is None:
        raise InputError(where, "no address", "auto, or HOST:PORT of a cluster's head",
                         "for instance 10.0.0.5:6379")  # fmt: skip
    try:
        _ask(parts[1].strip("[]"), int(parts[2]))
    except (OSError, OverflowError, UnicodeError) as error:
        raise InputError(
            where, f"does not answer ({describe_error(error)})", "the head of a running cluster",
            "start one there: ray start --head --port 6379",
        ) from None  # fmt: skip
    return named


def _ask(host: str, port: int) -> None:
    """Raises `OSError` where nobody answers, or somebody else: Ray itself asks for minutes."""
    with socket.create_connection((host, port), _ANSWERS) as asked:
        if os.environ.get("RAY_USE_TLS", "0") != "0":
            return  # it answers nobody without a certificate
        asked.settimeout(_ANSWERS)
        asked.sendall(_GREETING)
        if asked.recv(4)[3:] != _SETTINGS:
            raise OSError("not as a cluster does")


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
