"""Programs as sums of products that people read: `-9.81 sin(theta) - 0.1 theta'`."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from tustinnet.program.program import OPERATIONS, Node, Program

_MOST_TERMS = 200  # of a sum; more are no formula that somebody reads
_NEGLIGIBLE = 1e-12  # of the largest coefficient of a sum: what rounding leaves
_COEFFICIENT_DIGITS = 4  # of a coefficient
_LARGEST_POWER = 8  # that is multiplied out


class TooLong(Exception):
    """A formula that nobody would read, or a computation that is none."""


@dataclass(frozen=True)
class Symbol:
    """A quantity by its name: in plain text, and in LaTeX."""

    text: str
    latex: str


@dataclass(frozen=True)
class Function:
    """A function of sums; `group` is a sum of several terms that is a factor as a whole."""

    name: str
    arguments: tuple["Sum", ...]


Factor = Symbol | Function
Product = tuple[tuple[Factor, float], ...]  # factors and their exponents, in their order


@dataclass(frozen=True)
class Sum:
    """A sum of products with coefficients.

    Attributes:
        terms: products and their coefficients; the empty product is 1.
    """

    terms: tuple[tuple[Product, float], ...]

    @classmethod
    def of(cls, terms: Iterable[tuple[Product, float]]) -> "Sum":
        """The sum of some terms: equal products are added, what rounding leaves is left out.

        Of squares of a sine and a cosine one is left.
        """
        total: dict[Product, float] = {}
        for product, coefficient in terms:
            total[product] = total.get(product, 0.0) + coefficient
        _join_squares(total)
        if len(total) > _MOST_TERMS:
            raise TooLong(f"more than {_MOST_TERMS} terms")
        largest = max(map(abs, total.values()), default=0.0)
        return cls(tuple((p, c) for p, c in total.items() if abs(c) > _NEGLIGIBLE * largest))

    @classmethod
    def number(cls, value: float) -> "Sum":
        """A constant."""
        return cls.of([((), float(value))])

    @classmethod
    def factor(cls, factor: Factor, power: float = 1.0) -> "Sum":
        """A power of a single factor."""
        return cls.of([(((factor, power),), 1.0)])

    @property
    def value(self) -> float | None:
        """The number that it is, None of another sum."""
        if not self.terms:
            return 0.0
        ((product, coefficient), *more) = self.terms
        return coefficient if not product and not more else None

    def __add__(self, other: "Sum") -> "Sum":
        return Sum.of([*self.terms, *other.terms])

    def __mul__(self, other: "Sum") -> "Sum":
        return Sum.of((_multiply(a, b), x * y) for a, x in self.terms for b, y in other.terms)

    def scaled(self, number: float) -> "Sum":
        """A multiple."""
        return Sum.of((product, number * c) for product, c in self.terms)

    def grouped(self) -> "Sum":
        """The sum as one factor, which a product does not multiply out."""
        return self if len(self.terms) < 2 else Sum.factor(Function("group", (self,)))

    def power(self, exponent: float) -> "Sum":
        """A power: multiplied out where it is a small whole one, else of the sum as a whole."""
        if self.value is not None:
            return Sum.number(self.value**exponent)
        if exponent == int(exponent) and 0 <= exponent <= _LARGEST_POWER:
            result = Sum.number(1.0)
            for _ in range(int(exponent)):
                result = result * self
            return result
        ((product, coefficient), *more) = self.terms
        if not more and (coefficient > 0 or exponent == int(exponent)):
            return Sum.of([(tuple((f, p * exponent) for f, p in product), coefficient**exponent)])
        return Sum.factor(Function("group", (self,)), exponent)  # in brackets


def _join_squares(total: dict[Product, float]) -> None:
    """Writes `a sin(x)^2 + b cos(x)^2` as `(a - b) sin(x)^2 + b`, also where they are factors."""
    for product in [*total]:
        for cosine, power in product:
            if not (isinstance(cosine, Function) and cosine.name == "cos" and power == 2):
                continue
            rest = tuple((f, p) for f, p in product if f != cosine)
            sine = _multiply(rest, ((Function("sin", cosine.arguments), 2.0),))
            if sine in total and product in total:
                coefficient = total.pop(product)
                total[sine] -= coefficient
                total[rest] = total.get(rest, 0.0) + coefficient


def _multiply(a: Product, b: Product) -> Product:
    """The product of two, its factors in the order in which they are met."""
    powers = dict(a)
    for factor, power in b:
        powers[factor] = powers.get(factor, 0.0) + power
    return tuple(sorted(((f, p) for f, p in powers.items() if p), key=_order))


def _order(power: tuple[Factor, float]) -> tuple[int, str]:
    """A key by which factors stand: brackets, quantities, functions."""
    factor = power[0]
    if isinstance(factor, Symbol):
        return 1, factor.text
    return (0 if factor.name == "group" else 2), repr(factor)


def read_sums(program: Program, symbols: Mapping[str, list[Symbol]]) -> dict[str, list[Sum]]:
    """The outputs of a program as sums.

    Args:
        program: the program.
        symbols: the symbols of its input vectors.

    Raises:
        TooLong: more terms than somebody reads, or loops.
    """
    values: list[list[Sum]] = []
    for node in program.nodes:
        values.append(_value(program, node, [values[a] for a in node.args], symbols))
    return {name: values[number] for name, number in program.outputs.items()}


def _value(
    program: Program, node: Node, args: list[list[Sum]], symbols: Mapping[str, list[Symbol]]
) -> list[Sum]:
    match node.op:
        case "input":
            return [Sum.factor(symbol) for symbol in symbols[node.data]]
        case "number":
            return [Sum.number(node.data)]
        case "table":
            return [Sum.number(x) for x in program.tables[node.data].tolist()]
        case "pick":
            return [args[0][node.data]]
        case "part":
            return args[0][node.data : node.data + node.size]
        case "join":
            return [x for part in args for x in part]
        case "product":
            rows = program.tables[node.data].tolist()
            return [
                Sum.of(t for x, c in zip(args[0], row, strict=True) for t in x.scaled(c).terms)
                for row in rows
            ]
        case op if op in OPERATIONS:
            return [_apply(op, [x[k if len(x) > 1 else 0] for x in args]) for k in range(node.size)]
        case op:
            raise TooLong(f"a {op}")


def _apply(op: str, x: list[Sum]) -> Sum:
    """An operation on sums; a function of numbers is a number."""
    numbers = [a.value for a in x]
    if all(value is not None for value in numbers):
        return Sum.number(float(OPERATIONS[op].apply(*numbers)))
    match op:
        case "add":
            return x[0] + x[1]
        case "sub":
            return x[0] + x[1].scaled(-1.0)
        case "neg":
            return x[0].scaled(-1.0)
        case "mul":
            return x[0] * x[1]
        case "div":
            return x[0] * x[1].power(-1.0)
        case "sqrt":
            return x[0].power(0.5)
        case "eq" | "ne":  # of derivatives of kinks
            raise TooLong("a condition that holds at single points")
        case "pow" if numbers[1] is not None:
            return x[0].power(numbers[1])
        case _:
            return Sum.factor(Function(op, tuple(x)))


# --- as text ---

_NAMES = {"rem": "mod", "select": "if"}
_SIGNS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "and": "and", "or": "or"}
_LATEX_FUNCTIONS = {"sin", "cos", "tan", "exp", "log", "sinh", "cosh", "tanh", "max", "min"}


def write_plain(total: Sum) -> str:
    """A sum as plain text."""
    return _write(total, is_latex=False)


def write_latex(total: Sum) -> str:
    """A sum in LaTeX."""
    return _write(total, is_latex=True)


def _write(total: Sum, *, is_latex: bool) -> str:
    text = ""
    for product, coefficient in sorted(total.terms, key=lambda term: bool(term[0])):
        factors = [_write_power(f, p, is_latex=is_latex) for f, p in product]
        size = abs(coefficient)
        is_one = math.isclose(size, 1.0, rel_tol=0.5 * 10.0**-_COEFFICIENT_DIGITS) and factors
        number = [] if is_one else [_write_number(size, is_latex=is_latex)]
        term = (r"\, " if is_latex else " ").join([*number, *factors])
        sign = "-" if coefficient < 0 else "+"
        text += f" {sign} {term}" if text else f"{sign * (coefficient < 0)}{term}"
    return text or "0"


def _write_number(size: float, *, is_latex: bool) -> str:
    text = f"{size:.{_COEFFICIENT_DIGITS}g}"
    mantissa, _, exponent = text.partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if is_latex and exponent else text


def _write_power(factor: Factor, power: float, *, is_latex: bool) -> str:
    text = _write_factor(factor, is_latex=is_latex)
    if power == 1:
        return text
    if isinstance(factor, Symbol) and "'" in text and not is_latex:
        text = f"({text})" if " " in text else text
    exponent = f"{power:g}"
    return f"{text}^{{{exponent}}}" if is_latex else f"{text}^{exponent}"


def _write_factor(factor: Factor, *, is_latex: bool) -> str:
    if isinstance(factor, Symbol):
        return factor.latex if is_latex else factor.text
    parts = [_write(x, is_latex=is_latex) for x in factor.arguments]
    left, right = (r"\left(", r"\right)") if is_latex else ("(", ")")
    if factor.name == "group":
        return f"{left}{parts[0]}{right}"
    if factor.name in _SIGNS:
        return f"{left}{f' {_SIGNS[factor.name]} '.join(parts)}{right}"
    if factor.name == "abs":
        return rf"\left|{parts[0]}\right|" if is_latex else f"|{parts[0]}|"
    name = _NAMES.get(factor.name, factor.name)
    if is_latex:
        name = rf"\{name}" if name in _LATEX_FUNCTIONS else rf"\operatorname{{{name}}}"
    return f"{name}{left}{', '.join(parts)}{right}"
