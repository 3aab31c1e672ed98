"""Elementary functions of all lanes at once, in LLVM's language.

LLVM has vectors' sums and products but no vectors' sines: it calls the C library for one number
after the other, which takes longer than all the rest of the equations of motion. Those that
equations and networks use most are written here; the others are called lane by lane. All compute
in double precision; numbers in single precision are widen and rounded.

References:
    Cody, Waite (1980), Software Manual for the Elementary Functions (reduction of the argument
    by a constant in several parts).
"""

from fractions import Fraction
from math import factorial, frexp

from tustinnet.engine.text import SYMBOL, Function, Module, float_bits

# called for one lane after the other, by their names in the C library
SCALAR = {
    "tan": 1,
    "asin": 1,
    "acos": 1,
    "atan": 1,
    "sinh": 1,
    "cosh": 1,
    "asinh": 1,
    "acosh": 1,
    "atanh": 1,
    "expm1": 1,
    "log": 1,
    "log1p": 1,
    "pow": 2,
    "atan2": 2,
    "fmod": 2,
    "sin": 1,
    "cos": 1,
}

_HALF_PI = Fraction(314159265358979323846264338327950288419716939937510582097494, 2 * 10**59)
_LOG_2 = Fraction(693147180559945309417232121458176568075500134360255254120680, 10**60)
_ROUNDING = 1.5 * 2.0**52  # added, it leaves the nearest whole number in the last bits
_REDUCED = 1e5  # largest angle that is reduced with three parts of pi / 2
_LARGEST_EXPONENT, _SMALLEST_EXPONENT = 710.0, -746.0  # beyond them exp is infinite, or 0
_SATURATED = 40.0  # of twice the argument: from there on tanh is 1


def _parts(number: Fraction, count: int) -> list[float]:
    """A number as a sum of floats; all but the last have 34 bits, so that multiples are exact."""
    parts, rest = [], number
    for _ in range(count - 1):
        unit = Fraction(2) ** (frexp(rest)[1] - 34)
        parts.append(float(rest // unit * unit))
        rest -= Fraction(parts[-1])
    return [*parts, float(rest)]


def widen(f: Function, x: str) -> str:
    """A value of the module converted to double precision."""
    m = f.module
    return x if m.wide is m else f.value(f"fpext {m.v} {x} to {m.wide.v}")


def narrow(f: Function, x: str) -> str:
    """A value in double precision converted to the precision of the module."""
    m = f.module
    return x if m.wide is m else f.value(f"fptrunc {m.wide.v} {x} to {m.v}")


def in_double(f: Function, name: str, *values: str) -> str:
    """A call of a function of this module, which computes in double precision."""
    v = f.module.wide.v
    arguments = ", ".join(f"{v} {widen(f, x)}" for x in values)
    return narrow(f, f.value(f"call {v} @{name}({arguments})"))


def scalar(module: Module, name: str) -> str:
    """A function of the C library for all lanes, one after the other; its name in the module."""

    def write() -> str:
        count = SCALAR[name]
        symbol = SYMBOL.format(name)
        arguments = [f"%a{i}" for i in range(count)]
        f = module.function(
            f"each.{name}", ", ".join(f"{module.v} {a}" for a in arguments), module.v
        )
        numbers = [
            f.value(
                f'call double @"{symbol}"('
                + ", ".join(f"double {f.lane(a, lane)}" for a in arguments)
                + ")"
            )
            for lane in range(module.lanes)
        ]
        f.line(f"ret {module.v} {f.together(numbers)}")
        return f'declare double @"{symbol}"({", ".join(["double"] * count)})\n' + f.text()

    return module.once(f"each.{name}", write)


def intrinsic(module: Module, name: str, arguments: int = 1) -> str:
    """A function of LLVM itself for all lanes; its name in the module."""
    number = f"f{8 * module.bytes}"
    suffix = number if module.lanes == 1 else f"v{module.lanes}{number}"
    full = f"llvm.{name}.{suffix}"
    types = ", ".join([module.v] * arguments)
    return module.once(full, lambda: f"declare {module.v} @{full}({types})")


def _whole_type(module: Module) -> str:
    return "i64" if module.lanes == 1 else f"<{module.lanes} x i64>"


def _whole(module: Module, value: int) -> str:
    return module.constant("i64", value)


def _nearest(f: Function, x: str, scale: float) -> tuple[str, str]:
    """The whole number nearest to `x scale`, as a number, and in the last bits of another."""
    m = f.module
    magic = m.number(_ROUNDING)
    product = f.apply("fmul", x, m.number(scale), exact=True)
    shifted = f.apply("fadd", product, magic, exact=True)
    return f.apply("fsub", shifted, magic, exact=True), f.value(
        f"bitcast {m.v} {shifted} to {_whole_type(m)}"
    )


def _without(f: Function, x: str, count: str, parts: list[float]) -> str:
    """`x` less a whole number of times a constant, which is given in parts."""
    for part in parts:
        product = f.apply("fmul", count, f.module.number(part), exact=True)
        x = f.apply("fsub", x, product, exact=True)
    return x


def _series(f: Function, z: str, coefficients: list[float]) -> str:
    """A polynomial, the constant coefficient first, by Horner's rule."""
    value = f.module.number(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = f.fma(value, z, f.module.number(coefficient))
    return value


def sine_and_cosine(module: Module) -> str:
    """Sine and cosine of an angle as a pair; the name of the function in the module."""

    def write() -> str:
        m, pair, kind = module, f"{{ {module.v}, {module.v} }}", _whole_type(module)
        f = m.function("sine.cosine", f"{m.v} %x", pair)
        slow, fast = f.label(), f.label()
        size = f.call(intrinsic(m, "fabs"), "%x")
        is_near = f.compare("olt", size, m.number(_REDUCED))
        is_far = f.value(f"xor {m.truth} {is_near}, {m.constant('i1', 'true')}")
        if m.lanes > 1:  # in some lane
            name = f"llvm.vector.reduce.or.v{m.lanes}i1"
            m.once(name, lambda: f"declare i1 @{name}({m.truth})")
            is_far = f.value(f"call i1 @{name}({m.truth} {is_far})")
        f.line(f"br i1 {is_far}, label %{slow}, label %{fast}")

        def return_pair(sine: str, cosine: str) -> None:
            one = f.value(f"insertvalue {pair} poison, {m.v} {sine}, 0")
            f.line(f"ret {pair} {f.value(f'insertvalue {pair} {one}, {m.v} {cosine}, 1')}")

        f.place(slow)  # far away, or no number
        return_pair(f.call(scalar(m, "sin"), "%x"), f.call(scalar(m, "cos"), "%x"))
        f.place(fast)
        quarters, bits = _nearest(f, "%x", float(1 / _HALF_PI))
        r = _without(f, "%x", quarters, _parts(_HALF_PI, 3))
        z = f.apply("fmul", r, r)
        odd = [(-1) ** k / factorial(2 * k + 1) for k in range(1, 9)]
        even = [(-1) ** k / factorial(2 * k) for k in range(2, 9)]
        sine = f.fma(f.apply("fmul", r, z), _series(f, z, odd), r)
        half = f.apply("fsub", m.number(1.0), f.apply("fmul", m.number(0.5), z), exact=True)
        cosine = f.fma(f.apply("fmul", z, z), _series(f, z, even), half)

        def in_quadrant(quadrant: str, a: str, b: str) -> str:
            """Sine or cosine as the quadrant says, with its sign."""
            last = f.value(f"and {kind} {quadrant}, {_whole(m, 1)}")
            swaps = f.value(f"icmp ne {kind} {last}, {_whole(m, 0)}")
            chosen = f.value(f"bitcast {m.v} {f.select(swaps, b, a)} to {kind}")
            second = f.value(f"and {kind} {quadrant}, {_whole(m, 2)}")
            sign = f.value(f"shl {kind} {second}, {_whole(m, 62)}")
            signed = f.value(f"xor {kind} {chosen}, {sign}")
            return f.value(f"bitcast {kind} {signed} to {m.v}")

        ahead = f.value(f"add {kind} {bits}, {_whole(m, 1)}")
        return_pair(in_quadrant(bits, sine, cosine), in_quadrant(ahead, sine, cosine))
        return f.text()

    return module.once("sine.cosine", write)


def _power_of_two(f: Function, exponent: str) -> str:
    """2 to a whole number."""
    m, kind = f.module, _whole_type(f.module)
    biased = f.value(f"add {kind} {exponent}, {_whole(m, 1023)}")
    return f.value(f"bitcast {kind} {f.value(f'shl {kind} {biased}, {_whole(m, 52)}')} to {m.v}")


def _exponent(f: Function, x: str) -> tuple[str, str]:
    """`x = n log 2 + r`: n as a whole number, and `exp(r) - 1`."""
    m, kind = f.module, _whole_type(f.module)
    count, bits = _nearest(f, x, float(1 / _LOG_2))
    n = f.value(f"sub {kind} {bits}, {_whole(m, float_bits(_ROUNDING))}")
    r = _without(f, x, count, _parts(_LOG_2, 2))
    rest = _series(f, r, [1 / factorial(k) for k in range(2, 14)])
    return n, f.fma(f.apply("fmul", r, r), rest, r)


def exponential(module: Module) -> str:
    """`exp`; the name of the function in the module."""

    def write() -> str:
        m, kind = module, _whole_type(module)
        f = m.function("exponential", f"{m.v} %x", m.v)
        high, low = m.number(_LARGEST_EXPONENT), m.number(_SMALLEST_EXPONENT)
        x = f.select(f.compare("ogt", "%x", high), high, "%x")
        x = f.select(f.compare("olt", x, low), low, x)
        n, rest = _exponent(f, x)
        value = f.apply("fadd", rest, m.number(1.0), exact=True)
        # in two steps, as the factor itself may be no number where the result is one
        half = f.value(f"ashr {kind} {n}, {_whole(m, 1)}")
        other = f.value(f"sub {kind} {n}, {half}")
        for part in (half, other):
            value = f.apply("fmul", value, _power_of_two(f, part), exact=True)
        f.line(f"ret {m.v} {value}")
        return f.text()

    return module.once("exponential", write)


def hyperbolic_tangent(module: Module) -> str:
    """`tanh`; the name of the function in the module."""

    def write() -> str:
        m = module
        f = m.function("hyperbolic.tangent", f"{m.v} %x", m.v)
        size = f.call(intrinsic(m, "fabs"), "%x")
        twice = f.apply("fadd", size, size)
        most = m.number(_SATURATED)
        twice = f.select(f.compare("ogt", twice, most), most, twice)
        n, rest = _exponent(f, twice)
        # exp(2 x) - 1 without the loss of digits that the difference would have near 0
        power = _power_of_two(f, n)
        less = f.apply("fsub", power, m.number(1.0), exact=True)
        grown = f.apply("fadd", f.apply("fmul", rest, power), less)
        below = f.apply("fadd", grown, m.number(2.0), exact=True)
        ratio = f.apply("fdiv", grown, below)
        f.line(f"ret {m.v} {f.call(intrinsic(m, 'copysign', 2), ratio, '%x')}")
        return f.text()

    return module.once("hyperbolic.tangent", write)
