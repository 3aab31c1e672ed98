"""File formats of figures; checked before results are printed, so without loading matplotlib."""

from pathlib import Path

from tustinnet.errors import InputError

ENDINGS = (".png", ".svg", ".pdf")


def format_of(path: Path) -> str:
    """Format of a figure, from the ending of its file.

    Raises:
        InputError: another ending than .png, .svg or .pdf.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(path, f"ending '{path.suffix}'", f"one of {', '.join(ENDINGS)}")
    return ending[1:]
