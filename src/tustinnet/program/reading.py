"""Reading functions of JAX arrays as programs, the one way from models to all targets."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from tustinnet.errors import InputError
from tustinnet.program.primitives import (
    INDEXED,
    MOVES,
    RULES,
    UnsupportedPrimitive,
    move_by_index,
    multiply,
    read_by_index,
    scatter_add,
)
from tustinnet.program.program import OPERATIONS, Factor, Loop, Program
from tustinnet.program.tape import Tape

_UNROLLED_OPERATIONS = 300  # operations up to which a loop is written out
_MOST_OPERATIONS = 200_000  # operations of a loop that can only be written out
_TURNS = 10_000  # of a loop that ends by a condition
_COMPUTED_INDEX = "by an index that depends on the state or the inputs"
# what to write in the place of primitives that people use without knowing them by name
_REMEDIES = {
    "while": "write a loop of a fixed length with jax.lax.fori_loop",
    "sort": "compare with jnp.minimum and jnp.maximum",
    "lu": "solve few equations by formulas, symmetric ones by jax.scipy.linalg.cho_solve",
    "erf": "write jnp.tanh, which is close to it",
    "gather": "read tables by jnp.interp, or choose with jnp.where",
    "dynamic_slice": "read tables by jnp.interp, or choose with jnp.where",
    "scatter": "choose with jnp.where",
    "scatter-add": "choose with jnp.where",
    "dynamic_update_slice": "choose with jnp.where",
}
# primitives with a program of their own that is run once, and the parameter that holds it
_CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "remat": "jaxpr",
    "checkpoint": "jaxpr",
    "remat2": "jaxpr",
}


@dataclass(frozen=True, eq=False)
class Numbers:
    """An array of a program that is read: each place holds the number of a node.

    Attributes:
        ids: the numbers.
    """

    ids: np.ndarray


@dataclass(frozen=True, eq=False)
class Matrix:
    """An input matrix of a program: it only multiplies vectors.

    Attributes:
        factor: its name, and whether its transpose is meant.
        shape: shape of the matrix, or of its transpose if that is meant.
    """

    factor: Factor
    shape: tuple[int, int]

    def transpose(self) -> "Matrix":
        """The transpose of the matrix."""
        name, is_transposed = self.factor
        rows, columns = self.shape
        return Matrix(Factor(name, not is_transposed), (columns, rows))


Value = np.ndarray | Numbers | Matrix  # a constant, computed by the program, or an input matrix


def read(
    function: Callable[..., Mapping[str, Any]],
    inputs: Mapping[str, int],
    what: str = "program",
    matrices: Mapping[str, tuple[int, int]] | None = None,
) -> Program:
    """Reads a function as a program.

    Args:
        function: of vectors in float64, and matrices behind them; returns vectors by name.
        inputs: sizes of its input vectors, by name.
        what: its name in messages.
        matrices: shapes of its input matrices, by name.

    Raises:
        Unreadable: it uses primitives without a rule, or loops whose end depends on the state.
    """
    # in single precision where JAX knows no other; the program itself computes in double
    kind = jax.dtypes.canonicalize_dtype(np.float64)
    matrices = matrices or {}
    sizes = [*((size,) for size in inputs.values()), *matrices.values()]
    shapes = [jax.ShapeDtypeStruct(size, kind) for size in sizes]
    tape = Tape(dict(inputs), matrices)
    arguments: list[Value] = [Numbers(np.array(tape.split(tape.input(n)), int)) for n in inputs]
    arguments += [Matrix(Factor(name), size) for name, size in matrices.items()]
    reader = _Reader(tape)
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*shapes)
    try:
        with jax.ensure_compile_time_eval():  # a program may be read while another is compiled
            values = reader.run(closed, arguments)
    except UnsupportedPrimitive as error:
        raise Unreadable(
            what,
            f"the model uses '{error.name}' {error}".rstrip() + error.place,
            "arithmetic, functions as sin and exp, matrices, loops of a fixed length",
            _REMEDIES.get(error.name, "write that function with these"),
        ) from None
    names = jax.tree.unflatten(jax.tree.structure(shape), range(len(values)))
    return tape.program({name: reader.ids(values[i]).ravel() for name, i in names.items()})


class _Reader:
    """Reads jaxprs onto a tape.

    Args:
        tape: the tape.
        counters: the inputs of a loop's body that may be counters. As indices these are refused:
            they are constants where the loop is written out.
    """

    def __init__(self, tape: Tape, counters: Collection[str] = ()) -> None:
        self._tape, self._counters = tape, counters

    def ids(self, value: Value) -> np.ndarray:
        """Numbers of the nodes of an array; constants become nodes."""
        if isinstance(value, Numbers):
            return value.ids
        if isinstance(value, Matrix):
            raise UnsupportedPrimitive("on the weights of a layer")
        array = np.asarray(value)
        if array.dtype.kind not in "bifu":
            raise UnsupportedPrimitive(f"of {array.dtype} numbers")
        array = array if array.dtype == bool else array.astype(np.float64)
        numbers = [self._tape.number(x) for x in array.ravel().tolist()]
        return np.array(numbers, int).reshape(array.shape)

    def run(self, closed: ClosedJaxpr, arguments: Sequence[Value]) -> list[Value]:
        """Results of a jaxpr for its arguments."""
        jaxpr, constants = closed.jaxpr, map(np.asarray, closed.consts)
        values: dict[Any, Value] = dict(zip(jaxpr.constvars, constants, strict=True))
        values.update(zip(jaxpr.invars, arguments, strict=True))

        def value(variable: Any) -> Value:
            if isinstance(variable, Literal):
                return np.asarray(variable.val)
            return values[variable]

        for eqn in jaxpr.eqns:
            try:
                results = self._equation(eqn, [value(v) for v in eqn.invars])
            except UnsupportedPrimitive as error:
                # in a function of JAX the place is that of its call
                error.name = error.name or eqn.primitive.name
                error.place = error.place or _place(eqn)
                raise
            values.update(zip(eqn.outvars, results, strict=True))
        return [value(v) for v in jaxpr.outvars]

    def _equation(self, eqn: Any, operands: list[Value]) -> list[Value]:
        """Results of an equation of a jaxpr."""
        name, params = eqn.primitive.name, eqn.params
        if name in _CALLS:
            inner = params[_CALLS[name]]
            closed = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())
            return self.run(closed, operands)
        if name == "call_hi_primitive":
            return self._by_parts(eqn, operands)
        if any(isinstance(o, Matrix) for o in operands):
            return [self._with_matrix(eqn, operands)]
        is_constant = not any(isinstance(o, Numbers) for o in operands)
        if name in MOVES:
            moved = MOVES[name](params, *(operands if is_constant else map(self.ids, operands)))
            results = moved if isinstance(moved, list) else [moved]
            return results if is_constant else [Numbers(np.asarray(ids)) for ids in results]
        if is_constant:
            return _constant_results(eqn, operands)
        if name == "scan":
            return self._scan(eqn, operands)
        if name in ("cond", "while"):
            return getattr(self, f"_{name}")(params, operands)
        return [Numbers(self._by_rule(eqn, operands))]

    def _by_parts(self, eqn: Any, operands: list[Value]) -> list[Value]:
        """Results of a function that JAX 0.12 keeps as one primitive, by those it is made of."""
        shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in eqn.invars]
        parts = jax.make_jaxpr(partial(eqn.primitive.to_lojax, **eqn.params))(*shapes)
        try:
            return self.run(parts, operands)
        except UnsupportedPrimitive as error:
            error.place = ""  # not here, but where the function is called
            raise

    def _with_matrix(self, eqn: Any, operands: list[Value]) -> Value:
        """The result for an input matrix, which is transposed, or multiplies a vector."""
        name, params = eqn.primitive.name, eqn.params
        first = operands[0]
        if name == "convert_element_type" and isinstance(first, Matrix):
            return first
        if name == "transpose" and isinstance(first, Matrix):
            return first.transpose() if tuple(params["permutation"]) == (1, 0) else first
        if name == "dot_general":
            contracted, (batched, _) = params["dimension_numbers"]
            at = 0 if isinstance(first, Matrix) else 1
            matrix, vector, axes = operands[at], operands[1 - at], contracted[at]
            if isinstance(matrix, Matrix) and not isinstance(vector, Matrix) and not batched:
                ids = self.ids(vector)
                if ids.ndim == 1 and len(axes) == 1:
                    # the sum is over the columns of the factor
                    factor = (matrix if axes[0] == 1 else matrix.transpose()).factor
                    tape = self._tape
                    return Numbers(np.array(tape.split(tape.layer(factor, tape.vector(ids))), int))
        raise UnsupportedPrimitive("on the weights of a layer")

    def _by_rule(self, eqn: Any, operands: list[Value]) -> np.ndarray:
        name, params = eqn.primitive.name, eqn.params
        if name in INDEXED:
            fixed = [o for i, o in enumerate(operands) if i not in INDEXED[name]]
            if any(isinstance(o, Numbers) for o in fixed):
                array, *indices = map(self.ids, operands)
                counts = self._tape.depends(
                    np.concatenate([i.ravel() for i in indices]), self._counters
                )
                if name not in ("gather", "dynamic_slice") or counts:
                    raise UnsupportedPrimitive(_COMPUTED_INDEX)
                return read_by_index(self._tape, name, params, array, indices)
            moved = [self.ids(o) if i in INDEXED[name] else o for i, o in enumerate(operands)]
            return move_by_index(eqn.primitive, params, moved)
        if name == "scatter-add":
            into, where, added = operands
            if isinstance(where, Numbers):
                raise UnsupportedPrimitive(_COMPUTED_INDEX)
            return scatter_add(
                self._tape, eqn.primitive, params, [self.ids(into), where, self.ids(added)]
            )
        if name == "dot_general":
            sides = [
                o.ids if isinstance(o, Numbers) else np.asarray(o, np.float64) for o in operands
            ]
            return multiply(self._tape, params, *sides)
        if name not in RULES:
            raise UnsupportedPrimitive("")
        result = RULES[name](self._tape, params, *map(self.ids, operands))
        kind = np.dtype(eqn.outvars[0].aval.dtype)
        if name == "div" and kind.kind in "iu":  # rounded towards 0
            return RULES["convert_element_type"](self._tape, {"new_dtype": kind}, result)
        return result

    def _scan(self, eqn: Any, operands: list[Value]) -> list[Value]:
        """Results of a loop; it is written out where it is short, or collects results."""
        params, body = eqn.params, eqn.params["jaxpr"]
        # a turn sees a row of what the loop goes through and adds a row to what it collects; these
        # have an axis more outside, in every version of JAX, which all name their numbers otherwise
        n_rows = _count_longer(eqn.invars, body.in_avals)
        n_carried = len(eqn.outvars) - _count_longer(eqn.outvars, body.out_avals)
        n_constants = len(operands) - n_carried - n_rows
        constants = operands[:n_constants]
        carried = operands[n_constants : n_constants + n_carried]
        rows = operands[n_constants + n_carried :]
        results = self._loop_node(params, constants, carried, rows)
        if results is not None:
            return results
        order = range(params["length"])
        collected = []
        for i in reversed(order) if params["reverse"] else order:
            now: list[Value] = []
            for row in rows:
                if isinstance(row, Matrix):
                    raise UnsupportedPrimitive("over the weights of a layer")
                if isinstance(row, Numbers):
                    now.append(Numbers(np.asarray(row.ids[i])))
                else:
                    now.append(np.asarray(row[i]))
            out = self.run(params["jaxpr"], [*constants, *carried, *now])
            carried = out[:n_carried]
            collected.append(out[n_carried:])
            if len(collected) * (i + 1) > _MOST_OPERATIONS:
                raise UnsupportedPrimitive("of too many turns")
        if params["reverse"]:
            collected.reverse()
        stacked: list[Value] = []
        for values in zip(*collected, strict=True):
            if any(isinstance(v, Numbers) for v in values):
                stacked.append(Numbers(np.stack([self.ids(v) for v in values])))
            else:
                stacked.append(np.stack([np.asarray(v) for v in values]))
        return [*carried, *stacked]

    def _loop_node(
        self,
        params: dict[str, Any],
        constants: list[Value],
        carried: list[Value],
        rows: list[Value],
    ) -> list[Value] | None:
        """Results of a loop as one node; None where it is better written out."""
        length, closed = params["length"], params["jaxpr"]
        if length < 2 or len(closed.out_avals) > len(carried) or params["reverse"]:
            return None
        if any(isinstance(v, Matrix) for v in constants):
            return None  # inputs of a loop's body are vectors only
        # computed constants are passed in, other constants stand in the body
        passed = {
            f"constant{i}": self.ids(v).ravel()
            for i, v in enumerate(constants)
            if isinstance(v, Numbers)
        }
        starts = {f"carried{i}": self.ids(v).ravel() for i, v in enumerate(carried)}
        collected = {f"given{i}": self.ids(v).ravel() for i, v in enumerate(rows)}
        sizes = {k: len(ids) for k, ids in (passed | starts).items()}
        sizes |= {k: len(ids) // length for k, ids in collected.items()}
        if not all(sizes.values()):
            return None
        tape = Tape(sizes)

        names = [*(f"constant{i}" for i in range(len(constants))), *starts, *collected]
        inputs: list[Value] = []
        counters = [
            name
            for name, aval in zip(names, closed.in_avals, strict=True)
            if name in sizes and aval.dtype.kind in "iu"
        ]
        for i, (name, aval) in enumerate(zip(names, closed.in_avals, strict=True)):
            if name in sizes:
                ids = np.array(tape.split(tape.input(name)), int)
                inputs.append(Numbers(ids.reshape(aval.shape)))
            else:
                inputs.append(np.asarray(constants[i]))
        inner = _Reader(tape, counters)
        try:
            out = inner.run(closed, inputs)
        except UnsupportedPrimitive:
            return None  # such as a counter that is an index: written out it is a constant
        body = tape.program({k: inner.ids(v).ravel() for k, v in zip(starts, out, strict=True)})
        if body.operations * length <= _UNROLLED_OPERATIONS:
            return None
        loop = Loop(body, length, len(passed), len(starts))
        numbers = self._tape.loop(loop, [*passed.values(), *starts.values(), *collected.values()])
        ends = np.cumsum([len(ids) for ids in starts.values()])[:-1]
        shapes = [aval.shape for aval in closed.out_avals]
        parts = np.split(np.array(numbers, int), ends)
        return [Numbers(p.reshape(shape)) for p, shape in zip(parts, shapes, strict=True)]

    def _cond(self, params: dict[str, Any], operands: list[Value]) -> list[Value]:
        """Results of a choice; where its index is computed, one of all results is selected."""
        which, *arguments = operands
        branches = params["branches"]
        if not isinstance(which, Numbers):
            branch = branches[int(np.clip(np.asarray(which), 0, len(branches) - 1))]
            return self.run(branch, arguments)
        cases = [self.run(branch, arguments) for branch in branches]
        results: list[Value] = []
        for values in zip(*cases, strict=True):
            ids = list(map(self.ids, values))
            selected = RULES["select_n"](self._tape, {}, which.ids, *ids)
            results.append(Numbers(np.reshape(selected, ids[0].shape)))
        return results

    def _while(self, params: dict[str, Any], operands: list[Value]) -> list[Value]:
        """Results of a loop that ends by a condition, where that is constant while reading."""
        n_cond, n_body = params["cond_nconsts"], params["body_nconsts"]
        cond_constants, body_constants = operands[:n_cond], operands[n_cond : n_cond + n_body]
        state = operands[n_cond + n_body :]
        for _ in range(_TURNS):
            (has_more,) = self.run(params["cond_jaxpr"], [*cond_constants, *state])
            if isinstance(has_more, Numbers):
                raise UnsupportedPrimitive("whose end depends on the state or the inputs")
            if not has_more:
                return state
            state = self.run(params["body_jaxpr"], [*body_constants, *state])
        raise UnsupportedPrimitive(f"of more than {_TURNS} turns")


class Unreadable(InputError):
    """A function that cannot be read as a program: some of its primitives have no rule."""


def _count_longer(variables: Sequence[Any], inside: Sequence[Any]) -> int:
    """Number of variables that have an axis more outside of a loop than inside of its body."""
    return sum(v.aval.ndim > aval.ndim for v, aval in zip(variables, inside, strict=True))


def _constant_results(eqn: Any, operands: list[Value]) -> list[Value]:
    """Results of a primitive for constants, by NumPy for usual ones, as JAX would compile them."""
    name, params, out = eqn.primitive.name, eqn.params, eqn.outvars[0].aval
    kind = np.dtype(out.dtype)
    by_numpy = _BY_NUMPY.get(name)
    is_rounded = name in ("div", "rem") and kind.kind in "iu"  # otherwise than by NumPy
    if by_numpy is None and name in OPERATIONS and name != "select" and not is_rounded:
        operation = OPERATIONS[name].apply
        by_numpy = lambda params, *operands: operation(*operands)  # noqa: E731
    if by_numpy is not None:
        with np.errstate(all="ignore"):
            return [np.asarray(by_numpy(params, *operands), kind)]
    bound = eqn.primitive.bind(*map(jnp.asarray, operands), **params)
    results = bound if eqn.primitive.multiple_results else [bound]
    return [np.asarray(result) for result in results]


def _iota(params: dict[str, Any]) -> np.ndarray:
    shape, axis = params["shape"], params["dimension"]
    counts = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return np.broadcast_to(counts, shape)


# functions of NumPy for primitives on constants, beside the operations: of (params, *operands)
_BY_NUMPY: dict[str, Callable[..., Any]] = {
    "iota": _iota,
    "convert_element_type": lambda params, x: np.asarray(x).astype(params["new_dtype"]),
    "integer_pow": lambda params, x: np.asarray(x) ** params["y"],
    "square": lambda params, x: np.square(x),
    "reduce_sum": lambda params, x: np.sum(x, axis=tuple(params["axes"])),
    "stop_gradient": lambda params, x: x,
}


_PACKAGE = str(Path(__file__).parents[1])
_LIBRARIES = str(Path(jax.__file__).parent), str(Path(eqx.__file__).parent)


def _place(eqn: Any) -> str:
    """Function and line in which a primitive was written, for messages; empty if not known.

    Outside of JAX, and of this package where there is such a line.
    """
    trace = eqn.source_info.traceback
    frames = [] if trace is None else list(trace.frames)
    frames = [f for f in frames if not f.file_name.startswith(_LIBRARIES)]
    outside = [f for f in frames if not f.file_name.startswith(_PACKAGE)]
    for frame in (outside or frames)[:1]:
        name = frame.function_name.rsplit(".", 1)[-1]
        return f", in {name} ({Path(frame.file_name).name}, line {frame.line_num})"
    return ""
