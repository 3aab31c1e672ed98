"""Operations on tensors as nodes of ONNX graphs, also those that runtimes lack in double."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from onnx import NodeProto, TensorProto
from onnx.helper import make_node, np_dtype_to_tensor_dtype
from onnx.numpy_helper import from_array

_INFINITE = 1e30  # its arc tangent is that of infinity


@dataclass
class ModelBuilder:
    """The names and constants that all graphs of a model share.

    Attributes:
        kind: float64 or float32, for all numbers.
        constants: tensors by their bytes.
    """

    kind: np.dtype
    constants: dict[Any, TensorProto] = field(default_factory=dict)
    _count: int = 0

    @property
    def number(self) -> int:
        """The type of its numbers in ONNX."""
        return np_dtype_to_tensor_dtype(self.kind)

    def name(self) -> str:
        """A new name."""
        self._count += 1
        return f"t{self._count}"

    def constant(self, values: Any) -> str:
        """The name of a constant tensor; whole numbers stay whole."""
        array = np.asarray(values)
        if array.dtype.kind == "f":
            with np.errstate(over="ignore"):
                array = array.astype(self.kind)
        key = array.shape, array.dtype.kind, array.tobytes()
        if key not in self.constants:
            self.constants[key] = from_array(array, f"c{len(self.constants)}")
        return self.constants[key].name


@dataclass
class Graph:
    """A graph, or the body of a loop, while it is written.

    Attributes:
        model: the model that it is a part of.
        nodes: in the order of computation.
    """

    model: ModelBuilder
    nodes: list[NodeProto] = field(default_factory=list)

    def add(self, op: str, *inputs: str, **attributes: Any) -> "Term":
        """Adds a node and returns its output."""
        name = self.model.name()
        self.nodes.append(make_node(op, list(inputs), [name], **attributes))
        return Term(self, name)

    def number(self, value: Any) -> "Term":
        """A constant, of shape (1, 1)."""
        return Term(self, self.model.constant(np.reshape(value, (1, 1))))


@dataclass(frozen=True, eq=False)
class Term:
    """A tensor in a graph; operations on it add nodes.

    Attributes:
        graph: the graph.
        name: its name there.
    """

    graph: Graph
    name: str

    def to(self, op: str, *others: "Term | float", **attributes: Any) -> "Term":
        """The result of an operator of ONNX on this and others."""
        terms = [t if isinstance(t, Term) else self.graph.number(float(t)) for t in others]
        return self.graph.add(op, self.name, *(t.name for t in terms), **attributes)

    def cast(self, kind: int) -> "Term":
        """The tensor as numbers of another type."""
        return self.to("Cast", to=kind)

    def __add__(self, other: "Term | float") -> "Term":
        return self.to("Add", other)

    def __sub__(self, other: "Term | float") -> "Term":
        return self.to("Sub", other)

    def __mul__(self, other: "Term | float") -> "Term":
        return self.to("Mul", other)

    def __truediv__(self, other: "Term | float") -> "Term":
        return self.to("Div", other)

    def __neg__(self) -> "Term":
        return self.to("Neg")

    def __lt__(self, other: "Term | float") -> "Term":
        return self.to("Less", other)

    def equals(self, other: "Term | float") -> "Term":
        """Whether they are equal."""
        return self.to("Equal", other)

    def where(self, yes: "Term | float", no: "Term | float") -> "Term":
        """The first where this is true, the second elsewhere."""
        return self.to("Where", yes, no)

    def signed(self, size: "Term") -> "Term":
        """An absolute value with the sign of this."""
        return (self < 0.0).where(-size, size)

    def below(self) -> "Term":
        """Whether it is less than 0, or the negative zero."""
        return (self < 0.0).to("Or", self.equals(0.0).to("And", self.to("Reciprocal") < 0.0))


def _expm1(x: Term) -> Term:
    # Kahan: the rounding error of exp(x) is the same in its logarithm
    power = x.to("Exp")
    near = power.equals(1.0).where(x, (power - 1.0) * x / power.to("Log"))
    return (x.to("Abs") < 1.0).where(near, power - 1.0)


def _log1p(x: Term) -> Term:
    whole = x + 1.0
    near = whole.equals(1.0).where(x, whole.to("Log") * x / (whole - 1.0))
    return (x.to("Abs") < 0.5).where(near, whole.to("Log"))


def _sinh(x: Term) -> Term:
    grown = _expm1(x.to("Abs"))
    return x.signed(grown * 0.5 * ((grown + 1.0).to("Reciprocal") + 1.0))


def _asinh(x: Term) -> Term:
    size = x.to("Abs")
    inverse = size.to("Reciprocal")
    rest = size / (inverse + (inverse * inverse + 1.0).to("Sqrt"))
    return x.signed(_log1p(size + rest))


def _acosh(x: Term) -> Term:
    over = x - 1.0
    return _log1p(over + over.to("Sqrt") * (over + 2.0).to("Sqrt"))


def _atanh(x: Term) -> Term:
    size = x.to("Abs")
    return x.signed(_log1p(size * 2.0 / (-size + 1.0)) * 0.5)


def _atan(x: Term) -> Term:
    # in single precision, then the tangent of the remainder; its cube is less than a rounding
    size = (x.to("Abs") < _INFINITE).where(x, x.to("Sign") * _INFINITE)
    guess = size.cast(TensorProto.FLOAT).to("Atan").cast(x.graph.model.number)
    sine, cosine = guess.to("Sin"), guess.to("Cos")
    return guess + (size * cosine - sine) / (cosine + size * sine)


def _atan2(y: Term, x: Term) -> Term:
    """The angle of (x, y); of two infinities it is not a number."""
    right = y.equals(0.0).where(y, _atan(y / x))
    turn = y.below().where(y.graph.number(-np.pi), np.pi)
    return x.below().where(right + turn, right)


def _op(op: str, **attributes: Any) -> Callable[..., Term]:
    """An operation that ONNX has."""
    return lambda first, *others: first.to(op, *others, **attributes)


# operations by their names in programs; the last ones have no operator in double precision
OPERATORS: dict[str, Callable[..., Term]] = {
    "add": _op("Add"),
    "sub": _op("Sub"),
    "mul": _op("Mul"),
    "div": _op("Div"),
    "neg": _op("Neg"),
    "max": _op("Max"),
    "min": _op("Min"),
    "pow": _op("Pow"),
    "rem": _op("Mod", fmod=1),
    "abs": _op("Abs"),
    "sign": _op("Sign"),
    "floor": _op("Floor"),
    "ceil": _op("Ceil"),
    "sqrt": _op("Sqrt"),
    "exp": _op("Exp"),
    "log": _op("Log"),
    "sin": _op("Sin"),
    "cos": _op("Cos"),
    "tanh": _op("Tanh"),
    "lt": _op("Less"),
    "le": _op("LessOrEqual"),
    "gt": _op("Greater"),
    "ge": _op("GreaterOrEqual"),
    "eq": _op("Equal"),
    "ne": lambda a, b: a.equals(b).to("Not"),
    "and": _op("And"),
    "or": _op("Or"),
    "not": _op("Not"),
    "select": lambda which, yes, no: which.where(yes, no),
    "expm1": _expm1,
    "log1p": _log1p,
    "tan": lambda x: x.to("Sin") / x.to("Cos"),
    "asin": lambda x: _atan(x / ((-x + 1.0) * (x + 1.0)).to("Sqrt")),
    "acos": lambda x: _atan(((-x + 1.0) / (x + 1.0)).to("Sqrt")) * 2.0,
    "atan": _atan,
    "atan2": _atan2,
    "sinh": _sinh,
    "cosh": lambda x: (x.to("Exp") + (-x).to("Exp")) * 0.5,
    "asinh": _asinh,
    "acosh": _acosh,
    "atanh": _atanh,
}
