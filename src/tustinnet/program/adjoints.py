"""Derivatives of programs in reverse: of one number by all that it depends on.

The output of a program is weighted with an adjoint, the derivative of some loss by it. From the
end of the program to its beginning, every node adds to the adjoints of what it is computed from.
What this costs is a few times the program, however many numbers there are to differentiate by.

References:
    Griewank, Walther (2008), Evaluating Derivatives, section 3.2 (reverse mode).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tustinnet.program.derivatives import PARTIALS
from tustinnet.program.program import OPERATIONS, Factor, Loop, Node, Program
from tustinnet.program.tape import Tape

ADJOINT = "adjoint"  # the input that weights the output


@dataclass(frozen=True)
class Adjoints:
    """A program in reverse.

    Attributes:
        program: of the inputs of the program and of `adjoint`: the adjoint `by_NAME` of every
            input that was asked for; of each place `i` where a layer acts, its vector `in_i` and
            the adjoint of its product, `out_i`. The gradient of a matrix is the sum of the
            products `out_i in_i'` over the places where it acts.
        layers: the name of the matrix that acts at each place.
    """

    program: Program
    layers: tuple[str, ...]


def with_adjoints(
    program: Program, output: str, by: Sequence[str], *, value: bool = False
) -> Adjoints:
    """The adjoints of a program's inputs and layers.

    Args:
        program: the program; its loops are written out.
        output: the output that is weighted, (n,).
        by: the inputs that are differentiated by.
        value: whether the output itself is returned, too.
    """
    size = program.nodes[program.outputs[output]].size
    tape = Tape({**program.inputs, ADJOINT: size}, program.matrices)
    inputs = {name: tape.input_vector(name) for name in program.inputs}
    reached = _written_out(tape, program, inputs)[output]
    backward = _Backward(tape, [inputs[name] for name in by], reached)
    backward.run(reached, tape.input_vector(ADJOINT))
    outputs = {f"by_{name}": tape.split(backward.adjoint(inputs[name])) for name in by}
    for i, (_, vector, adjoint) in enumerate(backward.layers):
        outputs |= {f"in_{i}": tape.split(vector), f"out_{i}": tape.split(adjoint)}
    if value:
        outputs[output] = tape.split(reached)
    names = tuple(factor.name for factor, _, _ in backward.layers)
    return Adjoints(tape.program(outputs), names)


def _written_out(tape: Tape, program: Program, inputs: dict[str, int]) -> dict[str, int]:
    """A program on a tape, its loops turn by turn; the nodes of its outputs."""
    values: list[int] = []
    for node in program.nodes:
        args = [values[a] for a in node.args]
        if node.op == "loop":
            values.append(_turns(tape, node.data, args))
        else:
            values.append(tape.copied(program, node, args, inputs))
    return {name: values[i] for name, i in program.outputs.items()}


def _turns(tape: Tape, loop: Loop, args: list[int]) -> int:
    """All turns of a loop on a tape; the node of what it carries at the end."""
    first, last = loop.constants, loop.constants + loop.carried
    constants, carried, given = args[:first], args[first:last], args[last:]
    rows = [np.split(np.array(tape.split(row)), loop.length) for row in given]
    for turn in range(loop.length):
        now = [tape.vector(row[turn]) for row in rows]
        inputs = dict(zip(loop.body.inputs, [*constants, *carried, *now], strict=True))
        carried = list(_written_out(tape, loop.body, inputs).values())
    return tape.vector([x for vector in carried for x in tape.split(vector)])


@dataclass
class _Partial:
    """What has been added to the adjoint of a node so far: to all of it, and number by number."""

    whole: int | None = None
    numbers: dict[int, int] = field(default_factory=dict)


class _Backward:
    """Goes over a tape from its end to its beginning.

    Attributes:
        layers: each layer that was passed, its vector, the adjoint of its product.
    """

    def __init__(self, tape: Tape, by: Sequence[int], end: int) -> None:
        self._tape = tape
        self._sums: dict[int, _Partial] = {}
        self.layers: list[tuple[Factor, int, int]] = []
        # only what depends on what is differentiated by has an adjoint; weights always do
        self._depends: list[bool] = []
        wanted = set(by)
        for number in range(end + 1):
            node = tape[number]
            active = number in wanted or node.op == "layer"
            self._depends.append(active or any(self._depends[a] for a in node.args))

    def adjoint(self, number: int) -> int:
        """The adjoint of a node, as far as it has been added up: a node of the same size."""
        tape, size = self._tape, self._tape[number].size
        partial = self._sums.get(number, _Partial())
        total = partial.whole
        if partial.numbers:
            zero = tape.number(0.0)
            joined = tape.vector([partial.numbers.get(i, zero) for i in range(size)])
            total = joined if total is None else tape.apply("add", total, joined)
        if total is None:
            return self._zeros(number)
        return total

    def run(self, end: int, adjoint: int) -> None:
        """Adds up the adjoints of all nodes, from that of the last."""
        self._add(end, adjoint)
        for number in range(end, -1, -1):
            if self._depends[number] and number in self._sums:
                self._pass_on(self._tape[number], number, self.adjoint(number))

    def _pass_on(self, node: Node, value: int, adjoint: int) -> None:
        """What a node adds to the adjoints of what it is computed from."""
        tape = self._tape
        match node.op:
            case "input":
                return
            case "pick":
                self._add_numbers(node.args[0], {node.data: adjoint})
            case "part":
                parts = enumerate(tape.split(adjoint), node.data)
                self._add_numbers(node.args[0], dict(parts))
            case "join":
                numbers, first = tape.split(adjoint), 0
                for a in node.args:
                    size = tape[a].size
                    self._add(a, tape.vector(numbers[first : first + size])
                              if size > 1 else numbers[first])  # fmt: skip
                    first += size
            case "product":
                matrix = tape.matrix(node.data)
                self._add(node.args[0], tape.product_vector(matrix.T.copy(), adjoint))
            case "layer":
                factor, vector = node.data, node.args[0]
                # a matrix that is used turned has its vector and its product change places
                pair = (adjoint, vector) if factor.transposed else (vector, adjoint)
                self.layers.append((factor, *pair))
                turned = Factor(factor.name, not factor.transposed)
                if self._depends[vector]:
                    self._add(vector, tape.layer(turned, adjoint))
            case _:
                self._pass_operation_on(node, value, adjoint)

    def _pass_operation_on(self, node: Node, value: int, adjoint: int) -> None:
        tape, args = self._tape, node.args
        if OPERATIONS[node.op].truth:
            return
        if node.op == "select":
            zero = tape.number(0.0)
            self._add(args[1], tape.apply("select", args[0], adjoint, zero))
            self._add(args[2], tape.apply("select", args[0], zero, adjoint))
            return
        partials = PARTIALS[node.op](tape, value, *args)
        for a, partial in zip(args, partials, strict=True):
            self._add(a, tape.apply("mul", partial, adjoint))

    def _add(self, number: int, term: int) -> None:
        """A term of the adjoint of a node; of a number that acts on a vector, the sum."""
        tape = self._tape
        if not self._depends[number] or tape.value(term) == 0.0:
            return
        size = tape[number].size
        if tape[term].size > 1 and size == 1:
            total, *others = tape.split(term)
            for other in others:
                total = tape.apply("add", total, other)
            term = total
        elif tape[term].size < size:
            term = tape.vector([term] * size)
        partial = self._sums.setdefault(number, _Partial())
        partial.whole = term if partial.whole is None else tape.apply("add", partial.whole, term)

    def _add_numbers(self, number: int, terms: dict[int, int]) -> None:
        """Terms of some numbers of a node's adjoint."""
        if not self._depends[number]:
            return
        known = self._sums.setdefault(number, _Partial()).numbers
        for i, term in terms.items():
            known[i] = self._tape.apply("add", known[i], term) if i in known else term

    def _zeros(self, like: int) -> int:
        node = self._tape[like]
        return self._tape.number(0.0) if node.single else self._tape.table(np.zeros(node.size))
