"""The process that reads files of foreign formats, seen from inside: its limits, and its guard.

On damaged files the libraries of the readers can crash, hang or ask for any amount of memory; on
hostile ones they might do what the file's author wants. `reading_process` starts this process,
asks it to call functions, and takes nothing from it but JSON and numbers.
"""

import importlib
import inspect
import json
import math
import os
import signal
import sys
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tustinnet.data.columns import Column
from tustinnet.errors import InputError, convert_errors
from tustinnet.registry import load_place

_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
# what no reader does, by the beginning of its audit event (docs.python.org, "Audit events table")
_STARTS = (
    "subprocess.",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.spawn",
    "os.startfile",
    "os.fork",
    "pty.spawn",
)
_CHANGES = (
    "os.remove",
    "os.rename",
    "os.rmdir",
    "os.mkdir",
    "os.chmod",
    "os.chown",
    "os.link",
    "os.symlink",
    "os.truncate",
    "os.setxattr",
    "shutil.",
)


def serve() -> None:
    """Answers requests on stdin until it is closed.

    A request is a line of JSON: a `function` as `module:attribute`, its `arguments`, the `path` of
    the file that it reads, the `folder` where a relative one begins, and the `seconds` and the
    `memory` [bytes] that it may take. With `modules` it requests the import of a reader's own
    module and of its library instead. A reply is a line of JSON, too: the `result` of the function
    and the `lengths` of columns, followed by their numbers as bytes of float64, or the message with
    which the request is `refused`, and whether the process `ends`.
    """
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries print there, which is no reply
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    sys.dont_write_bytecode = True  # nor into the folder of a file, of code beside it
    guard = Guard(replies, Path(os.environ["TMPDIR"]))
    sys.addaudithook(guard.audit)
    for line in sys.stdin.buffer:
        reply, columns = _answer(json.loads(line), guard)
        _send(replies, reply)
        for column in columns:
            replies.write(column.data.cast("B"))
        replies.flush()


def _answer(request: dict[str, Any], guard: "Guard") -> tuple[dict[str, Any], list[Column]]:
    _alarm(request["seconds"])
    path = Path(request["path"])
    try:
        if "modules" in request:
            own, library = request["modules"]
            importlib.import_module(own)  # the program names it, wherever it is
            guard.path = path
            importlib.import_module(library)
            return {}, []
        function = load_place(request["function"])
        if request["folder"] is not None:
            os.chdir(request["folder"])
        _limit_memory(request["memory"])
        with convert_errors(
            path, f"cannot be read as {path.suffix.lower()}", "a whole file of that format"
        ):
            guard.path = path
            result, columns = function(path, *request["arguments"])
        return {"result": result, "lengths": [len(column) for column in columns]}, columns
    except InputError as error:
        return {"refused": str(error)}, []
    finally:
        guard.path = None
        _alarm(0)


def _limit_memory(more: int) -> None:
    """Limits the memory of this process to what it has and some bytes, on Linux."""
    if sys.platform == "linux":
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = pages * resource.getpagesize() + more
        limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _send(replies: BinaryIO, reply: dict[str, Any]) -> None:
    replies.write(json.dumps(reply, default=np.ndarray.tolist).encode() + b"\n")
    replies.flush()


def _alarm(seconds: float) -> None:
    """Ends this process after some seconds, also where the parent cannot any more."""
    if sys.platform != "win32":
        signal.alarm(math.ceil(seconds))


class Guard:
    """Ends the process where reading a file would do more than read it.

    A second lock: no reader is known to evaluate what is in a file. It sees what Python does, not
    what a library does in machine code; of imports only where the code is; while `path` is None
    nothing.

    Args:
        replies: where the reply goes that says why the process ends.
        scratch: the folder in which libraries may write.

    Attributes:
        path: the file that is read now.
    """

    def __init__(self, replies: BinaryIO, scratch: Path) -> None:
        self._replies, self._scratch = replies, scratch
        self.path: Path | None = None

    def audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        """The hook of `sys.addaudithook`."""
        path = self.path
        if path is None:
            return
        if _is_code_beside(path, event, arguments):
            self._end(path, "run code from its folder", event)
        act = self._find_harm(event, arguments)
        if act and not _is_importing():
            self._end(path, act, event)

    def _end(self, path: Path, act: str, event: str) -> None:
        self.path = None  # what follows is not the file's doing
        error = InputError(
            path,
            f"reading it would {act} ({event})",
            "data alone",
            "the file may be hostile: nothing of it was used",
        )
        _send(self._replies, {"refused": str(error), "ends": True})
        os._exit(1)

    def _find_harm(self, event: str, arguments: tuple[Any, ...]) -> str:
        """The harm of an event that reading a file never needs, in words; else empty."""
        if event.startswith(_STARTS):
            return "start a process"
        if event.startswith("socket."):
            return "use the network"
        if event == "open":
            file, _, flags = arguments
            is_written = isinstance(flags, int) and flags & _WRITES
            return "write a file" if is_written and not self._is_scratch(file) else ""
        files = [x for x in arguments if isinstance(x, str | bytes)]
        is_change = event.startswith(_CHANGES) and not all(map(self._is_scratch, files))
        return "change files" if is_change else ""

    def _is_scratch(self, file: object) -> bool:
        """Whether a file, by path or descriptor, is one that libraries may write."""
        if not isinstance(file, str | bytes | os.PathLike):
            return True  # one that is open already
        place = os.path.abspath(os.fsdecode(file))  # noqa: PTH100
        return place == os.devnull or Path(place).is_relative_to(self._scratch)


def _is_importing() -> bool:
    """Whether a module that is installed is being imported, which may look at the system."""
    frame = inspect.currentframe()
    while frame is not None and frame.f_code.co_filename != "<frozen importlib._bootstrap>":
        frame = frame.f_back
    return frame is not None


def _is_code_beside(path: Path, event: str, arguments: tuple[Any, ...]) -> bool:
    """Whether code from the folder of a file is run, not that of packages somewhere below it."""
    number = {"exec": 0, "import": 1, "ctypes.dlopen": 0}.get(event)
    source = None if number is None else arguments[number]
    source = getattr(source, "co_filename", source)
    if not isinstance(source, str | bytes | os.PathLike):
        return False
    folder, place = path.absolute().parent, Path(os.fsdecode(source))
    if not place.is_relative_to(folder):  # nor is "<string>", of code that a library makes
        return False
    homes = [home for entry in sys.path if (home := Path(entry).absolute()) != folder]
    return not any(place.is_relative_to(h) for h in homes if h.is_relative_to(folder))
