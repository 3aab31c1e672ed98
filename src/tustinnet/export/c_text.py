"""Programs as C99 functions that allocate nothing, over constants that stay in flash."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from tustinnet.export.words import INFIX, apply_form, called_functions
from tustinnet.program.memory import is_elementwise, lifetimes
from tustinnet.program.program import Loop, Node, Program

# operations in C; all others are functions of math.h of the same name
# `larger` and `smaller`, unlike fmax and fmin, keep NaN as NumPy does
_FORMS = {
    **INFIX,
    "abs": "M(fabs)({})",
    "rem": "M(fmod)({}, {})",
    "max": "larger({}, {})",
    "min": "smaller({}, {})",
    "sign": "sign_of({})",
}


class Code:
    """The code of one C file: functions, and the constants and helpers that they share."""

    def __init__(self) -> None:
        self._names: dict[Any, str] = {}
        self._arrays: list[str] = []
        self._functions: list[str] = []

    def add(self, name: str, program: Program, changed: Sequence[str] = ()) -> None:
        """Adds a program as a static function of its inputs, then its outputs as `to_NAME`.

        Where inputs may be changed, `changed` names those that take the outputs, in their order.
        """
        # the functions of its loops are added before it
        text = _CWriter(self, name, program, changed).text()
        self._functions.append(text)

    def constant(self, values: np.ndarray) -> str:
        """The name of an array of constants; the same numbers are kept once."""
        values = values.astype(np.float64)
        key = values.tobytes()
        if key not in self._names:
            self._names[key] = f"k{len(self._names)}"
            self._arrays.append(constant_array(self._names[key], values))
        return self._names[key]

    def text(self) -> str:
        """The text of the file, constants first."""
        helpers = called_functions("helpers.c", "".join(self._functions))
        return "\n".join(
            part.strip("\n") + "\n" for part in (*self._arrays, *helpers, *self._functions)
        )


class _CWriter:
    """A writer of one program as a function of C."""

    def __init__(
        self, code: Code, name: str, program: Program, changed: Sequence[str] = ()
    ) -> None:
        self._code, self._name, self._program = code, name, program
        self._nodes = program.nodes
        self._lives = lifetimes(program)
        self._lines: list[str] = []
        self._sizes: dict[str, int] = {}  # of the arrays of the function
        self._free: list[str] = []  # those of them that are not needed any more
        self._place: dict[int, str] = {}  # the arrays of vectors
        names = changed or [f"to_{output}" for output in program.outputs]
        self._returned = list(zip(names, program.outputs.values(), strict=True))
        self._changed = changed
        self._ends: dict[int, str] = {}  # vectors that are computed where they are returned
        if not changed:
            self._ends = {i: name for name, i in reversed(self._returned)}
        self._loops = 0
        self._groups: dict[int, list[int]] = {}  # nodes that are computed with a node
        self._last_read: dict[int, list[int]] = {}  # nodes that a node is the last to read
        for i in range(len(self._nodes)):
            self._groups.setdefault(self._lives.root[i], []).append(i)
            self._last_read.setdefault(self._lives.last[i], []).append(i)

    def text(self) -> str:
        """The text of the function."""
        for i, node in enumerate(self._nodes):
            self._write(i, node)
            for unneeded in self._last_read.get(i, []):
                place = self._place.get(unneeded)
                if place in self._sizes and place not in self._free:
                    self._free.append(place)
        for place, i in self._returned:
            if self._changed:
                self._join(place, self._nodes[i])  # now that nothing is read any more
            elif self._place.get(i) != place:
                self._store(place, 0, i)
        inputs = [
            f"{'' if name in self._changed else 'const '}model_real *restrict {name}"
            for name in self._program.inputs
        ]
        outputs = [
            f"model_real *restrict {name}" for name, _ in self._returned if not self._changed
        ]
        start = f"static void {self._name}("
        signature = start + (",\n" + " " * len(start)).join([*inputs, *outputs]) + ")"
        read = {node.data for node in self._nodes if node.op == "input"}
        unread = [name for name in self._program.inputs if name not in {*read, *self._changed}]
        empty = [name for name, i in self._returned if not self._nodes[i].size]
        declarations = [
            *(f"    model_real {name}[{size}];" for name, size in self._sizes.items()),
            *(f"    (void){name};" for name in (*unread, *empty)),
        ]
        return signature + "\n{\n" + "\n".join([*declarations, *self._lines]) + "\n}\n"

    def _write(self, i: int, node: Node) -> None:
        match node.op:
            case "number" | "pick" | "part" | "table":
                return
            case "join" if self._changed and i in self._program.outputs.values():
                return
            case "input":
                self._place[i] = node.data
            case "join":
                self._join(self._array_of(i), node)
            case "product":
                self._product(self._array_of(i), node)
            case "loop":
                self._loop(self._array_of(i), node.data, node.args)
            case _ if not is_elementwise(node):
                self._lines.append(f"    {self._definition(i)}")
            case _ if self._lives.root[i] == i:
                self._elementwise(i, node)

    def _array_of(self, i: int) -> str:
        """An array for a vector: where it is returned, or one that is not needed any more."""
        self._place[i] = self._ends.get(i) or self._free_array(self._nodes[i].size)
        return self._place[i]

    def _free_array(self, size: int) -> str:
        candidates = sorted(
            self._free, key=lambda name: (self._sizes[name] < size, abs(self._sizes[name] - size))
        )
        name = candidates[0] if candidates else f"v{len(self._sizes)}"
        if candidates:
            self._free.remove(name)
        self._sizes[name] = max(size, self._sizes.get(name, 0))
        return name

    def _join(self, place: str, node: Node) -> None:
        offset = 0
        for a in node.args:
            self._store(place, offset, a)
            offset += self._nodes[a].size

    def _store(self, place: str, offset: int, a: int) -> None:
        """Writes a number or a vector to an array."""
        size = self._nodes[a].size
        if size == 1:
            self._lines.append(f"    {place}[{offset}] = {self._real(a)};")
        elif size:
            self._lines.append(f"    copy({size}, {self._at(a)}, {_plus(place, offset)});")

    def _product(self, place: str, node: Node) -> None:
        matrix = self._program.tables[node.data]
        rows, columns = matrix.shape
        stored = self._code.constant(matrix.ravel(order="F"))
        self._lines.append(
            f"    product({rows}, {columns}, {stored}, {self._at(node.args[0])}, {place});"
        )

    def _loop(self, place: str, loop: Loop, args: tuple[int, ...]) -> None:
        """Writes a loop; its carried state is one array, which the body changes or is copied to."""
        body = f"{self._name}_turn{self._loops}"
        self._loops += 1
        constants, starts, tables = loop.split(args)
        changed = loop.split(tuple(loop.body.inputs))[1]
        changed = changed if _may_change(loop.body, changed) else ()
        self._code.add(body, loop.body, changed)
        offset, carried = 0, []
        for a, size in zip(starts, loop.carried_sizes, strict=True):
            self._store(place, offset, a)
            carried.append(offset)
            offset += size
        rows = [
            f"{self._at(a)} + turn * {size}"
            for a, size in zip(tables, loop.split(loop.sizes)[2], strict=True)
        ]
        arguments = [*map(self._at, constants), *(_plus(place, k) for k in carried), *rows]
        copy = []
        if not changed:
            after = self._free_array(offset)
            arguments += [_plus(after, k) for k in carried]
            copy = [f"        copy({offset}, {after}, {place});"]
            self._free.append(after)
        self._lines += [
            f"    for (int turn = 0; turn < {loop.length}; turn++) {{",
            f"        {body}({', '.join(arguments)});",
            *copy,
            "    }",
        ]

    def _elementwise(self, i: int, node: Node) -> None:
        """Writes a loop that computes a vector and those that only it needs."""
        *inner, _ = self._groups[i]
        place = self._in_place(i) or self._array_of(i)
        self._place[i] = place
        self._lines += [
            f"    for (int i = 0; i < {node.size}; i++) {{",
            *(f"        {self._definition(j)}" for j in inner),
            f"        {place}[i] = {self._formula(i, real=True)};",
            "    }",
        ]

    def _in_place(self, i: int) -> str | None:
        """The array of a vector that is read for the last time, each number just before it."""
        if i in self._ends:
            return None
        read = [a for j in self._groups[i] for a in self._nodes[j].args]
        for a in read:
            place = self._place.get(a)
            whole = place in self._sizes and self._nodes[a].size == self._nodes[i].size
            elsewhere = any(b != a and self._owner(b) == a for b in read)
            if whole and self._lives.last[a] == i and not elsewhere:
                self._last_read[i].remove(a)
                return place
        return None

    def _owner(self, i: int) -> int:
        """The vector of which a node is a part or a number."""
        while self._nodes[i].op in ("part", "pick"):
            (i,) = self._nodes[i].args
        return i

    def _definition(self, i: int) -> str:
        kind = "int" if self._nodes[i].truth else "model_real"
        return f"const {kind} t{i} = {self._formula(i)};"

    def _formula(self, i: int, *, real: bool = False) -> str:
        """The formula of a node; of a vector, that of one element."""
        node = self._nodes[i]
        operands = [
            self._truth(a) if node.takes_truth(k) else self._real(a)
            for k, a in enumerate(node.args)
        ]
        text = apply_form(_FORMS.get(node.op), f"M({node.op})", operands)
        return f"(model_real)({text})" if real and node.truth else text

    def _real(self, a: int) -> str:
        """A number; of a vector, the one at the place of the loop."""
        text, is_real = self._read(a)
        return f"(model_real){text}" if self._nodes[a].truth and not is_real else text

    def _truth(self, a: int) -> str:
        text, is_real = self._read(a)
        return text if self._nodes[a].truth and not is_real else f"({text} != R(0.0))"

    def _read(self, a: int) -> tuple[str, bool]:
        """The text of a number or truth, and whether its type in C is that of numbers."""
        node = self._nodes[a]
        if node.op == "number":
            return _literal(float(node.data)), True
        if node.op == "pick":
            place, offset = self._where(node.args[0])
            return f"{place}[{offset + node.data}]", True
        if node.is_single or self._lives.root[a] != a:
            return f"t{a}", False
        place, offset = self._where(a)
        if node.size == 1:
            return f"{place}[{offset}]", True
        return f"{place}[{_plus('i', offset)}]", True

    def _at(self, a: int) -> str:
        return _plus(*self._where(a))

    def _where(self, a: int) -> tuple[str, int]:
        """The array in which a vector is, and the offset of its first number."""
        node = self._nodes[a]
        if node.op == "part":
            place, offset = self._where(node.args[0])
            return place, offset + node.data
        if node.op == "table":
            return self._code.constant(self._program.tables[node.data]), 0
        return self._place[a], 0


def _may_change(program: Program, carried: Sequence[str]) -> bool:
    """Whether outputs may overwrite inputs: all are numbers that are computed before."""
    nodes = program.nodes

    def is_independent(a: int) -> bool:
        node = nodes[a]
        if node.op == "pick":
            vector = nodes[node.args[0]]
            return vector.op == "input" and vector.data not in carried
        return node.is_single

    ends = program.outputs.values()
    read = {a for node in nodes for a in node.args}
    return all(
        nodes[i].op == "join" and all(map(is_independent, nodes[i].args)) for i in ends
    ) and (not read & set(ends))


def constant_array(name: str, values: np.ndarray) -> str:
    """The definition of an array of constants, in the order of memory."""
    numbers = [_literal(x) for x in values.ravel().tolist()]
    return f"static const model_real {name}[{len(numbers)}] = {{\n{_wrapped(numbers)}\n}};\n"


def _plus(text: str, offset: int) -> str:
    return f"{text} + {offset}" if offset else text


def _literal(value: float) -> str:
    """A constant in the precision of the C file, which defines `R` and `EITHER`."""
    with np.errstate(over="ignore", under="ignore"):
        single = float(np.float32(value))
    if np.isfinite(single) and (single != 0 or value == 0):
        return f"R({float(value)!r})"
    # beyond the range of float, where a suffix would be an error
    return f"EITHER({_plain(value)}, {'0.0f' if single == 0 else _plain(single)})"


def _plain(value: float) -> str:
    if np.isnan(value):
        return "(model_real)NAN"
    if np.isinf(value):
        return "(model_real)INFINITY" if value > 0 else "-(model_real)INFINITY"
    return repr(float(value))


def _wrapped(items: Iterable[str]) -> str:
    """Items separated by commas on lines of at most about 100 characters."""
    lines, line = [], "   "
    for item in items:
        if len(line) + len(item) > 98:
            lines.append(line)
            line = "   "
        line += f" {item},"
    return "\n".join([*lines, line.rstrip(",")])
