"""Machine code inside of programs that JAX compiles: rollouts with their gradient.

XLA calls functions that stand in memory beside its own code and hands them the addresses of
arrays. Here these are loops over time of models whose layers are given: many short rollouts, and
their adjoints. No Python runs in between, so several devices may call at once; by
`jax.pure_callback` an epoch takes a multiple of the time (docs/explanation/performance.md).

References:
    XLA, `xla/ffi/api/c_api.h`: how XLA calls foreign functions, API versions 0.1 to 0.5.
"""

import ctypes
import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine.emission import Constants, blocked_layout
from tustinnet.engine.engines import warn_once
from tustinnet.engine.equations import Equations, ResidualFormula
from tustinnet.engine.kernels import (
    BACKWARD,
    COMPARE,
    LANE,
    RUN,
    layer_outputs,
    output_size,
    write_backward,
    write_compare,
    write_run,
)
from tustinnet.engine.machine import CompiledModule, compile_module, width
from tustinnet.engine.text import Function, Module
from tustinnet.errors import describe_error

_NEWEST = (0, 5)  # version of the interface that is known
# places in its structures, bytes from their beginning; the tests compare them with JAX's header
_EXTENSION, _ARGUMENTS, _RESULTS = 8, 72, 112  # of a call
_KIND, _METADATA = 8, 24  # of an extension
_MAJOR, _MINOR = 24, 28  # of metadata
_DATA, _SHAPE = 24, 40  # of an array
_METADATA_REQUEST = 1


class Rollouts:
    """Rollouts of a discrete model whose layers are given, as an operation of JAX.

    Args:
        equations: the step of the model.
    """

    def __init__(self, equations: Equations) -> None:
        self._equations, n_p = equations, equations.n_p

        def fixed(x: Array, u: Array, p: Array, c: Array, *weights: Array) -> Array:
            return equations.function(x, u, c[:n_p], c[n_p:], *weights)

        # equations without derivatives by parameters
        self._fixed = replace(equations, function=fixed, n_p=0, n_c=n_p + equations.n_c)
        self.states = jax.custom_vjp(self._states)
        self.states.defvjp(self._forward, self._backward)

    def compare(
        self,
        weights: list[Array],
        p: Array,
        c: Array,
        x0: Array,
        u: Array,
        residual: ResidualFormula,
        target: Array,
        weight: Array,
    ) -> tuple[Array, Array, Array]:
        """Products of residuals and their derivatives by `x0`; they cannot be differentiated.

        Args:
            weights: the matrices of the layers, in the order of the equations.
            p: parameters.
            c: further parameters.
            x0: initial states, (batch, n_x).
            u: inputs of the steps, (batch, steps, n_u).
            residual: residual of the errors of the first numbers of the states.
            target: measured values of these, (batch, samples, n_y).
            weight: weight of each residual, (batch, samples, n_y).

        Returns:
            Products of derivatives (batch, n_x, n_x), of derivatives and residuals (batch, n_x),
            and sums of squared residuals, (batch,).
        """
        n, n_x = x0.shape
        function = _target("compare", self._fixed, x0, residual)
        shapes = target.shape, (n, n_x, n_x), (n, n_x), (n,)
        seeds = jnp.broadcast_to(jnp.eye(n_x, dtype=x0.dtype), (n, n_x, n_x))
        _, lower, gradient, cost = function.call(
            shapes, weights, _repeat_parameters(p, c, x0), x0, _pad_inputs(u), seeds, target, weight
        )
        return lower + jnp.swapaxes(jnp.tril(lower, -1), 1, 2), gradient, cost

    def _states(
        self, weights: list[Array], p: Array, c: Array, x0: Array, u: Array
    ) -> Float[Array, "batch samples n_x"]:
        """The states of rollouts; they have derivatives by `weights`, `p` and `x0`.

        Args:
            weights: the matrices of the layers, in the order of the equations.
            p: parameters that derivatives are needed by, (n_p,).
            c: all others, (n_c,).
            x0: initial states, (batch, n_x).
            u: inputs of the steps, (batch, steps, n_u).
        """
        function = _target("run", self._equations, x0)
        shape = (len(x0), u.shape[1] + 1, x0.shape[1])
        parameters = _repeat_parameters(p, c, x0)
        return function.call([shape], weights, parameters, x0, _pad_inputs(u))[0]

    def _forward(self, *arguments: Any) -> tuple[Array, Any]:
        states = self._states(*arguments)
        return states, (*arguments, states)

    def _backward(self, saved: Any, seeds: Array) -> tuple[Any, ...]:
        weights, p, c, x0, u, states = saved
        equations, lanes = self._equations, _lanes(x0)
        function = _target("backward", equations, x0)
        sizes = [output_size(equations.adjoints.program, name) for name in layer_outputs(equations)]
        samples = -(-len(x0) // lanes) * u.shape[1] * lanes
        shapes = (sum(sizes), samples), (len(x0), len(p)), x0.shape
        layers, by_p, by_x0 = function.call(
            shapes, weights, _repeat_parameters(p, c, x0), _pad_inputs(u), states, seeds
        )
        ends = np.cumsum([0, *sizes]).tolist()
        by_weights = dict.fromkeys(equations.matrices)
        for i, name in enumerate(equations.adjoints.layers):
            begin, middle, end = ends[2 * i : 2 * i + 3]
            product = layers[middle:end] @ layers[begin:middle].T
            total = by_weights[name]
            by_weights[name] = product if total is None else total + product
        gradients = [
            jnp.zeros_like(weight) if gradient is None else gradient
            for weight, gradient in zip(weights, by_weights.values(), strict=True)
        ]
        return gradients, jnp.sum(by_p, axis=0), jnp.zeros_like(c), by_x0, jnp.zeros_like(u)


def _repeat_parameters(p: Array, c: Array, x0: Array) -> Array:
    """The parameters for every rollout, (batch, n_p + n_c)."""
    numbers = jnp.concatenate([p, c]).astype(x0.dtype)
    return jnp.broadcast_to(numbers, (len(x0), len(numbers)))


def _pad_inputs(u: Array) -> Array:
    """Inputs with a row for every sample, though the last one has no effect."""
    return jnp.pad(u, ((0, 0), (0, 1), (0, 0)))


def _lanes(x0: Array) -> int:
    """Number of rollouts side by side: two vectors, so that each weight is read once for both."""
    lanes = width() * 8 // x0.dtype.itemsize
    return 2 * lanes if len(x0) > lanes else lanes


@cache
def available() -> bool:
    """Whether JAX can call machine code: on a processor, by an interface that it supports."""
    if jax.default_backend() != "cpu":
        return False
    module = Module(1, "float")
    try:
        _write_called(module, lambda f: None)
        name, _ = _register(module.text())
        with jax.ensure_compile_time_eval():
            result = jax.ShapeDtypeStruct((1,), np.float32)
            jax.block_until_ready(jax.ffi.ffi_call(name, result)())
    except Exception as error:  # whatever another version of JAX makes of it
        warn_once(
            f"JAX does not call machine code ({describe_error(error)}); XLA trains hybrids, slower"
        )
        return False
    return True


class _Target:
    """A function that XLA can call, and the numbers that it reads.

    Attributes:
        name: its name in programs; the same code has the same name in every process, so that
            programs in the cache of XLA find it again.
    """

    def __init__(self, module: Module, constants: Constants, equations: Equations) -> None:
        self.name, self._code = _register(module.text())
        # the source of each number: a constant, or a weight behind these
        base = np.array([*constants.numbers, 0.0])
        begins, first = {}, len(base)
        for name, shape in equations.matrices.items():
            begins[name] = first
            first += shape[0] * shape[1]
        order = np.arange(len(base))
        for factor, place in constants.layers.items():
            shape = equations.matrices[factor.name]
            weights = begins[factor.name] + np.arange(shape[0] * shape[1]).reshape(shape)
            layout = blocked_layout(weights.T if factor.is_transposed else weights)
            order[place : place + len(layout)] = layout
        self._base, self._order = base, order

    def call(
        self, shapes: Sequence[tuple[int, ...]], weights: Sequence[Array], *arrays: Array
    ) -> list[Array]:
        """Results of some shapes, in the precision of the weights.

        Args:
            shapes: shapes of the results.
            weights: the matrices of the layers, in the order of the equations.
            arrays: all arguments behind the constants, which have the weights among them.
        """
        kind = arrays[0].dtype
        results = [jax.ShapeDtypeStruct(shape, kind) for shape in shapes]
        numbers = [jnp.asarray(self._base, kind), *(jnp.ravel(w) for w in weights)]
        call = jax.ffi.ffi_call(self.name, results, vmap_method="sequential")
        return list(call(jnp.concatenate(numbers)[self._order], *arrays))


def _target(kernel: str, equations: Equations, x0: Array, *residual: ResidualFormula) -> _Target:
    """The function of a kernel for initial states of some number and precision; made once."""
    return _make_target(kernel, equations, _lanes(x0), x0.dtype == np.float64, *residual)


@cache
def _make_target(
    kernel: str, equations: Equations, lanes: int, is_double: bool, *residual: ResidualFormula
) -> _Target:
    module, constants = Module(lanes, "double" if is_double else "float"), Constants()
    write, call = {
        "run": (write_run, _call_run),
        "compare": (write_compare, _call_compare),
        "backward": (write_backward, _call_backward),
    }[kernel]
    write(module, constants, equations, *residual)
    _write_called(module, call)
    return _Target(module, constants, equations)


@cache  # for good: XLA never forgets a registration, so the code must stay where it is
def _register(text: str) -> tuple[str, CompiledModule]:
    """Registers the function `called` of a module with XLA; its name, and the module's code."""
    name = f"tustinnet.{hashlib.sha256(text.encode()).hexdigest()[:32]}"
    code = compile_module(text)
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype = ctypes.py_object
    capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    jax.ffi.register_ffi_target(name, capsule(code.address("called"), None, None), platform="cpu")
    return name, code


@cache
def _version() -> tuple[int, int]:
    """The interface of this JAX, or the newest that is known: JAX takes earlier ones too."""
    header = Path(jax.ffi.include_dir(), "xla/ffi/api/c_api.h").read_text()
    parts = re.findall(r"#define XLA_FFI_API_(?:MAJOR|MINOR) (\d+)", header)
    major, minor = map(int, parts)
    return min((major, minor), _NEWEST)


def _write_called(module: Module, write: Callable[[Function], None]) -> None:
    """Writes the function that XLA calls: it says which interface it has, or does its work."""
    with module.procedure("called", "ptr %call", "ptr null", is_internal=False) as f:
        extension = _field(f, "%call", _EXTENSION, "ptr")
        with f.when(f.value(f"icmp ne ptr {extension}, null")):
            kind = _field(f, extension, _KIND, "i32")
            with f.when(f.value(f"icmp eq i32 {kind}, {_METADATA_REQUEST}")):
                metadata = _field(f, extension, _METADATA, "ptr")
                for place, value in zip((_MAJOR, _MINOR), _version(), strict=True):
                    f.line(f"store i32 {value}, ptr {f.at(metadata, place, 'i8')}")
                f.line("ret ptr null")
                f.place(f.label())
        write(f)


def _field(f: Function, structure: str, place: int, kind: str) -> str:
    return f.value(f"load {kind}, ptr {f.at(structure, place, 'i8')}")


def _arrays(f: Function, arguments: str, results: str) -> dict[str, str]:
    """The arrays that a call passes in, and those for its results, by their names."""
    arrays = {}
    for place, names in ((_ARGUMENTS, arguments), (_RESULTS, results)):
        pointers = _field(f, "%call", place, "ptr")
        for i, name in enumerate(names.split()):
            arrays[name] = f.value(f"load ptr, ptr {f.at(pointers, i, 'ptr')}")
    return arrays


def _data(f: Function, arrays: dict[str, str]) -> dict[str, str]:
    """The places of the numbers of arrays, by their names."""
    return {name: _field(f, array, _DATA, "ptr") for name, array in arrays.items()}


def _lane_table(f: Function, drive: str) -> tuple[str, str, str]:
    """Writes the table of lanes of rollouts of one length; its place, groups, and steps."""
    shape = _field(f, drive, _SHAPE, "ptr")
    batch = f.value(f"load i64, ptr {shape}")
    samples = f.value(f"load i64, ptr {f.at(shape, 1, 'i64')}")
    steps, lanes = f.whole("sub", samples, 1), f.module.lanes
    groups = f.whole("sdiv", f.whole("add", batch, lanes - 1), lanes)
    count = f.whole("mul", groups, lanes)
    table = f.value(f"alloca i64, i64 {f.whole('mul', count, len(LANE))}")
    last = f.whole("sub", batch, 1)
    with f.loop(0, count) as i:
        idle = f.value(f"icmp sgt i64 {i}, {last}")
        run = f.value(f"select i1 {idle}, i64 {last}, i64 {i}")
        first = f.whole("mul", run, samples)
        lane_steps = f.value(f"select i1 {idle}, i64 -1, i64 {steps}")
        row = f.whole("mul", i, len(LANE))
        for k, column in enumerate((run, lane_steps, first, first, "0")):  # as `LANE` has them
            f.line(f"store i64 {column}, ptr {f.at(table, f.whole('add', row, k), 'i64')}")
    return table, groups, steps


def _call_run(f: Function) -> None:
    arrays = _arrays(f, "constants parameters start drive", "states")
    table, groups, _ = _lane_table(f, arrays["drive"])
    f.call_procedure(
        "run",
        RUN,
        **_data(f, arrays),
        begin=0,
        end=groups,
        lanes=table,
        substeps=1,
        order=1,
        periods="null",
        measured="null",
        n_measured=0,
    )


def _call_compare(f: Function) -> None:
    arguments = "constants parameters start drive seeds target weight"
    arrays = _arrays(f, arguments, "errors products gradient cost")
    table, groups, _ = _lane_table(f, arrays["drive"])
    n_d = f.value(f"load i64, ptr {f.at(_field(f, arrays['seeds'], _SHAPE, 'ptr'), 1, 'i64')}")
    # three derivatives of a state, a row of products and the gradient for each direction
    size = f.whole("mul", n_d, f.whole("add", f.whole("mul", n_d, 4), 1))
    v, align = f.module.v, f.module.align
    work = f.value(f"alloca {v}, i64 {f.whole('add', size, 1)}, align {align}")
    f.call_procedure(
        "compare",
        COMPARE,
        **_data(f, arrays),
        begin=0,
        end=groups,
        lanes=table,
        substeps=1,
        order=1,
        periods="null",
        n_d=n_d,
        n_by_p=0,
        work=work,
    )


def _call_backward(f: Function) -> None:
    arrays = _arrays(f, "constants parameters drive states seeds", "layers by_p by_start")
    table, groups, steps = _lane_table(f, arrays["drive"])
    f.call_procedure(
        "backward",
        BACKWARD,
        **_data(f, arrays),
        begin=0,
        end=groups,
        lanes=table,
        span=f.whole("mul", groups, steps),
        length=steps,
    )
