"""Parquet files: a table of columns."""

from pathlib import Path

from tustinnet.data.columns import frame_columns
from tustinnet.data.formats.reader import Array, Contents, Reader


def _contents(path: Path) -> Contents:
    import polars as pl

    table = pl.scan_parquet(path, glob=False, hive_partitioning=False)
    rows = table.select(pl.len()).collect().item()
    return Contents([(name, (rows,)) for name in table.collect_schema().names() if rows])


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    import polars as pl

    frame = pl.read_parquet(path, columns=sorted(names), glob=False, hive_partitioning=False)
    columns = frame_columns(frame, path)
    return {name: columns[name] for name in names}


READER = Reader("polars", _contents, _arrays)
