"""What every verb does with the terminal: messages, results, precision."""

import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from tustinnet.report.tables import Table
    from tustinnet.systems.files import SystemFile

_LATER = 0.05  # seconds until a signal is sent again
_LONGEST_QUESTION = 400  # characters
# JAX would keep what takes a second to compile: few of the programs of a fit, which are many
_SMALL_PROGRAMS = {
    "jax_persistent_cache_min_compile_time_secs": 0.0,
    "jax_persistent_cache_min_entry_size_bytes": -1,
}
_PIPED_WIDTH = 200  # columns of a table that goes into a file or a pipe


def messages() -> "Console":
    """Where progress and remarks go: standard error, so that results can be piped."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, soft_wrap=True, markup=False)


def teller(*, quiet: bool) -> Callable[[str], None]:
    """Who is told sentences while something goes on; nobody where it is to be quiet."""
    return (lambda sentence: None) if quiet else messages().print


def print_json(content: Any) -> None:
    """A result as JSON on standard output."""
    from tustinnet.store.files import to_json

    sys.stdout.write(to_json(content))
    sys.stdout.flush()  # figures, which come next, take seconds


def print_tables(*tables: "Table") -> None:
    """Results as tables on standard output."""
    from rich.console import Console

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_PIPED_WIDTH)
    for table in tables:
        table.print(console)


def confirmed(question: str) -> bool:
    """Whether the user says yes; no, where nobody can be asked."""
    if not (sys.stdin and sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    from tustinnet.errors import printable

    sys.stderr.write(f"{printable(question, _LONGEST_QUESTION)} [y/N] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def remember_trust(system: "SystemFile") -> None:
    """Remembers that the user ran this file, so that a kept copy is run without a question."""
    from tustinnet.errors import InputError
    from tustinnet.store.kept_system import trust

    try:
        trust(system)
    except InputError as error:  # costs a question later
        messages().print(f"note: {error}")


class Stopped(KeyboardInterrupt):
    """Ctrl-C, SIGTERM or SIGHUP.

    Attributes:
        number: of the signal; the usual exit code is 128 more: 130, 143 or 129.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


_verbs = 0  # how deep in `interruptible`


def _stop(number: int, frame: FrameType | None) -> None:
    """Raises in a verb; ends the process at once before it, and while a module loads.

    An exception would leave half a module, and compiled ones crash; nothing is being written then.
    """
    while frame is not None and frame.f_globals.get("__name__") != "importlib._bootstrap":
        frame = frame.f_back
    if _verbs and frame is None:
        raise Stopped(number)
    os.write(2, b"interrupted\n")
    os._exit(128 + number)


@contextmanager
def _redelivering() -> Iterator[None]:
    """Sends a signal again that was raised where Python drops exceptions, as in a `__del__`."""
    before = sys.unraisablehook

    def catch(dropped: Any) -> None:
        if isinstance(dropped.exc_value, Stopped):
            again = (os.getpid(), dropped.exc_value.number)
            threading.Timer(_LATER, os.kill, again).start()
        else:
            before(dropped)

    sys.unraisablehook = catch
    try:
        yield
    finally:
        sys.unraisablehook = before


@contextmanager
def stoppable() -> Iterator[None]:
    """Ctrl-C, SIGTERM and SIGHUP end what is inside with one line.

    Those that whoever started the command has it ignore stay ignored.
    """
    before = {}
    if threading.current_thread() is threading.main_thread():  # others cannot set handlers
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, _stop)
    try:
        with _redelivering():
            yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def interruptible(remedy: str = "") -> Iterator[None]:
    """Ends with one line and the usual exit code when interrupted."""
    global _verbs
    _verbs += 1
    try:
        yield
    except KeyboardInterrupt as stop:
        sys.stderr.write(f"interrupted; {remedy}\n" if remedy else "interrupted\n")
        raise SystemExit(128 + getattr(stop, "number", signal.SIGINT)) from None
    finally:
        _verbs -= 1


def shorten_warnings() -> None:
    """Shows each warning of this package as one line, without the place in its source."""
    plain = warnings.showwarning

    def tell(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if category is UserWarning:
            sys.stderr.write(f"note: {message}\n")
        else:
            plain(message, category, *place)

    warnings.showwarning = tell


def prepare_jax(device: str | None = None) -> None:
    """Double precision for scores, a device for each core; compiled programs are kept.

    Args:
        device: `cpu` or `gpu`; what JAX prefers when left out.

    Raises:
        InputError: JAX sees no such device.
    """
    import jax

    from tustinnet.cores import cores

    jax.config.update("jax_enable_x64", True)
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", cores())
    platforms = os.environ.get("JAX_PLATFORMS", "")
    _first_device(None, f"JAX_PLATFORMS={platforms}", "unset the variable")
    if device is not None:
        first = _first_device(device, f"--device {device}", "leave the option out")
        jax.config.update("jax_default_device", first)
    _keep_programs()


def _keep_programs() -> None:
    """Keeps compiled programs: in the user's cache folder, or in JAX_COMPILATION_CACHE_DIR."""
    import jax

    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        import platformdirs

        kept = Path(platformdirs.user_cache_dir("tustinnet")) / "compiled"
        try:
            kept.mkdir(parents=True, exist_ok=True)
        except OSError:
            return  # a home that cannot be written only costs time
        if not os.access(kept, os.W_OK):
            return
        jax.config.update("jax_compilation_cache_dir", str(kept))
    for name, value in _SMALL_PROGRAMS.items():
        if name.upper() not in os.environ:  # whoever says it himself means it
            jax.config.update(name, value)


def _first_device(kind: str | None, asked: str, undo: str) -> Any:
    """The first device of a kind, of any kind where none is given; an error names who asked."""
    import jax

    from tustinnet.errors import InputError

    try:
        return jax.devices(kind)[0]
    except (RuntimeError, AssertionError):  # the second is what it says of some that are absent
        raise InputError(
            asked, "JAX sees none", "a device that JAX sees",
            f"{undo}, or install JAX for your GPU: pip install 'jax[cuda13]'",
        ) from None  # fmt: skip
