"""Columns of numbers by name, from a file or a data frame."""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.formats.reader import Contents, Part
from tustinnet.errors import InputError, convert_errors, escape_unprinted

Column = Float[np.ndarray, " n"]

_ELEMENT = re.compile(r"(?P<variable>[^.({\[]+)[({](?P<number>\d{1,9})[)}](?P<rest>.*)", re.DOTALL)
# an export of Simulink: its signals are channels of one record, and no records
_SIGNAL = re.compile(r"(?P<export>.*)\.signals\(\d+\)\.", re.DOTALL)
NUMBERED = "column "  # columns without a name are called "column 1", ...


def are_numbers(names: Sequence[str]) -> bool:
    """Whether columns are called by their numbers alone, as those of a file without names."""
    return list(names) == [f"{NUMBERED}{number}" for number in range(1, len(names) + 1)]


def find_column(names: Sequence[str], key: int | str) -> str | None:
    """The name of a column that a card names, or numbers from 1 on; None where there is none."""
    if isinstance(key, int):
        return names[key - 1] if 1 <= key <= len(names) else None
    return key if key in names else None


class Columns:
    """The columns of a file by name, in the file's order, read as numbers on access.

    A column of text does no harm until it is read, which is an `InputError`. Whatever a file calls
    something enters here: characters that are not printed are escaped (`escape_unprinted`).

    Attributes:
        names: names of the columns.
        notes: remarks on how the file was read.
        rows: the rows of a text file, counted from 1; None of other files.
        others: a description of everything in the file that is no column of numbers, by name.
        clocks: names of the columns of times of those columns that have times of their own.
        units: units by the name of the column, where the file has them.
        labels: what the file calls a column in a text beside it, by its name, where it does.
        parts: records among several in the file, by label: groups of HDF5, episodes.
    """

    def __init__(
        self,
        names: Sequence[str],
        read: Callable[[list[str]], Sequence[Column]],
        rows: Sequence[int] | Int[np.ndarray, " n"] | None = None,
        notes: tuple[str, ...] = (),
        others: Mapping[str, str] | None = None,
        clocks: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        labels: Mapping[str, str] | None = None,
        parts: Mapping[str, Part] | None = None,
    ) -> None:
        self.names = tuple(map(escape_unprinted, names))
        require_different(self.names, "names of columns")
        self._sources = dict(zip(self.names, names, strict=True))
        self.notes = tuple(map(escape_unprinted, notes))
        self.others, self.clocks = _escape_all(others), _escape_all(clocks)
        self.units, self.labels = _escape_all(units), _escape_all(labels)
        self.parts = {
            escape_unprinted(label): Part(escape_unprinted(part.prefix), part.rows)
            for label, part in (parts or {}).items()
        }
        self._read, self.rows = read, rows
        self._columns: dict[str, Column] = {}

    @classmethod
    def from_contents(
        cls, contents: Contents, read: Callable[[list[str]], Sequence[Column]]
    ) -> "Columns":
        """Columns of a file whose arrays are columns, read by a function."""
        return cls(
            [name for name, _ in contents.arrays],
            read,
            notes=contents.notes,
            others=contents.others,
            clocks=contents.clocks,
            units=contents.units,
            labels=contents.labels,
            parts=contents.parts,
        )

    def place(self, sample: int) -> str:
        """The place of a sample: the row of a text file, else its number."""
        if self.rows is None:
            return f"sample {sample} (counted from 0)"
        return f"row {self.rows[sample]}"

    def fetch(self, names: Sequence[str]) -> None:
        """Reads some columns at once, which is quicker than one after the other."""
        missing = [name for name in dict.fromkeys(names) if name not in self._columns]
        if missing:
            columns = self._read([self._sources.get(name, name) for name in missing])
            self._columns.update(zip(missing, columns, strict=True))

    def release(self) -> None:
        """Gives back the memory of the numbers and of the file; nothing can be read after it."""
        self._columns, self._read = {}, _read_nothing

    def fetch_elements(self, names: Collection[str]) -> None:
        """Reads some columns of all elements at once: one by one, each would read the file."""
        sources = [self._element_names(self.names, k) for k in range(1, self.elements + 1)]
        self.fetch([s for element in sources for name, s in element.items() if name in names])

    @property
    def elements(self) -> int:
        """Length of the longest cell or struct array of a MAT file, 0 without any."""
        matches = (self._match_element(name) for name in (*self.names, *self.others))
        return max((int(match["number"]) for match in matches if match), default=0)

    def element(self, number: int) -> "Columns":
        """The columns with one element, from 1 on, in place of each cell or struct array."""
        others = self._element_names(self.others, number)
        texts = {name: self.others[source] for name, source in others.items()}
        return self._renamed(self._element_names(self.names, number), texts)

    def _renamed(
        self, sources: Mapping[str, str], others: Mapping[str, str], rows: slice = slice(None)
    ) -> "Columns":
        """Some of the columns by other names, or some rows of them."""

        def read(names: list[str]) -> list[Column]:
            self.fetch([sources[name] for name in names])
            return [self[sources[name]][rows] for name in names]

        units, labels = (
            {name: texts[source] for name, source in sources.items() if source in texts}
            for texts in (self.units, self.labels)
        )
        return Columns(
            tuple(sources), read, self.rows, self.notes, others, units=units, labels=labels
        )

    def _match_element(self, name: str) -> re.Match[str] | None:
        if self.rows is not None:  # a text has no arrays: `pos (3)` is a column
            return None
        signal = _SIGNAL.match(name)
        if signal is not None and f"{signal['export']}.time" in self.names:
            return None
        match = _ELEMENT.fullmatch(name)
        # so are those of dSPACE, each with a name of its own
        return match if match and f"{match['variable']}(1).Data" not in self.labels else None

    def _element_names(self, names: Iterable[str], number: int) -> dict[str, str]:
        """Names in the file by their names in an element; those outside of arrays stay."""
        sources = {}
        for name in names:
            match = self._match_element(name)
            if match is None:
                sources.setdefault(name, name)
            elif int(match["number"]) == number:
                sources[match["variable"] + match["rest"]] = name
        return sources

    def part(self, label: str) -> "Columns":
        """The columns of one of the records in the file; those outside of all groups stay."""
        part = self.parts[label]
        prefixes = tuple({p.prefix for p in self.parts.values() if p.prefix})
        sources = {
            name.removeprefix(part.prefix): name
            for name in self.names
            if (part.prefix and name.startswith(part.prefix)) or not name.startswith(prefixes)
        }
        return self._renamed(sources, self.others, slice(*(part.rows or (None,))))

    def fetch_parts(self, names: Collection[str]) -> None:
        """Reads some columns of all records in the file at once: one by one, each would read it."""
        prefixes = [part.prefix for part in self.parts.values()]
        sources = {f"{prefix}{name}" for prefix in ("", *prefixes) for name in names}
        self.fetch([name for name in self.names if name in sources])

    def __getitem__(self, name: str) -> Column:
        self.fetch([name])
        return self._columns[name]


def _escape_all(texts: Mapping[str, str] | None) -> dict[str, str]:
    """Texts by name, both with what is not printed escaped."""
    return {escape_unprinted(name): escape_unprinted(x) for name, x in (texts or {}).items()}


def _read_nothing(names: list[str]) -> list[Column]:
    raise RuntimeError(f"columns were released before {names} were read")


def number_repeated(names: Sequence[str]) -> list[str]:
    """Names of which later ones that are alike are numbered: `q`, `q #2`."""
    earlier: Counter[str] = Counter()
    numbered: list[str] = []
    for name in names:
        earlier[name] += 1
        numbered.append(f"{name} #{earlier[name]}" if earlier[name] > 1 else name)
    return numbered


def require_different(names: Sequence[str], where: object) -> None:
    """Raises unless every name occurs once.

    Raises:
        InputError: two columns of one name.
    """
    earlier: set[str] = set()
    for name in names:
        if name in earlier:
            raise InputError(where, f"two columns are called '{name}'", "different names")
        earlier.add(name)


def frame_columns(frame: Any, where: object = "frame") -> Columns:
    """The columns of a pandas or polars data frame; `where` names it in errors.

    Raises:
        InputError: no data frame, an empty one, two columns of one name; text where numbers
            belong (when the column is read).
    """
    import polars as pl

    if not isinstance(frame, pl.DataFrame):
        if not hasattr(frame, "columns") or not hasattr(frame, "to_numpy"):
            raise InputError(where, f"a {type(frame).__name__}", "a pandas or polars data frame")
        require_different([str(name) for name in frame.columns], where)
        with convert_errors(where, "cannot be read as a data frame", "columns of numbers"):
            arrays = {str(name): frame[name].to_numpy() for name in frame.columns}
            frame = pl.DataFrame(
                {name: a.astype(str) if a.dtype.kind == "O" else a for name, a in arrays.items()}
            )
    if not len(frame):
        raise InputError(where, "no samples", "rows of numbers")

    def convert(name: str) -> Column:
        with convert_errors(f"{where}, {name}", "cannot be turned into numbers", "numbers"):
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
