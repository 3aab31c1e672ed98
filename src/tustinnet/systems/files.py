"""Systems by name, or from the file of a user."""

import importlib.util
from pathlib import Path

from tustinnet.errors import InputError
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.registry import SYSTEMS

AnySystem = LagrangianSystem | str | Path
ATTRIBUTE = "SYSTEM"  # what a system file calls its system


def load_system(which: AnySystem) -> LagrangianSystem:
    """A system by its packaged name, or the `SYSTEM` of a Python file, which is run.

    Args:
        which: a name (`qube-servo2`, `qube-servo2-naive`, `qube-servo2-memory`), or a file, as
            `arm.py`; a system is returned as it is.

    Raises:
        InputError: no such name or file, a file that fails or has no `SYSTEM`.
    """
    if isinstance(which, LagrangianSystem):
        return which
    if str(which) in SYSTEMS:
        return SYSTEMS[str(which)]
    path = Path(which)
    if path.suffix != ".py":
        raise InputError(
            f"system '{which}'",
            "no such system",
            f"one of {', '.join(SYSTEMS.names())}, or a file FILE.py",
        )
    if not path.is_file():
        raise InputError(path, "no such file", "a Python file that defines SYSTEM")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(path, "cannot be read as Python", "a Python file that defines SYSTEM")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        line = _line_of(error, path)
        raise InputError(
            path, f"fails{line} with {type(error).__name__}: {error}", "a file that runs",
            "docs/systems.md shows one",
        ) from error  # fmt: skip
    system = getattr(module, ATTRIBUTE, None)
    if not isinstance(system, LagrangianSystem):
        found = "no SYSTEM" if system is None else f"SYSTEM is a {type(system).__name__}"
        raise InputError(
            path, found, "SYSTEM = LagrangianSystem(...)", "docs/systems.md shows a whole file"
        )
    return system


def _line_of(error: BaseException, path: Path) -> str:
    trace, line = error.__traceback__, 0
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = trace.tb_lineno
        trace = trace.tb_next
    line = getattr(error, "lineno", None) or line
    return f" at line {line}" if line else ""
