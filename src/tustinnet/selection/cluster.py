"""The machines of a Ray cluster as an executor of jobs; a laptop is a cluster of one.

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
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jax

from tustinnet.cores import count_cores
from tustinnet.errors import InputError, convert_errors, describe_error, require_package

AUTO = "auto"
_CONNECTS = 5.0  # seconds in which somebody listens at the address of a cluster
_ANSWERS = 20.0  # seconds in which a cluster answers, with those that loading Ray takes
_RETRIES = 2  # of a job whose worker dies
_STORE = 2**27  # bytes of shared memory of a cluster of one; more goes to the disk
_PACKAGES = ("tustinnet", "jax", "jaxlib", "numpy")  # of one version everywhere
_QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}


@contextmanager
def cluster(address: str = AUTO) -> Iterator[Executor]:
    """The machines of a Ray cluster as an executor, for `select_model` (`executor=`).

    A job is given as many cores as JAX has CPU devices in this process; a machine does as many
    jobs at once as it has cores for. A worker that dies has its job done again by another.

    Args:
        address: `HOST:PORT` of a cluster's head, of which this machine is one; or `auto`: the
            cluster that RAY_ADDRESS names, else this machine alone.

    Raises:
        InputError: Ray is not installed, no such cluster, it does not answer within seconds, or
            it has no machine with enough cores.
    """
    head = _find_head(address)
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    require_package("ray", "ray", "cluster")
    ray: Any = import_module("ray")
    if head is not None:
        _require_answer(head, address)
    _join(ray, head)
    try:
        yield _Machines(ray)
    finally:
        ray.shutdown()


class _Machines(Executor):
    """Does calls in processes of a cluster that this process has joined.

    The first argument of calls is sent once for as long as it stays the same.

    Args:
        ray: the library.
    """

    def __init__(self, ray: Any) -> None:
        self._ray, self._cores = ray, len(jax.devices("cpu"))
        self._sent: tuple[Any, Any] = (None, None)  # an argument, and where it is in the cluster
        self._call = ray.remote(num_cpus=self._cores, max_retries=_RETRIES)(_call)
        if not self.places:
            raise InputError(
                "cluster",
                f"no machine with {self._cores} cores, which a job is given",
                "a machine with as many",
                "set JAX_NUM_CPU_DEVICES to give a job fewer",
            )

    @property
    def places(self) -> int:
        """The number of calls that the machines can do at once; they come and go."""
        alive = [node for node in self._ray.nodes() if node["Alive"]]
        return sum(int(node["Resources"].get("CPU", 0)) // self._cores for node in alive)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **named: Any) -> Future[Any]:
        """Sends a call."""
        shared, *others = args
        if shared is not self._sent[0]:
            self._sent = shared, self._ray.put(self._ray.cloudpickle.dumps(shared))
        reference = self._call.remote(versions(), fn, self._sent[1], *others, **named)
        result: Future[Any] = Future()

        def take(done: Future[Any]) -> None:
            if (error := done.exception()) is None:
                result.set_result(done.result())
            else:  # of the call itself, or of its worker
                result.set_exception(getattr(error, "cause", None) or error)

        reference.future().add_done_callback(take)
        return result


def _call(
    expected: dict[str, str], fn: Callable[..., Any], sent: bytes, *args: Any, **named: Any
) -> Any:
    """The result of a call in a worker whose packages are those of the process that asks.

    Args:
        expected: the versions of these packages.
        fn: what is called.
        sent: its first argument, pickled.
        args: the others.
        named: those by name.

    Raises:
        InputError: they are not.
    """
    here = versions()
    if other := {name: v for name, v in expected.items() if here.get(name) != v}:
        raise InputError(
            f"worker on {socket.gethostname()}",
            "has " + ", ".join(f"{name} {here.get(name)}" for name in other),
            "the versions of the process that asks: "
            + ", ".join(f"{name} {v}" for name, v in other.items()),
        )
    return fn(_load(sent), *args, **named)


@lru_cache(maxsize=1)
def _load(sent: bytes) -> Any:
    """One object for all calls: a system is loaded once, and its programs compiled once."""
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
    quiet = {
        "log_to_driver": False,
        "logging_level": logging.ERROR,
        "runtime_env": {"env_vars": _jax_settings()},
    }
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
