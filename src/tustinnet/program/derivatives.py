"""Derivatives of programs, as further operations on the same tape.

Forward mode: every node has, beside its value, its derivative along each direction in which it
has one. A derivative that is zero by the structure of the program is never written down, so the
Jacobian of equations of motion costs a few operations an entry.

References:
    Griewank, Walther (2008), Evaluating Derivatives, chapters 3 (forward mode) and 7 (sparsity).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.program.program import OPERATIONS, Loop, Node, Program
from tustinnet.program.tape import Tape

# of a node along each direction: the number of a node of its size; no entry where it is zero
Tangents = dict[int, int]
_FEW = 0.25  # share of a vector that is not zero, up to which a product is written by columns


def with_derivatives(
    program: Program,
    output: str,
    by: Mapping[str, str],
    columns: Mapping[str, range] | None = None,
) -> Program:
    """The program with derivatives of one of its outputs beside it.

    Args:
        program: the program.
        output: the output that is differentiated, (n,).
        by: input that it is differentiated by, (m,), for each further output; that one has the
            Jacobian by rows, (n m,).
        columns: of these inputs the numbers by which it is, where not by all.
    """
    columns = columns or {}
    tape = Tape(dict(program.inputs), program.matrices)
    values = {name: tape.input_vector(name) for name in program.inputs}
    seeds: dict[str, Tangents] = {name: {} for name in program.inputs}
    directions: dict[str, range] = {}
    count = 0
    for name in by.values():
        unit = np.eye(program.inputs[name])[columns.get(name, range(program.inputs[name]))]
        directions[name] = range(count, count + len(unit))
        seeds[name] |= {count + i: tape.table(row) for i, row in enumerate(unit)}
        count += len(unit)
    reached, tangents = forward(tape, program, values, seeds)
    outputs = {name: tape.split(number) for name, number in reached.items()}
    zero = tape.number(0.0)
    n = len(outputs[output])
    slopes = {d: tape.split(number) for d, number in tangents[output].items()}
    for derivative, name in by.items():
        outputs[derivative] = [
            slopes[d][i] if d in slopes else zero for i in range(n) for d in directions[name]
        ]
    # in the order of their names, as those of `read`
    return tape.program({name: outputs[name] for name in sorted(outputs)})


def forward(
    tape: Tape, program: Program, inputs: Mapping[str, int], tangents: Mapping[str, Tangents]
) -> tuple[dict[str, int], dict[str, Tangents]]:
    """A program written onto a tape together with its derivatives along some directions.

    Args:
        tape: the tape.
        program: the program.
        inputs: the nodes of the tape that are its inputs.
        tangents: derivatives of these inputs.

    Returns:
        The nodes of its outputs, and their derivatives.
    """
    writer = _Forward(tape, program, inputs, tangents)
    values, slopes = [], []
    for node in program.nodes:
        value, slope = writer.node(node, [values[a] for a in node.args],
                                   [slopes[a] for a in node.args])  # fmt: skip
        values.append(value)
        slopes.append(slope)
    ends = program.outputs.items()
    return {name: values[i] for name, i in ends}, {name: slopes[i] for name, i in ends}


@dataclass(frozen=True)
class _Forward:
    tape: Tape
    program: Program
    inputs: Mapping[str, int]
    tangents: Mapping[str, Tangents]

    def node(
        self, node: Node, args: Sequence[int], slopes: Sequence[Tangents]
    ) -> tuple[int, Tangents]:
        """The value of a node on the tape, and its derivatives."""
        tape = self.tape
        if node.op == "loop":
            return self._loop(node.data, args, slopes)
        value = tape.copied(self.program, node, args, self.inputs)
        match node.op:
            case "input":
                return value, dict(self.tangents.get(node.data, {}))
            case "number" | "table":
                return value, {}
            case "pick":
                picked = {d: tape.split(t)[node.data] for d, t in slopes[0].items()}
                return value, self._nonzero(picked)
            case "part":
                part = slice(node.data, node.data + node.size)
                cut = {d: tape.vector(tape.split(t)[part]) for d, t in slopes[0].items()}
                return value, self._nonzero(cut)
            case "join":
                each = list(zip(args, slopes, strict=True))
                return value, {
                    d: self._joined([s.get(d, self._zeros(a)) for a, s in each])
                    for d in _directions(slopes)
                }
            case "product":
                matrix = self.program.tables[node.data]
                return value, {d: self._product(matrix, t) for d, t in slopes[0].items()}
            case "layer":
                return value, {d: tape.layer(node.data, t) for d, t in slopes[0].items()}
        if OPERATIONS[node.op].truth or not any(slopes):
            return value, {}
        return value, self._operation(node, value, args, slopes)

    def _operation(
        self, node: Node, value: int, args: Sequence[int], slopes: Sequence[Tangents]
    ) -> Tangents:
        tape, zero = self.tape, self.tape.number(0.0)
        if node.op == "select":
            along = {
                d: tape.apply("select", args[0], *(s.get(d, zero) for s in slopes[1:]))
                for d in _directions(slopes[1:])
            }
            return {d: self._sized(t, node.size) for d, t in self._nonzero(along).items()}
        partials = [
            PARTIALS[node.op](tape, value, *args)[i] if slope else None
            for i, slope in enumerate(slopes)
        ]
        found: Tangents = {}
        for d in _directions(slopes):
            total: int | None = None
            for partial, slope in zip(partials, slopes, strict=True):
                if partial is None or d not in slope:
                    continue
                term = tape.apply("mul", partial, slope[d])
                total = term if total is None else tape.apply("add", total, term)
            if total is not None:
                found[d] = total
        return {d: self._sized(t, node.size) for d, t in self._nonzero(found).items()}

    def _product(self, matrix: np.ndarray, vector: int) -> int:
        """A matrix times a derivative, by columns where that has few entries."""
        tape = self.tape
        numbers = tape.split(vector)
        known = [tape.value(n) for n in numbers]
        if all(v is not None for v in known):
            return tape.table(matrix @ np.array(known, float))
        used = [i for i, v in enumerate(known) if v != 0.0]
        if len(used) > _FEW * len(numbers):
            return tape.product_vector(matrix, vector)
        total = tape.table(np.zeros(len(matrix)))
        for i in used:
            term = tape.apply("mul", tape.table(matrix[:, i].copy()), numbers[i])
            total = term if i == used[0] else tape.apply("add", total, term)
        return total

    def _loop(
        self, loop: Loop, args: Sequence[int], slopes: Sequence[Tangents]
    ) -> tuple[int, Tangents]:
        """A loop that carries the derivatives of what it carries along with it."""
        tape, names = self.tape, list(loop.body.inputs)
        first, last = loop.constants, loop.constants + loop.carried
        directions = _directions(slopes)
        if not directions:
            return tape.add(Node("loop", tuple(args), sum(loop.carried_sizes), loop)), {}
        # each vector that the body takes, its derivatives behind it; what is carried has all
        kinds: list[list[tuple[str, int, int]]] = []
        tangents: dict[str, dict[int, str]] = {name: {} for name in names}
        for place, (name, value, slope) in enumerate(zip(names, args, slopes, strict=True)):
            carried = first <= place < last
            size, part = loop.sizes[place], [(name, loop.sizes[place], value)]
            for d in directions if carried else slope:
                tangents[name][d] = f"{name}_by_{d}"
                part.append((f"{name}_by_{d}", size, slope.get(d, self._zeros(value))))
            kinds.append(part)
        constants = [x for part in kinds[:first] for x in part]
        own = [part[0] for part in kinds[first:last]]
        moved = [part[1 + k] for k in range(len(directions)) for part in kinds[first:last]]
        given = [x for part in kinds[last:] for x in part]
        every = [*constants, *own, *moved, *given]
        inner = Tape({name: size for name, size, _ in every})
        values = {name: inner.input_vector(name) for name in names}
        seeds = {
            name: {d: inner.input_vector(t) for d, t in tangents[name].items()} for name in names
        }
        reached, slope = forward(inner, loop.body, values, seeds)
        outputs = {name: inner.split(number) for name, number in reached.items()}
        for d in directions:
            for name, number in reached.items():
                nothing = [inner.number(0.0)] * inner[number].size
                ahead = slope[name].get(d)
                outputs[f"{name}_by_{d}"] = nothing if ahead is None else inner.split(ahead)
        body = inner.program(outputs)
        carried_count = len(own) + len(moved)
        together = Loop(body, loop.length, len(constants), carried_count)
        ends = tape.loop(together, [tape.split(number) for _, _, number in every])
        size = sum(loop.carried_sizes)
        return tape.vector(ends[:size]), {
            d: tape.vector(ends[(k + 1) * size : (k + 2) * size]) for k, d in enumerate(directions)
        }

    def _joined(self, numbers: Sequence[int]) -> int:
        return self.tape.vector([x for number in numbers for x in self.tape.split(number)])

    def _zeros(self, like: int) -> int:
        node = self.tape[like]
        zero = self.tape.number(0.0)
        return zero if node.single else self.tape.table(np.zeros(node.size))

    def _sized(self, number: int, size: int) -> int:
        """A derivative in the size of its node; a number that acts on a vector is repeated."""
        node = self.tape[number]
        return number if node.size == size else self.tape.vector([number] * size)

    def _nonzero(self, tangents: Tangents) -> Tangents:
        return {d: t for d, t in tangents.items() if not self._vanishes(t)}

    def _vanishes(self, number: int) -> bool:
        if self.tape[number].op == "table":
            return all(self.tape.value(x) == 0.0 for x in self.tape.split(number))
        return self.tape.value(number) == 0.0


def _directions(slopes: Sequence[Tangents]) -> list[int]:
    return sorted({d for slope in slopes for d in slope})


# --- partial derivatives of the operations: of (tape, value, *arguments), one an argument ---

Partials = Callable[..., tuple[int, ...]]


def _one(formula: Callable[[Tape, int, int], int]) -> Partials:
    """The rule of a function of one number, by its value and its argument."""
    return lambda tape, value, x: (formula(tape, value, x),)


def _square(tape: Tape, x: int) -> int:
    return tape.apply("mul", x, x)


def _over(tape: Tape, x: int) -> int:
    return tape.apply("div", tape.number(1.0), x)


def _plus(tape: Tape, x: int, constant: float) -> int:
    return tape.apply("add", x, tape.number(constant))


def _minus(tape: Tape, constant: float, x: int) -> int:
    return tape.apply("sub", tape.number(constant), x)


def _quotient(tape: Tape, value: int, a: int, b: int) -> tuple[int, ...]:
    inverse = _over(tape, b)
    return inverse, tape.apply("neg", tape.apply("mul", value, inverse))


def _larger(first: str) -> Partials:
    """The rule of max and min; where both are equal, half of each, as in JAX."""

    def rule(tape: Tape, value: int, a: int, b: int) -> tuple[int, ...]:
        one, half, zero = (tape.number(x) for x in (1.0, 0.5, 0.0))
        same, wins = tape.apply("eq", a, b), tape.apply(first, a, b)
        tie = tape.apply("select", same, half, zero)
        return (
            tape.apply("select", wins, one, tie),
            tape.apply("select", tape.apply("or", wins, same), tie, one),
        )

    return rule


def _side(tape: Tape, value: int, x: int) -> int:
    """The derivative of abs, 1 at 0, as in JAX."""
    above = tape.apply("ge", x, tape.number(0.0))
    return tape.apply("select", above, tape.number(1.0), tape.number(-1.0))


def _power(tape: Tape, value: int, a: int, b: int) -> tuple[int, ...]:
    zero = tape.number(0.0)
    base = tape.apply("mul", b, tape.apply("pow", a, _plus(tape, b, -1.0)))
    exponent = tape.apply("mul", value, tape.apply("log", a))
    return (
        tape.apply("select", tape.apply("eq", b, zero), zero, base),
        tape.apply("select", tape.apply("eq", a, zero), zero, exponent),
    )


def _remainder(tape: Tape, value: int, a: int, b: int) -> tuple[int, ...]:
    ratio = tape.apply("div", a, b)
    low, high = tape.apply("floor", ratio), tape.apply("ceil", ratio)
    whole = tape.apply("select", tape.apply("ge", ratio, tape.number(0.0)), low, high)
    return tape.number(1.0), tape.apply("neg", whole)


def _angle(tape: Tape, value: int, a: int, b: int) -> tuple[int, ...]:
    size = _over(tape, tape.apply("add", _square(tape, a), _square(tape, b)))
    return tape.apply("mul", b, size), tape.apply("neg", tape.apply("mul", a, size))


def _over_root(inside: Callable[[Tape, int], int], sign: float = 1.0) -> Partials:
    """The rule of inverse functions whose derivative is one over a root."""
    return _one(
        lambda tape, value, x: tape.apply(
            "div", tape.number(sign), tape.apply("sqrt", inside(tape, x))
        )
    )


PARTIALS: dict[str, Partials] = {
    "add": lambda tape, value, a, b: (tape.number(1.0), tape.number(1.0)),
    "sub": lambda tape, value, a, b: (tape.number(1.0), tape.number(-1.0)),
    "mul": lambda tape, value, a, b: (b, a),
    "div": _quotient,
    "neg": _one(lambda tape, value, x: tape.number(-1.0)),
    "max": _larger("gt"),
    "min": _larger("lt"),
    "pow": _power,
    "rem": _remainder,
    "atan2": _angle,
    "abs": _one(_side),
    "sign": _one(lambda tape, value, x: tape.number(0.0)),
    "floor": _one(lambda tape, value, x: tape.number(0.0)),
    "ceil": _one(lambda tape, value, x: tape.number(0.0)),
    "sqrt": _one(lambda tape, value, x: tape.apply("div", tape.number(0.5), value)),
    "exp": _one(lambda tape, value, x: value),
    "expm1": _one(lambda tape, value, x: _plus(tape, value, 1.0)),
    "log": _one(lambda tape, value, x: _over(tape, x)),
    "log1p": _one(lambda tape, value, x: _over(tape, _plus(tape, x, 1.0))),
    "sin": _one(lambda tape, value, x: tape.apply("cos", x)),
    "cos": _one(lambda tape, value, x: tape.apply("neg", tape.apply("sin", x))),
    "tan": _one(lambda tape, value, x: _plus(tape, _square(tape, value), 1.0)),
    "asin": _over_root(lambda tape, x: _minus(tape, 1.0, _square(tape, x))),
    "acos": _over_root(lambda tape, x: _minus(tape, 1.0, _square(tape, x)), -1.0),
    "atan": _one(lambda tape, value, x: _over(tape, _plus(tape, _square(tape, x), 1.0))),
    "sinh": _one(lambda tape, value, x: tape.apply("cosh", x)),
    "cosh": _one(lambda tape, value, x: tape.apply("sinh", x)),
    "tanh": _one(lambda tape, value, x: _minus(tape, 1.0, _square(tape, value))),
    "asinh": _over_root(lambda tape, x: _plus(tape, _square(tape, x), 1.0)),
    "acosh": _over_root(lambda tape, x: _plus(tape, _square(tape, x), -1.0)),
    "atanh": _one(lambda tape, value, x: _over(tape, _minus(tape, 1.0, _square(tape, x)))),
}
