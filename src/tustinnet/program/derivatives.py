"""Derivatives of programs, as further operations on the same tape.

Forward mode: every node has, beside its value, its derivative along each direction in which it
has one. A derivative that is zero by the structure of the program is never written, so the
Jacobian of equations of motion costs a few operations an entry.

References:
    Griewank, Walther (2008), Evaluating Derivatives, chapters 3 (forward mode) and 7 (sparsity).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.program.program import OPERATIONS, Loop, Node, Program
from tustinnet.program.tape import NodeTerm, Tape

# derivatives of a node: for each direction the number of a node of its size; no entry for zero
Tangents = dict[int, int]
_SPARSE = 0.25  # share of a vector that is not zero, up to which a product is written by columns


def with_derivatives(
    program: Program,
    output: str,
    by: Mapping[str, str],
    columns: Mapping[str, range] | None = None,
) -> Program:
    """A program with derivatives of one of its outputs as further outputs.

    Args:
        program: the program.
        output: the output that is differentiated, (n,).
        by: for each further output the input that is differentiated by, (m,); the output is the
            Jacobian by rows, (n m,).
        columns: for these inputs the numbers that are differentiated by, where not all.
    """
    columns = columns or {}
    tape = Tape(dict(program.inputs), program.matrices)
    values = {name: tape.input(name) for name in program.inputs}
    seeds: dict[str, Tangents] = {name: {} for name in program.inputs}
    directions: dict[str, range] = {}
    count = 0
    for name in by.values():
        unit = np.eye(program.inputs[name])[columns.get(name, range(program.inputs[name]))]
        directions[name] = range(count, count + len(unit))
        seeds[name] |= {count + i: tape.table(row) for i, row in enumerate(unit)}
        count += len(unit)
    ends, tangents = write_with_tangents(tape, program, values, seeds)
    outputs = {name: tape.split(number) for name, number in ends.items()}
    zero = tape.number(0.0)
    n = len(outputs[output])
    derivatives = {d: tape.split(number) for d, number in tangents[output].items()}
    for derivative, name in by.items():
        outputs[derivative] = [
            derivatives[d][i] if d in derivatives else zero
            for i in range(n)
            for d in directions[name]
        ]
    # in the order of their names, as the outputs of programs from `read`
    return tape.program({name: outputs[name] for name in sorted(outputs)})


def write_with_tangents(
    tape: Tape, program: Program, inputs: Mapping[str, int], tangents: Mapping[str, Tangents]
) -> tuple[dict[str, int], dict[str, Tangents]]:
    """Writes a program onto a tape together with its derivatives along some directions.

    Args:
        tape: the tape.
        program: the program.
        inputs: the nodes of the tape that are its inputs.
        tangents: derivatives of these inputs.

    Returns:
        The nodes of its outputs, and their derivatives.
    """
    writer = _Forward(tape, program, inputs, tangents)
    values, by_node = [], []
    for node in program.nodes:
        value, derivatives = writer.node(
            node, [values[a] for a in node.args], [by_node[a] for a in node.args]
        )
        values.append(value)
        by_node.append(derivatives)
    ends = program.outputs.items()
    return {name: values[i] for name, i in ends}, {name: by_node[i] for name, i in ends}


@dataclass(frozen=True)
class _Forward:
    tape: Tape
    program: Program
    inputs: Mapping[str, int]
    tangents: Mapping[str, Tangents]

    def node(
        self, node: Node, args: Sequence[int], tangents: Sequence[Tangents]
    ) -> tuple[int, Tangents]:
        """The value of a node on the tape, and its derivatives by those of its arguments."""
        tape = self.tape
        if node.op == "loop":
            return self._loop(node.data, args, tangents)
        value = tape.copy_node(self.program, node, args, self.inputs)
        match node.op:
            case "input":
                return value, dict(self.tangents.get(node.data, {}))
            case "number" | "table":
                return value, {}
            case "pick":
                numbers = {d: tape.pick(t, node.data) for d, t in tangents[0].items()}
                return value, self._nonzero(numbers)
            case "part":
                part = slice(node.data, node.data + node.size)
                parts = {d: tape.vector(tape.split(t)[part]) for d, t in tangents[0].items()}
                return value, self._nonzero(parts)
            case "join":
                pairs = list(zip(args, tangents, strict=True))
                return value, {
                    d: tape.vector([x for a, t in pairs for x in tape.split(self._along(t, d, a))])
                    for d in _directions(tangents)
                }
            case "product":
                matrix = self.program.tables[node.data]
                return value, {d: self._product(matrix, t) for d, t in tangents[0].items()}
            case "layer":
                return value, {d: tape.layer(node.data, t) for d, t in tangents[0].items()}
        if OPERATIONS[node.op].truth or not any(tangents):
            return value, {}
        return value, self._operation(node, value, args, tangents)

    def _operation(
        self, node: Node, value: int, args: Sequence[int], tangents: Sequence[Tangents]
    ) -> Tangents:
        tape, zero = self.tape, self.tape.number(0.0)
        if node.op == "select":
            selected = {
                d: tape.apply("select", args[0], *(t.get(d, zero) for t in tangents[1:]))
                for d in _directions(tangents[1:])
            }
            return self._nonzero(selected, node.size)
        partials = partial_derivatives(tape, node.op, value, args)
        totals: Tangents = {}
        for d in _directions(tangents):
            for partial, tangent in zip(partials, tangents, strict=True):
                if d in tangent:
                    term = tape.apply("mul", partial, tangent[d])
                    totals[d] = tape.apply("add", totals[d], term) if d in totals else term
        return self._nonzero(totals, node.size)

    def _product(self, matrix: np.ndarray, vector: int) -> int:
        """A matrix times a derivative, by columns where that has few entries."""
        tape = self.tape
        numbers = tape.split(vector)
        values = [tape.value(n) for n in numbers]
        if all(v is not None for v in values):
            return tape.table(matrix @ np.array(values, float))
        used = [i for i, v in enumerate(values) if v != 0.0]
        if len(used) > _SPARSE * len(numbers):
            return tape.product(matrix, vector)
        total = tape.table(np.zeros(len(matrix)))
        for i in used:
            term = tape.apply("mul", tape.table(matrix[:, i].copy()), numbers[i])
            total = term if i == used[0] else tape.apply("add", total, term)
        return total

    def _loop(
        self, loop: Loop, args: Sequence[int], tangents: Sequence[Tangents]
    ) -> tuple[int, Tangents]:
        """A loop that carries the derivatives of its carried vectors along with these."""
        tape, names = self.tape, list(loop.body.inputs)
        first, last = loop.constants, loop.constants + loop.carried
        directions = _directions(tangents)
        if not directions:
            return tape.add(Node("loop", tuple(args), sum(loop.carried_sizes), loop)), {}
        # name, size and node of each vector that the body takes, its derivatives behind it; carried
        # vectors have one along every direction
        inputs: list[list[tuple[str, int, int]]] = []
        tangent_names: dict[str, dict[int, str]] = {name: {} for name in names}
        for place, (name, value, tangent) in enumerate(zip(names, args, tangents, strict=True)):
            is_carried = first <= place < last
            size = loop.sizes[place]
            vectors = [(name, size, value)]
            for d in directions if is_carried else tangent:
                tangent_names[name][d] = f"{name}_by_{d}"
                vectors.append((f"{name}_by_{d}", size, self._along(tangent, d, value)))
            inputs.append(vectors)
        constants = [x for vectors in inputs[:first] for x in vectors]
        carried = [vectors[0] for vectors in inputs[first:last]]
        carried += [
            vectors[1 + k] for k in range(len(directions)) for vectors in inputs[first:last]
        ]
        collected = [x for vectors in inputs[last:] for x in vectors]
        vectors = [*constants, *carried, *collected]
        inner = Tape({name: size for name, size, _ in vectors})
        values = {name: inner.input(name) for name in names}
        seeds = {
            name: {d: inner.input(t) for d, t in tangent_names[name].items()} for name in names
        }
        next_values, next_tangents = write_with_tangents(inner, loop.body, values, seeds)
        outputs = {name: inner.split(number) for name, number in next_values.items()}
        for d in directions:
            for name, number in next_values.items():
                zeros = [inner.number(0.0)] * inner[number].size
                tangent = next_tangents[name].get(d)
                outputs[f"{name}_by_{d}"] = zeros if tangent is None else inner.split(tangent)
        with_tangents = Loop(inner.program(outputs), loop.length, len(constants), len(carried))
        ends = tape.loop(with_tangents, [tape.split(number) for _, _, number in vectors])
        size = sum(loop.carried_sizes)
        return tape.vector(ends[:size]), {
            d: tape.vector(ends[(k + 1) * size : (k + 2) * size]) for k, d in enumerate(directions)
        }

    def _along(self, tangents: Tangents, direction: int, number: int) -> int:
        """The derivative of a node along a direction, also where it is zero."""
        if direction in tangents:
            return tangents[direction]
        tape, node = self.tape, self.tape[number]
        return tape.number(0.0) if node.is_single else tape.table(np.zeros(node.size))

    def _nonzero(self, tangents: Tangents, size: int | None = None) -> Tangents:
        """Derivatives that are not zero; of a vector's size, numbers that act on it repeated."""
        tape = self.tape
        result: Tangents = {}
        for d, t in tangents.items():
            numbers = tape.split(t) if tape[t].op == "table" else [t]
            if all(tape.value(x) == 0.0 for x in numbers):
                continue
            if size is None or tape[t].size == size:
                result[d] = t
            else:
                result[d] = tape.vector([t] * size)
        return result


def _directions(tangents: Sequence[Tangents]) -> list[int]:
    return sorted({d for tangent in tangents for d in tangent})


# --- partial derivatives of operations ---


def partial_derivatives(tape: Tape, op: str, value: int, args: Sequence[int]) -> list[int]:
    """Nodes of the derivatives of an operation by each of its arguments.

    Args:
        tape: the program.
        op: the operation; none whose value is a truth, nor `select`.
        value: the node of its value.
        args: the nodes of its arguments.
    """
    result = PARTIALS[op](*(NodeTerm(tape, number) for number in (value, *args)))
    partials = result if isinstance(result, tuple) else (result,)
    return [x.number if isinstance(x, NodeTerm) else tape.number(x) for x in partials]


Partials = NodeTerm | float | tuple[NodeTerm | float, ...]


def _quotient(y: NodeTerm, a: NodeTerm, b: NodeTerm) -> Partials:
    inverse = 1.0 / b
    return inverse, -(y * inverse)


def _larger(first: str) -> Callable[[NodeTerm, NodeTerm, NodeTerm], Partials]:
    """The rule of max and min; the derivative is half of each where both are equal, as in JAX."""

    def rule(y: NodeTerm, a: NodeTerm, b: NodeTerm) -> Partials:
        is_equal, is_first = a.apply("eq", b), a.apply(first, b)
        tie = is_equal.choose(0.5, 0.0)
        return is_first.choose(1.0, tie), is_first.apply("or", is_equal).choose(tie, 1.0)

    return rule


def _power(y: NodeTerm, a: NodeTerm, b: NodeTerm) -> Partials:
    base = b * a.apply("pow", b + -1.0)
    exponent = y * a.apply("log")
    return b.apply("eq", 0.0).choose(0.0, base), a.apply("eq", 0.0).choose(0.0, exponent)


def _remainder(y: NodeTerm, a: NodeTerm, b: NodeTerm) -> Partials:
    ratio = a / b
    low, high = ratio.apply("floor"), ratio.apply("ceil")
    return 1.0, -ratio.apply("ge", 0.0).choose(low, high)


def _angle(y: NodeTerm, a: NodeTerm, b: NodeTerm) -> Partials:
    size = 1.0 / (a * a + b * b)
    return b * size, -(a * size)


# formulas of the value y and the arguments; one for each argument
PARTIALS: dict[str, Callable[..., Partials]] = {
    "add": lambda y, a, b: (1.0, 1.0),
    "sub": lambda y, a, b: (1.0, -1.0),
    "mul": lambda y, a, b: (b, a),
    "div": _quotient,
    "neg": lambda y, x: -1.0,
    "max": _larger("gt"),
    "min": _larger("lt"),
    "pow": _power,
    "rem": _remainder,
    "atan2": _angle,
    "abs": lambda y, x: x.apply("ge", 0.0).choose(1.0, -1.0),  # 1 at 0, as in JAX
    "sign": lambda y, x: 0.0,
    "floor": lambda y, x: 0.0,
    "ceil": lambda y, x: 0.0,
    "sqrt": lambda y, x: 0.5 / y,
    "exp": lambda y, x: y,
    "expm1": lambda y, x: y + 1.0,
    "log": lambda y, x: 1.0 / x,
    "log1p": lambda y, x: 1.0 / (x + 1.0),
    "sin": lambda y, x: x.apply("cos"),
    "cos": lambda y, x: -x.apply("sin"),
    "tan": lambda y, x: y * y + 1.0,
    "asin": lambda y, x: 1.0 / (1.0 - x * x).apply("sqrt"),
    "acos": lambda y, x: -1.0 / (1.0 - x * x).apply("sqrt"),
    "atan": lambda y, x: 1.0 / (x * x + 1.0),
    "sinh": lambda y, x: x.apply("cosh"),
    "cosh": lambda y, x: x.apply("sinh"),
    "tanh": lambda y, x: 1.0 - y * y,
    "asinh": lambda y, x: 1.0 / (x * x + 1.0).apply("sqrt"),
    "acosh": lambda y, x: 1.0 / (x * x + -1.0).apply("sqrt"),
    "atanh": lambda y, x: 1.0 / (1.0 - x * x),
}
