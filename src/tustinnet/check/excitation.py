"""Checks of all records together: inputs and coordinates that say nothing of their own."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tustinnet.check.card_lines import WHICH_COLUMN, coordinate_line, input_line
from tustinnet.check.levels import LEVELS
from tustinnet.check.view import RecordView
from tustinnet.finding import Finding


def still_inputs(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Inputs that move in no record."""
    for k, i in enumerate(views[0].experiment.inputs):
        values = np.concatenate([v.experiment.u[:, k] for v in views])
        if not np.ptp(values):
            finding = views[0].finding(
                "still input",
                input_line(i.name, WHICH_COLUMN),
                i.name,
                value=values[0],
                unit=i.unit,
                samples=len(values),
            )
            yield replace(finding, records=())


def same_sensors(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Coordinates that are one sensor."""
    coordinates = views[0].experiment.coordinates
    everything = np.concatenate([v.experiment.q - v.experiment.q.mean(axis=0) for v in views])
    noise = np.median([v.noise for v in views], axis=0)
    for j, c in enumerate(coordinates):
        for i, other in enumerate(coordinates[:j]):
            x, y = everything[:, i], everything[:, j]
            if not (np.ptp(x) and np.ptp(y)):
                continue
            gain = float(x @ y / (x @ x))
            error = float(np.sqrt(np.mean((y - gain * x) ** 2)))
            count = max(noise[j], abs(gain) * noise[i])
            if error <= max(LEVELS.same_sensor * count, 1e-9 * float(y.std())):
                finding = views[0].finding(
                    "same sensor",
                    coordinate_line(c.name, WHICH_COLUMN),
                    c.name,
                    other=other.name,
                    gain=gain,
                    error=error,
                    unit=c.unit,
                )
                yield replace(finding, records=())


CHECKS = (still_inputs, same_sensors)
