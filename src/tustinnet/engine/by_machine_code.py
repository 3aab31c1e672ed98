"""Runs of equations by machine code, several side by side on every core."""

import ctypes
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Int

from tustinnet.cores import count_cores
from tustinnet.engine.emission import Constants
from tustinnet.engine.equations import Equations, Formula, ResidualFormula
from tustinnet.engine.kernels import (
    COMPARE,
    LANE,
    MAP,
    MOST_ORDER,
    RUN,
    STEP,
    output_size,
    write_compare,
    write_map,
    write_run,
    write_step,
)
from tustinnet.engine.machine import compile_module, width
from tustinnet.engine.runs import Comparison, Directions, Runs, Samples
from tustinnet.engine.text import Module
from tustinnet.program.numbers import run

_TYPES = {"ptr": ctypes.c_void_p, "i64": ctypes.c_int64}
_ALIGNED = 64  # bytes
_CACHED_FUNCTIONS = 192  # functions
# of a formula, up to which NumPy does them and nothing is compiled: to compile an operation, which
# a loop repeats, takes longer than to do it at hundreds of points
_FEW_OPERATIONS, _FEW_POINTS = 30_000, 20
_operations: WeakKeyDictionary[Formula, int] = WeakKeyDictionary()  # of each, done by NumPy


def simulate(equations: Equations, runs: Runs, substeps: int) -> Float[np.ndarray, "rows n_x"]:
    """The states at all samples, run after run; see `runs.simulate`."""
    n_x = equations.n_x
    equations, at_samples, start = _with_sampled_states(equations, runs.start)
    runs = replace(runs, start=start)
    # two vectors side by side where layers of a network are multiplied: each weight is then read
    # once for both
    has_layers = any(node.op == "product" for node in equations.program.nodes)
    lanes = 2 * width() if has_layers and len(runs.steps) > width() else width()
    function, constants = _function(write_run, "run", RUN, lanes, equations, at_samples)
    states = np.zeros((runs.samples, equations.n_x))
    measured = np.zeros((1, 0)) if runs.measured is None else _contiguous(runs.measured)
    table = _table(runs, lanes)
    arrays = _arrays(runs)

    def run(group: int) -> None:
        function(
            group,
            group + 1,
            _address(table),
            _address(constants),
            substeps,
            runs.drive.shape[1],
            *map(_address, arrays),
            _address(measured),
            measured.shape[1],
            _address(states),
        )

    _side_by_side(run, len(table) // lanes)
    return states[:, :n_x]


def compare(
    equations: Equations,
    residual: ResidualFormula,
    runs: Runs,
    substeps: int,
    directions: Directions,
    samples: Samples,
) -> Comparison:
    """Products of residuals and derivatives, see `runs.compare`."""
    lanes = width()
    extended, at_samples, start = _with_sampled_states(equations, runs.start)
    runs = replace(runs, start=start)
    seeds = _with_sampled_states(equations, directions.seeds)[2]
    function, constants = _function(
        write_compare, "compare", COMPARE, lanes, extended, residual, at_samples
    )
    n_r, n_d, n_x = seeds.shape
    result = Comparison(
        np.zeros((n_r, n_d, n_d)),
        np.zeros((n_r, n_d)),
        np.zeros(n_r),
        np.zeros((runs.samples, residual.n_y)),
    )
    table = _table(runs, lanes)
    arrays = [*_arrays(runs), _contiguous(seeds)]
    target, weight = _contiguous(samples.target), _contiguous(samples.weight)
    by_p = equations.n_p if directions.parameters else 0

    def run(group: int) -> None:
        # memory that begins where vectors are aligned
        work = np.zeros((n_d * (3 * n_x + n_d + 1) + 1) * lanes + _ALIGNED // 8)
        work = work[-work.ctypes.data % _ALIGNED // 8 :]
        function(
            group,
            group + 1,
            _address(table),
            _address(constants),
            substeps,
            runs.drive.shape[1],
            *map(_address, arrays),
            n_d,
            by_p,
            _address(target),
            _address(weight),
            _address(work),
            _address(result.error),
            _address(result.products),
            _address(result.gradient),
            _address(result.cost),
        )

    _side_by_side(run, len(table) // lanes)
    # only the lower triangles were computed
    result.products[...] += np.swapaxes(np.tril(result.products, -1), 1, 2)
    return result


def _with_sampled_states(
    equations: Equations, states: Float[np.ndarray, "*runs n_x"]
) -> tuple[Equations, Equations | None, Float[np.ndarray, "*runs n"]]:
    """Equations without sampled values: these are states behind the others.

    Returns:
        The equations; the step that computes the sampled values at each sample, None without any;
        and states, or derivatives of them, with zeros in their places.
    """
    if equations.sampled is None:
        return equations, None, states
    flow, at_samples = equations.with_sampled_states
    zeros = np.zeros((*states.shape[:-1], equations.sampled.size))
    return flow, at_samples, np.concatenate([states, zeros], axis=-1)


def evaluate(
    formula: Formula, points: Float[np.ndarray, "n n_in"], *, derivatives: bool
) -> Float[np.ndarray, "n n_out"]:
    """Values of a formula, or its derivatives, at many points; see `runs.evaluate`."""
    program = formula.derivatives if derivatives else formula.program
    operations = _operations.get(formula, 0) + len(points) * program.executed
    _operations[formula] = operations
    if operations < max(_FEW_OPERATIONS, _FEW_POINTS * program.operations):
        rows = [run(program, x=point)["value"] for point in _contiguous(points)]
        return np.stack(rows) if rows else np.zeros((0, output_size(program, "value")))
    function, constants = _function(
        write_map, "map", MAP, width(), formula, derivatives=derivatives
    )
    values, points = np.zeros((len(points), output_size(program, "value"))), _contiguous(points)
    if values.size:
        function(len(points), _address(constants), _address(points), _address(values))
    return values


def compile_formula(formula: Formula, *, derivatives: bool) -> None:
    """Compiles a formula whatever the number of points; see `runs.compile_formula`."""
    _operations[formula] = max(
        _FEW_OPERATIONS,
        _FEW_POINTS * formula.program.operations,
        _FEW_POINTS * formula.derivatives.operations,
    )
    _function(write_map, "map", MAP, width(), formula, derivatives=derivatives)


def make_step(equations: Equations) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A function that steps a discrete model once; see `runs.make_step`."""
    step = _make_function(equations, equations.n_x, linearised=False)
    return lambda state, inputs: step(state, inputs).copy()


def make_linearised_step(
    equations: Equations,
) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A function that steps and linearises a discrete model; see `runs.make_linearised_step`."""
    n_x, n_u = equations.n_x, equations.n_u
    end = n_x + n_x**2
    step = _make_function(equations, end + n_x * n_u, linearised=True)

    def linearised_step(
        state: np.ndarray, inputs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        values = step(state, inputs).copy()
        return values[:n_x], values[n_x:end].reshape(n_x, n_x), values[end:].reshape(n_x, n_u)

    return linearised_step


def _make_function(
    equations: Equations, size: int, *, linearised: bool
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The function of a step kernel; what it returns is overwritten by the next call."""
    function, constants = _load(write_step, "step", STEP, 1, equations, linearised=linearised)
    n_u = equations.n_u
    # memory of its own, whose addresses are known: asking an array for its address takes longer
    # than the step
    memory = constants, *(np.zeros(max(1, n)) for n in (equations.n_x, n_u, size))
    addresses = [_address(array) for array in memory]

    def step(state: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        _, x, u, values = memory
        x[:] = state
        if n_u:
            u[:] = inputs
        function(*addresses)
        return values

    return step


def _table(runs: Runs, lanes: int) -> Int[np.ndarray, "lanes columns"]:
    """Rows of the table of lanes, see `LANE`; runs of like length stand side by side."""
    order = np.argsort(-runs.steps, kind="stable")
    table = np.zeros((-(-len(order) // lanes) * lanes, len(LANE)), np.int64)
    table[:, 0], table[:, 1] = order[-1] if len(order) else 0, -1
    counts = runs.measured_samples
    counts = np.zeros(len(order), int) if counts is None else counts
    columns = order, runs.steps[order], runs.first[order], runs.results[order], counts[order]
    table[: len(order)] = np.stack(columns, axis=1)
    return table


def _arrays(runs: Runs) -> list[np.ndarray]:
    if runs.drive.shape[1] > MOST_ORDER:
        raise ValueError(f"inputs of order {runs.drive.shape[1]}")
    return [_contiguous(a) for a in (runs.drive, runs.periods, runs.start, runs.parameters)]


def _load(
    write: Callable[..., None], name: str, signature: str, lanes: int, *args: Any, **options: Any
) -> tuple[Any, np.ndarray]:
    """A compiled function that `write` writes, and the constants that it reads."""
    module, constants = Module(lanes), Constants()
    write(module, constants, *args, **options)
    types = [_TYPES[parameter.split()[0]] for parameter in signature.split(", ")]
    function = compile_module(module.text()).function(name, types)
    return function, np.array([*constants.numbers, 0.0])


_function = lru_cache(_CACHED_FUNCTIONS)(_load)


def _side_by_side(run: Callable[[int], None], groups: int) -> None:
    """Runs all groups, one on each core; machine code releases Python's lock."""
    if groups == 1:
        run(0)
        return
    with ThreadPoolExecutor(count_cores()) as pool:
        list(pool.map(run, range(groups)))


def _contiguous(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, np.float64)


def _address(array: np.ndarray) -> int:
    return array.ctypes.data
