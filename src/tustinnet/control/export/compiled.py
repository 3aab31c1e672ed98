"""Controllers played by their code in C, which takes a small part of Python's time."""

import ctypes
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.control.controller import Controller
from tustinnet.control.export.code import controller_files
from tustinnet.control.input_history import find_causal_layout
from tustinnet.control.mpc import Mpc
from tustinnet.export.c import compile_c, make_model_files
from tustinnet.export.source import make_source
from tustinnet.export.target import Files, NotRunnable
from tustinnet.models.contract import Model
from tustinnet.store.files import write_into

_LIBRARY = ("-std=c99", "-O1", "-fPIC", "-shared")
MEMORY = 100_000  # numbers: more than the memory of a controller


class CompiledController:
    """A controller in C, compiled.

    Args:
        files: `controller.c` and `model.c` with their headers.
        n_u: number of inputs.

    Raises:
        NotRunnable: there is no compiler, or it reports an error.
    """

    def __init__(self, files: Files, n_u: int) -> None:
        self._functions = load_library(files, ("controller.c", "model.c"))
        self._memory, self._u = np.zeros(MEMORY), np.zeros(n_u)
        self._place, self._result = (
            ctypes.c_void_p(a.ctypes.data) for a in (self._memory, self._u)
        )
        self.reset()

    def reset(self) -> None:
        """Begins anew."""
        self._functions.controller_reset(self._place)

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs from sample k to sample k + 1, (n_u,)."""
        state = np.ascontiguousarray(x, np.float64)
        self._functions.controller_inputs(
            self._place, ctypes.c_void_p(state.ctypes.data), self._result
        )
        return self._u.copy()


def compiled(mpc: Mpc, model: Model) -> Controller:
    """Predictive control by its code in C; itself where no compiler is there.

    Args:
        mpc: the controller.
        model: its model.
    """
    source = make_source(model)
    source = replace(source, layout=find_causal_layout(source.model, mpc.final.delay))
    try:
        files = {**make_model_files(source), **controller_files(mpc, source)}
        return CompiledController(files, source.channels.n_u)
    except NotRunnable:
        return mpc


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
