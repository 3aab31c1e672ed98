"""Lines of a data card that mend a finding, as texts with the table that they belong to."""

from tustinnet.data.experiment import Experiment


def top_line(entry: str) -> str:
    """A line above the tables of the card."""
    return f"at the top: {entry}"


def time_line(entry: str) -> str:
    """A line of the table of times."""
    return f"under [time]: {entry}"


def coordinate_line(name: str, entry: str) -> str:
    """A line in the block of a coordinate."""
    return f"under [[coordinates]] {name}: {entry}"


def input_line(name: str, entry: str) -> str:
    """A line in the block of an input."""
    return f"under [[inputs]] {name}: {entry}"


def times_too_large(factor: float) -> str:
    """How wrong the numbers of a column are that are some times the true ones."""
    size = f"{factor:.4g} times too large" if factor > 1 else f"{1 / factor:.4g} times too small"
    return f"its numbers are {size}"


def file_line(e: Experiment, entry: str) -> str:
    """An entry of a record's file in its split, with a key."""
    return f'under [splits] {_split(e)}: {{ file = "{_file(e)}", {entry} }}'


def file_parts(e: Experiment, stop: int, start: int) -> str:
    """Entries of a record's file up to a row, and from another row on."""
    rows = f"rows = [{e.first_row}, {stop}]"
    return f"{file_line(e, rows)}, and the rows from {start} on as another entry"


def without_record(e: Experiment) -> str:
    """The advice to leave a record out of its split."""
    return f'under [splits] {_split(e)}: leave out "{_file(e)}"'


def _split(e: Experiment) -> str:
    return e.split or "train"


def _file(e: Experiment) -> str:
    return e.source or e.name
