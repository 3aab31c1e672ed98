"""CasADi: a step as a function, for solvers of optimal control."""

import math
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tustinnet.errors import require_package
from tustinnet.export.source import Source, make_source
from tustinnet.export.target import Files, Stepper, Target, Vector
from tustinnet.models.contract import Model
from tustinnet.program.program import Loop, Node, Program

if TYPE_CHECKING:
    from casadi import Function

FILE = "step.casadi"
_WRITTEN_OUT = 30_000  # operations up to which a loop is written out
_COPIED = ("number", "table", "pick", "part")  # cheaper to make again than to hand on
# what CasADi calls otherwise
_CALLED = {
    "add": "plus", "sub": "minus", "mul": "times", "div": "rdivide", "max": "fmax", "min": "fmin",
    "pow": "power", "rem": "fmod", "abs": "fabs", "and": "logic_and", "or": "logic_or",
    "not": "logic_not", "select": "if_else",
}  # fmt: skip

Values = dict[int, Any]  # expressions by the numbers of nodes


def casadi_step(model: Model) -> "Function":
    """The step of a model as a CasADi function, `(x, u) -> x_next`.

    Value, Jacobian and Hessian are the model's, to rounding.

    Args:
        model: a model that steps from sample to sample.

    Returns:
        A function of `x`, (n_x,), and `u`, (n_u,), that gives `x_next`, (n_x,). Where a step
        depends on inputs at several samples, `u` has all of them: at the sample itself, after it,
        before it.

    Raises:
        InputError: CasADi is not installed, or the model uses what no target can say.
    """
    require_package("casadi", "casadi", "casadi_step")
    return _step_of(make_source(model))


def _step_of(source: Source) -> "Function":
    return function_of(source.step, "step", ["x", "u"], ["x_next"])


def function_of(
    program: Program, name: str, inputs: Sequence[str], outputs: Sequence[str]
) -> "Function":
    """A program as a CasADi function.

    Products and long loops are nodes of an MX graph. What is computed between them is SX. A
    program that has neither is nothing but SX, whose derivatives are quicker.

    Args:
        program: the program.
        name: what the function is called.
        inputs: the program's inputs, in the order in which the function takes them.
        outputs: what its outputs are called.
    """
    import casadi

    joined = any(map(_joins, program.nodes))
    kind: Any = casadi.MX if joined else casadi.SX
    given = {n: kind.sym(n, program.inputs[n]) for n in inputs}
    values = {i: given[n.data] for i, n in enumerate(program.nodes) if n.op == "input"}
    if joined:
        _join(program, values)
    else:
        _write(program, values, range(len(program.nodes)))
    ends = [values[i] for i in program.outputs.values()]
    return casadi.Function(name, list(given.values()), ends, list(inputs), list(outputs))


def _joins(node: Node) -> bool:
    """Whether a node stands in the MX graph."""
    long = node.op == "loop" and node.data.length * _size(node.data.body) > _WRITTEN_OUT
    return node.op == "product" or long


def _size(program: Program) -> float:
    """How many operations a program is in SX; infinite of one that is MX."""
    found = 0.0
    for node in program.nodes:
        if _joins(node):
            return math.inf
        found += node.data.length * _size(node.data.body) if node.op == "loop" else node.size
    return found


def _write(program: Program, values: Values, which: Iterable[int]) -> None:
    """Adds the values of some nodes, in SX."""
    for i in which:
        if i not in values:
            node = program.nodes[i]
            values[i] = _scalar(program, node, [values[a] for a in node.args])


def _scalar(program: Program, node: Node, args: list[Any]) -> Any:
    import casadi

    match node.op:
        case "number":
            return casadi.SX(float(node.data))
        case "table":
            return casadi.SX(casadi.DM(program.tables[node.data].astype(float)))
        case "pick":
            return args[0][node.data]
        case "part":
            return args[0][node.data : node.data + node.size]
        case "join":
            return casadi.vertcat(*args)
        case "neg":
            return -args[0]
        case "loop":
            return _written_out(node.data, args)
    return getattr(casadi, _CALLED.get(node.op, node.op))(*args)


def _written_out(loop: Loop, args: list[Any]) -> Any:
    """A loop in SX, turn after turn."""
    import casadi

    turn, carried, constants, given = _taken_apart(loop, args)
    rows = [casadi.reshape(g, -1, loop.length) for g in given]
    for i in range(loop.length):
        carried = turn.call([*carried, *constants, *(row[:, i] for row in rows)])
    return casadi.vertcat(*carried)


def _repeated(loop: Loop, args: list[Any]) -> Any:
    """A loop in MX, as a function that is called again and again."""
    import casadi

    turn, carried, constants, given = _taken_apart(loop, args)
    every = [casadi.repmat(c, 1, loop.length) for c in constants]
    rows = [casadi.reshape(g, -1, loop.length) for g in given]
    turns = turn.mapaccum("turns", loop.length, loop.carried)
    return casadi.vertcat(*(states[:, -1] for states in turns.call([*carried, *every, *rows])))


def _taken_apart(loop: Loop, args: list[Any]) -> tuple[Any, list[Any], list[Any], list[Any]]:
    """One turn as a function of what is carried, constant and given, and these."""
    first, last = loop.constants, loop.constants + loop.carried

    def parts(of: list[Any]) -> tuple[list[Any], list[Any], list[Any]]:
        return of[first:last], of[:first], of[last:]

    inputs = [name for part in parts(list(loop.body.inputs)) for name in part]
    outputs = [f"next{i}" for i in range(loop.carried)]
    return function_of(loop.body, "turn", inputs, outputs), *parts(args)


def _join(program: Program, values: Values) -> None:
    """Adds the values of the outputs and of products and long loops, in MX."""
    import casadi

    stage = _stages(program)
    between = _between(program, stage)
    for now, (given, inner, wanted) in enumerate(between):
        for i, node in enumerate(program.nodes):
            if stage[i] == now and _joins(node):
                args = [values[a] for a in node.args]
                values[i] = (
                    _repeated(node.data, args) if node.op == "loop"
                    else casadi.mtimes(casadi.DM(program.tables[node.data]), *args)
                )  # fmt: skip
        symbols = {i: casadi.SX.sym(f"n{i}", program.nodes[i].size) for i in given}
        written = dict(symbols)
        _write(program, written, inner)
        part = casadi.Function(f"part{now}", list(symbols.values()), [written[i] for i in wanted])
        found = part.call([values[i] for i in given])
        values.update(zip(wanted, found, strict=True))


def _stages(program: Program) -> list[int]:
    """How many nodes of the MX graph are computed one after the other up to each node."""
    found = []
    for node in program.nodes:
        found.append(max((found[a] for a in node.args), default=0) + _joins(node))
    return found


def _between(program: Program, stage: list[int]) -> list[tuple[list[int], list[int], list[int]]]:
    """What is computed in SX in each stage: from which nodes, which nodes, which are used later."""
    nodes = program.nodes
    outer = {i for i, node in enumerate(nodes) if node.op == "input" or _joins(node)}
    wanted = [set() for _ in range(max(stage) + 1)]
    for i in (*program.outputs.values(), *(a for o in outer for a in nodes[o].args)):
        if i not in outer:
            wanted[stage[i]].add(i)
    found = []
    for now in reversed(range(len(wanted))):
        given, inner, open_ = set(), set(), list(wanted[now])
        while open_:
            i = open_.pop()
            inner.add(i)
            for a in nodes[i].args:
                if a in outer:
                    given.add(a)
                elif stage[a] < now and nodes[a].op not in _COPIED:
                    given.add(a)
                    wanted[stage[a]].add(a)
                elif a not in inner:
                    open_.append(a)
        found.append((sorted(given), sorted(inner), sorted(wanted[now])))
    return found[::-1]


class CasADi(Target):
    """A function that CasADi loads by itself."""

    name = "casadi"
    extra = ("casadi", ("casadi",))

    def files(self, source: Source) -> Files:
        """The function, as CasADi saves it."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / FILE
            _step_of(source).save(str(path))
            return {FILE: path.read_bytes()}

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """The function that was saved, run by CasADi."""
        import casadi

        step = casadi.Function.load(str(folder / FILE))

        def stepped(x: Vector, u: Vector) -> Vector:
            return step(x, u).full().ravel()

        return stepped


TARGET = CasADi()
