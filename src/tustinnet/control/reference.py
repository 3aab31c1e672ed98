"""References: motions that a controller is to follow, from CSV files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from tustinnet.channels import Channels
from tustinnet.errors import InputError

_TIME = "time"
_MOST_SAMPLES = 100_000  # samples


def read_reference(
    path: str | Path, channels: Channels, factors: Mapping[str, float] | None = None
) -> dict[str, Float[np.ndarray, " samples"]]:
    """The positions of a motion at a model's samples, from rest to rest, by coordinate.

    Between the rows of the file they are cubic splines.

    Args:
        path: a CSV file with the column `time` [s], which ascends, and one for each coordinate that
            follows, by its name.
        channels: the model's.
        factors: of the columns to rad or m, by coordinate; 1 of those without.

    Raises:
        InputError: a file that cannot be read, other columns, times that do not ascend, fewer than
            two rows, values that are no finite numbers.
    """
    expected = f"a CSV file with the columns {_TIME} and {', '.join(_names(channels))}, or some"
    try:
        table = pl.read_csv(path).cast(pl.Float64)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise InputError(path, str(error).partition("\n")[0], expected) from None
    wrong = [name for name in table.columns if name not in (_TIME, *_names(channels))]
    if wrong or _TIME not in table.columns or len(table.columns) < 2:
        raise InputError(path, f"the columns {', '.join(table.columns)}", expected)
    if not np.isfinite(table.to_numpy()).all():
        raise InputError(path, "values that are missing or not finite", "numbers in every row")
    t = table[_TIME].to_numpy()
    if len(t) < 2 or not (np.diff(t) > 0).all() or t[-1] - t[0] > _MOST_SAMPLES * channels.dt:
        raise InputError(
            path,
            f"times of {len(t)} rows that do not ascend, or of more than {_MOST_SAMPLES} samples",
            f"two rows or more, later and later [s], with the model's period of {channels.dt:g} s",
        )
    at = t[0] + channels.dt * np.arange(round((t[-1] - t[0]) / channels.dt) + 1)
    return {
        name: CubicSpline(
            t, (factors or {}).get(name, 1.0) * table[name].to_numpy(), bc_type="clamped"
        )(np.minimum(at, t[-1]))
        for name in table.columns
        if name != _TIME
    }


def checked_reference(value: ArrayLike, n_x: int, where: str) -> Float[np.ndarray, "samples n_x"]:
    """A reference as an array, a state for each sample.

    Raises:
        InputError: another shape, or a number that is not finite.
    """
    x = np.asarray(value, np.float64)
    if x.ndim != 2 or x.shape[1] != n_x or len(x) < 2 or not np.isfinite(x).all():
        raise InputError(where, f"a reference of shape {x.shape}", f"finite, (samples, {n_x})")
    return x


def _names(channels: Channels) -> list[str]:
    return [c.name for c in channels.coordinates]
