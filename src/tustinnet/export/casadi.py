"""CasADi: a step as a function, for solvers of optimal control."""

import math
import tempfile
from collections.abc import Iterable, Sequence
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
_COPIED = ("number", "table", "pick", "part")  # cheaper to make again than to pass on
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

Values = dict[int, Any]  # expressions by the numbers of nodes


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

    Products and long loops are nodes of an MX graph, operations between them SX. A program that
    has neither is SX alone, whose derivatives are quicker.

    Args:
        program: the program.
        name: the name of the function.
        inputs: the program's inputs, in the order in which the function takes them.
        outputs: the names of its outputs.
    """
    import casadi

    is_graph = any(map(_is_mx, program.nodes))
    kind: Any = casadi.MX if is_graph else casadi.SX
    symbols = {n: kind.sym(n, program.inputs[n]) for n in inputs}
    values = {i: symbols[n.data] for i, n in enumerate(program.nodes) if n.op == "input"}
    if is_graph:
        _write_graph(program, values)
    else:
        _write_scalars(program, values, range(len(program.nodes)))
    results = [values[i] for i in program.outputs.values()]
    return casadi.Function(name, list(symbols.values()), results, list(inputs), list(outputs))


def _is_mx(node: Node) -> bool:
    """Whether a node stands in the MX graph."""
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


def _write_scalars(program: Program, values: Values, which: Iterable[int]) -> None:
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
            return _unrolled(node.data, args)
    return getattr(casadi, _NAMES.get(node.op, node.op))(*args)


def _unrolled(loop: Loop, args: list[Any]) -> Any:
    """A loop in SX, turn after turn."""
    import casadi

    turn, constants, carried, tables = _split(loop, args)
    rows = [casadi.reshape(table, -1, loop.length) for table in tables]
    for i in range(loop.length):
        carried = turn.call([*carried, *constants, *(row[:, i] for row in rows)])
    return casadi.vertcat(*carried)


def _repeated(loop: Loop, args: list[Any]) -> Any:
    """A loop in MX, as a function that is called again and again."""
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


def _write_graph(program: Program, values: Values) -> None:
    """Adds the values of the outputs and of products and long loops, in MX."""
    import casadi

    stage: list[int] = []  # how many nodes of the MX graph lie before each node, in a chain
    for node in program.nodes:
        stage.append(max((stage[a] for a in node.args), default=0) + _is_mx(node))
    for now, (inputs, inner, outputs) in enumerate(_scalar_parts(program, stage)):
        for i, node in enumerate(program.nodes):
            if stage[i] == now and _is_mx(node):
                args = [values[a] for a in node.args]
                values[i] = (
                    _repeated(node.data, args)
                    if node.op == "loop"
                    else casadi.mtimes(casadi.DM(program.tables[node.data]), *args)
                )
        symbols = {i: casadi.SX.sym(f"n{i}", program.nodes[i].size) for i in inputs}
        scalars = dict(symbols)
        _write_scalars(program, scalars, inner)
        part = casadi.Function(f"part{now}", list(symbols.values()), [scalars[i] for i in outputs])
        values.update(zip(outputs, part.call([values[i] for i in inputs]), strict=True))


def _scalar_parts(
    program: Program, stage: list[int]
) -> list[tuple[list[int], list[int], list[int]]]:
    """The nodes that are SX in each stage: inputs, all nodes, and those that are used later."""
    nodes = program.nodes
    outer = {i for i, node in enumerate(nodes) if node.op == "input" or _is_mx(node)}
    used_later = [set() for _ in range(max(stage) + 1)]
    for i in (*program.outputs.values(), *(a for o in outer for a in nodes[o].args)):
        if i not in outer:
            used_later[stage[i]].add(i)
    parts = []
    for now in reversed(range(len(used_later))):
        inputs, inner, pending = set(), set(), list(used_later[now])
        while pending:
            i = pending.pop()
            inner.add(i)
            for a in nodes[i].args:
                if a in outer:
                    inputs.add(a)
                elif stage[a] < now and nodes[a].op not in _COPIED:
                    inputs.add(a)
                    used_later[stage[a]].add(a)
                elif a not in inner:
                    pending.append(a)
        parts.append((sorted(inputs), sorted(inner), sorted(used_later[now])))
    return parts[::-1]


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
