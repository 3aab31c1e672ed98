"""Runs of equations by machine code, several side by side on every core."""

import ctypes
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Int

from tustinnet.cores import count_cores
from tustinnet.engine.equations import Equations, Formula, Residual
from tustinnet.engine.kernels import (
    LANE,
    MOST_ORDER,
    Kernel,
    compare_kernel,
    map_kernel,
    run_kernel,
    size_of,
    step_kernel,
)
from tustinnet.engine.machine import compiled, width
from tustinnet.engine.runs import Comparison, Directions, Runs, Samples
from tustinnet.program.numbers import run

_ALIGNED = 64  # bytes
_KEPT = 64  # functions that are at hand
_QUICK = 30_000  # operations of a formula that NumPy has done before they were compiled
_done: WeakKeyDictionary[Formula, int] = WeakKeyDictionary()  # operations of each, by NumPy
_POINTER, _WHOLE = ctypes.c_void_p, ctypes.c_int64
_RUN = (_WHOLE, _WHOLE, _POINTER, _POINTER, _WHOLE, _WHOLE, *[_POINTER] * 5, _WHOLE, _POINTER)
_COMPARE = (
    _WHOLE, _WHOLE, _POINTER, _POINTER, _WHOLE, _WHOLE, *[_POINTER] * 5, _WHOLE, _WHOLE,
    *[_POINTER] * 7,
)  # fmt: skip
_MAP = (_WHOLE, _POINTER, _POINTER, _POINTER)


def simulate(equations: Equations, runs: Runs, substeps: int) -> Float[np.ndarray, "rows n_x"]:
    """The states at all samples, run after run; see `runs.simulate`."""
    lanes = _lanes(equations, len(runs.steps))
    function, constants = _run_function(equations, lanes)
    states = np.zeros((runs.samples, equations.n_x))
    known = np.zeros((1, 0)) if runs.known is None else _plain(runs.known)
    table = _table(runs, lanes)
    arrays = _arrays(runs)

    def run(group: int) -> None:
        function(
            group, group + 1, _at(table), _at(constants), substeps, runs.drive.shape[1],
            *map(_at, arrays), _at(known), known.shape[1], _at(states),
        )  # fmt: skip

    _side_by_side(run, len(table) // lanes)
    return states


def compare(
    equations: Equations, residual: Residual, runs: Runs, substeps: int, directions: Directions,
    samples: Samples,
) -> Comparison:  # fmt: skip
    """Products of residuals and derivatives, see `runs.compare`."""
    lanes = width()
    function, constants = _compare_function(equations, residual, lanes)
    n_r, n_d, n_x = directions.seeds.shape
    result = Comparison(
        np.zeros((n_r, n_d, n_d)), np.zeros((n_r, n_d)), np.zeros(n_r),
        np.zeros((runs.samples, residual.n_y)),
    )  # fmt: skip
    table = _table(runs, lanes)
    arrays = [*_arrays(runs), _plain(directions.seeds)]
    compared = [_plain(samples.target), _plain(samples.weight)]
    by_p = equations.n_p if directions.parameters else 0

    def run(group: int) -> None:
        work = _aligned((n_d * (3 * n_x + n_d + 1) + 1) * lanes)
        function(
            group, group + 1, _at(table), _at(constants), substeps, runs.drive.shape[1],
            *map(_at, arrays), n_d, by_p, *map(_at, compared), _at(work), _at(result.error),
            _at(result.products), _at(result.gradient), _at(result.cost),
        )  # fmt: skip

    _side_by_side(run, len(table) // lanes)
    # only the lower triangles were computed
    result.products[...] += np.swapaxes(np.tril(result.products, -1), 1, 2)
    return result


def evaluate(
    formula: Formula, points: Float[np.ndarray, "n n_in"], *, derivatives: bool
) -> Float[np.ndarray, "n n_out"]:
    """A formula, or its derivatives, at many points; see `runs.evaluate`."""
    program = formula.derivatives if derivatives else formula.program
    done = _done.get(formula, 0) + len(points) * len(program.nodes)
    if done < _QUICK:
        _done[formula] = done
        by_hand = [run(program, x=point)["value"] for point in _plain(points)]
        return np.stack(by_hand) if by_hand else np.zeros((0, size_of(program, "value")))
    function, constants, size = _map_function(formula, derivatives=derivatives)
    values, given = np.zeros((len(points), size)), _plain(points)
    if values.size:
        function(len(points), _at(constants), _at(given), _at(values))
    return values


def stepping(equations: Equations) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A function that steps a discrete model once; see `runs.stepping`."""
    function, constants = _function(step_kernel(equations), "step", (_POINTER,) * 4)
    n_x, n_u = equations.n_x, equations.n_u
    # memory of its own, whose addresses are known: to ask an array for its address takes longer
    # than the step
    memory = constants, *(np.zeros(max(1, n)) for n in (n_x, n_u, n_x))
    addresses = [_at(array) for array in memory]

    def step(state: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        _, x, u, ahead = memory
        x[:] = state
        if n_u:
            u[:] = inputs
        function(*addresses)
        return ahead.copy()

    return step


def _table(runs: Runs, lanes: int) -> Int[np.ndarray, "lanes columns"]:
    """What each lane does; runs of like length stand side by side."""
    order = np.argsort(-runs.steps, kind="stable")
    table = np.zeros((-(-len(order) // lanes) * lanes, len(LANE)), np.int64)
    table[:, 0], table[:, 1] = order[-1] if len(order) else 0, -1
    measured = np.zeros(len(order), int) if runs.measured is None else runs.measured
    columns = order, runs.steps[order], runs.first[order], runs.results[order], measured[order]
    table[: len(order)] = np.stack(columns, axis=1)
    return table


def _arrays(runs: Runs) -> list[np.ndarray]:
    if runs.drive.shape[1] > MOST_ORDER:
        raise ValueError(f"inputs of order {runs.drive.shape[1]}")
    return [_plain(a) for a in (runs.drive, runs.periods, runs.start, runs.parameters)]


@lru_cache(_KEPT)
def _run_function(equations: Equations, lanes: int) -> tuple[Any, np.ndarray]:
    return _function(run_kernel(equations, lanes), "run", _RUN)


@lru_cache(_KEPT)
def _compare_function(
    equations: Equations, residual: Residual, lanes: int
) -> tuple[Any, np.ndarray]:
    return _function(compare_kernel(equations, residual, lanes), "compare", _COMPARE)


@lru_cache(_KEPT)
def _map_function(formula: Formula, *, derivatives: bool) -> tuple[Any, np.ndarray, int]:
    kernel = map_kernel(formula, width(), derivatives=derivatives)
    size = size_of(formula.derivatives if derivatives else formula.program, "value")
    return *_function(kernel, "map", _MAP), size


def _function(kernel: Kernel, name: str, arguments: tuple[Any, ...]) -> tuple[Any, np.ndarray]:
    function = compiled(kernel.text).function(name, arguments)
    return function, np.array([*kernel.constants, 0.0])


def _lanes(equations: Equations, runs: int) -> int:
    """How many runs are simulated side by side.

    A vector of the processor, or two where layers of a network are multiplied: each weight is
    then read once for both.
    """
    layers = any(node.op == "product" for node in equations.program.nodes)
    return 2 * width() if layers and runs > width() else width()


def _side_by_side(run: Callable[[int], None], groups: int) -> None:
    """All groups, a core each; machine code releases Python's lock."""
    if groups == 1:
        run(0)
        return
    with ThreadPoolExecutor(count_cores()) as pool:
        list(pool.map(run, range(groups)))


def _plain(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, np.float64)


def _at(array: np.ndarray) -> int:
    return array.ctypes.data


def _aligned(count: int) -> np.ndarray:
    """So many numbers, aligned as vectors are."""
    memory = np.zeros(count + _ALIGNED // 8)
    first = -memory.ctypes.data % _ALIGNED // 8
    return memory[first : first + count]
