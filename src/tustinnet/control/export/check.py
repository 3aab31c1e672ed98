"""The comparison of an exported controller in C with the one in Python, in closed loop."""

import ctypes
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.control.controller import Controller
from tustinnet.control.controllers import LinearFeedback, TrackingFeedback
from tustinnet.control.estimator import make_filter, rest_state
from tustinnet.control.export.code import SOURCES
from tustinnet.control.export.compiled import MEMORY, load_library
from tustinnet.engine.engines import make_step
from tustinnet.errors import InputError
from tustinnet.export.c import address
from tustinnet.export.source import Source
from tustinnet.export.target import Files, NotRunnable
from tustinnet.simulate.filtering import LOST_AFTER, FilterNoise
from tustinnet.wording import counted

BOUND = 1e-9  # of the difference, relative to 1 + the value
_SPOILED = 20  # every so many samples are wrong by 3 rad or m, or NaN

Vector = Float[np.ndarray, " _"]


@dataclass(frozen=True)
class LoopCheck:
    """The comparison of a closed loop in C with Python.

    Attributes:
        steps: the periods that were compared.
        difference: the largest difference of a state, an estimate, its covariance or an input,
            relative to 1 + the value; None where the C code could not be compiled.
        note: the reason, where it could not be compiled; else empty.
    """

    steps: int
    difference: float | None
    note: str = ""


def check_loop(
    files: Files,
    controller: Controller,
    source: Source,
    noise: FilterNoise,
    start: Vector,
    steps: int,
    fall: Vector | None = None,
    lost_after: int = LOST_AFTER,
) -> LoopCheck:
    """Compares a closed loop in C with Python, period by period.

    The loop is that of `main.c`, with some wrong samples. In every period controller, filter and
    model of Python are given what those in C were given: two loops that are closed each by itself
    would part, as rounding errors grow between the counts of an encoder where the device is
    unstable.

    Args:
        files: the files in C.
        controller: the controller in Python.
        source: the model, with a causal layout of its inputs.
        noise: the noise of the estimator.
        start: the state from which the loop begins, (n_x,).
        steps: the periods that are compared.
        fall: the state to which the device falls after these periods, for as many more; None for no
            fall.
        lost_after: samples in a row without use after which the estimate is lost.

    Raises:
        InputError: the loop diverges, or a result differs by more than 1e-9, relative to
            1 + the value.
    """
    try:
        functions = load_library(files, SOURCES)
    except NotRunnable as reason:
        return LoopCheck(0, None, f"not run here: {reason}")
    difference = _compare(functions, controller, source, noise, start, steps, fall, lost_after)
    if not difference <= BOUND:
        raise InputError(
            "the controller in C",
            f"a result differs from that of Python by {difference:.1e}",
            f"at most {BOUND:.0e}",
            "nothing was written",
        )
    return LoopCheck(steps if fall is None else 2 * steps, difference)


def _compare(
    functions: ctypes.CDLL,
    controller: Controller,
    source: Source,
    noise: FilterNoise,
    start: Vector,
    steps: int,
    fall: Vector | None,
    lost_after: int,
) -> float:
    """The largest difference along the loop, relative to 1 + the value."""
    channels, n_x, n_w = source.channels, source.n_x, source.n_w
    counts, read = channels.resolution, channels.resolution > 0
    # as they are in memory: published state, state, covariance, variances, two counters, inputs
    estimator = np.zeros(4 * n_x + n_x**2 + channels.n_q + 1 + n_w)
    state, covariance = slice(n_x, 2 * n_x), slice(2 * n_x, 2 * n_x + n_x**2)
    memory = np.zeros(MEMORY)
    x, inputs, u = np.array(start, np.float64), np.zeros(n_w), np.zeros(channels.n_u)
    largest = 0.0

    def call(name: str, *arrays: np.ndarray) -> None:
        getattr(functions, name)(*map(address, arrays))

    def measure() -> Vector:
        y = x[channels.position].copy()
        y[read] = counts[read] * np.rint(y[read] / counts[read])
        return y

    def compare(computed: np.ndarray, expected: np.ndarray) -> None:
        nonlocal largest
        lost = np.isnan(computed) & np.isnan(expected)
        difference = np.abs(computed - expected) / (1 + np.abs(expected))
        largest = float(np.max(np.where(lost, 0.0, difference), initial=largest))

    step, own = make_step(source.equations), make_filter(source, noise, lost_after)
    y = measure()
    call("estimator_reset", estimator, y)
    call("controller_reset", memory)
    controller.reset()
    own.restart(rest_state(source.model, y))
    own.correct(y)
    compare(estimator[:n_x], own.x)
    total = steps if fall is None else 2 * steps
    for k in range(total):
        if k == steps and fall is not None:
            x[:] = fall
        own.x, own.p = estimator[state].copy(), estimator[covariance].reshape(n_x, n_x).copy()
        call("controller_inputs", memory, estimator, u)  # the state comes first
        compare(u, controller.inputs(k, estimator[:n_x].copy()))
        if isinstance(controller, LinearFeedback | TrackingFeedback):  # its memory is that of C
            controller.correct(u)
        call("estimator_remember", inputs, u)
        expected = step(x, inputs)
        call("model_step", x, inputs)
        if not (np.isfinite(x).all() and np.isfinite(estimator[state]).all()):
            raise InputError(
                "the controller",
                f"its closed loop diverges after {counted(k, 'sample')}",
                "one that holds the model itself",
                "change its weights, its plan or its start",
            )
        compare(x, expected)
        y = measure()
        _spoil(y, k, 2 * lost_after <= total - k < 3 * lost_after)
        call("estimator_update", estimator, y, u)
        own.predict(inputs)
        own.correct(y)
        compare(estimator[:n_x], np.where(own.missed < 0, np.nan, own.x))
        compare(estimator[state], own.x)
        compare(estimator[covariance], own.p.ravel())
    return largest


def _spoil(y: Vector, k: int, is_last: bool) -> None:
    """Makes wrong what encoders read: now and then, and where the filter has to be lost.

    Args:
        y: the positions, (n_q,), which are changed.
        k: the period.
        is_last: whether it is one of the last wrong samples in a row.
    """
    if is_last or k % _SPOILED == 0:
        i, turn = divmod(k // (1 if is_last else _SPOILED), 2)
        y[i % len(y)] += np.nan if turn else 3.0
