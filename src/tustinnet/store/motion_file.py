"""Designed motions as CSV files."""

from pathlib import Path

from tustinnet.evaluate.record_design import RecordDesign
from tustinnet.store.files import write_into


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
    write_into(folder, name, pl.DataFrame(columns).write_csv())
