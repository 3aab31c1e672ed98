"""Reading a function of JAX arrays as a program: the one way from models to all targets."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from tustinnet.errors import InputError
from tustinnet.program.primitives import (
    INDEXED,
    MOVES,
    RULES,
    Refused,
    move_by_index,
    multiplied,
    scattered,
)
from tustinnet.program.program import OPERATIONS, Factor, Loop, Program
from tustinnet.program.tape import Tape

_UNROLLED = 300  # operations up to which a loop is written out
_MOST = 200_000  # operations of a loop that can only be written out
_TURNS = 10_000  # of a loop that ends by a condition
# what holds a program of its own that is done once, and where
_CALLS = {
    "jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "remat": "jaxpr",
    "checkpoint": "jaxpr", "remat2": "jaxpr",
}  # fmt: skip


class Numbers:
    """An array of a program that is read: each place holds the number of a node.

    Attributes:
        ids: the numbers.
    """

    def __init__(self, ids: np.ndarray) -> None:
        self.ids = ids


class Matrix:
    """A matrix that a program is given: it only multiplies vectors.

    Attributes:
        factor: which one, and whether its transpose is meant.
        shape: of what is meant.
    """

    def __init__(self, factor: Factor, shape: tuple[int, int]) -> None:
        self.factor, self.shape = factor, shape

    def turned(self) -> "Matrix":
        """Its transpose."""
        name, transposed = self.factor
        rows, columns = self.shape
        return Matrix(Factor(name, not transposed), (columns, rows))


Value = np.ndarray | Numbers | Matrix  # known while reading, computed by the program, or given


def read(
    function: Callable[..., Mapping[str, Any]],
    inputs: Mapping[str, int],
    what: str = "program",
    matrices: Mapping[str, tuple[int, int]] | None = None,
) -> Program:
    """A function as a program.

    Args:
        function: of vectors in float64, and matrices behind them; returns vectors by name.
        inputs: the vectors that it is given, by name, and how many numbers each is.
        what: what is read, for messages.
        matrices: the matrices that it is given, by name, and their shapes.

    Raises:
        Unreadable: it uses what no rule is there for, or loops whose end depends on the state.
    """
    # in single precision where JAX knows no other; the program itself computes in double
    kind = jax.dtypes.canonicalize_dtype(np.float64)
    matrices = matrices or {}
    sizes = [*((size,) for size in inputs.values()), *matrices.values()]
    shapes = [jax.ShapeDtypeStruct(size, kind) for size in sizes]
    tape = Tape(dict(inputs), matrices)
    given: list[Value] = [Numbers(np.array(tape.input(name), int)) for name in inputs]
    given += [Matrix(Factor(name), size) for name, size in matrices.items()]
    reader = _Reader(tape, what)
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*shapes)
    with jax.ensure_compile_time_eval():  # a program may be read while another is compiled
        values = reader.run(closed.jaxpr, closed.consts, given)
    names = jax.tree.unflatten(jax.tree.structure(shape), range(len(values)))
    return tape.program({name: reader.ids(values[i]).ravel() for name, i in names.items()})


class _Reader:
    """Reads jaxprs onto a tape."""

    def __init__(self, tape: Tape, what: str) -> None:
        self._tape, self._what = tape, what

    def ids(self, value: Value) -> np.ndarray:
        """The numbers of nodes of an array; constants are noted."""
        if isinstance(value, Numbers):
            return value.ids
        if isinstance(value, Matrix):
            raise Refused("on the weights of a layer")
        array = np.asarray(value)
        if array.dtype.kind not in "bifu":
            raise Refused(f"of {array.dtype} numbers")
        array = array if array.dtype == bool else array.astype(np.float64)
        numbers = [self._tape.number(x) for x in array.ravel().tolist()]
        return np.array(numbers, int).reshape(array.shape)

    def run(self, jaxpr: Jaxpr, consts: Sequence[Any], given: Sequence[Value]) -> list[Value]:
        """What a jaxpr returns."""
        known: dict[Any, Value] = {}

        def value(of: Any) -> Value:
            return np.asarray(of.val) if isinstance(of, Literal) else known[of]

        known.update(zip(jaxpr.constvars, map(_constant, consts), strict=True))
        known.update(zip(jaxpr.invars, given, strict=True))
        for eqn in jaxpr.eqns:
            try:
                found = self._one(eqn, [value(v) for v in eqn.invars])
            except Refused as refused:
                raise self._refusal(eqn, str(refused)) from None
            known.update(zip(eqn.outvars, found, strict=True))
        return [value(v) for v in jaxpr.outvars]

    def _one(self, eqn: Any, operands: list[Value]) -> list[Value]:
        name, params = eqn.primitive.name, eqn.params
        if name in _CALLS:
            inner = params[_CALLS[name]]
            closed = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())
            return self.run(closed.jaxpr, closed.consts, operands)
        if any(isinstance(o, Matrix) for o in operands):
            return [self._by_matrix(eqn, operands)]
        known = not any(isinstance(o, Numbers) for o in operands)
        if name in MOVES:
            found = MOVES[name](params, *(operands if known else map(self.ids, operands)))
            several = found if isinstance(found, list) else [found]
            return several if known else [Numbers(np.asarray(f)) for f in several]
        if known:
            return _computed(eqn, operands)
        if name in ("scan", "cond", "while"):
            return getattr(self, f"_{name}")(params, operands)
        return [Numbers(self._ruled(eqn, operands))]

    def _by_matrix(self, eqn: Any, operands: list[Value]) -> Value:
        """A matrix that the program is given: it is turned, or multiplies a vector."""
        name, params = eqn.primitive.name, eqn.params
        first = operands[0]
        if name == "convert_element_type" and isinstance(first, Matrix):
            return first
        if name == "transpose" and isinstance(first, Matrix):
            return first.turned() if tuple(params["permutation"]) == (1, 0) else first
        if name == "dot_general":
            (of_left, of_right), (many, _) = params["dimension_numbers"]
            left, right = operands
            matrix, vector, along = (
                (left, right, of_left) if isinstance(left, Matrix) else (right, left, of_right)
            )
            if isinstance(matrix, Matrix) and not isinstance(vector, Matrix) and not many:
                ids = self.ids(vector)
                if ids.ndim == 1 and len(along) == 1:
                    # what is summed over are the columns of the factor
                    factor = (matrix if along[0] == 1 else matrix.turned()).factor
                    tape = self._tape
                    return Numbers(np.array(tape.split(tape.layer(factor, tape.vector(ids))), int))
        raise Refused("on the weights of a layer")

    def _ruled(self, eqn: Any, operands: list[Value]) -> np.ndarray:
        name, params = eqn.primitive.name, eqn.params
        if name in INDEXED:
            fixed = [o for i, o in enumerate(operands) if i not in INDEXED[name]]
            if any(isinstance(o, Numbers) for o in fixed):
                raise Refused("by an index that depends on the state or the inputs")
            moved = [self.ids(o) if i in INDEXED[name] else o for i, o in enumerate(operands)]
            return move_by_index(eqn.primitive, params, moved)
        if name == "scatter-add":
            into, where, added = operands
            if isinstance(where, Numbers):
                raise Refused("by an index that depends on the state or the inputs")
            return scattered(
                self._tape, eqn.primitive, params, [self.ids(into), where, self.ids(added)]
            )
        if name == "dot_general":
            sides = [
                o.ids if isinstance(o, Numbers) else np.asarray(o, np.float64) for o in operands
            ]
            return multiplied(self._tape, params, *sides)
        if name not in RULES:
            raise Refused("")
        if name in ("div", "rem") and np.dtype(eqn.outvars[0].aval.dtype).kind in "iu":
            raise Refused("of whole numbers")
        return RULES[name](self._tape, params, *map(self.ids, operands))

    def _scan(self, params: dict[str, Any], operands: list[Value]) -> list[Value]:
        """A loop; written out where that is short, or what it collects is wanted."""
        n_constants, n_carried = params["num_consts"], params["num_carry"]
        constants = operands[:n_constants]
        carried = operands[n_constants : n_constants + n_carried]
        rows = operands[n_constants + n_carried :]
        loop = self._looped(params, constants, carried, rows)
        if loop is not None:
            return loop
        order = range(params["length"])
        collected = []
        for i in reversed(order) if params["reverse"] else order:
            given = [_row(row, i) for row in rows]
            out = self._turn(params["jaxpr"], [*constants, *carried, *given])
            carried = out[:n_carried]
            collected.append(out[n_carried:])
            if len(collected) * (i + 1) > _MOST:
                raise Refused("of too many turns")
        if params["reverse"]:
            collected.reverse()
        return [*carried, *(self._stacked(of) for of in zip(*collected, strict=True))]

    def _turn(self, closed: Any, given: list[Value]) -> list[Value]:
        return self.run(closed.jaxpr, closed.consts, given)

    def _stacked(self, values: Sequence[Value]) -> Value:
        if any(isinstance(v, Numbers) for v in values):
            return Numbers(np.stack([self.ids(v) for v in values]))
        return np.stack([np.asarray(v) for v in values])

    def _looped(
        self, params: dict[str, Any], constants: list[Value], carried: list[Value],
        rows: list[Value],
    ) -> list[Value] | None:  # fmt: skip
        """The loop as one node; None where it is better written out."""
        length, closed = params["length"], params["jaxpr"]
        if length < 2 or len(closed.out_avals) > len(carried) or params["reverse"]:
            return None
        if any(isinstance(v, Matrix) for v in constants):
            return None  # the body of a loop is given vectors only
        # what is computed is handed in, what is known stands in the body
        asked = {f"constant{i}": self.ids(v).ravel() for i, v in enumerate(constants)
                 if isinstance(v, Numbers)}  # fmt: skip
        starts = {f"carried{i}": self.ids(v).ravel() for i, v in enumerate(carried)}
        given = {f"given{i}": self.ids(v).ravel() for i, v in enumerate(rows)}
        sizes = {k: len(ids) for k, ids in (asked | starts).items()}
        sizes |= {k: len(ids) // length for k, ids in given.items()}
        if not all(sizes.values()):
            return None
        tape = Tape(sizes)

        def part(name: str, like: Value | None, aval: Any) -> Value:
            if name not in sizes:
                return np.asarray(like)
            return Numbers(np.array(tape.input(name), int).reshape(aval.shape))

        names = [*(f"constant{i}" for i in range(len(constants))), *starts, *given]
        likes = [*constants, *([None] * (len(starts) + len(given)))]
        inputs = [part(*of) for of in zip(names, likes, closed.in_avals, strict=True)]
        inner = _Reader(tape, self._what)
        try:
            out = inner.run(closed.jaxpr, closed.consts, inputs)
        except Unreadable:
            return None  # as a counter that is an index: written out it is known
        body = tape.program({k: inner.ids(v).ravel() for k, v in zip(starts, out, strict=True)})
        if body.operations * length <= _UNROLLED:
            return None
        loop = Loop(body, length, len(asked), len(starts))
        found = self._tape.loop(loop, [*asked.values(), *starts.values(), *given.values()])
        ends = np.cumsum([len(ids) for ids in starts.values()])[:-1]
        shapes = [aval.shape for aval in closed.out_avals]
        parts = np.split(np.array(found, int), ends)
        return [Numbers(p.reshape(shape)) for p, shape in zip(parts, shapes, strict=True)]

    def _cond(self, params: dict[str, Any], operands: list[Value]) -> list[Value]:
        """A choice; of an index that is computed, all are computed and one is taken."""
        which, *given = operands
        branches = params["branches"]
        if not isinstance(which, Numbers):
            taken = branches[int(np.clip(np.asarray(which), 0, len(branches) - 1))]
            return self._turn(taken, given)
        cases = [self._turn(branch, given) for branch in branches]
        select = RULES["select_n"]
        return [
            Numbers(np.reshape(select(self._tape, {}, which.ids, *map(self.ids, of)), shape))
            for of, shape in ((of, np.shape(self.ids(of[0]))) for of in zip(*cases, strict=True))
        ]

    def _while(self, params: dict[str, Any], operands: list[Value]) -> list[Value]:
        """A loop that ends by a condition, where that is known while reading."""
        n_cond, n_body = params["cond_nconsts"], params["body_nconsts"]
        of_cond, of_body = operands[:n_cond], operands[n_cond : n_cond + n_body]
        state = operands[n_cond + n_body :]
        for _ in range(_TURNS):
            (goes_on,) = self._turn(params["cond_jaxpr"], [*of_cond, *state])
            if isinstance(goes_on, Numbers):
                raise Refused("whose end depends on the state or the inputs")
            if not goes_on:
                return state
            state = self._turn(params["body_jaxpr"], [*of_body, *state])
        raise Refused(f"of more than {_TURNS} turns")

    def _refusal(self, eqn: Any, why: str) -> InputError:
        return Unreadable(
            self._what, f"the model uses '{eqn.primitive.name}' {why}".rstrip() + _place(eqn),
            "arithmetic, functions as sin and exp, matrices, loops of a fixed length",
            "write that function with these",
        )  # fmt: skip


class Unreadable(InputError):
    """A function that no program can hold: of what its primitives do there is no rule."""


def _constant(value: Any) -> np.ndarray:
    return np.asarray(value)


def _row(value: Value, i: int) -> Value:
    if isinstance(value, Matrix):
        raise Refused("over the weights of a layer")
    return Numbers(np.asarray(value.ids[i])) if isinstance(value, Numbers) else np.asarray(value[i])


def _computed(eqn: Any, operands: list[Value]) -> list[Value]:
    """What JAX makes of constants; NumPy does the most usual, which JAX would compile for that."""
    name, params, out = eqn.primitive.name, eqn.params, eqn.outvars[0].aval
    kind = np.dtype(out.dtype)
    known = _BY_NUMPY.get(name)
    whole = name in ("div", "rem") and kind.kind in "iu"  # rounded otherwise than by NumPy
    if known is None and name in OPERATIONS and name != "select" and not whole:
        known = _operation(name)
    if known is not None:
        with np.errstate(all="ignore"):
            return [np.asarray(known(params, *operands), kind)]
    bound = eqn.primitive.bind(*map(jnp.asarray, operands), **params)
    several = bound if eqn.primitive.multiple_results else [bound]
    return [np.asarray(b) for b in several]


def _operation(name: str) -> Callable[..., Any]:
    return lambda params, *operands: OPERATIONS[name].apply(*operands)


def _iota(params: dict[str, Any]) -> np.ndarray:
    shape, axis = params["shape"], params["dimension"]
    counts = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return np.broadcast_to(counts, shape)


# primitives on constants by NumPy, beside the operations: of (params, *operands)
_BY_NUMPY: dict[str, Callable[..., Any]] = {
    "iota": _iota,
    "convert_element_type": lambda params, x: np.asarray(x).astype(params["new_dtype"]),
    "integer_pow": lambda params, x: np.asarray(x) ** params["y"],
    "square": lambda params, x: np.square(x),
    "reduce_sum": lambda params, x: np.sum(x, axis=tuple(params["axes"])),
    "stop_gradient": lambda params, x: x,
}


def _place(eqn: Any) -> str:
    """Where a primitive was written, outside of JAX and of this package where it can be."""
    trace = eqn.source_info.traceback
    frames = [] if trace is None else list(trace.frames)
    ours = Path(__file__).parents[1].as_posix()
    foreign = [f for f in frames if "/jax/" not in f.file_name and "/equinox/" not in f.file_name]
    theirs = [f for f in foreign if not f.file_name.startswith(ours)]
    for frame in [*theirs, *foreign][:1] if theirs else foreign[:1]:
        name = frame.function_name.rsplit(".", 1)[-1]
        return f", in {name} ({Path(frame.file_name).name}, line {frame.line_num})"
    return ""
