"""CasADi: a step as a function, for solvers of optimal control."""

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tustinnet.errors import require_package
from tustinnet.export.source import Source, make_source
from tustinnet.export.target import Files, Stepper, Target
from tustinnet.models.contract import Model
from tustinnet.program.program import Loop, Node, Program

if TYPE_CHECKING:
    from casadi import Function

FILE = "step.casadi"
_WRITTEN_OUT = 30_000  # operations up to which a loop is written out
# operations that have another name in CasADi
_NAMES = {
    "add": "plus",
    "sub": "minus",
    "mul": "times",
    "div": "rdivide",
    "max": "fmax",
    "min": "fmin",
    "pow": "power",
    "rem": "fmod",
    "abs": "fabs",
    "and": "logic_and",
    "or": "logic_or",
    "not": "logic_not",
    "select": "if_else",
}


def casadi_step(model: Model) -> "Function":
    """The step of a model as a CasADi function, `(x, u) -> x_next`.

    Value, Jacobian and Hessian are the model's, to rounding.

    Args:
        model: a model that steps from sample to sample.

    Returns:
        A function of `x`, (n_x,), and `u`, (n_u,), that gives `x_next`, (n_x,). Where a step
        depends on inputs at several samples, as where they act late, `u` has all of them: at the
        sample itself, after it, before it.

    Raises:
        InputError: CasADi is not installed, or the model has operations that no target supports.
    """
    require_package("casadi", "casadi", "casadi_step")
    return make_function(make_source(model).step, "step", ["x", "u"], ["x_next"])


def make_function(
    program: Program, name: str, inputs: Sequence[str], outputs: Sequence[str]
) -> "Function":
    """A program as a CasADi function.

    A program with products or long loops is an MX graph; the bodies of its loops, and all other
    programs, are SX, in which single operations are quicker.

    Args:
        program: the program.
        name: the name of the function.
        inputs: the program's inputs, in the order in which the function takes them.
        outputs: the names of its outputs.
    """
    import casadi

    kind: Any = casadi.MX if any(map(_is_mx, program.nodes)) else casadi.SX
    symbols = {n: kind.sym(n, program.inputs[n]) for n in inputs}
    values: list[Any] = []
    for node in program.nodes:
        args = [values[a] for a in node.args]
        is_input = node.op == "input"
        values.append(symbols[node.data] if is_input else _value(kind, program, node, args))
    results = [values[i] for i in program.outputs.values()]
    return casadi.Function(name, list(symbols.values()), results, list(inputs), list(outputs))


def _is_mx(node: Node) -> bool:
    """Whether a node makes its program an MX graph."""
    long = node.op == "loop" and node.data.length * _size(node.data.body) > _WRITTEN_OUT
    return node.op == "product" or long


def _size(program: Program) -> float:
    """The number of operations of a program in SX; infinite for one in MX."""
    count = 0.0
    for node in program.nodes:
        if _is_mx(node):
            return math.inf
        count += node.data.length * _size(node.data.body) if node.op == "loop" else node.size
    return count


def _value(kind: Any, program: Program, node: Node, args: list[Any]) -> Any:
    """The expression of a node, SX or MX, by those of its arguments."""
    import casadi

    match node.op:
        case "number":
            return kind(float(node.data))
        case "table":
            return kind(casadi.DM(program.tables[node.data].astype(float)))
        case "product":
            return casadi.mtimes(casadi.DM(program.tables[node.data]), *args)
        case "pick":
            return args[0][node.data]
        case "part":
            return args[0][node.data : node.data + node.size]
        case "join":
            return casadi.vertcat(*args)
        case "neg":
            return -args[0]
        case "loop":
            return _repeated(node.data, args) if _is_mx(node) else _unrolled(node.data, args)
    return getattr(casadi, _NAMES.get(node.op, node.op))(*args)


def _unrolled(loop: Loop, args: list[Any]) -> Any:
    """A loop that is written out, turn after turn."""
    import casadi

    turn, constants, carried, tables = _split(loop, args)
    rows = [casadi.reshape(table, -1, loop.length) for table in tables]
    for i in range(loop.length):
        carried = turn.call([*carried, *constants, *(row[:, i] for row in rows)])
    return casadi.vertcat(*carried)


def _repeated(loop: Loop, args: list[Any]) -> Any:
    """A long loop, as a function that is called again and again."""
    import casadi

    turn, constants, carried, tables = _split(loop, args)
    repeated = [casadi.repmat(c, 1, loop.length) for c in constants]
    rows = [casadi.reshape(table, -1, loop.length) for table in tables]
    turns = turn.mapaccum("turns", loop.length, loop.carried)
    return casadi.vertcat(*(states[:, -1] for states in turns.call([*carried, *repeated, *rows])))


def _split(loop: Loop, args: list[Any]) -> tuple[Any, Sequence[Any], Sequence[Any], Sequence[Any]]:
    """One turn of a loop, and its constant and carried values and its tables.

    The turn is a function of the carried values, the constants and a row of each table.
    """
    constants, carried, tables = loop.split(list(loop.body.inputs))
    outputs = [f"next{i}" for i in range(loop.carried)]
    turn = make_function(loop.body, "turn", [*carried, *constants, *tables], outputs)
    return turn, *loop.split(args)


def step_file(step: Program) -> bytes:
    """A step, of `x` and `u`, as CasADi saves functions."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / FILE
        make_function(step, "step", ["x", "u"], ["x_next"]).save(str(path))
        return path.read_bytes()


class CasADi(Target):
    """A function that CasADi loads by itself."""

    name = "casadi"
    extra = ("casadi", ("casadi",))

    def files(self, source: Source) -> Files:
        """The function, as CasADi saves it."""
        return {FILE: step_file(source.step)}

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """The function that was saved, run by CasADi."""
        import casadi

        function = casadi.Function.load(str(folder / FILE))
        return lambda x, u: function(x, u).full().ravel()


TARGET = CasADi()
