"""NPZ files: arrays of NumPy by name."""

import math
import zipfile
from pathlib import Path

import numpy as np

from tustinnet.data.formats.reader import REAL, Array, Contents, Reader


def _contents(path: Path) -> Contents:
    with zipfile.ZipFile(path) as archive:
        tables, others = [], {}
        for member in archive.namelist():
            if not member.endswith(".npy"):
                continue
            with archive.open(member) as file:
                version = np.lib.format.read_magic(file)
                read_header = (
                    np.lib.format.read_array_header_1_0
                    if version == (1, 0)
                    else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = read_header(file)
            name = member.removesuffix(".npy")
            if dtype.kind not in REAL:
                others[name] = "text or objects"
            elif len(shape) in (1, 2) and math.prod(shape) >= 2:
                tables.append((name, shape))
            else:
                others[name] = f"of shape {shape}"
    return Contents(tables, others)


def _arrays(path: Path, names: set[str]) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in names}


READER = Reader("numpy", _contents, _arrays)
