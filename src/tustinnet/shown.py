"""What notebooks show: tables, pictures and frames of records and results.

Pictures are drawn in the upper rooms, which are loaded when something is shown.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import polars as pl

_PLACE = "tustinnet.report.notebook"


class Shown:
    """Base class of what notebooks show as a table, and of which there are frames."""

    def _repr_html_(self) -> str:
        return import_module(_PLACE).to_html(self)

    def to_frame(self) -> "pl.DataFrame":
        """Its content as a frame of polars; `.to_pandas()` makes one of pandas."""
        return import_module(_PLACE).to_frame(self)


class Plotted(Shown):
    """Base class of what can be drawn."""

    def plot(self, axes: Any = None) -> Any:
        """Draws it, a panel for each coordinate, and one for the inputs.

        Args:
            axes: axes of matplotlib to draw into, one a panel; by default those of a new figure.

        Returns:
            The axes, an array.

        Raises:
            InputError: another number of axes.
        """
        return import_module(_PLACE).plot(self, axes)
