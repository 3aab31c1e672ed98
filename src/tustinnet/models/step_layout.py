"""Layouts of inputs: what a model's step takes of a record's inputs, as rows."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.signals.excitation import Excitation

# the inputs of one step: (n_u,) where they are one row, else rows before that
StepInput = Float[Array, "*rows n_u"]
StepInputs = Float[np.ndarray, "steps *rows n_u"]


@dataclass(frozen=True)
class StepLayout:
    """The rows of inputs that a model's step takes: polynomial, mean, samples, in this order.

    A model that is composed of others has the rows of all its parts, each row once, and passes
    each part its own. A single row is a vector.

    Attributes:
        polynomial: whether coefficients of the polynomials over the period are among them, as many
            rows as the holds of the inputs require: 1 where all are held.
        mean: whether the mean over the period is.
        taps: the samples that are, counted from the beginning of the period: -1 is the sample
            before, 1 the one after.
    """

    polynomial: bool = False
    mean: bool = False
    taps: tuple[int, ...] = ()

    def __or__(self, other: "StepLayout") -> "StepLayout":
        """The rows of two layouts, each row once."""
        return StepLayout(
            self.polynomial or other.polynomial,
            self.mean or other.mean,
            tuple(dict.fromkeys((*self.taps, *other.taps))),
        )

    def arrange(self, inputs: Excitation) -> StepInputs:
        """The rows of every period of a record, (steps, rows, n_u); a single one is (steps, n_u).

        Beyond a record's ends its end samples count.
        """
        last = len(inputs.samples) - 1
        at_taps = np.arange(last)[:, None] + np.array(self.taps, int)
        rows = np.concatenate(
            [
                *([inputs.pieces] if self.polynomial else []),
                *([inputs.mean[:, None]] if self.mean else []),
                inputs.samples[np.clip(at_taps, 0, last)],
            ],
            axis=1,
        )
        return rows[:, 0] if rows.shape[1] == 1 else rows

    def select(self, u: StepInput, part: "StepLayout") -> Float[Array, "*selected n_u"]:
        """The rows that a part of a model takes, of the rows that the whole model is given.

        Args:
            u: the inputs of a step in this layout, (rows, n_u); a vector, (n_u,), is held and acts
                on all parts.
            part: the layout of the part, whose rows are among those of this one.

        Returns:
            The inputs in the layout of the part; a single row as a vector.

        Raises:
            ValueError: inputs of another layout.
        """
        if u.ndim == 1:
            return u
        coefficients = len(u) - int(self.mean) - len(self.taps)
        if coefficients < 0 or self.polynomial != (coefficients > 0):
            raise ValueError(f"{len(u)} rows of inputs in a period, in the layout {self}")
        first_tap = coefficients + int(self.mean)
        rows = [
            *(range(coefficients) if part.polynomial else ()),
            *((coefficients,) if part.mean else ()),
            *(first_tap + self.taps.index(tap) for tap in part.taps),
        ]
        if len(rows) == 1:
            return u[rows[0]]
        return u if rows == list(range(len(u))) else jnp.stack([u[row] for row in rows])
