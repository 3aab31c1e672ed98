"""Programs written in LLVM's language, operation by operation, with one value for all lanes."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tustinnet.engine import functions
from tustinnet.engine.text import Function, Module
from tustinnet.program.program import Factor, Loop, Node, Program
from tustinnet.program.tape import LONG_VECTOR

_ROWS = 4  # of a matrix that are multiplied at once: their sums stay in registers
_LITERAL = 16  # whole numbers up to this stand in the code, others among the constants


@dataclass
class Constants:
    """The numbers of programs that stand in memory.

    Models that differ in nothing else share their machine code.

    Attributes:
        numbers: the numbers.
        layers: places of the weights of layers that are given, as `blocked_layout` has them.
    """

    numbers: list[float] = field(default_factory=list)
    layers: dict[Factor, int] = field(default_factory=dict)
    _places: dict[bytes, int] = field(default_factory=dict)

    def place(self, values: np.ndarray) -> int:
        """The place of an array among the numbers; the same array stands there once."""
        key = np.ascontiguousarray(values, np.float64).tobytes()
        if key not in self._places:
            self._places[key] = len(self.numbers)
            self.numbers += np.ravel(values).astype(float).tolist()
        return self._places[key]

    def layer(self, factor: Factor, size: int) -> int:
        """The place of the weights of a layer that is given, so many of them."""
        if factor not in self.layers:
            self.layers[factor] = len(self.numbers)
            self.numbers += [0.0] * size
        return self.layers[factor]


def blocked_layout(matrix: np.ndarray) -> np.ndarray:
    """The numbers of a matrix in the order in which they are multiplied.

    Some rows at once, column by column; the remaining rows behind them likewise.
    """
    rows, columns = matrix.shape
    whole = rows // _ROWS * _ROWS
    blocks = matrix[:whole].reshape(-1, _ROWS, columns).swapaxes(1, 2)
    return np.concatenate([blocks.ravel(), matrix[whole:].T.ravel()])


@dataclass(frozen=True)
class Number:
    """A single number, or a truth, by its name in the code."""

    name: str
    truth: bool = False


@dataclass(frozen=True)
class Vector:
    """A vector by its numbers, or by their place in memory.

    Attributes:
        size: how many numbers.
        numbers: its numbers, where each has been computed by itself.
        pointer: memory in which they stand one after the other, a value each.
        table: the place of the first of them, where they are constants.
    """

    size: int
    numbers: tuple[Number, ...] | None = None
    pointer: str | None = None
    table: int | None = None


Value = Number | Vector


class Emission:
    """Writes a program into a function.

    Attributes:
        function: the function.
        program: the program.
        inputs: the place of each input in memory.
        constants: the numbers that stand in memory.
        pointer: the place of these.
    """

    def __init__(
        self,
        function: Function,
        program: Program,
        inputs: Mapping[str, str],
        constants: Constants,
        pointer: str,
    ) -> None:
        self.function, self.program, self.inputs = function, program, inputs
        self.constants, self.pointer = constants, pointer
        self.module: Module = function.module
        self._values: dict[int, Value] = {}
        self._pairs: dict[str, tuple[str, str]] = {}
        self._elements: dict[tuple[str, int], Number] = {}

    def outputs(self) -> dict[str, tuple[Number, ...]]:
        """The numbers of every output, after their code is written."""
        return {name: self.numbers(value) for name, value in self.values().items()}

    def values(self) -> dict[str, Value]:
        """The value of every output, after its code is written."""
        self.compute(i for i in range(len(self.program.nodes)) if i not in self._values)
        return {name: self._values[i] for name, i in self.program.outputs.items()}

    def compute(self, nodes: Iterable[int]) -> None:
        """Writes the code of some of the nodes, in their order; those that they need are there."""
        for i in nodes:
            node = self.program.nodes[i]
            self._values[i] = self._node(node, [self._values[a] for a in node.args])

    def numbers(self, value: Value) -> tuple[Number, ...]:
        """The single numbers of a value."""
        if isinstance(value, Number):
            return (value,)
        return tuple(self._element(value, i) for i in range(value.size))

    def _node(self, node: Node, args: list[Any]) -> Value:
        match node.op:
            case "input":
                return Vector(node.size, pointer=self.inputs[node.data])
            case "number":
                return self._constant(node.data)
            case "table":
                values = self.program.tables[node.data]
                return Vector(node.size, table=self.constants.place(values))
            case "pick":
                return self._element(args[0], node.data)
            case "part":
                return self._part(args[0], node.data, node.size)
            case "join":
                return Vector(node.size, tuple(x for a in args for x in self.numbers(a)))
            case "product":
                matrix = self.program.tables[node.data]
                return self._product(
                    self.constants.place(blocked_layout(matrix)), matrix.shape, args[0]
                )
            case "layer":
                columns = args[0].size if isinstance(args[0], Vector) else 1
                first = self.constants.layer(node.data, node.size * columns)
                return self._product(first, (node.size, columns), args[0])
            case "loop":
                return self._loop(node.data, args)
        if node.size == 1 and not any(isinstance(a, Vector) for a in args):
            return self._operation(node.op, args, node.truth)
        return self._elementwise(node, args)

    def _constant(self, value: float | bool) -> Number:
        if isinstance(value, bool):
            return Number(self.module.constant("i1", "true" if value else "false"), truth=True)
        whole = abs(value) <= _LITERAL and value * 2 == round(value * 2)
        if whole or value != value:
            return Number(self.module.number(value))
        return Number(self._from_table(self.constants.place(np.array([value]))))

    def _from_table(self, index: int | str) -> str:
        f = self.function
        return f.everywhere(f.load_number(self.pointer, index))

    def _element(self, vector: Vector, i: int) -> Number:
        if vector.numbers is not None:
            return vector.numbers[i]
        if vector.table is not None:
            return self._constant(self.constants.numbers[vector.table + i])
        assert vector.pointer is not None
        key = vector.pointer, i
        if key not in self._elements:
            self._elements[key] = Number(self.function.load(vector.pointer, i))
        return self._elements[key]

    def _part(self, vector: Vector, first: int, size: int) -> Vector:
        if vector.numbers is not None:
            return Vector(size, vector.numbers[first : first + size])
        if vector.table is not None:
            return Vector(size, table=vector.table + first)
        assert vector.pointer is not None
        return Vector(size, pointer=self.function.at(vector.pointer, first))

    def _in_memory(self, value: Value) -> str:
        """The place of a value's numbers in memory; they are stored there if need be."""
        if isinstance(value, Vector) and value.pointer is not None:
            return value.pointer
        pointer = self.function.memory(value.size if isinstance(value, Vector) else 1)
        self.store(value, pointer)
        return pointer

    def each_number(self, value: Value) -> Iterator[tuple[str, str | int]]:
        """Every number of a value and its index, while their use is written.

        A long vector has one number and index, in a loop that is written around their use.
        """
        if isinstance(value, Vector) and value.pointer is not None and value.size >= LONG_VECTOR:
            with self.function.loop(0, value.size) as i:
                yield self.function.load(value.pointer, i), i
            return
        for i, number in enumerate(self.numbers(value)):
            yield self.as_number(number), i

    def store(self, value: Value, pointer: str, first: int = 0) -> None:
        """Writes that the numbers of a value go to memory, from some place on."""
        for i, number in enumerate(self.numbers(value), first):
            self.function.store(self.as_number(number), pointer, i)

    def as_number(self, number: Number) -> str:
        """The name of a number; a truth is converted to 1 or 0."""
        if not number.truth:
            return number.name
        one, zero = self.module.number(1.0), self.module.number(0.0)
        return self.function.select(number.name, one, zero)

    def _truth(self, number: Number) -> str:
        if number.truth:
            return number.name
        return self.function.compare("une", number.name, self.module.number(0.0))

    def _elementwise(self, node: Node, args: list[Value]) -> Vector:
        f = self.function
        result = f.memory(node.size)
        places = [
            a if isinstance(a, Number) or a.table is not None else self._in_memory(a) for a in args
        ]
        with f.loop(0, node.size) as i:
            operands = []
            for place in places:
                if isinstance(place, Number):
                    operands.append(place)
                elif isinstance(place, Vector):
                    operands.append(Number(self._from_table(f.whole("add", i, place.table or 0))))
                else:
                    operands.append(Number(f.load(place, i)))
            pairs, self._pairs = self._pairs, {}  # values of a loop cannot be used outside of it
            # truths stand in memory as 1 and 0
            f.store(self.as_number(self._operation(node.op, operands, node.truth)), result, i)
            self._pairs = pairs
        return Vector(node.size, pointer=result)

    def _product(self, first: int, shape: tuple[int, int], vector: Value) -> Vector:
        """A matrix that stands among the constants times a vector, some rows at once."""
        f, m = self.function, self.module
        rows, columns = shape
        result, source = f.memory(rows), self._in_memory(vector)
        whole = rows // _ROWS * _ROWS
        zero = m.number(0.0)
        if whole:
            with f.loop(0, whole // _ROWS) as block:
                begin = f.whole("add", f.whole("mul", block, _ROWS * columns), first)
                sums = self._rows(source, begin, columns, _ROWS, zero)
                at = f.whole("mul", block, _ROWS)
                for k, total in enumerate(sums):
                    f.store(total, result, f.whole("add", at, k))
        if whole < rows:
            rest = first + whole * columns
            for k, total in enumerate(self._rows(source, rest, columns, rows - whole, zero)):
                f.store(total, result, whole + k)
        return Vector(rows, pointer=result)

    def _rows(self, source: str, first: str | int, columns: int, rows: int, zero: str) -> list[str]:
        """Products of some rows of a matrix with a vector, the matrix by columns from a place."""
        f, m = self.function, self.module
        before, head, after = f.label(), f.label(), f.label()
        f.line(f"br label %{before}")
        f.place(before)
        f.line(f"br label %{head}")
        f.place(head)
        counter = f"%c{head}"
        f.line(f"{counter} = phi i64 [ 0, %{before} ], [ {counter}n, %{head} ]")
        names = [f"%s{head}{k}" for k in range(rows)]
        for name in names:
            f.line(f"{name} = phi {m.v} [ {zero}, %{before} ], [ {name}n, %{head} ]")
        value = f.load(source, counter)
        base = f.whole("add", f.whole("mul", counter, rows), first)
        for k, name in enumerate(names):
            weight = self._from_table(f.whole("add", base, k))
            product = f.apply("fmul", weight, value)
            f.line(f"{name}n = fadd reassoc nsz contract {m.v} {name}, {product}")
        f.line(f"{counter}n = add i64 {counter}, 1")
        has_more = f.value(f"icmp slt i64 {counter}n, {columns}")
        f.line(f"br i1 {has_more}, label %{head}, label %{after}")
        f.place(after)
        return [f"{name}n" for name in names]

    def _loop(self, loop: Loop, args: list[Value]) -> Vector:
        f = self.function
        total = sum(loop.carried_sizes)
        carried = f.memory(total)
        offsets = np.cumsum([0, *loop.carried_sizes]).tolist()
        constants, starts, collected = loop.split(args)
        names = loop.split(list(loop.body.inputs))
        for value, offset in zip(starts, offsets, strict=False):
            self.store(value, carried, offset)
        inputs = dict(zip(names[0], map(self._in_memory, constants), strict=True))
        rows = [self._in_memory(value) for value in collected]
        with f.loop(0, loop.length) as turn:
            for name, offset in zip(names[1], offsets, strict=False):
                inputs[name] = f.at(carried, offset)
            for name, row in zip(names[2], rows, strict=True):
                inputs[name] = f.at(row, f.whole("mul", turn, loop.body.inputs[name]))
            body = Emission(f, loop.body, inputs, self.constants, self.pointer)
            ends = [body.as_number(x) for numbers in body.outputs().values() for x in numbers]
            # all has been read before anything is replaced
            for i, end in enumerate(ends):
                f.store(end, carried, i)
        return Vector(total, pointer=carried)

    def _operation(self, op: str, args: list[Number], truth: bool) -> Number:
        f, m = self.function, self.module
        if op == "select":
            condition = self._truth(args[0])
            if truth:
                a, b = map(self._truth, args[1:])
                return Number(f.select(condition, a, b, m.truth), truth=True)
            return Number(f.select(condition, self.as_number(args[1]), self.as_number(args[2])))
        if op in _LOGIC:
            operands = [self._truth(a) for a in args]
            if op == "not":
                operands.append(self._constant(True).name)
            a, b = operands
            return Number(f.value(f"{_LOGIC[op]} {m.truth} {a}, {b}"), truth=True)
        operands = [self.as_number(a) for a in args]
        if op in _COMPARISONS:
            return Number(f.compare(_COMPARISONS[op], *operands), truth=True)
        if op in ("sin", "cos"):
            return Number(self._sine_and_cosine(operands[0])[op == "cos"])
        return Number(_WRITERS[op](f, *operands))

    def _sine_and_cosine(self, angle: str) -> tuple[str, str]:
        """Sine and cosine, which equations of motion need together."""
        if angle not in self._pairs:
            f, m = self.function, self.module
            pair = f"{{ {m.wide.v}, {m.wide.v} }}"
            name = functions.sine_and_cosine(m.wide)
            both = f.value(f"call {pair} @{name}({m.wide.v} {functions.widen(f, angle)})")
            sine, cosine = (f.value(f"extractvalue {pair} {both}, {i}") for i in (0, 1))
            self._pairs[angle] = functions.narrow(f, sine), functions.narrow(f, cosine)
        return self._pairs[angle]


_LOGIC = {"and": "and", "or": "or", "not": "xor"}
_COMPARISONS: dict[str, Any] = {
    "lt": "olt",
    "le": "ole",
    "gt": "ogt",
    "ge": "oge",
    "eq": "oeq",
    "ne": "une",
}


def _arithmetic(op: str) -> Callable[..., str]:
    return lambda f, a, b: f.apply(op, a, b)


def _intrinsic(name: str, arguments: int = 1) -> Callable[..., str]:
    return lambda f, *values: f.call(functions.intrinsic(f.module, name, arguments), *values)


def _scalar(name: str) -> Callable[..., str]:
    return _by_function(lambda module: functions.scalar(module, name))


def _by_function(write: Callable[[Module], str]) -> Callable[..., str]:
    return lambda f, *values: functions.in_double(f, write(f.module.wide), *values)


def _sign(f: Function, x: str) -> str:
    zero, one, less = (f.module.number(v) for v in (0.0, 1.0, -1.0))
    below = f.select(f.compare("olt", x, zero), less, x)  # zeros and NaN stay
    return f.select(f.compare("ogt", x, zero), one, below)


# writers of operations on numbers: from the function and the operands to the name of the value
_WRITERS: dict[str, Callable[..., str]] = {
    **{op: _arithmetic(f"f{op}") for op in ("add", "sub", "mul", "div")},
    "neg": lambda f, x: f.value(f"fneg {f.module.v} {x}"),
    "abs": _intrinsic("fabs"),
    "max": _intrinsic("maximum", 2),
    "min": _intrinsic("minimum", 2),
    "floor": _intrinsic("floor"),
    "ceil": _intrinsic("ceil"),
    "sqrt": _intrinsic("sqrt"),
    "sign": _sign,
    "exp": _by_function(functions.exponential),
    "tanh": _by_function(functions.hyperbolic_tangent),
    "rem": _scalar("fmod"),
    **{name: _scalar(name) for name in functions.SCALAR if name not in ("fmod", "sin", "cos")},
}
