"""Feedback loops played by their code in C, which takes a small part of Python's time."""

import ctypes
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.control.controller import Controller
from tustinnet.control.controllers import feedback_controller
from tustinnet.control.estimator import Estimator, ExtendedKalmanFilter
from tustinnet.control.export.code import (
    LOOP_SOURCES,
    controller_files,
    estimator_files,
    gains_of,
)
from tustinnet.control.input_history import causal_source
from tustinnet.control.lqr import Feedback, Tracking
from tustinnet.control.mpc import Mpc, make_controller
from tustinnet.errors import InputError, convert_errors
from tustinnet.export.c import address, compile_c, make_model_files
from tustinnet.export.target import Files, NotRunnable
from tustinnet.models.contract import Model
from tustinnet.simulate.filtering import FilterNoise
from tustinnet.store.files import write_into

_LIBRARY = ("-std=c99", "-O2", "-fPIC", "-shared")
MEMORY = 100_000  # numbers: more than the memory of a controller


class CompiledController:
    """A controller in C.

    Args:
        functions: its functions.
        n_x: number of states.
        n_u: number of inputs.
    """

    def __init__(self, functions: ctypes.CDLL, n_x: int, n_u: int) -> None:
        self._functions = functions
        self._arrays = np.zeros(MEMORY), np.zeros(n_x), np.zeros(n_u)
        self._places = tuple(map(address, self._arrays))
        self.reset()

    def reset(self) -> None:
        """Begins anew."""
        self._functions.controller_reset(self._places[0])

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,)."""
        _, state, u = self._arrays
        state[:] = x
        self._functions.controller_inputs(*self._places)
        return u.copy()


class CompiledEstimator:
    """An estimator in C.

    Args:
        functions: its functions.
        channels: of the model.
        n_x: number of states.
    """

    def __init__(self, functions: ctypes.CDLL, channels: Channels, n_x: int) -> None:
        self._functions = functions
        self._arrays = np.zeros(MEMORY), np.zeros(channels.n_q), np.zeros(channels.n_u)
        self._places, self._x = tuple(map(address, self._arrays)), self._arrays[0][:n_x]

    def reset(self, y: Float[np.ndarray, " n_q"]) -> Float[np.ndarray, " n_x"]:
        """The estimate at the first sample, (n_x,)."""
        self._arrays[1][:] = y
        self._functions.estimator_reset(*self._places[:2])
        return self._x.copy()

    def update(
        self, y: Float[np.ndarray, " n_q"], u: Float[np.ndarray, " n_u"]
    ) -> Float[np.ndarray, " n_x"]:
        """The estimate at the next sample, (n_x,)."""
        _, positions, inputs = self._arrays
        positions[:], inputs[:] = y, u
        self._functions.estimator_update(*self._places)
        return self._x.copy()


def compile_loop(
    controller: Feedback | Tracking | Mpc, model: Model, noise: FilterNoise
) -> tuple[Controller, Estimator]:
    """A controller and its estimator by their code in C; in Python where no compiler is there.

    Args:
        controller: the controller.
        model: the model whose states are estimated.
        noise: the noise of the estimator.
    """
    delay = gains_of(controller).final.delay
    source = causal_source(model, delay)
    files = {
        **make_model_files(source),
        **estimator_files(source, noise),
        **controller_files(controller, source),
    }
    try:
        functions = load_library(files, LOOP_SOURCES)
    except NotRunnable:
        return make_controller(controller), ExtendedKalmanFilter(model, noise, delay=delay)
    return (
        CompiledController(functions, source.n_x, source.channels.n_u),
        CompiledEstimator(functions, source.channels, source.n_x),
    )


def folder_controller(folder: Path, gains: Feedback | Tracking, *, predictive: bool) -> Controller:
    """The controller of a folder by its code in C; in Python where no compiler is there.

    Args:
        folder: the folder, as `export_controller` writes it.
        gains: its numbers, as `read_controller` reads them.
        predictive: whether it is predictive control, of which these are not all.

    Raises:
        InputError: a file in C that is missing, or predictive control where no compiler is there.
    """
    names = [*LOOP_SOURCES, *(str(Path(name).with_suffix(".h")) for name in LOOP_SOURCES)]
    with convert_errors(folder, "cannot be read", "the files in C that `control` writes"):
        files: Files = {name: (folder / name).read_bytes() for name in names}
    try:
        final = gains.final
        return CompiledController(load_library(files, LOOP_SOURCES), len(final.x0), len(final.u0))
    except NotRunnable as reason:
        if predictive:
            raise InputError(
                folder, f"predictive control, and {reason}", "a compiler, by which it is played"
            ) from reason
        return feedback_controller(gains)


def load_library(files: Files, sources: Sequence[str]) -> ctypes.CDLL:
    """Functions of some files in C, compiled and loaded.

    Raises:
        NotRunnable: there is no compiler, or it reports an error.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, content in files.items():
            write_into(folder, name, content)
        library = folder / "controller.so"
        compile_c([folder / name for name in sources], library, _LIBRARY)
        return ctypes.CDLL(str(library))
