"""Where a free run starts."""

import re

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel
from tustinnet.signals.derivatives import polynomial_fit

DEFAULT_START = "derived-6"


def initial_state(experiment: Experiment, start: str) -> Float[np.ndarray, " n_x"]:
    """The initial state of a record's free run, [q, v], (n_x,).

    Args:
        experiment: the record.
        start: `file`, the first row as it is stored, velocities included; or `derived-N`, the
            least-squares parabola through the first N samples (6 is usual).

    Raises:
        InputError: an unknown start, no velocities for `file`, too few samples for `derived-N`.
    """
    if start == "file":
        if experiment.v is None:
            raise InputError(
                experiment.name,
                "start 'file' without velocity columns",
                "velocities in the file",
                f"use the start '{DEFAULT_START}'",
            )
        return np.concatenate([experiment.q[0], experiment.v[0]])
    match = re.fullmatch(r"derived-(\d+)", start)
    if not match:
        known = "'file', 'derived-N' such as derived-6"
        if samples_fitted(start):
            raise InputError("start", f"'{start}' without a model", known, "use start_states")
        raise InputError(
            "start", f"unknown start '{start}'", f"{known}, or 'model-N' such as model-20"
        )
    samples = int(match[1])
    if not 3 <= samples <= len(experiment):
        raise InputError(
            experiment.name, f"start '{start}'", f"3 to {len(experiment)} samples for the parabola"
        )
    t = experiment.t[:samples]
    q, v = polynomial_fit(t, experiment.q[:samples], 2, at=t[:1])
    return np.concatenate([q[0], v[0]])


def samples_fitted(start: str) -> int:
    """N of a start `model-N`, 0 of any other."""
    match = re.fullmatch(r"model-(\d+)", start)
    return int(match[1]) if match else 0


def padded_state(model: DiscreteModel, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_x"]:
    """Positions and velocities with the model's internal states at 0."""
    return np.concatenate([x, np.zeros(model.state_size - len(x))])


def default_start(experiments: list[Experiment]) -> str:
    """`file` where every record stores velocities, else `derived-6`."""
    stored = all(e.v is not None for e in experiments)
    return "file" if stored else DEFAULT_START
