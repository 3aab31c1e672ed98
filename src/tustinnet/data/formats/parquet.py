"""Parquet files: a table of columns. LeRobot data sets: one whose lists have names, of episodes."""

import itertools
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tustinnet.data.columns import frame_columns
from tustinnet.data.formats.reader import Array, Contents, Part, Reader
from tustinnet.errors import InputError, convert_errors

if TYPE_CHECKING:
    import polars as pl

LEROBOT_INFO = "meta/info.json"  # in the folder of a LeRobot data set
_EPISODE = "episode_index"
_LARGEST_INFO = 10**7  # bytes
_LONGEST_LIST = 256  # numbers of a list that are columns

Place = tuple[str, int | None]  # a column of the table, and the number of an item of its lists


def _contents(path: Path) -> Contents:
    import polars as pl

    table = pl.scan_parquet(path, glob=False, hive_partitioning=False)
    rows = table.select(pl.len()).collect().item()
    if not rows:
        return Contents([])
    info = _lerobot_info(path)
    places, others = _places(table, info)
    parts, notes = {}, []
    if info is not None:
        notes.append(f"a LeRobot data set, {info.get('fps', '?')} frames a second")
        if _EPISODE in table.collect_schema().names():
            parts = _episodes(table, single=not str(info.get("codebase_version")).startswith("v2"))
    return Contents([(name, (rows,)) for name in places], others, parts=parts, notes=tuple(notes))


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    import polars as pl

    table = pl.scan_parquet(path, glob=False, hive_partitioning=False)
    places, _ = _places(table, _lerobot_info(path))
    sources = sorted({places[name][0] for name in names})
    frame = pl.read_parquet(path, columns=sources, glob=False, hive_partitioning=False)
    plain = frame_columns(frame, path)
    arrays: dict[str, Array] = {}
    for name in names:
        source, item = places[name]
        arrays[name] = plain[source] if item is None else _items(path, frame[source], item)
    return arrays


def _items(path: Path, lists: "pl.Series", number: int) -> Array:
    """An item of each of some lists, which have one length."""
    import polars as pl

    lists = lists.arr.to_list() if isinstance(lists.dtype, pl.Array) else lists
    lengths = lists.list.len()
    if lengths.n_unique() > 1:
        found = f"lists of {lengths.min()} to {lengths.max()} numbers"
        raise InputError(f"{path}, {lists.name}", found, "lists of one length")
    return lists.list.get(number).cast(pl.Float64).fill_null(float("nan")).to_numpy()


def _places(
    table: "pl.LazyFrame", info: dict[str, Any] | None
) -> tuple[dict[str, Place], dict[str, str]]:
    """The place of each column of numbers, and a description of everything else, by name."""
    import polars as pl

    schema = table.collect_schema()
    lists = [name for name, kind in schema.items() if isinstance(kind, pl.List)]
    first = table.select(lists).head(1).collect() if lists else pl.DataFrame()
    places: dict[str, Place] = {}
    others: dict[str, str] = {}
    for name, kind in schema.items():
        if isinstance(kind, pl.Struct):
            others[name] = "a structure, such as a picture"
        elif not isinstance(kind, pl.List | pl.Array):
            places[name] = (name, None)
        elif not (kind.inner is not None and kind.inner.is_numeric()):  # pyright: ignore
            others[name] = "lists of no numbers"
        else:
            length = (
                kind.size if isinstance(kind, pl.Array) else len(first[name].to_list()[0] or ())
            )
            if length > _LONGEST_LIST:
                others[name] = f"lists of {length}, longer than {_LONGEST_LIST}"
                continue
            labels = _labels(info, name, length)
            places |= {f"{name}{label}": (name, k) for k, label in enumerate(labels)}
    return places, others


def _labels(info: dict[str, Any] | None, name: str, length: int) -> list[str]:
    """The endings of a list's name for each of its numbers: names of LeRobot, else [0], ..."""
    features = (info or {}).get("features")
    feature = features.get(name) if isinstance(features, dict) else None
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):  # { "motors": [...] }
        inner = list(names.values())
        is_flat = all(isinstance(n, list) for n in inner)
        names = list(itertools.chain.from_iterable(inner)) if is_flat else [*names]
    if isinstance(names, list) and len({*map(str, names)}) == len(names) == length:
        return [f".{name}" for name in names]
    return [f"[{k}]" for k in range(length)]


def _lerobot_info(path: Path) -> dict[str, Any] | None:
    """The description of the LeRobot data set that a file belongs to, None of another file."""
    for folder in path.absolute().parents[:3]:
        file = folder / LEROBOT_INFO
        if file.is_file():
            if file.stat().st_size > _LARGEST_INFO:
                raise InputError(file, "more than 10 MB", "a description of features")
            with convert_errors(file, "cannot be read as JSON", "a description of features"):
                info = json.loads(file.read_text(encoding="utf-8"))
            return info if isinstance(info, dict) else None
    return None


def _episodes(table: "pl.LazyFrame", *, single: bool) -> dict[str, Part]:
    """Rows of each episode by its number; none where there is one, unless `single`."""
    import polars as pl

    numbers = table.select(pl.col(_EPISODE).cast(pl.Int64)).collect()[_EPISODE]
    runs = pl.DataFrame({"n": numbers}).select(pl.col("n").rle()).unnest("n")
    parts: dict[str, Part] = {}
    row = 0
    for length, number in runs.iter_rows():
        if str(number) in parts:
            raise InputError(_EPISODE, f"rows of episode {number} in two places", "in one")
        parts[str(number)] = Part(rows=(row, row + length))
        row += length
    return parts if single or len(parts) > 1 else {}


READER = Reader("polars", _contents, _arrays)
