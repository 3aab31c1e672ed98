"""The process in which files of foreign formats are read, so that a crash there stops nothing else.

`guarded_process` is that process seen from inside.
"""

import atexit
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic import TypeAdapter

from tustinnet.data.columns import Column
from tustinnet.data.formats.reader import Contents, Reader
from tustinnet.errors import InputError, convert_errors

_NAMES_S = 10.0  # to list the columns of a file
_NUMBERS_S = 60.0  # to read columns
_MEMORY = 5 * 2**30  # bytes: the columns of a card, their sources, what its library takes
_MUCH = 2**26  # bytes read at once, above which the process is stopped

# the child finds the package where this process found it
_PROGRAM = """
import sys
sys.path[:] = sys.argv[1:]
from tustinnet.data.guarded_process import serve
serve()
"""
_ONE_THREAD = ("POLARS_MAX_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

Reply = tuple[dict[str, Any], list[Column]]
_CONTENTS = TypeAdapter(Contents)  # JSON has lists where these have tuples


class _Process:
    """A child process; `owner` is the process that started it."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        self.modules: set[tuple[str, str]] = set()
        self._scratch = tempfile.mkdtemp(prefix="tustinnet-")  # where its libraries may write
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONFAULTHANDLER"}
        environment["TMPDIR"] = os.path.realpath(self._scratch)
        self._child = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", _PROGRAM, *map(os.path.abspath, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment | dict.fromkeys(_ONE_THREAD, "1"),
        )

    @property
    def is_usable(self) -> bool:
        """Whether it runs, and for this process: after a fork two would send requests."""
        return self.owner == os.getpid() and self._child.poll() is None

    def send(self, request: dict[str, Any], seconds: float) -> Reply | None:
        """The reply to a request; None where the child died or took too long."""
        assert self._child.stdin is not None
        requests, replies = self._child.stdin, cast(BufferedReader, self._child.stdout)
        timer = threading.Timer(seconds, self._child.kill)
        timer.start()
        try:
            requests.write(json.dumps({**request, "seconds": seconds + 1}).encode() + b"\n")
            requests.flush()
            reply = json.loads(replies.readline())
            columns = [np.empty(length) for length in reply.get("lengths", ())]
            for column in columns:
                if replies.readinto(column.data.cast("B")) < column.nbytes:
                    raise EOFError
            return reply, columns
        except (OSError, ValueError, EOFError):
            self.stop()
            return None
        except BaseException:  # Ctrl-C: a late reply would look like that to the next request
            self.stop()
            raise
        finally:
            timer.cancel()

    def stop(self) -> None:
        """Ends the child."""
        if self.owner == os.getpid():
            self._child.kill()
            self._child.communicate()
            shutil.rmtree(self._scratch, ignore_errors=True)


_process: _Process | None = None
_one_at_a_time = threading.Lock()


def list_columns(path: Path, place: str, reader: Reader) -> Contents:
    """The contents of a binary file, each column of a matrix as an array of its own.

    Args:
        path: the file.
        place: the reader of such files, as `module:attribute`.
        reader: the reader itself.

    Raises:
        InputError: a damaged file, one that crashes its reader, or takes it too long.
    """
    # one more second for every 10 MB of the file
    seconds = _NAMES_S + _size(path) / 10e6
    function, modules = "tustinnet.data.binary_files:list_columns_by", _modules(place, reader)
    contents, _ = call(path, function, [place], seconds=seconds, modules=modules)
    return _CONTENTS.validate_python(contents)


def read(path: Path, place: str, reader: Reader, names: list[str]) -> list[Column]:
    """Some columns of a binary file.

    Args:
        path: the file.
        place: the reader of such files, as `module:attribute`.
        reader: the reader itself.
        names: the columns.

    Raises:
        InputError: as `list_columns`; numbers that take too much memory; text.
    """
    if not names:
        return []
    seconds = _NUMBERS_S + _size(path) / reader.speed
    function, modules = "tustinnet.data.binary_files:read_by", _modules(place, reader)
    return call(path, function, [place, names], seconds=seconds, modules=modules)[1]


def _size(path: Path) -> int:
    with convert_errors(path, "cannot be looked at", "a file"):
        return path.stat().st_size


def _modules(place: str, reader: Reader) -> tuple[str, str]:
    return place.partition(":")[0], reader.library


def call(
    path: Path,
    function: str,
    arguments: Sequence[Any],
    *,
    seconds: float,
    modules: tuple[str, str],
    memory: int = _MEMORY,
) -> tuple[Any, list[Column]]:
    """The result of a function that reads a file, called in the process.

    Args:
        path: the file.
        function: the function as `module:attribute`; its first argument is the file. It returns
            what JSON can say, arrays as lists, and columns of numbers.
        arguments: its other arguments, which JSON can say.
        seconds: how long it may take.
        modules: what is imported before, which may take longer: the reader's own module, and the
            library that it uses.
        memory: how many bytes it may take, beside those that the process has.

    Raises:
        InputError: what the function raises; a file that crashes it, takes it too long, or makes it
            do more than read.
    """
    folder = None if path.is_absolute() else str(Path.cwd())
    request = {
        "path": str(path),
        "folder": folder,
        "function": function,
        "arguments": arguments,
        "memory": memory,
    }
    with _one_at_a_time:
        process = _running_process(path, modules)
        reply = process.send(request, seconds)
        if reply is None:
            raise InputError(
                path,
                f"the file crashes its reader, or keeps it busy for more than {seconds:.0f} s",
                f"a whole {path.suffix.lower()} file",
                "write it anew",
            )
        content, columns = reply
        if sum(column.nbytes for column in columns) > _MUCH:
            process.stop()  # its libraries would keep the memory
        _raise_refusal(content, process)
    return content["result"], columns


def _running_process(path: Path, modules: tuple[str, str]) -> _Process:
    """The process, with the modules of a reader imported, started where necessary."""
    global _process
    if _process is None or not _process.is_usable:
        with convert_errors(path, "the process that reads such files does not start", "Python"):
            _process = _Process()
        atexit.register(_process.stop)
    if modules not in _process.modules:
        # a minute, for Python starts and imports a library on a busy machine, too
        reply = _process.send({"path": str(path.absolute()), "modules": modules}, 60.0)
        if reply is None:
            suffix = path.suffix.lower()
            raise InputError(path, f"the process that reads {suffix} files does not start")
        _raise_refusal(reply[0], _process)
        _process.modules.add(modules)
    return _process


def _raise_refusal(content: dict[str, Any], process: _Process) -> None:
    if content.get("ends"):
        process.stop()
    if "refused" in content:
        raise InputError(*content["refused"].split(": ", 1))
