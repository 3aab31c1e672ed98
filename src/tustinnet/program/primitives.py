"""Rules that translate JAX's primitives into nodes of a program."""

import math
from collections.abc import Callable
from functools import partial, reduce
from itertools import accumulate
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.lax import GatherScatterMode, RoundingMethod

from tustinnet.program.program import OPERATIONS
from tustinnet.program.tape import NodeTerm, Tape

Ids = np.ndarray  # numbers of nodes, in the shape of the array that they stand for

_DENSE = 32  # products from which a matrix stays one
_FULL = 0.25  # share of a matrix that is not 0, from which it stays one
_MOST_PLACES = 256  # of a table that is read by a computed index
_LARGEST = float(np.finfo(np.float64).max)


class UnsupportedPrimitive(Exception):
    """A primitive, or its use, that has no rule.

    Attributes:
        name: the primitive's name, once that is known.
        place: function and line in which it was written, once that is known.
    """

    name: str = ""
    place: str = ""


def elementwise(tape: Tape, op: Callable[..., int], arrays: list[Ids]) -> Ids:
    """Nodes of an operation on every number of arrays of one shape; long vectors stay vectors.

    Args:
        tape: the program.
        op: from numbers of nodes to the number of the result.
        arrays: arrays of one shape, or scalars.
    """
    shape = np.broadcast_shapes(*(a.shape for a in arrays))
    arrays = [np.broadcast_to(a, shape) for a in arrays]
    if not shape or not math.prod(shape):
        return np.array(op(*(int(a) for a in arrays)) if not shape else arrays[0])
    out = np.empty(shape, int)
    for row in np.ndindex(shape[:-1]):
        rows = [a[row] for a in arrays]
        if any(tape.is_vector(r) for r in rows):
            # one number everywhere stays a number
            operands = [int(r[0]) if (r == r[0]).all() else tape.vector(r) for r in rows]
            out[row] = tape.split(op(*operands))
        else:
            out[row] = [op(*map(int, numbers)) for numbers in zip(*rows, strict=True)]
    return out


def _elementwise_rule(op: str) -> Callable[..., Ids]:
    def rule(tape: Tape, params: dict[str, Any], *arrays: Ids) -> Ids:
        return elementwise(tape, partial(tape.apply, op), list(arrays))

    return rule


def _formula_rule(formula: Callable[..., NodeTerm | float]) -> Callable[..., Ids]:
    """A rule made of several operations: `formula(params, *terms)` for every number."""

    def rule(tape: Tape, params: dict[str, Any], *arrays: Ids) -> Ids:
        def op(*numbers: int) -> int:
            result = formula(params, *(NodeTerm(tape, number) for number in numbers))
            return result.number if isinstance(result, NodeTerm) else tape.number(result)

        return elementwise(tape, op, list(arrays))

    return rule


def _power(params: dict[str, Any], x: NodeTerm) -> NodeTerm | float:
    """An integer power by repeated squares."""
    exponent, result, square = abs(params["y"]), None, x
    while exponent:
        if exponent % 2:
            result = square if result is None else result * square
        exponent //= 2
        square = square * square if exponent else square
    if result is None:
        return 1.0
    return result if params["y"] > 0 else 1.0 / result


def _polynomial(params: dict[str, Any], x: NodeTerm, *coefficients: NodeTerm) -> NodeTerm:
    """A polynomial by Horner's rule; its constant term is the first coefficient."""
    return reduce(lambda value, c: value * x + c, reversed(coefficients))


def _round(params: dict[str, Any], x: NodeTerm) -> NodeTerm:
    """The nearest whole number; halves are rounded away from zero, or to the even one."""
    if params["rounding_method"] == RoundingMethod.AWAY_FROM_ZERO:
        return x.apply("sign") * (x.apply("abs") + 0.5).apply("floor")
    up = (x + 0.5).apply("floor")
    is_tie, is_odd = (up - x).apply("eq", 0.5), up.apply("rem", 2.0).apply("ne", 0.0)
    return is_tie.apply("and", is_odd).choose(up - 1.0, up)


def _select(params: dict[str, Any], which: NodeTerm, *cases: NodeTerm) -> NodeTerm:
    if which.tape[which.number].truth:
        return which.choose(cases[1], cases[0])
    result = cases[-1]
    for i in range(len(cases) - 2, -1, -1):
        result = which.apply("eq", float(i)).choose(cases[i], result)
    return result


def _convert(params: dict[str, Any], x: NodeTerm) -> NodeTerm:
    kind, is_truth = np.dtype(params["new_dtype"]).kind, x.tape[x.number].truth
    if kind == "b":
        return x if is_truth else x.apply("ne", 0.0)
    if is_truth:
        return x.choose(1.0, 0.0)
    if kind in "iu":
        return x.apply("ge", 0.0).choose(x.apply("floor"), x.apply("ceil"))
    return x


def _is_less(params: dict[str, Any], a: NodeTerm, b: NodeTerm) -> NodeTerm:
    """Whether a comes before b, and NaN after all numbers.

    JAX itself replaces zeros and NaN by those without a sign before it compares so.
    """
    is_last = a.apply("eq", a).apply("and", b.apply("ne", b))
    return a.apply("lt", b).apply("or", is_last)


def _extremum_rule(op: str) -> Callable[..., Ids]:
    """The rule of `argmax`, or `argmin`: the first index of an extremum, or of a NaN."""

    def is_better(params: dict[str, Any], x: NodeTerm, best: NodeTerm) -> NodeTerm:
        is_nan = x.apply("ne", x).apply("and", best.apply("eq", best))
        return x.apply(op, best).apply("or", is_nan)

    choose = _elementwise_rule("select")

    def rule(tape: Tape, params: dict[str, Any], array: Ids) -> Ids:
        numbers = _formula_rule(_convert)(tape, {"new_dtype": np.float64}, array)
        best, *others = map(np.asarray, np.moveaxis(numbers, params["axes"][0], 0))
        index = np.full(best.shape, tape.number(0.0))
        for i, row in enumerate(others, 1):
            better = _formula_rule(is_better)(tape, params, row, best)
            best = choose(tape, params, better, row, best)
            index = choose(tape, params, better, np.array(tape.number(float(i))), index)
        return index

    return rule


def _reduction_rule(op: str) -> Callable[..., Ids]:
    def rule(tape: Tape, params: dict[str, Any], array: Ids) -> Ids:
        axes = params["axes"]
        others = [i for i in range(array.ndim) if i not in axes]
        rows = array.transpose(*others, *axes).reshape([array.shape[i] for i in others] + [-1])
        parts = [np.asarray(part) for part in np.moveaxis(rows, -1, 0)]
        if not parts:
            raise UnsupportedPrimitive("of nothing")
        return reduce(lambda a, b: elementwise(tape, partial(tape.apply, op), [a, b]), parts)

    return rule


def _cumulation_rule(op: str) -> Callable[..., Ids]:
    def rule(tape: Tape, params: dict[str, Any], array: Ids) -> Ids:
        moved = np.moveaxis(array, params["axis"], 0)
        rows = [np.asarray(row) for row in (moved[::-1] if params["reverse"] else moved)]
        sums = accumulate(rows, lambda a, b: elementwise(tape, partial(tape.apply, op), [a, b]))
        out = np.stack(list(sums))
        return np.moveaxis(out[::-1] if params["reverse"] else out, 0, params["axis"])

    return rule


def multiply(tape: Tape, params: dict[str, Any], first: Any, second: Any) -> Ids:
    """Nodes of a product of arrays (`dot_general`), of which one may be constant: a float array.

    A large constant matrix stays one; everything else is written out.
    """
    contracted, batched = params["dimension_numbers"]
    a = _arrange(first, batched[0], contracted[0])
    b = _arrange(second, batched[1], contracted[1])
    rows, columns = a.shape[1], b.shape[1]
    out = np.empty((len(a), rows, columns), int)
    for i in range(len(a)):
        if a.dtype.kind == "f":
            out[i] = np.stack([_product(tape, a[i], v) for v in b[i]], 1) if columns else 0
        elif b.dtype.kind == "f":
            out[i] = np.stack([_product(tape, b[i], v) for v in a[i]]) if rows else 0
        elif columns and any(tape.is_vector(v) for v in b[i].T):
            out[i] = [_combination(tape, numbers, b[i].T) for numbers in a[i]]
        else:
            for row, column in np.ndindex(rows, columns):
                out[i, row, column] = _dot(tape, a[i, row], b[i, column])
    shape = [first.shape[i] for i in batched[0]]
    for array, *axes in zip((first, second), contracted, batched, strict=True):
        shape += [n for i, n in enumerate(array.shape) if not any(i in part for part in axes)]
    return out.reshape(shape)


def _arrange(array: Any, batched: Any, contracted: Any) -> Any:
    """An array as (batch, free, contracted)."""
    free = [i for i in range(array.ndim) if i not in (*batched, *contracted)]
    size = [math.prod(array.shape[i] for i in axes) for axes in (batched, free, contracted)]
    return array.transpose(*batched, *free, *contracted).reshape(size)


def _product(tape: Tape, matrix: np.ndarray, vector: Ids) -> list[int]:
    """Nodes of a constant matrix times a vector of numbers."""
    nonzero = np.count_nonzero(matrix)
    if matrix.size >= _DENSE and nonzero >= _FULL * matrix.size:
        return tape.split(tape.product(np.asarray(matrix, np.float64), tape.vector(vector)))
    used = [np.flatnonzero(row) for row in matrix]
    return [
        _dot(tape, np.array([tape.number(w) for w in row[i]], int), vector[i])
        for row, i in zip(matrix, used, strict=True)
    ]


def _combination(tape: Tape, numbers: Ids, vectors: Ids) -> Ids:
    """Nodes of the sum of vectors, each times a number."""
    total = np.full(vectors.shape[1], tape.number(0.0))
    for number, vector in zip(numbers, vectors, strict=True):
        term = elementwise(tape, partial(tape.apply, "mul"), [number, vector])
        total = elementwise(tape, partial(tape.apply, "add"), [total, term])
    return total


def _dot(tape: Tape, a: Ids, b: Ids) -> int:
    total = zero = tape.number(0.0)
    for x, y in zip(a.tolist(), b.tolist(), strict=True):
        if x != zero and y != zero:
            total = tape.apply("add", total, tape.apply("mul", x, y))
    return total


def _cholesky(tape: Tape, params: dict[str, Any], array: Ids) -> Ids:
    """Nodes of the lower Cholesky factor of symmetric matrices, written out."""
    zero, n = tape.number(0.0), array.shape[-1]
    out = np.full(array.shape, zero)
    for batch in np.ndindex(array.shape[:-2]):
        matrix, low = array[batch], out[batch]
        for j in range(n):
            rest = tape.apply("sub", int(matrix[j, j]), _dot(tape, low[j, :j], low[j, :j]))
            low[j, j] = tape.apply("sqrt", rest)
            for i in range(j + 1, n):
                rest = tape.apply("sub", int(matrix[i, j]), _dot(tape, low[i, :j], low[j, :j]))
                low[i, j] = tape.apply("div", rest, int(low[j, j]))
    return out


def _triangular(tape: Tape, params: dict[str, Any], a: Ids, b: Ids) -> Ids:
    """Nodes of the solutions of triangular systems, written out."""
    if a.ndim != 2 or params["conjugate_a"]:
        raise UnsupportedPrimitive("of several matrices")
    if not params["left_side"]:
        transposed = {**params, "left_side": True, "transpose_a": not params["transpose_a"]}
        return _triangular(tape, transposed, a, b.T).T
    matrix, lower = (a.T, not params["lower"]) if params["transpose_a"] else (a, params["lower"])
    n = len(matrix)
    out = np.full(b.shape, tape.number(0.0))
    # by rows, as long ones are vectors
    for i in range(n) if lower else range(n - 1, -1, -1):
        solved = slice(0, i) if lower else slice(i + 1, n)
        known = _combination(tape, matrix[i, solved], out[solved])
        rest = elementwise(tape, partial(tape.apply, "sub"), [b[i], known])
        if not params["unit_diagonal"]:
            rest = elementwise(tape, partial(tape.apply, "div"), [rest, np.asarray(matrix[i, i])])
        out[i] = rest
    return out


# from arrays of numbers of nodes to such arrays, by the names of JAX's primitives
RULES: dict[str, Callable[..., Ids]] = {
    **{name: _elementwise_rule(name) for name in OPERATIONS if name != "select"},
    "add_any": _elementwise_rule("add"),
    "integer_pow": _formula_rule(_power),
    "square": _formula_rule(lambda params, x: x * x),
    "one_minus_square": _formula_rule(lambda params, x: (x + 1.0) * (1.0 - x)),
    "polynomial": _formula_rule(_polynomial),
    "rsqrt": _formula_rule(lambda params, x: 1.0 / x.apply("sqrt")),
    "cbrt": _formula_rule(lambda params, x: x.apply("sign") * x.apply("abs").apply("pow", 1 / 3)),
    "log2": _formula_rule(lambda params, x: x.apply("log") * (1.0 / math.log(2.0))),
    "exp2": _formula_rule(lambda params, x: x.constant(2.0).apply("pow", x)),
    "logistic": _formula_rule(lambda params, x: 1.0 / (x.constant(1.0) + (-x).apply("exp"))),
    "round": _formula_rule(_round),
    "select_n": _formula_rule(_select),
    "clamp": _formula_rule(lambda params, low, x, high: x.apply("max", low).apply("min", high)),
    "convert_element_type": _formula_rule(_convert),
    "lt_to": _formula_rule(_is_less),
    "le_to": _formula_rule(lambda params, a, b: _is_less(params, b, a).apply("not")),
    "is_finite": _formula_rule(lambda params, x: x.apply("abs").apply("le", _LARGEST)),
    "argmax": _extremum_rule("gt"),
    "argmin": _extremum_rule("lt"),
    "reduce_sum": _reduction_rule("add"),
    "reduce_prod": _reduction_rule("mul"),
    "reduce_max": _reduction_rule("max"),
    "reduce_min": _reduction_rule("min"),
    "reduce_and": _reduction_rule("and"),
    "reduce_or": _reduction_rule("or"),
    "cumsum": _cumulation_rule("add"),
    "cumprod": _cumulation_rule("mul"),
    "cummax": _cumulation_rule("max"),
    "cummin": _cumulation_rule("min"),
    "cholesky": _cholesky,
    "triangular_solve": _triangular,
    "stop_gradient": lambda tape, params, x: x,
    "copy": lambda tape, params, x: x,
    "copy_p": lambda tape, params, x: x,
    "reduce_precision": lambda tape, params, x: x,
}


def _pad(params: dict[str, Any], array: Any, value: Any) -> Any:
    low, high, between = zip(*params["padding_config"], strict=True)
    if any(between) or min(low) < 0 or min(high) < 0:
        raise UnsupportedPrimitive("that cuts, or pads between numbers")
    shape = [n + a + b for n, a, b in zip(array.shape, low, high, strict=True)]
    out = np.full(shape, value)
    out[tuple(slice(a, a + n) for a, n in zip(low, array.shape, strict=True))] = array
    return out


def _broadcast(params: dict[str, Any], array: Any) -> Any:
    shape = [1] * len(params["shape"])
    for i, axis in enumerate(params["broadcast_dimensions"]):
        shape[axis] = array.shape[i]
    return np.broadcast_to(array.reshape(shape), params["shape"])


def _slice(params: dict[str, Any], array: Any) -> Any:
    steps = params["strides"] or (1,) * array.ndim
    bounds = zip(params["start_indices"], params["limit_indices"], steps, strict=True)
    return array[tuple(slice(*ends) for ends in bounds)]


def _split(params: dict[str, Any], array: Any) -> list[Any]:
    ends = np.cumsum(params["sizes"])[:-1]
    return np.split(array, ends.tolist(), params["axis"])


# primitives that only move numbers, as NumPy does it, of constants as of nodes
MOVES: dict[str, Callable[..., Any]] = {
    "slice": _slice,
    "reshape": lambda params, a: a.reshape(params["new_sizes"]),
    "squeeze": lambda params, a: a.squeeze(params["dimensions"]),
    "expand_dims": lambda params, a: np.expand_dims(a, params["dimensions"]),
    "transpose": lambda params, a: a.transpose(params["permutation"]),
    "broadcast_in_dim": _broadcast,
    "rev": lambda params, a: np.flip(a, params["dimensions"]),
    "concatenate": lambda params, *a: np.concatenate(a, params["dimension"]),
    "stack": lambda params, *a: np.stack(a, params["axis"]),
    "split": _split,
    "unstack": lambda params, a: [np.asarray(part) for part in np.moveaxis(a, params["axis"], 0)],
    "pad": _pad,
}
# primitives that move by indices: places of the moved operands, the others must be constant
INDEXED = {
    "gather": (0,),
    "dynamic_slice": (0,),
    "dynamic_update_slice": (0, 1),
    "scatter": (0, 2),
    "tile": (0,),
}


def move_by_index(primitive: Any, params: dict[str, Any], operands: list[Any]) -> Ids:
    """Nodes of a primitive that moves numbers by constant indices.

    The primitive is applied to the numbers of the nodes themselves.

    Raises:
        UnsupportedPrimitive: it would read beyond the end of an array.
    """
    moved = INDEXED[primitive.name]
    arrays = [jnp.asarray(a, jnp.int32 if i in moved else None) for i, a in enumerate(operands)]
    ids = np.asarray(primitive.bind(*arrays, **params))
    if (ids < 0).any():
        raise UnsupportedPrimitive("beyond the end of an array")
    return ids.astype(int)


def read_by_index(
    tape: Tape, name: str, params: dict[str, Any], array: Ids, indices: list[Ids]
) -> Ids:
    """Nodes of `gather` or `dynamic_slice` by computed indices: one of all places is selected.

    Args:
        tape: the program.
        name: the primitive.
        params: its parameters.
        array: the array that is read.
        indices: the index of each axis, or of `gather` one array of all.

    Raises:
        UnsupportedPrimitive: there are too many places, or what is beyond the end is filled.
    """
    sizes = params["slice_sizes"]
    if name == "dynamic_slice":
        axes, dropped, kept = tuple(range(array.ndim)), (), tuple(range(array.ndim))
    else:
        layout = params["dimension_numbers"]
        axes, dropped, kept = (
            layout.start_index_map,
            layout.collapsed_slice_dims,
            layout.offset_dims,
        )
        indices = list(np.moveaxis(indices[0], -1, 0))
        if layout.operand_batching_dims or params["mode"] == GatherScatterMode.FILL_OR_DROP:
            raise UnsupportedPrimitive("by a computed index, as batched or filled")
    last = [array.shape[axis] - sizes[axis] for axis in axes]
    count = math.prod(n + 1 for n in last)
    if count > _MOST_PLACES:
        raise UnsupportedPrimitive(f"by a computed index, in more than {_MOST_PLACES} places")
    zero, which = tape.number(0.0), np.full(indices[0].shape, tape.number(0.0))
    for index, end in zip(indices, last, strict=True):

        def add_place(place: int, i: int, end: int = end) -> int:
            within = tape.apply("min", tape.apply("max", i, zero), tape.number(float(end)))
            row = tape.apply("mul", place, tape.number(end + 1.0))
            return tape.apply("add", row, within)

        which = elementwise(tape, add_place, [which, index])
    rank = which.ndim + len(kept)
    batch = tuple(axis for axis in range(rank) if axis not in kept)
    cases = []
    for place in np.ndindex(*(n + 1 for n in last)):
        starts = dict(zip(axes, place, strict=True))
        part = array[tuple(slice(b := starts.get(i, 0), b + n) for i, n in enumerate(sizes))]
        cases.append(np.expand_dims(part.squeeze(dropped), batch))
    return RULES["select_n"](tape, {}, np.expand_dims(which, kept), *cases)


def scatter_add(tape: Tape, primitive: Any, params: dict[str, Any], operands: list[Any]) -> Ids:
    """Nodes of `scatter-add` with constant indices.

    The place of each number is found by scattering a 1 in its place.
    """
    into, where, added = operands
    ones = np.eye(added.size).reshape(added.size, *added.shape)
    zeros = jnp.zeros(into.shape)
    masks = [np.ravel(primitive.bind(zeros, where, jnp.asarray(one), **params)) for one in ones]
    out = into.ravel().copy()
    for number, mask in zip(added.ravel().tolist(), masks, strict=True):
        for place in np.flatnonzero(mask):
            out[place] = tape.apply("add", int(out[place]), number)
    return out.reshape(into.shape)
