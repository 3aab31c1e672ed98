"""Designed motions as CSV files."""

from pathlib import Path

import numpy as np

from tustinnet.evaluate.record_design import RecordDesign
from tustinnet.store.files import write_into

_DECIMALS = 12


def write_motion(folder: Path, name: str, design: RecordDesign) -> None:
    """Writes the reference of a designed record: time, motion of each coordinate, expected inputs.

    SI units; a header names the columns after the channels, `NAME_dot` for velocities, `NAME_ddot`
    for accelerations.

    Args:
        folder: the output folder.
        name: the file's name.
        design: the designed record.
    """
    import polars as pl

    columns = {"time": design.t}
    motion = {"": design.q, "_dot": design.v, "_ddot": design.a}
    for j, c in enumerate(design.channels.coordinates):
        columns |= {c.name + ending: values[:, j] for ending, values in motion.items()}
    columns |= {i.name: design.u[:, j] for j, i in enumerate(design.channels.inputs)}
    # so that what is at rest is exactly 0
    table = pl.DataFrame({key: np.round(x, _DECIMALS) + 0.0 for key, x in columns.items()})
    write_into(folder, name, table.write_csv())
