"""LLVM's assembly language while it is written: values of several lanes, loops, memory.

A value of the equations is a vector with one number for each lane; lanes are records, windows or
variants of a model that are simulated side by side. With one lane it is a plain number.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Literal

import numpy as np

# sums may be reordered and multiplications fused with them, so that vectors can be used; that a
# number is not finite is always respected: a simulation that diverges must stay visible
FAST = "reassoc nsz contract"

SYMBOL = "c.{}"  # the name of a function of the C library in a module
_STACK = 2**18  # bytes of it that a function uses; threads have as little as half a megabyte

Precision = Literal["double", "float"]
Predicate = Literal["oeq", "une", "olt", "ole", "ogt", "oge", "uno"]


def float_bits(value: float) -> int:
    """The bits of a number as a whole number with a sign."""
    return struct.unpack("<q", struct.pack("<d", value))[0]


class Function:
    """A function while it is written.

    Attributes:
        module: the module that it belongs to.
    """

    def __init__(
        self, module: "Module", name: str, arguments: str, result: str, is_internal: bool
    ) -> None:
        self.module = module
        # written once and called from several places: inlining would multiply the code
        linkage, mark = ("internal ", " noinline") if is_internal else ("", "")
        self._head = f"define {linkage}{result} @{name}({arguments}){mark}"
        self._entry: list[str] = []
        self._lines: list[str] = []
        self._count = self._stack = 0
        self._allocated: list[str] = []

    # --- lines ---

    def line(self, text: str) -> None:
        """A line without a value."""
        self._lines.append(text)

    def value(self, text: str) -> str:
        """A line with a value, whose name is returned."""
        self._count += 1
        name = f"%v{self._count}"
        self._lines.append(f"{name} = {text}")
        return name

    def label(self) -> str:
        """A new name of a block."""
        self._count += 1
        return f"b{self._count}"

    def place(self, label: str) -> None:
        """The block of that name begins here."""
        self._lines.append(f"{label}:")

    def memory(self, count: int) -> str:
        """Memory for so many values of this function, aligned as vectors are.

        On the stack, as far as that reaches; what large networks need beyond it is allocated.
        """
        self._count += 1
        name, m, size = f"%m{self._count}", self.module, max(count, 1)
        self._stack += size * m.align
        if self._stack <= _STACK:
            self._entry.append(f"{name} = alloca [{size} x {m.v}], align {m.align}")
            return name
        self._stack -= size * m.align
        m.once("malloc", lambda: f'declare ptr @"{SYMBOL.format("malloc")}"(i64)\n')
        m.once("free", lambda: f'declare void @"{SYMBOL.format("free")}"(ptr)\n')
        bytes_ = (size + 1) * m.align
        self._entry += [
            f'{name}a = call ptr @"{SYMBOL.format("malloc")}"(i64 {bytes_})',
            f"{name}b = ptrtoint ptr {name}a to i64",
            f"{name}c = add i64 {name}b, {m.align - 1}",
            f"{name}d = and i64 {name}c, {-m.align}",
            f"{name} = inttoptr i64 {name}d to ptr",
        ]
        self._allocated.append(f"{name}a")
        return name

    def counter(self) -> str:
        """Memory for a whole number."""
        self._count += 1
        self._entry.append(f"%m{self._count} = alloca i64")
        return f"%m{self._count}"

    def text(self) -> str:
        """The function as text."""
        free = [f'call void @"{SYMBOL.format("free")}"(ptr {name})' for name in self._allocated]
        lines = [
            text
            for line in self._lines
            for text in ([*free, line] if line.startswith("ret ") else [line])
        ]
        body = "\n".join(["entry:", *self._entry, *lines])
        return f"{self._head} {{\n{body}\n}}\n"

    # --- whole numbers and flow ---

    def whole(self, op: str, a: str | int, b: str | int) -> str:
        """An operation on whole numbers."""
        return self.value(f"{op} i64 {a}, {b}")

    def at(self, pointer: str, index: str | int, kind: str | None = None) -> str:
        """The address of an element: of values, or of a kind such as `i64`."""
        if index == 0:
            return pointer
        return self.value(
            f"getelementptr inbounds {kind or self.module.v}, ptr {pointer}, i64 {index}"
        )

    @contextmanager
    def loop(self, begin: str | int, end: str | int) -> Iterator[str]:
        """A loop: code that is written inside runs for every whole number from begin up to end."""
        counter, head, body, after = self.counter(), self.label(), self.label(), self.label()
        self.line(f"store i64 {begin}, ptr {counter}")
        self.line(f"br label %{head}")
        self.place(head)
        i = self.value(f"load i64, ptr {counter}")
        has_more = self.value(f"icmp slt i64 {i}, {end}")
        self.line(f"br i1 {has_more}, label %{body}, label %{after}")
        self.place(body)
        yield i
        i_next = self.whole("add", i, 1)
        self.line(f"store i64 {i_next}, ptr {counter}")
        self.line(f"br label %{head}")
        self.place(after)

    @contextmanager
    def when(self, condition: str) -> Iterator[None]:
        """A branch: code that is written inside runs where the condition holds."""
        body, after = self.label(), self.label()
        self.line(f"br i1 {condition}, label %{body}, label %{after}")
        self.place(body)
        yield
        self.line(f"br label %{after}")
        self.place(after)

    # --- values ---

    def load(self, pointer: str, index: str | int = 0) -> str:
        """A value in memory."""
        address = self.at(pointer, index)
        return self.value(f"load {self.module.v}, ptr {address}, align {self.module.align}")

    def store(
        self, value: str, pointer: str, index: str | int = 0, *, aligned: bool = True
    ) -> None:
        """A value goes to memory; not aligned where somebody else allocated that."""
        address, m = self.at(pointer, index), self.module
        self.line(f"store {m.v} {value}, ptr {address}, align {m.align if aligned else m.bytes}")

    def load_number(self, pointer: str, index: str | int) -> str:
        """A single number in memory."""
        m = self.module
        return self.value(f"load {m.n}, ptr {self.at(pointer, index, m.n)}, align {m.bytes}")

    def store_number(self, number: str, pointer: str, index: str | int) -> None:
        """A single number goes to memory."""
        m = self.module
        self.line(f"store {m.n} {number}, ptr {self.at(pointer, index, m.n)}, align {m.bytes}")

    def apply(self, op: str, a: str, b: str, *, exact: bool = False) -> str:
        """`fadd`, `fsub`, `fmul` or `fdiv`; exact where rounding must not be touched."""
        flags = "" if exact else f"{FAST} "
        return self.value(f"{op} {flags}{self.module.v} {a}, {b}")

    def fma(self, a: str, b: str, c: str) -> str:
        """`a b + c`."""
        return self.apply("fadd", self.apply("fmul", a, b), c)

    def compare(self, predicate: Predicate, a: str, b: str) -> str:
        """A truth for every lane."""
        return self.value(f"fcmp {predicate} {self.module.v} {a}, {b}")

    def select(self, condition: str, a: str, b: str, kind: str | None = None) -> str:
        """One or the other value, or truth, chosen for every lane."""
        kind = kind or self.module.v
        return self.value(f"select {self.module.truth} {condition}, {kind} {a}, {kind} {b}")

    def call_procedure(self, name: str, signature: str, **arguments: object) -> None:
        """Calls a procedure, its arguments by the names that they have in its signature."""
        parameters = (parameter.split() for parameter in signature.split(", "))
        values = [f"{kind} {arguments[name[1:]]}" for kind, *_, name in parameters]
        self.line(f"call void @{name}({', '.join(values)})")

    def call(self, name: str, *values: str) -> str:
        """A function of values that returns one."""
        v = self.module.v
        return self.value(f"call {v} @{name}({', '.join(f'{v} {x}' for x in values)})")

    def lane(self, value: str, lane: int) -> str:
        """The number of one lane."""
        if self.module.lanes == 1:
            return value
        return self.value(f"extractelement {self.module.v} {value}, i32 {lane}")

    def together(self, numbers: list[str]) -> str:
        """A value of the numbers of all lanes."""
        if self.module.lanes == 1:
            return numbers[0]
        value = "poison"
        for lane, number in enumerate(numbers):
            value = self.value(
                f"insertelement {self.module.v} {value}, {self.module.n} {number}, i32 {lane}"
            )
        return value

    def everywhere(self, number: str) -> str:
        """A value that is the same number in all lanes."""
        m = self.module
        if m.lanes == 1:
            return number
        first = self.value(f"insertelement {m.v} poison, {m.n} {number}, i32 0")
        order = f"<{m.lanes} x i32> zeroinitializer"
        return self.value(f"shufflevector {m.v} {first}, {m.v} poison, {order}")


class Module:
    """A module while it is written.

    Attributes:
        lanes: numbers of a value.
        n: the type of a number, `double` or `float`.
        bytes: of a number.
        v: the type of a value.
        truth: the type of a truth for every lane.
        align: bytes that values in memory are aligned to.
    """

    def __init__(self, lanes: int, number: Precision = "double") -> None:
        self.lanes, self.n = lanes, number
        self.bytes = 8 if number == "double" else 4
        self.v = number if lanes == 1 else f"<{lanes} x {number}>"
        self.truth = "i1" if lanes == 1 else f"<{lanes} x i1>"
        self.align = self.bytes * lanes
        self._parts: dict[str, str] = {}

    @cached_property
    def wide(self) -> "Module":
        """This module in double precision, for functions that compute so; it shares their text."""
        if self.n == "double":
            return self
        other = Module(self.lanes)
        other._parts = self._parts
        return other

    def function(self, name: str, arguments: str, result: str = "void") -> Function:
        """A function for this module alone, whose text is added by `once`."""
        return Function(self, name, arguments, result, is_internal=True)

    @contextmanager
    def procedure(
        self, name: str, arguments: str, returns: str = "void", *, is_internal: bool = True
    ) -> Iterator[Function]:
        """A function with a constant result: code that is written inside is its body."""
        function = Function(self, name, arguments, returns.split()[0], is_internal)
        yield function
        function.line(f"ret {returns}")
        self._parts[name] = function.text()

    def once(self, name: str, write: Callable[[], str]) -> str:
        """A part of the module that is written where it is needed first; its name."""
        if name not in self._parts:
            self._parts[name] = ""  # so that what it needs stands before it
            self._parts[name] = write()
        return name

    def number(self, value: float) -> str:
        """A constant in all lanes."""
        # a number in single precision is written as that in double precision which it is
        exact = value if self.n == "double" else float(np.float32(value))
        return self.constant(self.n, f"0x{float_bits(exact) % 2**64:016X}")

    def constant(self, kind: str, value: object) -> str:
        """A constant of a type such as `i64` in all lanes."""
        if self.lanes == 1:
            return str(value)
        return "<" + ", ".join([f"{kind} {value}"] * self.lanes) + ">"

    def text(self) -> str:
        """The module as text."""
        return "\n".join(self._parts.values())
