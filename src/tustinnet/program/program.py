"""Programs: computations of numbers and vectors without JAX, such as a step of a model.

A program is a list of nodes in the order of computation. Most nodes are single numbers; layers of
networks are products of matrices and vectors, and operations after them act on whole vectors.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np


class Operation(NamedTuple):
    """An operation on single numbers, or on every number of vectors.

    Attributes:
        apply: its function in NumPy.
        truth: whether its value is true or false.
    """

    apply: Callable[..., Any]
    truth: bool = False


# all that a target has to support beside the nodes that move or multiply
OPERATIONS: dict[str, Operation] = {
    "add": Operation(np.add),
    "sub": Operation(np.subtract),
    "mul": Operation(np.multiply),
    "div": Operation(np.divide),
    "neg": Operation(np.negative),
    "max": Operation(np.maximum),
    "min": Operation(np.minimum),
    "pow": Operation(np.power),
    "rem": Operation(np.fmod),
    "atan2": Operation(np.arctan2),
    "abs": Operation(np.abs),
    "sign": Operation(np.sign),
    "floor": Operation(np.floor),
    "ceil": Operation(np.ceil),
    "sqrt": Operation(np.sqrt),
    "exp": Operation(np.exp),
    "expm1": Operation(np.expm1),
    "log": Operation(np.log),
    "log1p": Operation(np.log1p),
    "sin": Operation(np.sin),
    "cos": Operation(np.cos),
    "tan": Operation(np.tan),
    "asin": Operation(np.arcsin),
    "acos": Operation(np.arccos),
    "atan": Operation(np.arctan),
    "sinh": Operation(np.sinh),
    "cosh": Operation(np.cosh),
    "tanh": Operation(np.tanh),
    "asinh": Operation(np.arcsinh),
    "acosh": Operation(np.arccosh),
    "atanh": Operation(np.arctanh),
    "lt": Operation(np.less, truth=True),
    "le": Operation(np.less_equal, truth=True),
    "gt": Operation(np.greater, truth=True),
    "ge": Operation(np.greater_equal, truth=True),
    "eq": Operation(np.equal, truth=True),
    "ne": Operation(np.not_equal, truth=True),
    "and": Operation(np.logical_and, truth=True),
    "or": Operation(np.logical_or, truth=True),
    "not": Operation(np.logical_not, truth=True),
    "select": Operation(np.where),  # a condition, the value where it holds, the other value
}

PRODUCTS = ("product", "layer")  # matrices times vectors


class Factor(NamedTuple):
    """A matrix that a program is given, where it multiplies a vector.

    Attributes:
        name: its name.
        is_transposed: whether its transpose multiplies.
    """

    name: str
    is_transposed: bool = False


@dataclass(frozen=True)
class Node:
    """One value of a program.

    Attributes:
        op: a key of `OPERATIONS`, or one of
            `input`: a vector that the program is given, called `data`;
            `number`: the number `data`;
            `table`: the constant vector `Program.tables[data]`;
            `pick`: the number at `data` of a vector;
            `part`: `size` numbers of a vector from `data` on;
            `join`: vectors and numbers one after the other;
            `product`: the matrix `Program.tables[data]` times a vector;
            `layer`: a matrix that the program is given times a vector; `data` is a `Factor`;
            `loop`: a `Loop`, which is `data`; its value is all carried vectors at the end.
        args: the nodes that it is computed from. An operation takes vectors of its own size and
            single numbers, which act on all.
        size: how many numbers it has; more than 1 for vectors only.
        data: see `op`.
        truth: whether its value is true or false.
    """

    op: str
    args: tuple[int, ...] = ()
    size: int = 1
    data: Any = None
    truth: bool = False

    @property
    def is_single(self) -> bool:
        """Whether it is a number, not a vector."""
        return self.op in ("number", "pick") or (self.op in OPERATIONS and self.size == 1)

    def takes_truth(self, place: int) -> bool:
        """Whether an operation takes its argument at `place` as true or false, not as a number."""
        if self.op == "select":
            return place == 0 or self.truth
        return self.op in ("and", "or", "not")


@dataclass(frozen=True, eq=False)
class Loop:
    """A program that is run several times, each time with vectors that it carries on.

    The nodes that a loop is computed from are, in this order, the constants, the first values of
    the carried vectors, and the collected vectors of all turns, one turn after the other.

    Attributes:
        body: its inputs are the constants, the carried vectors and the collected vectors of one
            turn; its outputs are the carried vectors.
        length: the number of turns.
        constants: how many vectors are the same in every turn.
        carried: how many vectors are carried.
    """

    body: "Program"
    length: int
    constants: int
    carried: int

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of the body's inputs, in their order."""
        return tuple(self.body.inputs.values())

    def split(self, values: Sequence[Any]) -> tuple[list[Any], list[Any], list[Any]]:
        """Something of each input of the body, by constants, carried and collected vectors."""
        first, last = self.constants, self.constants + self.carried
        return list(values[:first]), list(values[first:last]), list(values[last:])

    @property
    def carried_sizes(self) -> tuple[int, ...]:
        """Sizes of the carried vectors."""
        return tuple(self.split(self.sizes)[1])


@dataclass(frozen=True, eq=False)
class Program:
    """A computation of vectors from vectors, as a list of nodes.

    Attributes:
        inputs: the vectors that it is given, and their sizes.
        nodes: in the order of computation.
        outputs: the vectors that it returns, by name: numbers of nodes.
        tables: constant vectors and matrices.
        matrices: the matrices that it is given, and their shapes.
    """

    inputs: dict[str, int]
    nodes: tuple[Node, ...]
    outputs: dict[str, int]
    tables: tuple[np.ndarray, ...]
    matrices: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    @cached_property
    def uses(self) -> tuple[int, ...]:
        """The number of uses of each node, by others and as output."""
        counts = [0] * len(self.nodes)
        for used in (*(a for node in self.nodes for a in node.args), *self.outputs.values()):
            counts[used] += 1
        return tuple(counts)

    def nodes_depending_on(self, name: str) -> set[int]:
        """The nodes that depend on an input."""
        nodes: set[int] = set()
        for i, node in enumerate(self.nodes):
            if (node.op == "input" and node.data == name) or not nodes.isdisjoint(node.args):
                nodes.add(i)
        return nodes

    def dependencies(self, output: str) -> list[frozenset[tuple[str, int]]]:
        """For every number of an output, the numbers of inputs that it depends on, by structure."""
        empty: frozenset[tuple[str, int]] = frozenset()
        return self._trace(output, lambda origin: frozenset([origin]), lambda *s: empty.union(*s))

    def copies(self, output: str, name: str) -> list[int | None]:
        """For every number of an output, the number of an input that it copies, if any."""
        return self._trace(
            output, lambda origin: origin[1] if origin[0] == name else None, lambda *_: None
        )

    def _trace(
        self, output: str, start: Callable[[tuple[str, int]], Any], combine: Callable[..., Any]
    ) -> list[Any]:
        """For every number of an output, what follows from the numbers that it is computed from.

        Args:
            output: its name.
            start: the value of a number of an input, from the input's name and the place there.
            combine: the value of a number from those that it is computed from.
        """
        by_node: list[list[Any]] = []
        for node in self.nodes:
            args = [by_node[a] for a in node.args]
            match node.op:
                case "input":
                    numbers = [start((node.data, i)) for i in range(node.size)]
                case "pick":
                    numbers = [args[0][node.data]]
                case "part":
                    numbers = args[0][node.data : node.data + node.size]
                case "join":
                    numbers = [number for arg in args for number in arg]
                case "product" | "layer" | "loop":
                    numbers = [combine(*(number for arg in args for number in arg))] * node.size
                case _:  # number by number; single ones act on all
                    numbers = [
                        combine(*(arg[i if len(arg) > 1 else 0] for arg in args))
                        for i in range(node.size)
                    ]
            by_node.append(numbers)
        return by_node[self.outputs[output]]

    @property
    def loops(self) -> Iterator[Loop]:
        """The loops of the program, without those inside of them."""
        return (node.data for node in self.nodes if node.op == "loop")

    @cached_property
    def executed(self) -> int:
        """The number of nodes that are computed, those of loops in every turn."""
        return len(self.nodes) + sum(loop.length * loop.body.executed for loop in self.loops)

    @cached_property
    def operations(self) -> int:
        """The number of operations on numbers and vectors written in it, loops included."""
        outside = sum(node.op in OPERATIONS or node.op in PRODUCTS for node in self.nodes)
        return outside + sum(loop.body.operations for loop in self.loops)
