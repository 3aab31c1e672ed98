"""Systems by name, or of a file, which is run if it is Python code."""

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.errors import InputError, describe_error, require_text
from tustinnet.models.lagrangian import LagrangianSystem, tracing_remedy
from tustinnet.registry import SYSTEMS
from tustinnet.systems.files import (
    AnySystem,
    SystemFile,
    SystemTemplate,
    find_system,
    running_in,
)
from tustinnet.systems.robot_options import RobotOptions
from tustinnet.systems.robots import RobotFile

ATTRIBUTE = "SYSTEM"  # the name of the system in a system file
_FUNCTIONS = ("kinetic", "potential", "dissipation", "input_map")
_PARTS = {
    "memory": ("rate", "force", "initial", "spread"),
    "unmeasured": ("follow", "initial", "spread"),
}
_REMEDY = "docs/reference/systems.md shows a whole file"

# what a command checks first and fits later is run once; forgotten with the file that was read
_loaded: WeakKeyDictionary[SystemFile, LagrangianSystem] = WeakKeyDictionary()


def load_system(which: AnySystem) -> LagrangianSystem:
    """A system by its packaged name, of a robot file, or the `SYSTEM` of a Python file.

    A Python file is run. A robot file (URDF, or MuJoCo's format) is only read; see `load_robot` for
    joints that are locked and inputs that are currents.

    Args:
        which: a name, as `qube-servo2`, `cart-pole` or `crane` (all of them in
            docs/reference/systems.md and library.md), or a file, as `arm.py`, `arm.urdf` or
            `robot.xml`; a system is returned as it is.

    Raises:
        InputError: no such name or file, a file that fails or has no `SYSTEM`, a system that is
            made for records. The functions of a system from a file raise it, too, whatever
            happens in them.
    """
    system = load_system_or_template(which)
    if isinstance(system, SystemTemplate):
        raise InputError(
            f"system '{system.name}'",
            "made for the records that it is identified from",
            "no `system=`",
            "a model file of it has all that is needed",
        )
    return system


def load_system_or_template(which: AnySystem) -> LagrangianSystem | SystemTemplate:
    """A system as `load_system` loads it, or the template of one that is made for records."""
    if isinstance(which, LagrangianSystem | SystemTemplate):
        return which
    file = which if isinstance(which, SystemFile) else find_system(which)
    if isinstance(file, str):
        return SYSTEMS[file]
    if file not in _loaded:
        _loaded[file] = _load_file(file)
    return _loaded[file]


def _load_file(file: SystemFile) -> LagrangianSystem:
    """The system of a file."""
    path, text = file.path, file.text
    if not file.is_code:
        return RobotFile(text, path, RobotOptions()).load()
    module = ModuleType(path.stem)
    module.__file__ = str(path)
    with _errors_with_place(path), _run_in(path.parent):
        # not imported: that would write a compiled copy beside the file, and may read an old one
        exec(compile(text, str(path), "exec", dont_inherit=True), vars(module))
        system = vars(module).get(ATTRIBUTE)
    if not isinstance(system, LagrangianSystem):
        problem = "no SYSTEM" if system is None else f"SYSTEM is a {type(system).__name__}"
        raise InputError(path, problem, "SYSTEM = LagrangianSystem(...)", _REMEDY)
    with _errors_with_place(path):
        system = _with_guards(system, path)
        # names that can be printed, and equations of motion that can be derived
        for name in (system.name, *system.nominal(), *system.internal):
            require_text(name, f"system '{system.name}'")
        hash(system)  # compiled programs are kept by it; lists in the place of tuples have none

        def derive(values: dict[str, Any]) -> Any:
            model = system.model(values)
            return model.derivative(jnp.zeros(model.state_size), jnp.zeros(model.channels.n_u))

        nominal = {name: np.float64(value) for name, value in system.nominal().items()}
        jax.eval_shape(derive, nominal)  # by their shapes
    return system


@contextmanager
def _run_in(folder: Path) -> Iterator[None]:
    """Files of robots are looked for in the folder of a system file, while that runs."""
    token = running_in.set(folder)
    try:
        yield
    finally:
        running_in.reset(token)


def _with_guards(system: LagrangianSystem, path: Path) -> LagrangianSystem:
    """A system whose functions name the file and themselves when they fail."""

    def guard(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def guarded(*arguments: Any) -> Any:
            with _errors_with_place(path, f"{name} "):
                return function(*arguments)

        return guarded

    def guard_all(part: Any, functions: Sequence[str], label: str = "") -> dict[str, Any]:
        present = {name: f for name in functions if (f := getattr(part, name)) is not None}
        return {name: guard(f"{label}{name}", f) for name, f in present.items()}

    parts = {
        label: replace(part, **guard_all(part, functions, f"{label} "))
        for label, functions in _PARTS.items()
        if (part := getattr(system, label))
    }
    return replace(system, **parts, **guard_all(system, _FUNCTIONS))


@contextmanager
def _errors_with_place(path: Path, function: str = "") -> Iterator[None]:
    """Turns all errors in a system file into an `InputError` that names file and line.

    Also a `KeyboardInterrupt` that the file raises; signals of a kind of their own pass.
    """
    try:
        yield
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}{_line_of(error, path)}", str(error)) from error
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and type(error) is not KeyboardInterrupt:
            raise
        remedy = tracing_remedy(error)
        problem = type(error).__name__ if remedy else describe_error(error)
        raise InputError(
            path,
            f"{function}fails{_line_of(error, path)} with {problem}",
            "a file that runs",
            remedy or _REMEDY,
        ) from error


def _line_of(error: BaseException | None, path: Path) -> str:
    """The line of a system file at which an error, or a cause of it, began, as " at line 3"."""
    line = 0
    for _ in range(20):
        if error is None:
            break
        trace = error.__traceback__
        while trace is not None:
            if trace.tb_frame.f_code.co_filename == str(path):
                line = trace.tb_lineno
            trace = trace.tb_next
        if isinstance(error, SyntaxError):
            line = error.lineno or line
        error = error.__cause__ or error.__context__
    return f" at line {line}" if line else ""
