"""Files of figures: what is checked before results are printed, so without matplotlib."""

from pathlib import Path

from tustinnet.errors import InputError
from tustinnet.store.files import require_writable_folder

_FORMATS = ("png", "svg", "pdf")


def format_of(path: Path) -> str:
    """The format of a figure, which the ending of its file says.

    Raises:
        InputError: another ending than .png, .svg or .pdf.
    """
    ending = path.suffix.lstrip(".").lower()
    if ending not in _FORMATS:
        raise InputError(path, f"ending '{path.suffix}'", f"one of .{', .'.join(_FORMATS)}")
    return ending


def require_figure_file(path: Path) -> None:
    """Raises `InputError` unless a figure can be written into a file; makes its folder."""
    format_of(path)
    require_writable_folder(path.parent)
