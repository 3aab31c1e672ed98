"""The tape: a program while it is written."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from tustinnet.program.program import OPERATIONS, Factor, Loop, Node, Program

LONG_VECTOR = 8  # numbers from which a vector is treated as one value

Ids = Sequence[int] | np.ndarray


@dataclass
class Tape:
    """A program while it is written: equal nodes are computed once, constants while writing.

    Attributes:
        inputs: its input vectors, and their sizes.
        matrices: its input matrices, and their shapes.
    """

    inputs: dict[str, int]
    matrices: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    _nodes: list[Node] = field(default_factory=list)
    _numbers: dict[Node, int] = field(default_factory=dict)
    _tables: list[np.ndarray] = field(default_factory=list)
    _table_indices: dict[tuple[Any, ...], int] = field(default_factory=dict)

    def __getitem__(self, number: int) -> Node:
        return self._nodes[number]

    def add(self, node: Node) -> int:
        """The number of a node, an old one where there is an equal node already."""
        number = self._numbers.setdefault(node, len(self._nodes))
        if number == len(self._nodes):
            self._nodes.append(node)
        return number

    def input(self, name: str) -> int:
        """The node of an input, a vector."""
        return self.add(Node("input", size=self.inputs[name], data=name))

    def number(self, value: float | bool) -> int:
        """The node of a constant; 0.0 and -0.0 are different constants."""
        truth = isinstance(value, bool | np.bool_)
        data = bool(value) if truth else float(value)
        # as nodes are compared by ==, by which 0.0 is -0.0 and True is 1.0
        return self.add(Node("number", data=_Exact(data), truth=truth))

    def value(self, number: int) -> float | bool | None:
        """The value of a node that is a constant number; None of others."""
        node = self._nodes[number]
        return node.data.value if node.op == "number" else None

    def depends(self, ids: Ids, inputs: Collection[str]) -> bool:
        """Whether some nodes depend on one of some inputs."""
        open_nodes, visited = {int(i) for i in ids} if inputs else set(), set[int]()
        while open_nodes:
            number = open_nodes.pop()
            node = self._nodes[number]
            if node.op == "input" and node.data in inputs:
                return True
            visited.add(number)
            open_nodes |= set(node.args) - visited
        return False

    def split(self, number: int) -> list[int]:
        """The single numbers of a vector."""
        node = self._nodes[number]
        if node.op == "table":
            return [self.number(value) for value in self._tables[node.data].tolist()]
        if node.op == "join":
            return [x for part in node.args for x in self.split(part)]
        if node.op == "part":
            return self.split(node.args[0])[node.data : node.data + node.size]
        if node.is_single:
            return [number]
        return [self.add(Node("pick", (number,), 1, i, truth=node.truth)) for i in range(node.size)]

    def pick(self, number: int, index: int) -> int:
        """One of the single numbers of a vector; of a long constant one no other is written."""
        node = self._nodes[number]
        if node.op == "table":
            return self.number(self._tables[node.data][index].item())
        return self.split(number)[index]

    def vector(self, ids: Ids) -> int:
        """The node of a vector of single numbers: the vector that they are already, if they are."""
        ids = [int(i) for i in ids]
        values = [self.value(i) for i in ids]
        if all(value is not None for value in values):
            return self.table(np.array(values))
        pieces = list(self._pieces(ids))
        if len(pieces) == 1 and not self._nodes[pieces[0]].is_single:
            return pieces[0]
        return self.add(Node("join", tuple(pieces), len(ids), truth=self._nodes[pieces[0]].truth))

    def _pieces(self, ids: list[int]) -> Iterator[int]:
        """Nodes of numbers in order; parts of a vector where they follow one another in it."""
        first = 0
        while first < len(ids):
            last, node = first + 1, self._nodes[ids[first]]
            if node.op == "pick":
                while last < len(ids) and self._follows(ids[last - 1], ids[last]):
                    last += 1
            count = last - first
            if node.op == "pick" and count == self._nodes[node.args[0]].size:
                yield node.args[0]
            elif count > 1:
                yield self.add(Node("part", node.args, count, node.data, truth=node.truth))
            else:
                yield ids[first]
            first = last

    def _follows(self, before: int, after: int) -> bool:
        a, b = self._nodes[before], self._nodes[after]
        return b.op == "pick" and b.args == a.args and b.data == a.data + 1

    def is_vector(self, ids: Ids) -> bool:
        """Whether numbers stand one after the other in a long vector, which is one node."""
        first = self._nodes[int(ids[0])]
        return (
            len(ids) >= LONG_VECTOR
            and first.op == "pick"
            and all(self._follows(int(a), int(b)) for a, b in pairwise(ids))
        )

    def table(self, values: np.ndarray) -> int:
        """The node of a constant vector."""
        return self.add(
            Node("table", (), len(values), self._table_index(values), values.dtype == bool)
        )

    def product(self, matrix: np.ndarray, vector: int) -> int:
        """The node of a constant matrix, (rows, columns), times a vector node, (columns,)."""
        return self.add(Node("product", (vector,), len(matrix), self._table_index(matrix)))

    def matrix(self, number: int) -> np.ndarray:
        """The constant matrix of that number in nodes of products."""
        return self._tables[number]

    def layer(self, factor: Factor, vector: int) -> int:
        """The node of an input matrix times a vector node."""
        rows, columns = self.matrices[factor.name]
        size = columns if factor.is_transposed else rows
        return self.add(Node("layer", (vector,), size, factor))

    def _table_index(self, values: np.ndarray) -> int:
        key = values.shape, values.dtype.kind, values.tobytes()
        if key not in self._table_indices:
            self._table_indices[key] = len(self._tables)
            self._tables.append(values)
        return self._table_indices[key]

    def copy_node(
        self, program: Program, node: Node, args: Sequence[int], inputs: Mapping[str, int]
    ) -> int:
        """A copy of a node of another program on this tape; not of a loop.

        Args:
            program: that program.
            node: the node.
            args: the nodes of this tape that it is computed from.
            inputs: the nodes of this tape that are the inputs of that program.
        """
        match node.op:
            case "input":
                return inputs[node.data]
            case "number":
                return self.number(node.data)
            case "table":
                return self.table(program.tables[node.data])
            case "pick":
                return self.pick(args[0], node.data)
            case "part":
                return self.vector(self.split(args[0])[node.data : node.data + node.size])
            case "join":
                return self.vector([x for a in args for x in self.split(a)])
            case "product":
                return self.product(program.tables[node.data], args[0])
            case "layer":
                return self.layer(node.data, args[0])
        return self.apply(node.op, *args)

    def loop(self, loop: Loop, args: Sequence[Ids]) -> list[int]:
        """The numbers of the vectors that a loop carries, at its end."""
        vectors = tuple(self.vector(ids) for ids in args)
        return self.split(self.add(Node("loop", vectors, sum(loop.carried_sizes), loop)))

    def apply(self, op: str, *args: int) -> int:
        """The node of an operation on single numbers, or on vectors of one size."""
        values = [self.value(a) for a in args]
        if all(value is not None for value in values):
            with np.errstate(all="ignore"):
                return self.number(OPERATIONS[op].apply(*values).item())
        simplified = self._simplify(op, args, values)
        if simplified is not None:
            return simplified
        size = max(self._nodes[a].size for a in args)
        truth = OPERATIONS[op].truth
        if op == "select":
            truth = self._nodes[args[1]].truth
        if op in ("add", "mul", "max", "min"):
            args = tuple(sorted(args))
        return self.add(Node(op, tuple(args), size, truth=truth))

    def _simplify(self, op: str, args: Sequence[int], values: Sequence[Any]) -> int | None:
        """A node equal to an operation, without the operation; factors of 0 give 0."""
        match op, values:
            case ("add", [0.0, _]) | ("mul", [1.0, _]):
                return args[1]
            case ("add", [_, 0.0]) | ("sub", [_, 0.0]) | ("mul", [_, 1.0]) | ("div", [_, 1.0]):
                return args[0]
            case ("mul", [0.0, _]) | ("mul", [_, 0.0]) | ("div", [0.0, _]):
                return self.number(0.0)
            case ("sub", [0.0, _]):
                return self.apply("neg", args[1])
            case ("mul", [-1.0, _]):
                return self.apply("neg", args[1])
            case ("mul", [_, -1.0]):
                return self.apply("neg", args[0])
            # a factorisation divides several numbers by the same root: one reciprocal serves all
            case ("div", _) if self._nodes[args[1]].op == "sqrt" and values[0] != 1.0:
                return self.apply("mul", args[0], self.apply("div", self.number(1.0), args[1]))
            case ("neg", _) if self._nodes[args[0]].op == "neg":
                return self._nodes[args[0]].args[0]
            case ("select", [True, *_]):
                return args[1]
            case ("select", [False, *_]):
                return args[2]
            case ("select", _) if args[1] == args[2]:
                return args[1]
        return None

    def program(self, outputs: Mapping[str, Ids]) -> Program:
        """The program that returns some vectors, without nodes that they do not need."""
        ends = {name: self.vector(ids) for name, ids in outputs.items()}
        needed = set(ends.values())
        for number in range(len(self._nodes) - 1, -1, -1):
            if number in needed:
                needed |= set(self._nodes[number].args)
        order = [self._nodes[number] for number in sorted(needed)]
        place = {number: i for i, number in enumerate(sorted(needed))}
        used = sorted({node.data for node in order if node.op in ("table", "product")})
        nodes = []
        for node in order:
            data = node.data
            if node.op in ("table", "product"):
                data = used.index(data)
            elif node.op == "number":
                data = data.value
            args = tuple(place[a] for a in node.args)
            nodes.append(Node(node.op, args, node.size, data, node.truth))
        tables = tuple(self._tables[i] for i in used)
        returned = {name: place[number] for name, number in ends.items()}
        return Program(dict(self.inputs), tuple(nodes), returned, tables, dict(self.matrices))


@dataclass(frozen=True)
class _Exact:
    """A constant that equals only constants with the same bits."""

    value: float | bool

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Exact) and repr(self.value) == repr(other.value)

    def __hash__(self) -> int:
        return hash(repr(self.value))


@dataclass(frozen=True, eq=False)
class NodeTerm:
    """A node of a tape in a formula: operators and `apply` write further nodes.

    Attributes:
        tape: the tape.
        number: the number of the node.
    """

    tape: Tape
    number: int

    def apply(self, op: str, *others: "NodeTerm | float") -> "NodeTerm":
        """An operation on this node and others, or numbers, in this order."""
        operands = (
            other.number if isinstance(other, NodeTerm) else self.tape.number(other)
            for other in others
        )
        return NodeTerm(self.tape, self.tape.apply(op, self.number, *operands))

    def choose(self, first: "NodeTerm | float", other: "NodeTerm | float") -> "NodeTerm":
        """The first of two values where this node is true, else the other."""
        return self.apply("select", first, other)

    def constant(self, value: float) -> "NodeTerm":
        """A constant on the same tape."""
        return NodeTerm(self.tape, self.tape.number(value))

    def __add__(self, other: "NodeTerm | float") -> "NodeTerm":
        return self.apply("add", other)

    def __sub__(self, other: "NodeTerm | float") -> "NodeTerm":
        return self.apply("sub", other)

    def __rsub__(self, other: float) -> "NodeTerm":
        return self.constant(other) - self

    def __mul__(self, other: "NodeTerm | float") -> "NodeTerm":
        return self.apply("mul", other)

    def __truediv__(self, other: "NodeTerm | float") -> "NodeTerm":
        return self.apply("div", other)

    def __rtruediv__(self, other: float) -> "NodeTerm":
        return self.constant(other) / self

    def __neg__(self) -> "NodeTerm":
        return self.apply("neg")
