"""Columns of numbers by name, from a file or a data frame."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError, refusing

Column = Float[np.ndarray, " n"]

NUMBERED = "column "  # how columns without a name are called: "column 1", ...


class Columns:
    """The columns of a file by name, in the file's order, turned into numbers when asked for.

    A column of text that nobody asks for does no harm; one that is asked for is an `InputError`.

    Attributes:
        names: what the columns are called.
        notes: what reading the file found out.
    """

    def __init__(
        self,
        names: Sequence[str],
        read: Callable[[list[str]], Sequence[Column]],
        rows: Sequence[int] | None = None,
        notes: tuple[str, ...] = (),
    ) -> None:
        self.names, self.notes = tuple(names), notes
        self._read, self._rows = read, rows
        self._found: dict[str, Column] = {}

    def place(self, sample: int) -> str:
        """Where a sample stands: the row of a text file, else its number."""
        if self._rows is None:
            return f"sample {sample} (counted from 0)"
        return f"row {self._rows[sample]}"

    def fetch(self, names: Sequence[str]) -> None:
        """Reads some columns at once, which is quicker than one after the other."""
        missing = [name for name in dict.fromkeys(names) if name not in self._found]
        self._found.update(zip(missing, self._read(missing), strict=True))

    def __getitem__(self, name: str) -> Column:
        self.fetch([name])
        return self._found[name]


def require_different(names: Sequence[str], where: object) -> None:
    """Raises unless every name occurs once.

    Raises:
        InputError: two columns of one name.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(where, f"two columns are called '{name}'", "different names")
        seen.add(name)


def frame_columns(frame: Any, where: object = "frame") -> Columns:
    """The columns of a pandas or polars data frame; `where` names it in errors.

    Raises:
        InputError: no data frame, an empty one, two columns of one name; text where numbers
            belong (when the column is asked for).
    """
    import polars as pl

    if not isinstance(frame, pl.DataFrame):
        if not hasattr(frame, "columns") or not hasattr(frame, "to_numpy"):
            raise InputError(where, f"a {type(frame).__name__}", "a pandas or polars data frame")
        require_different([str(name) for name in frame.columns], where)
        with refusing(where, "cannot be read as a data frame", "columns of numbers"):
            arrays = {str(name): frame[name].to_numpy() for name in frame.columns}
            frame = pl.DataFrame(
                {name: a.astype(str) if a.dtype.kind == "O" else a for name, a in arrays.items()}
            )
    if not len(frame):
        raise InputError(where, "no samples", "rows of numbers")

    def convert(name: str) -> Column:
        with refusing(f"{where}, {name}", "cannot be turned into numbers", "numbers"):
            # an empty cell becomes NaN, which the checks then name by row
            numbers = frame[name].cast(pl.Float64, strict=False)
            lost = np.flatnonzero((numbers.is_null() & frame[name].is_not_null()).to_numpy())
            if len(lost):
                raise InputError(
                    f"{where}, sample {lost[0]} (counted from 0), {name}",
                    f"'{str(frame[name][int(lost[0])])[:40]}'",
                    "a number",
                )
            return numbers.fill_null(float("nan")).to_numpy()

    return Columns(frame.columns, lambda names: [convert(name) for name in names])
