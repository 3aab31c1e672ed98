"""Checks of all records together: inputs and coordinates that say nothing of their own."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from tustinnet.check.card_lines import WHICH_COLUMN, coordinate_line, input_line
from tustinnet.check.levels import LEVELS
from tustinnet.check.view import RecordView
from tustinnet.finding import Finding


def still_inputs(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Inputs that move in no record."""
    u = np.concatenate([v.experiment.u for v in views])
    for i, values in zip(views[0].experiment.inputs, u.T, strict=True):
        if not np.ptp(values):
            yield views[0].finding(
                "still input",
                input_line(i.name, WHICH_COLUMN),
                i.name,
                value=values[0],
                unit=i.unit,
                samples=len(values),
                is_of_all=True,
            )


def same_sensors(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Coordinates that are one sensor."""
    coordinates = views[0].experiment.coordinates
    q = np.concatenate([v.experiment.q - v.experiment.q.mean(axis=0) for v in views])
    noise, size = np.median([v.noise for v in views], axis=0), np.sqrt(np.mean(q**2, axis=0))
    for i, j in combinations(range(len(coordinates)), 2):
        gain = float(q[:, i] @ q[:, j]) / max(len(q) * float(size[i]) ** 2, 1e-300)
        error = float(np.sqrt(np.mean((q[:, j] - gain * q[:, i]) ** 2)))
        count = max(noise[j], abs(gain) * noise[i])
        limit = max(LEVELS.same_sensor * count, 1e-9 * size[j])
        if size[i] and size[j] and error <= min(limit, LEVELS.same_share * size[j]):
            c = coordinates[j]
            yield views[0].finding(
                "same sensor",
                coordinate_line(c.name, WHICH_COLUMN),
                c.name,
                other=coordinates[i].name,
                gain=gain,
                error=error,
                is_of_all=True,
                unit=c.unit,
            )
