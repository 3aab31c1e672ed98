"""Logs whose columns and units have names that were made to do harm, one function a format."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars as pl
import scipy.io

# names that end a line, steer a terminal, or would add to a card, a message or a program
NAMES = (
    'u\ndescription = "written by the name"\n#',
    "\x1b[31mred\x1b[0m",
    "a\r\nb",
    'q"]\n[x]',
    "column 1\nname = 3",
    "column 7",
    "column = 2",
    "\x7f\x85\u2028",
    "\u202eabc",
    "'''",
    "#",
    "a\x00b",
    "\\u001b",
    "{x}",
    "{",
    "%s",
    "$(id)",
    "$\\foo$",
    "../../x",
    "<b>&amp;",
    "\x1b]0;title\x07",
)
T = 0.01 * np.arange(300)
SIGNALS = (T, np.sin(3 * T), np.repeat(np.random.default_rng(0).normal(size=15), 20))


def write_text(folder: Path, names: list[str]) -> Path:
    cells = ['"' + name.replace('"', '""') + '"' for name in names]
    rows = [",".join(map(repr, row)) for row in zip(*map(list, SIGNALS), strict=True)]
    file = folder / "log.csv"
    file.write_text("\n".join([",".join(cells), *rows]), encoding="utf-8", newline="")
    return file


def write_hdf5(folder: Path, names: list[str]) -> Path:
    with h5py.File(folder / "log.h5", "w") as file:
        for name, values in zip(names, SIGNALS, strict=True):
            file[name] = values
            file[name].attrs["units"] = name
    return folder / "log.h5"


def write_parquet(folder: Path, names: list[str]) -> Path:
    pl.DataFrame(dict(zip(names, SIGNALS, strict=True))).write_parquet(folder / "log.parquet")
    return folder / "log.parquet"


def write_npz(folder: Path, names: list[str]) -> Path:
    arrays: dict[str, Any] = dict(zip(names, SIGNALS, strict=True))
    np.savez(folder / "log.npz", **arrays)
    return folder / "log.npz"


def write_mat(folder: Path, names: list[str]) -> Path:
    scipy.io.savemat(folder / "log.mat", dict(zip(names, SIGNALS, strict=True)), appendmat=False)
    return folder / "log.mat"


def write_workbook(folder: Path, names: list[str]) -> Path:
    import xlsxwriter

    with xlsxwriter.Workbook(folder / "log.xlsx") as book:
        sheet = book.add_worksheet("data")
        sheet.write_row(0, 0, names)
        for row, values in enumerate(zip(*map(list, SIGNALS), strict=True), 1):
            sheet.write_row(row, 0, values)
    return folder / "log.xlsx"


def write_mdf(folder: Path, names: list[str]) -> Path:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        signals = zip(names[1:], SIGNALS[1:], strict=True)
        file.append([Signal(x, T, name=name, unit=name) for name, x in signals], acq_name=names[0])
        file.save(folder / "log.mf4", overwrite=True)
    return folder / "log.mf4"


def write_tdms(folder: Path, names: list[str]) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(folder / "log.tdms") as writer:
        writer.write_segment(
            [
                ChannelObject("g", name, values, {"unit_string": name})
                for name, values in zip(names, SIGNALS, strict=True)
            ]
        )
    return folder / "log.tdms"


def write_lerobot(folder: Path, names: list[str]) -> Path:
    """Names of motors, and a word instead of the frames a second."""
    file = folder / "data/chunk-000/file-000.parquet"
    for parent in (folder / "meta", file.parent):
        parent.mkdir(parents=True)
    features = {"observation.state": {"dtype": "float32", "shape": [2], "names": names[:2]}}
    info = {"codebase_version": "v3.0", "fps": names[2], "features": features}
    (folder / "meta/info.json").write_text(json.dumps(info))
    state = np.column_stack(SIGNALS[1:]).astype(np.float32)
    episode = np.repeat([0, 1], len(T) // 2)
    pl.DataFrame(
        {"observation.state": state, "timestamp": T.astype(np.float32), "episode_index": episode}
    ).write_parquet(file)
    return file


WRITERS: tuple[Callable[[Path, list[str]], Path], ...] = (
    write_text,
    write_hdf5,
    write_parquet,
    write_npz,
    write_mat,
    write_workbook,
    write_mdf,
    write_tdms,
    write_lerobot,
)
