"""Matrices of a linearised step, for scipy and MATLAB."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.io import loadmat, savemat

from tustinnet.export.source import Source, StepFunction
from tustinnet.export.tangent import compute_tangent, operating_point
from tustinnet.export.target import Files, Stepper, Target

FILE = "linear.mat"
_TITLE = 116  # bytes of text that a file begins with


@dataclass(frozen=True)
class Matrices(Target):
    """`A`, `B`, `C`, `D` of a step about an operating point.

    Attributes:
        point: values of states and inputs there, by name; those that are not named are 0.
    """

    name = "mat"
    point: Mapping[str, float] = field(default_factory=dict)

    def at_operating_point(self, point: Mapping[str, float]) -> "Matrices":
        """Matrices about another operating point."""
        return Matrices(point)

    def expected(self, source: Source) -> StepFunction:
        """The tangent of the model's step, by JAX."""
        t = compute_tangent(source, *operating_point(source, self.point))
        following = t.x + t.drift
        return lambda x, u: jnp.asarray(following + t.a @ (x - t.x) + t.b @ (u - t.u))

    def files(self, source: Source) -> Files:
        """The matrices, names, period and operating point."""
        t = compute_tangent(source, *operating_point(source, self.point))
        states, inputs = mat_cells(source.states), mat_cells(source.input_names)
        columns = {"x": t.x, "u": t.u, "drift": t.drift}
        return {
            FILE: mat_file(
                {
                    "A": t.a,
                    "B": t.b,
                    "C": np.eye(source.n_x),
                    "D": np.zeros((source.n_x, source.n_w)),
                    "dt": source.channels.dt,
                    "states": states,
                    "inputs": inputs,
                    "outputs": states,
                    **{name: values[:, None] for name, values in columns.items()},
                }
            )
        }

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """An affine step by the matrices of the file, read by scipy."""
        content = loadmat(folder / FILE)
        x0, u0, drift = (content[name].ravel() for name in ("x", "u", "drift"))
        return lambda x, u: x0 + drift + content["A"] @ (x - x0) + content["B"] @ (u - u0)


def mat_cells(names: Sequence[str]) -> np.ndarray:
    """Names as MATLAB has them in a MAT file: a cell each."""
    return np.array(names, dtype=object)


def mat_file(content: Mapping[str, Any]) -> bytes:
    """The bytes of a MAT file with some variables, without the time at which it was written."""
    written = BytesIO()
    savemat(written, dict(content))
    return b"MATLAB 5.0 MAT-file, written by tustinnet".ljust(_TITLE) + written.getvalue()[_TITLE:]


TARGET = Matrices()
