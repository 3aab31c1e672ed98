"""Simulated records as CSV files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.bands import Band
from tustinnet.store.files import write_into


def simulation_name(experiment: Experiment) -> str:
    """The name of the file of a simulated record."""
    return f"{experiment.name}.csv"


def write_simulation(
    folder: Path,
    experiment: Experiment,
    states: Float[np.ndarray, "n n_x"],
    band: Band | None = None,
) -> None:
    """Writes time, inputs, simulated positions and velocities, measured positions of a record.

    SI units; a header names the columns after the channels, `NAME_dot` for velocities,
    `NAME_measured` for the record's positions, `NAME_low` and `NAME_high` for the ends of a band.
    """
    import polars as pl

    q, v = states[:, experiment.channels.position], states[:, experiment.channels.velocity]
    columns = {"time": experiment.t}
    columns |= {c.name: experiment.u[:, j] for j, c in enumerate(experiment.inputs)}
    columns |= {c.name: q[:, j] for j, c in enumerate(experiment.coordinates)}
    columns |= {f"{c.name}_dot": v[:, j] for j, c in enumerate(experiment.coordinates)}
    columns |= {
        f"{c.name}_measured": experiment.q[:, j] for j, c in enumerate(experiment.coordinates)
    }
    if band is not None:
        for j, c in enumerate(experiment.coordinates):
            columns |= {f"{c.name}_low": band.low[:, j], f"{c.name}_high": band.high[:, j]}
    write_into(folder, simulation_name(experiment), pl.DataFrame(columns).write_csv())
