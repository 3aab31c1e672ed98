"""Derivatives of programs in reverse mode: of one number by all inputs that it depends on.

The output of a program is weighted with an adjoint, the derivative of some loss by it. From the
end of the program to its beginning, every node adds to the adjoints of its arguments. The cost is a
few times that of the program, however many numbers there are to differentiate by.

References:
    Griewank, Walther (2008), Evaluating Derivatives, section 3.2 (reverse mode).
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tustinnet.program.derivatives import partial_derivatives
from tustinnet.program.program import OPERATIONS, Factor, Loop, Node, Program
from tustinnet.program.tape import Tape

ADJOINT = "adjoint"  # the input that weights the output


@dataclass(frozen=True)
class Adjoints:
    """A program in reverse, and the layers that it passes.

    Attributes:
        program: from the inputs of the program and `adjoint` to the adjoint `by_NAME` of every
            input that is differentiated by, and for each place `i` where a layer acts to its vector
            `in_i` and the adjoint of its product, `out_i`. The gradient of a matrix is the sum of
            the products `out_i in_i'` over the places where it acts.
        layers: the name of the matrix that acts at each place.
    """

    program: Program
    layers: tuple[str, ...]


def with_adjoints(
    program: Program, output: str, by: Sequence[str], *, value: bool = False
) -> Adjoints:
    """Adjoints of a program's inputs and layers.

    Args:
        program: the program; its loops are written out.
        output: the output that is weighted, (n,).
        by: the inputs that are differentiated by.
        value: whether the output itself is returned, too.
    """
    size = program.nodes[program.outputs[output]].size
    tape = Tape({**program.inputs, ADJOINT: size}, program.matrices)
    inputs = {name: tape.input(name) for name in program.inputs}
    end = _unroll(tape, program, inputs)[output]
    backward = _Backward(tape, [inputs[name] for name in by], end)
    backward.run(end, tape.input(ADJOINT))
    outputs = {f"by_{name}": tape.split(backward.adjoint(inputs[name])) for name in by}
    for i, (_, vector, adjoint) in enumerate(backward.layers):
        outputs |= {f"in_{i}": tape.split(vector), f"out_{i}": tape.split(adjoint)}
    if value:
        outputs[output] = tape.split(end)
    names = tuple(factor.name for factor, _, _ in backward.layers)
    return Adjoints(tape.program(outputs), names)


def _unroll(tape: Tape, program: Program, inputs: dict[str, int]) -> dict[str, int]:
    """Writes a program onto a tape, its loops turn by turn; the nodes of its outputs."""
    values: list[int] = []
    for node in program.nodes:
        args = [values[a] for a in node.args]
        if node.op != "loop":
            values.append(tape.copy_node(program, node, args, inputs))
            continue
        loop: Loop = node.data
        constants, carried, collected = loop.split(args)
        rows = [np.split(np.array(tape.split(vector)), loop.length) for vector in collected]
        for turn in range(loop.length):
            now = [tape.vector(row[turn]) for row in rows]
            arguments = dict(zip(loop.body.inputs, [*constants, *carried, *now], strict=True))
            carried = list(_unroll(tape, loop.body, arguments).values())
        values.append(tape.vector([x for vector in carried for x in tape.split(vector)]))
    return {name: values[i] for name, i in program.outputs.items()}


@dataclass
class _PartialSum:
    """Terms added to the adjoint of a node so far: to all of it, and number by number."""

    whole: int | None = None
    numbers: dict[int, int] = field(default_factory=dict)


class _Backward:
    """A walk over a tape from its end to its beginning, which adds up adjoints.

    Attributes:
        layers: each layer that the walk passed, its vector, the adjoint of its product.
    """

    def __init__(self, tape: Tape, by: Sequence[int], end: int) -> None:
        self._tape = tape
        self._sums: defaultdict[int, _PartialSum] = defaultdict(_PartialSum)
        self.layers: list[tuple[Factor, int, int]] = []
        # only nodes that depend on inputs that are differentiated by have an adjoint, and layers
        self._depends: list[bool] = []
        inputs = set(by)
        for number in range(end + 1):
            node = tape[number]
            is_active = number in inputs or node.op == "layer"
            self._depends.append(is_active or any(self._depends[a] for a in node.args))

    def adjoint(self, number: int) -> int:
        """The adjoint of a node, as far as it has been added up: a node of the same size."""
        tape, size = self._tape, self._tape[number].size
        partial = self._sums.get(number, _PartialSum())  # not added where there is none
        total = partial.whole
        if partial.numbers:
            zero = tape.number(0.0)
            joined = tape.vector([partial.numbers.get(i, zero) for i in range(size)])
            total = joined if total is None else tape.apply("add", total, joined)
        if total is None:
            is_single = tape[number].is_single
            return tape.number(0.0) if is_single else tape.table(np.zeros(size))
        return total

    def run(self, end: int, adjoint: int) -> None:
        """Adds up the adjoints of all nodes, from that of the last."""
        self._add(end, adjoint)
        for number in range(end, -1, -1):
            if self._depends[number] and number in self._sums:
                self._pass_on(self._tape[number], number, self.adjoint(number))

    def _pass_on(self, node: Node, value: int, adjoint: int) -> None:
        """Adds the terms of a node to the adjoints of its arguments."""
        tape = self._tape
        match node.op:
            case "input":
                pass
            case "pick":
                self._add_numbers(node.args[0], {node.data: adjoint})
            case "part":
                parts = enumerate(tape.split(adjoint), node.data)
                self._add_numbers(node.args[0], dict(parts))
            case "join":
                numbers, first = tape.split(adjoint), 0
                for a in node.args:
                    size = tape[a].size
                    self._add(
                        a,
                        tape.vector(numbers[first : first + size]) if size > 1 else numbers[first],
                    )
                    first += size
            case "product":
                matrix = tape.matrix(node.data)
                self._add(node.args[0], tape.product(matrix.T.copy(), adjoint))
            case "layer":
                factor, vector = node.data, node.args[0]
                # where the transpose of a matrix multiplies, vector and product change places
                pair = (adjoint, vector) if factor.is_transposed else (vector, adjoint)
                self.layers.append((factor, *pair))
                transpose = Factor(factor.name, not factor.is_transposed)
                if self._depends[vector]:
                    self._add(vector, tape.layer(transpose, adjoint))
            case "select":
                which, first, other = node.args
                zero = tape.number(0.0)
                self._add(first, tape.apply("select", which, adjoint, zero))
                self._add(other, tape.apply("select", which, zero, adjoint))
            case op if not OPERATIONS[op].truth:
                partials = partial_derivatives(tape, op, value, node.args)
                for a, partial in zip(node.args, partials, strict=True):
                    self._add(a, tape.apply("mul", partial, adjoint))

    def _add(self, number: int, term: int) -> None:
        """Adds a term to the adjoint of a node; for a number that acts on a vector, its sum."""
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
        partial = self._sums[number]
        partial.whole = term if partial.whole is None else tape.apply("add", partial.whole, term)

    def _add_numbers(self, number: int, terms: dict[int, int]) -> None:
        """Adds terms to some numbers of a node's adjoint."""
        if not self._depends[number]:
            return
        sums = self._sums[number].numbers
        for i, term in terms.items():
            sums[i] = self._tape.apply("add", sums[i], term) if i in sums else term
