"""The process in which binary files are read, so that a crash there stops nothing else."""

import atexit
import json
import os
import subprocess
import sys
import threading
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

import numpy as np

from tustinnet.data.columns import Column, Listing
from tustinnet.data.formats.reader import Part
from tustinnet.errors import InputError, convert_errors

_START_S = 60.0  # to start Python and import a library, also on a busy machine
_NAMES_S = 10.0  # to list the columns of a file
_NUMBERS_S = 60.0  # to read columns
_MUCH = 2**26  # bytes read at once, above which the process is stopped
_SPEED = 10e6  # bytes of the file a second, on top of that, while it is listed

# the child finds the package where this process found it
_PROGRAM = """
import sys
sys.path[:] = sys.argv[1:]
from tustinnet.data.binary_files import serve
serve()
"""
_ONE_THREAD = ("POLARS_MAX_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

Reply = tuple[dict[str, Any], list[Column]]


class _Process:
    """A child process; `owner` is the process that started it."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        self.readers: set[str] = set()
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONFAULTHANDLER"}
        self._child = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", _PROGRAM, *sys.path],
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


_process: _Process | None = None
_one_at_a_time = threading.Lock()


def list_columns(path: Path, reader: str) -> Listing:
    """The names of the columns of a binary file, and what else is known of them.

    Args:
        path: the file.
        reader: the reader of such files, as `module:attribute`.

    Raises:
        InputError: a damaged file, one that crashes its reader, or takes it too long.
    """
    listing = _request(path, reader, None, _NAMES_S, _SPEED)[0]["listing"]
    parts = {
        label: Part(part["prefix"], None if part["rows"] is None else tuple(part["rows"]))
        for label, part in listing["parts"].items()
    }
    return Listing(**{**listing, "parts": parts})


def read(path: Path, reader: str, names: list[str], *, speed: float) -> list[Column]:
    """Some columns of a binary file.

    Args:
        path: the file.
        reader: the reader of such files, as `module:attribute`.
        names: the columns.
        speed: bytes of the file that the reader reads in a second, at least.

    Raises:
        InputError: as `list_columns`; numbers that take too much memory; text.
    """
    return _request(path, reader, names, _NUMBERS_S, speed)[1] if names else []


def _request(
    path: Path, reader: str, names: list[str] | None, seconds: float, speed: float
) -> Reply:
    with convert_errors(path, "cannot be looked at", "a file"):
        seconds += path.stat().st_size / speed
        folder = None if path.is_absolute() else str(Path.cwd())
    with _one_at_a_time:
        process = _running_process(path, reader)
        request = {"path": str(path), "folder": folder, "names": names, "reader": reader}
        reply = process.send(request, seconds)
        if reply is not None and sum(column.nbytes for column in reply[1]) > _MUCH:
            process.stop()  # its libraries would keep the memory
    if reply is None:
        raise InputError(
            path,
            f"the file crashes its reader, or keeps it busy for more than {seconds:.0f} s",
            f"a whole {path.suffix.lower()} file",
            "write it anew",
        )
    if "refused" in reply[0]:
        raise InputError(*reply[0]["refused"].split(": ", 1))
    return reply


def _running_process(path: Path, reader: str) -> _Process:
    """The process, with the library of a reader, started where necessary."""
    global _process
    if _process is None or not _process.is_usable:
        with convert_errors(path, "the process that reads such files does not start", "Python"):
            _process = _Process()
        atexit.register(_process.stop)
    if reader not in _process.readers:
        if _process.send({"path": None, "reader": reader}, _START_S) is None:
            suffix = path.suffix.lower()
            raise InputError(path, f"the process that reads {suffix} files does not start")
        _process.readers.add(reader)
    return _process
