"""Systems by name or by file, and how a model file remembers which one it belongs to."""

import ast
import hashlib
import importlib
import importlib.util
import inspect
from pathlib import Path

from tustinnet.errors import InputError
from tustinnet.models.lagrangian import LagrangianSystem

_MODULES = {
    "qube-servo2": ("qube_servo2", "SYSTEM"),
    "qube-servo2-naive": ("qube_servo2", "NAIVE"),
    "qube-servo2-memory": ("qube_servo2", "WITH_MEMORY"),
}
PACKAGED = tuple(_MODULES)
ATTRIBUTE = "SYSTEM"  # what a system file calls its system


def load_system(which: str | Path | LagrangianSystem) -> LagrangianSystem:
    """A system by its packaged name, or the `SYSTEM` of a Python file, which is run.

    Args:
        which: a name (`qube-servo2`, `qube-servo2-naive`, `qube-servo2-memory`), or a file, as
            `arm.py`; a system is returned as it is.

    Raises:
        InputError: no such name or file, a file that fails or has no `SYSTEM`.
    """
    if isinstance(which, LagrangianSystem):
        return which
    if str(which) in _MODULES:
        module, attribute = _MODULES[str(which)]
        return getattr(importlib.import_module(f"tustinnet.systems.{module}"), attribute)
    path = Path(which)
    if path.suffix != ".py":
        raise InputError(
            f"system '{which}'",
            "no such system",
            f"one of {', '.join(PACKAGED)}, or a file FILE.py",
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


def source_of(system: LagrangianSystem) -> tuple[str, str]:
    """The file name and the digest of the code that a system's energies are written in.

    The digest is of what the code does: comments, docstrings, annotations and layout do not count,
    nor do the parameters' ranges.

    Raises:
        InputError: the code is in no file, as in a notebook.
    """
    try:
        path = Path(inspect.getsourcefile(system.kinetic) or "")
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except (TypeError, OSError, SyntaxError) as error:
        raise InputError(
            f"system '{system.name}'",
            "its energies are written in no file",
            "a file FILE.py with SYSTEM",
            "put the system into a file and load it with load_system",
        ) from error
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list) and body and _is_docstring(body[0]):
            body[0] = ast.Pass()
        if isinstance(node, ast.FunctionDef):
            node.returns = None
        if isinstance(node, ast.arg):
            node.annotation = None
        if isinstance(node, ast.Call) and _name_of(node.func) == "Parameter":
            # a model file holds all values: ranges and nominal ones are not part of what it needs
            node.args, node.keywords = node.args[:2], []
    return path.name, hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def _name_of(node: ast.AST) -> str:
    return getattr(node, "attr", getattr(node, "id", ""))


def _is_docstring(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _line_of(error: BaseException, path: Path) -> str:
    trace, line = error.__traceback__, 0
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = trace.tb_lineno
        trace = trace.tb_next
    line = getattr(error, "lineno", None) or line
    return f" at line {line}" if line else ""
