"""The comparison of an exported controller in C with the one in Python, in closed loop."""

import ctypes
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.control.controller import Controller
from tustinnet.control.estimator import ExtendedKalmanFilter
from tustinnet.control.export.code import SOURCES
from tustinnet.engine.runs import make_linearised_step, make_step
from tustinnet.errors import InputError
from tustinnet.export.c import compile_c
from tustinnet.export.source import Source
from tustinnet.export.target import Files, NotRunnable
from tustinnet.simulate.filtering import FilterNoise, KalmanFilter
from tustinnet.store.files import write_into
from tustinnet.wording import counted

BOUND = 1e-9  # of the difference, relative to 1 + the value
_LIBRARY = ("-std=c99", "-O1", "-fPIC", "-shared")
_CONTROLLER = 1000  # numbers: more than the memory of a controller

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
) -> LoopCheck:
    """Compares a closed loop in C with Python, period by period.

    The loop is that of `main.c`. In every period controller, filter and model of Python are given
    what those in C were given: two loops that are closed each by itself would part, as rounding
    errors grow between the counts of an encoder where the device is unstable.

    Args:
        files: the files in C.
        controller: the controller in Python.
        source: the model, with a causal layout of its inputs.
        noise: the noise of the estimator.
        start: the state from which the loop begins, (n_x,).
        steps: the periods that are compared.
        fall: the state to which the device falls after these periods, for as many more; None for no
            fall.

    Raises:
        InputError: the loop diverges, or a result differs by more than 1e-9, relative to
            1 + the value.
    """
    try:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            for name, content in files.items():
                write_into(folder, name, content)
            library = folder / "controller.so"
            compile_c([folder / name for name in SOURCES], library, _LIBRARY)
            difference = _compare(library, controller, source, noise, start, steps, fall)
    except NotRunnable as reason:
        return LoopCheck(0, None, f"not run here: {reason}")
    if not difference <= BOUND:
        raise InputError(
            "the controller in C", f"a result differs from that of Python by {difference:.1e}",
            f"at most {BOUND:.0e}", "nothing was written",
        )  # fmt: skip
    return LoopCheck(steps if fall is None else 2 * steps, difference)


def _compare(
    library: Path,
    controller: Controller,
    source: Source,
    noise: FilterNoise,
    start: Vector,
    steps: int,
    fall: Vector | None,
) -> float:
    """The largest difference along the loop, relative to 1 + the value."""
    functions = ctypes.CDLL(str(library))
    channels, n_x, n_w = source.channels, source.n_x, source.n_w
    counts, read = channels.resolution, channels.resolution > 0
    # as they are in memory; of the estimator state, covariance, variances, inputs
    estimator = np.zeros(n_x + n_x**2 + n_x + channels.n_q + n_w)
    covariance = slice(n_x, n_x + n_x**2)
    memory = np.zeros(_CONTROLLER)
    x, inputs, u = np.array(start, np.float64), np.zeros(n_w), np.zeros(channels.n_u)
    largest = 0.0

    def call(name: str, *arrays: np.ndarray) -> None:
        getattr(functions, name)(*(ctypes.c_void_p(a.ctypes.data) for a in arrays))

    def measure() -> Vector:
        y = x[channels.position].copy()
        y[read] = counts[read] * np.rint(y[read] / counts[read])
        return y

    def compare(computed: np.ndarray, expected: np.ndarray) -> None:
        nonlocal largest
        largest = max(largest, float(np.max(np.abs(computed - expected) / (1 + np.abs(expected)))))

    angular = channels.angular if channels.angular.any() else None
    step = make_step(source.equations)
    own = KalmanFilter(make_linearised_step(source.equations), noise, angular)
    y = measure()
    call("estimator_reset", estimator, y)
    call("controller_reset", memory)
    controller.reset()
    compare(estimator[:n_x], ExtendedKalmanFilter(source.model, noise).reset(y))
    for k in range(steps if fall is None else 2 * steps):
        if k == steps and fall is not None:
            x[:] = fall
        own.x, own.p = estimator[:n_x].copy(), estimator[covariance].reshape(n_x, n_x).copy()
        call("controller_inputs", memory, estimator, u)  # the state comes first
        compare(u, controller.inputs(k, own.x))
        call("estimator_remember", inputs, u)
        expected = step(x, inputs)
        call("model_step", x, inputs)
        if not (np.isfinite(x).all() and np.isfinite(estimator).all()):
            raise InputError(
                "the controller", f"its closed loop diverges after {counted(k, 'sample')}",
                "one that holds the model itself", "change its weights, its plan or its start",
            )  # fmt: skip
        compare(x, expected)
        y = measure()
        call("estimator_update", estimator, y, u)
        own.predict(inputs)
        own.correct(y)
        compare(estimator[:n_x], own.x)
        compare(estimator[covariance], own.p.ravel())
    return largest
