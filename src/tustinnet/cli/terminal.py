"""Output of messages and results, signals, and warnings."""

import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import typer

from tustinnet.cli import console, options
from tustinnet.errors import InputError, to_printable
from tustinnet.store import files as disk
from tustinnet.store import kept_system
from tustinnet.systems import files as system_files

_DELAY = 0.05  # seconds until a signal is sent again
_LONGEST_QUESTION = 400  # characters
_BROKEN_PIPE = 141  # 128 and the number of SIGPIPE: exit code of a program that has no reader


def echo(text: str) -> None:
    """Prints a line of results on standard output."""
    typer.echo(options.with_options(text))


def messages() -> "console.Messages":
    """Console for progress and remarks."""
    return console.Messages()


def make_printer(*, quiet: bool) -> Callable[[str], None]:
    """Makes a function that prints messages, or ignores them if `quiet`."""
    return (lambda message: None) if quiet else messages().print


def print_json(content: Any) -> None:
    """Prints a result as JSON on standard output."""
    sys.stdout.write(disk.to_json(content))
    sys.stdout.flush()  # figures, which come next, take seconds


def print_tables(*tables: "console.Table") -> None:
    """Prints results as tables on standard output."""
    console.print_tables(*tables)


def can_ask() -> bool:
    """Whether there is a terminal at which somebody can answer."""
    return bool(sys.stdin and sys.stdin.isatty() and sys.stderr.isatty())


def ask(question: str, default: str) -> str:
    """The line that the user answers to a question on a terminal; empty for the default."""
    sys.stderr.write(f"{to_printable(question, _LONGEST_QUESTION)} [{default}] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip()


def confirm(question: str) -> bool:
    """Asks the user on a terminal; False without a terminal."""
    return can_ask() and ask(question, "y/N").lower() in ("y", "yes")


def remember_trust(system: "system_files.SystemFile") -> None:
    """Remembers that the user ran this file, so that a kept copy is run without a question."""
    try:
        kept_system.trust(system)
    except InputError as error:  # only costs a question later
        messages().print(f"note: {error}")


class Stopped(KeyboardInterrupt):
    """Interruption by Ctrl-C, SIGTERM or SIGHUP.

    Attributes:
        number: number of the signal; the usual exit code is 128 more: 130, 143 or 129.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


_depth = 0  # of nested `interruptible` contexts
_received = 0  # number of the last signal that interrupted a verb, 0 without any


def _stop(number: int, frame: FrameType | None) -> None:
    """Signal handler: raises `Stopped` in a verb, but ends the process before it and in imports.

    During an import an exception would leave half a module, and compiled modules crash; nothing
    is being written then.
    """
    while frame is not None and frame.f_globals.get("__name__") != "importlib._bootstrap":
        frame = frame.f_back
    if _depth and frame is None:
        global _received
        _received = number
        raise Stopped(number)
    os.write(2, b"interrupted\n")
    os._exit(128 + number)


@contextmanager
def stoppable(*, is_whole_process: bool = False) -> Iterator[None]:
    """Within the context, Ctrl-C, SIGTERM and SIGHUP end the command with one line.

    Signals that the parent process ignores stay ignored. One whose exception Python drops, as in
    `__del__`, is sent again.

    Args:
        is_whole_process: whether the process ends after the context. Then signals end it with one
            line until it has; else the earlier handlers are back.
    """
    earlier_handlers, earlier_hook = {}, sys.unraisablehook

    def catch_dropped(dropped: Any) -> None:
        if isinstance(dropped.exc_value, Stopped):
            arguments = (os.getpid(), dropped.exc_value.number)
            threading.Timer(_DELAY, os.kill, arguments).start()
        else:
            earlier_hook(dropped)

    if threading.current_thread() is threading.main_thread():  # others cannot set handlers
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                earlier_handlers[number] = signal.signal(number, _stop)
    sys.unraisablehook = catch_dropped
    try:
        yield
    finally:
        sys.unraisablehook = earlier_hook
        for number, handler in () if is_whole_process else earlier_handlers.items():
            signal.signal(number, handler)


def exit_code(code: Any) -> Any:
    """The exit code of a command that would end with `code`: that of a signal, if one came.

    Libraries turn the exception of a signal into others, whose code is 1.
    """
    return 128 + _received if code == 1 and _received else code


@contextmanager
def interruptible(remedy: str = "") -> Iterator[None]:
    """Within the context, an interruption ends with one line and the usual exit code.

    Args:
        remedy: how to continue later, for the line.
    """
    global _depth, _received
    _received = _received if _depth else 0  # of an earlier verb in this process
    _depth += 1
    try:
        yield
    except KeyboardInterrupt as stop:
        sys.stderr.write(f"interrupted; {remedy}\n" if remedy else "interrupted\n")
        raise SystemExit(128 + getattr(stop, "number", signal.SIGINT)) from None
    finally:
        _depth -= 1


def shorten_warnings() -> None:
    """Prints each warning of this package as one line, without its place in the source."""
    standard = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if category is UserWarning:
            sys.stderr.write(f"note: {message}\n")
        else:
            standard(message, category, *place)

    warnings.showwarning = show


class _Output:
    """Standard output; where it cannot be written, the command ends with one line.

    Where its reader has ended, as `head` does, the command ends without a line, as Unix tools do.

    Args:
        stream: the standard output of the process.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Writes a text."""
        return self._attempt(self._stream.write, text)

    def flush(self) -> None:
        """Writes what is buffered."""
        self._attempt(self._stream.flush)

    def _attempt(self, act: Callable[..., Any], *arguments: str) -> Any:
        try:
            return act(*arguments)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python would try once more at its end
            raise SystemExit(_BROKEN_PIPE) from None
        except OSError as error:
            raise InputError(
                "standard output", f"cannot be written ({error.strerror})", "one that takes all"
            ) from None


def guard_streams() -> None:
    """Ends the command with one line where standard output is closed, full, or no longer read.

    Characters that the terminal's encoding does not have are written as escapes.
    """
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 (for good)
    if sys.stdout is None:
        sys.exit("error: standard output: closed; expected an open one, or > /dev/null")
    sys.stdout.reconfigure(errors="backslashreplace")  # pyright: ignore[reportAttributeAccessIssue]
    sys.stdout = _Output(sys.stdout)  # pyright: ignore[reportAttributeAccessIssue]
