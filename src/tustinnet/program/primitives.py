"""What JAX's primitives are in a program: one rule each."""

import math
from collections.abc import Callable
from functools import reduce
from itertools import accumulate
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.lax import RoundingMethod

from tustinnet.program.program import OPERATIONS
from tustinnet.program.tape import Tape

Ids = np.ndarray  # numbers of nodes, in the shape of the array that they are

_DENSE = 32  # products from which a matrix stays one
_FULL = 0.25  # share of a matrix that is not 0, from which it stays one


class Refused(Exception):
    """A primitive, or what is asked of it, has no rule."""


def elementwise(tape: Tape, op: Callable[..., int], arrays: list[Ids]) -> Ids:
    """An operation on every number of arrays of one shape; long vectors stay vectors.

    Args:
        tape: the program.
        op: from numbers of nodes to that of the result.
        arrays: of one shape, or scalars.
    """
    shape = np.broadcast_shapes(*(a.shape for a in arrays))
    arrays = [np.broadcast_to(a, shape) for a in arrays]
    if not shape or not math.prod(shape):
        return np.array(op(*(int(a) for a in arrays)) if not shape else arrays[0])
    out = np.empty(shape, int)
    for row in np.ndindex(shape[:-1]):
        rows = [a[row] for a in arrays]
        if any(tape.is_vector(r) for r in rows):
            same = [int(r[0]) if (r == r[0]).all() else tape.vector(r) for r in rows]
            out[row] = tape.split(op(*same))  # of one number, that everywhere
        else:
            out[row] = [op(*map(int, of)) for of in zip(*rows, strict=True)]
    return out


def _applied(op: str) -> Callable[..., Ids]:
    def rule(tape: Tape, params: dict[str, Any], *arrays: Ids) -> Ids:
        return elementwise(tape, lambda *of: tape.apply(op, *of), list(arrays))

    return rule


def _composed(formula: Callable[..., int]) -> Callable[..., Ids]:
    """A rule for what is made of several operations: `formula(tape, params, *numbers)`."""

    def rule(tape: Tape, params: dict[str, Any], *arrays: Ids) -> Ids:
        return elementwise(tape, lambda *of: formula(tape, params, *of), list(arrays))

    return rule


def _power(tape: Tape, params: dict[str, Any], x: int) -> int:
    """An integer power by repeated squares."""
    exponent, result, square = abs(params["y"]), None, x
    while exponent:
        if exponent % 2:
            result = square if result is None else tape.apply("mul", result, square)
        exponent //= 2
        square = tape.apply("mul", square, square) if exponent else square
    if result is None:
        return tape.number(1.0)
    return result if params["y"] > 0 else tape.apply("div", tape.number(1.0), result)


def _logistic(tape: Tape, params: dict[str, Any], x: int) -> int:
    one = tape.number(1.0)
    return tape.apply("div", one, tape.apply("add", one, tape.apply("exp", tape.apply("neg", x))))


def _cube_root(tape: Tape, params: dict[str, Any], x: int) -> int:
    root = tape.apply("pow", tape.apply("abs", x), tape.number(1 / 3))
    return tape.apply("mul", tape.apply("sign", x), root)


def _round(tape: Tape, params: dict[str, Any], x: int) -> int:
    """To the nearest whole number; halves away from zero, or to the even one."""
    half, one = tape.number(0.5), tape.number(1.0)
    if params["rounding_method"] == RoundingMethod.AWAY_FROM_ZERO:
        size = tape.apply("floor", tape.apply("add", tape.apply("abs", x), half))
        return tape.apply("mul", tape.apply("sign", x), size)
    up = tape.apply("floor", tape.apply("add", x, half))
    tie = tape.apply("eq", tape.apply("sub", up, x), half)
    odd = tape.apply("ne", tape.apply("rem", up, tape.number(2.0)), tape.number(0.0))
    return tape.apply("select", tape.apply("and", tie, odd), tape.apply("sub", up, one), up)


def _select(tape: Tape, params: dict[str, Any], which: int, *cases: int) -> int:
    if tape[which].truth:
        return tape.apply("select", which, cases[1], cases[0])
    chosen = cases[-1]
    for i in range(len(cases) - 2, -1, -1):
        here = tape.apply("eq", which, tape.number(float(i)))
        chosen = tape.apply("select", here, cases[i], chosen)
    return chosen


def _clamp(tape: Tape, params: dict[str, Any], low: int, x: int, high: int) -> int:
    return tape.apply("min", tape.apply("max", x, low), high)


def _converted(tape: Tape, params: dict[str, Any], x: int) -> int:
    kind = np.dtype(params["new_dtype"]).kind
    if kind == "b":
        return x if tape[x].truth else tape.apply("ne", x, tape.number(0.0))
    if tape[x].truth:
        return tape.apply("select", x, tape.number(1.0), tape.number(0.0))
    if kind in "iu":
        below, above = tape.apply("floor", x), tape.apply("ceil", x)
        return tape.apply("select", tape.apply("ge", x, tape.number(0.0)), below, above)
    return x


def _reduced(op: str) -> Callable[..., Ids]:
    def rule(tape: Tape, params: dict[str, Any], array: Ids) -> Ids:
        axes = params["axes"]
        kept = [i for i in range(array.ndim) if i not in axes]
        rows = array.transpose(*kept, *axes).reshape([array.shape[i] for i in kept] + [-1])
        parts = [np.asarray(part) for part in np.moveaxis(rows, -1, 0)]
        if not parts:
            raise Refused("of nothing")
        return reduce(
            lambda a, b: elementwise(tape, lambda *of: tape.apply(op, *of), [a, b]), parts
        )

    return rule


def _cumulated(op: str) -> Callable[..., Ids]:
    def rule(tape: Tape, params: dict[str, Any], array: Ids) -> Ids:
        moved = np.moveaxis(array, params["axis"], 0)
        rows = [np.asarray(row) for row in (moved[::-1] if params["reverse"] else moved)]
        found = accumulate(
            rows, lambda a, b: elementwise(tape, lambda *of: tape.apply(op, *of), [a, b])
        )
        out = np.stack(list(found))
        return np.moveaxis(out[::-1] if params["reverse"] else out, 0, params["axis"])

    return rule


def multiplied(tape: Tape, params: dict[str, Any], left: Any, right: Any) -> Ids:
    """Products of arrays (`dot_general`), of which one may be constant: a float array.

    A large constant matrix stays one; everything else is written out.
    """
    (of_left, of_right), (many_left, many_right) = params["dimension_numbers"]
    a, b = _arranged(left, many_left, of_left), _arranged(right, many_right, of_right)
    rows, columns = a.shape[1], b.shape[1]
    out = np.empty((len(a), rows, columns), int)
    for i in range(len(a)):
        if a.dtype.kind == "f":
            out[i] = np.stack([_product(tape, a[i], v) for v in b[i]], 1) if columns else 0
        elif b.dtype.kind == "f":
            out[i] = np.stack([_product(tape, b[i], v) for v in a[i]]) if rows else 0
        else:
            for row, column in np.ndindex(rows, columns):
                out[i, row, column] = _dot(tape, a[i, row], b[i, column])
    return out.reshape(_shape_of_product(params, np.shape(left), np.shape(right)))


def _arranged(array: Any, many: Any, contracted: Any) -> Any:
    """An array as (batch, free, contracted)."""
    free = [i for i in range(array.ndim) if i not in (*many, *contracted)]
    size = [math.prod(array.shape[i] for i in axes) for axes in (many, free, contracted)]
    return array.transpose(*many, *free, *contracted).reshape(size)


def _shape_of_product(params: Any, left: tuple[int, ...], right: tuple[int, ...]) -> list[int]:
    (of_left, of_right), (many_left, many_right) = params["dimension_numbers"]
    free_left = [n for i, n in enumerate(left) if i not in (*of_left, *many_left)]
    free_right = [n for i, n in enumerate(right) if i not in (*of_right, *many_right)]
    return [left[i] for i in many_left] + free_left + free_right


def _product(tape: Tape, matrix: np.ndarray, vector: Ids) -> list[int]:
    """A constant matrix times a vector of numbers."""
    filled = np.count_nonzero(matrix)
    if matrix.size >= _DENSE and filled >= _FULL * matrix.size:
        return tape.product(np.asarray(matrix, np.float64), vector)
    return [_dot(tape, np.array([tape.number(w) for w in row], int), vector) for row in matrix]


def _dot(tape: Tape, a: Ids, b: Ids) -> int:
    total = tape.number(0.0)
    for x, y in zip(a.tolist(), b.tolist(), strict=True):
        total = tape.apply("add", total, tape.apply("mul", x, y))
    return total


def _cholesky(tape: Tape, params: dict[str, Any], array: Ids) -> Ids:
    """The lower factor of symmetric matrices, written out."""
    zero, n = tape.number(0.0), array.shape[-1]
    out = np.full(array.shape, zero)
    for at in np.ndindex(array.shape[:-2]):
        low = out[at]
        for j in range(n):
            left = tape.apply("sub", int(array[at][j, j]), _dot(tape, low[j, :j], low[j, :j]))
            low[j, j] = tape.apply("sqrt", left)
            for i in range(j + 1, n):
                left = tape.apply("sub", int(array[at][i, j]), _dot(tape, low[i, :j], low[j, :j]))
                low[i, j] = tape.apply("div", left, int(low[j, j]))
    return out


def _triangular(tape: Tape, params: dict[str, Any], a: Ids, b: Ids) -> Ids:
    """Solutions of triangular systems, written out."""
    if a.ndim != 2 or params["conjugate_a"]:
        raise Refused("of several matrices")
    if not params["left_side"]:
        turned = {**params, "left_side": True, "transpose_a": not params["transpose_a"]}
        return _triangular(tape, turned, a, b.T).T
    matrix, lower = (a.T, not params["lower"]) if params["transpose_a"] else (a, params["lower"])
    n = len(matrix)
    out = np.full(b.shape, tape.number(0.0))
    for column in range(b.shape[1]):
        for i in range(n) if lower else range(n - 1, -1, -1):
            known = slice(0, i) if lower else slice(i + 1, n)
            sums = _dot(tape, matrix[i, known], out[known, column])
            left = tape.apply("sub", int(b[i, column]), sums)
            if not params["unit_diagonal"]:
                left = tape.apply("div", left, int(matrix[i, i]))
            out[i, column] = left
    return out


# from arrays of numbers of nodes to such arrays; most are called like what JAX calls them
RULES: dict[str, Callable[..., Ids]] = {
    **{name: _applied(name) for name in OPERATIONS if name != "select"},
    "add_any": _applied("add"),
    "integer_pow": _composed(_power),
    "square": _composed(lambda tape, params, x: tape.apply("mul", x, x)),
    "rsqrt": _composed(
        lambda tape, params, x: tape.apply("div", tape.number(1.0), tape.apply("sqrt", x))
    ),
    "cbrt": _composed(_cube_root),
    "exp2": _composed(lambda tape, params, x: tape.apply("pow", tape.number(2.0), x)),
    "logistic": _composed(_logistic),
    "round": _composed(_round),
    "select_n": _composed(_select),
    "clamp": _composed(_clamp),
    "convert_element_type": _composed(_converted),
    "reduce_sum": _reduced("add"),
    "reduce_prod": _reduced("mul"),
    "reduce_max": _reduced("max"),
    "reduce_min": _reduced("min"),
    "reduce_and": _reduced("and"),
    "reduce_or": _reduced("or"),
    "cumsum": _cumulated("add"),
    "cumprod": _cumulated("mul"),
    "cummax": _cumulated("max"),
    "cummin": _cumulated("min"),
    "cholesky": _cholesky,
    "triangular_solve": _triangular,
    "stop_gradient": lambda tape, params, x: x,
    "copy": lambda tape, params, x: x,
    "copy_p": lambda tape, params, x: x,
    "reduce_precision": lambda tape, params, x: x,
}


def _padded(params: dict[str, Any], array: Any, value: Any) -> Any:
    low, high, between = zip(*params["padding_config"], strict=True)
    if any(between) or min(low) < 0 or min(high) < 0:
        raise Refused("that cuts, or pads between numbers")
    shape = [n + a + b for n, a, b in zip(array.shape, low, high, strict=True)]
    out = np.full(shape, value)
    out[tuple(slice(a, a + n) for a, n in zip(low, array.shape, strict=True))] = array
    return out


def _broadcast(params: dict[str, Any], array: Any) -> Any:
    shape = [1] * len(params["shape"])
    for i, at in enumerate(params["broadcast_dimensions"]):
        shape[at] = array.shape[i]
    return np.broadcast_to(array.reshape(shape), params["shape"])


def _sliced(params: dict[str, Any], array: Any) -> Any:
    steps = params["strides"] or (1,) * array.ndim
    bounds = zip(params["start_indices"], params["limit_indices"], steps, strict=True)
    return array[tuple(slice(*of) for of in bounds)]


def _split(params: dict[str, Any], array: Any) -> list[Any]:
    ends = np.cumsum(params["sizes"])[:-1]
    return np.split(array, ends.tolist(), params["axis"])


# those that only move numbers, as NumPy does it, of constants as of nodes
MOVES: dict[str, Callable[..., Any]] = {
    "slice": _sliced,
    "reshape": lambda params, a: a.reshape(params["new_sizes"]),
    "squeeze": lambda params, a: a.squeeze(params["dimensions"]),
    "expand_dims": lambda params, a: np.expand_dims(a, params["dimensions"]),
    "transpose": lambda params, a: a.transpose(params["permutation"]),
    "broadcast_in_dim": _broadcast,
    "rev": lambda params, a: np.flip(a, params["dimensions"]),
    "concatenate": lambda params, *a: np.concatenate(a, params["dimension"]),
    "stack": lambda params, *a: np.stack(a, params["axis"]),
    "split": _split,
    "pad": _padded,
}
# those that move by indices: how many of their operands are moved, the others must be constant
INDEXED = {
    "gather": (0,), "dynamic_slice": (0,), "dynamic_update_slice": (0, 1), "scatter": (0, 2),
    "tile": (0,),
}  # fmt: skip


def move_by_index(primitive: Any, params: dict[str, Any], operands: list[Any]) -> Ids:
    """What a primitive that moves by constant indices does to arrays of nodes.

    It is done to the numbers of the nodes themselves.

    Raises:
        Refused: it would read beyond the end.
    """
    moved = INDEXED[primitive.name]
    places = [jnp.asarray(of, jnp.int32 if i in moved else None) for i, of in enumerate(operands)]
    found = np.asarray(primitive.bind(*places, **params))
    if (found < 0).any():
        raise Refused("beyond the end of an array")
    return found.astype(int)


def scattered(tape: Tape, primitive: Any, params: dict[str, Any], operands: list[Any]) -> Ids:
    """What `scatter-add` with constant indices does: where each number goes is tried one by one."""
    into, where, added = operands
    ones = np.eye(added.size).reshape(added.size, *added.shape)
    zeros = jnp.zeros(into.shape)
    goes = [np.ravel(primitive.bind(zeros, where, jnp.asarray(one), **params)) for one in ones]
    out = into.ravel().copy()
    for number, places in zip(added.ravel().tolist(), goes, strict=True):
        for place in np.flatnonzero(places):
            out[place] = tape.apply("add", int(out[place]), number)
    return out.reshape(into.shape)
