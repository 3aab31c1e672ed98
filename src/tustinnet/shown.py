"""What notebooks show: lines, tables, pictures and frames of records and results.

Pictures are drawn in the upper rooms, which are loaded when something is shown.
"""

from collections.abc import Sized
from dataclasses import fields
from importlib import import_module
from textwrap import shorten
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import polars as pl

_PLACE = "tustinnet.report.notebook"


class Brief:
    """Base class of results whose `repr` has the sizes of arrays, lists and tables.

    It leaves out values that are the default. The dataclass has `repr=False`.
    """

    def __repr__(self) -> str:
        values = [(f, getattr(self, f.name)) for f in fields(self)]  # pyright: ignore[reportArgumentType]
        shown = [f"{f.name}={_brief(value)}" for f, value in values if value is not f.default]
        return f"{type(self).__name__}({', '.join(shown)})"


def _brief(value: Any) -> str:
    """A few words on a value: a number or name itself, of all else kind and size or name."""
    name, shape = getattr(value, "name", None), getattr(value, "shape", None)
    kind = type(value).__name__
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str):
        return repr(shorten(value, 60, placeholder="..."))
    if value is None or isinstance(value, int):
        return str(value)
    if isinstance(value, tuple) and len(value) <= 4 and all(isinstance(v, float) for v in value):
        return f"({', '.join(map(_brief, value))})"
    if shape is not None:
        return f"array{shape}"
    if isinstance(name, str):
        return f"{kind}({name!r})"
    return f"<{len(value)}>" if isinstance(value, Sized) else kind


class Shown(Brief):
    """Base class of what notebooks show as a table, and of which there are frames."""

    def _repr_html_(self) -> str:
        return import_module(_PLACE).to_html(self)

    def to_frame(self) -> "pl.DataFrame":
        """The content as a frame of polars; `.to_pandas()` makes one of pandas, by pyarrow.

        A row is a sample of records, a parameter of an identification, a candidate of a selection,
        a score of a cross-validation, a column of a draft; a training and a score have one row.
        Without the package pyarrow `pandas.DataFrame(frame.to_dict(as_series=False))` makes one of
        pandas.
        """
        return import_module(_PLACE).to_frame(self)


class Plotted(Shown):
    """Base class of what can be drawn."""

    def plot(self, axes: Any = None) -> Any:
        """Draws it, a panel for each coordinate, and one for the inputs.

        Of a data set the first 5 records are drawn; of a score the record and the free run; of a
        fit a free run of its first validation record, or of a training record without these; of a
        choice one of the first record, from which the model was fitted, too.

        Args:
            axes: axes of matplotlib to draw into, one a panel; by default those of a new figure.

        Returns:
            The axes, an array.

        Raises:
            InputError: another number of axes; a score or a fit without its records.
        """
        return import_module(_PLACE).plot(self, axes)
