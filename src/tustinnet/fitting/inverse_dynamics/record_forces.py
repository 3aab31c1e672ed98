"""Forces along records by equations of motion, beside those of actuators and trivial references."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Coordinate
from tustinnet.fitting.inverse_dynamics.sums import force_sizes, rest_speeds
from tustinnet.fitting.report import ForceError
from tustinnet.shown import Brief


@dataclass(frozen=True, repr=False)
class RecordForces(Brief):
    """Forces along a record, filtered, at nearly independent samples.

    Attributes:
        record: the record's name.
        split: its split; "" without one.
        coordinates: the coordinates.
        units: of the forces at each.
        cutoff: frequency up to which forces are compared [Hz].
        t: times of the samples [s], (k,).
        applied: what the actuators give, (k, n_q) [units].
        needed: what the motion needs by the model, (k, n_q) [units].
        needed_by_file: the same by the nominal values, as of a robot's file.
        needed_by_least_squares: the same by least squares on training records without priors,
            ranges and added forces; None without such records.
        speed: size of the velocities, (k, n_q) [rad/s or m/s].
    """

    record: str
    split: str
    coordinates: tuple[Coordinate, ...]
    units: tuple[str, ...]
    cutoff: float
    t: Float[np.ndarray, " k"]
    applied: Float[np.ndarray, "k n_q"]
    needed: Float[np.ndarray, "k n_q"]
    needed_by_file: Float[np.ndarray, "k n_q"]
    needed_by_least_squares: Float[np.ndarray, "k n_q"] | None
    speed: Float[np.ndarray, "k n_q"]

    @property
    def missing(self) -> Float[np.ndarray, "k n_q"]:
        """The missing forces: needed by the motion, not given by actuators, (k, n_q) [units]."""
        return self.needed - self.applied

    @property
    def moves(self) -> Bool[np.ndarray, "k n_q"]:
        """Samples at which each coordinate moves: faster than 2 % of its root mean square speed."""
        return self.speed >= rest_speeds(self.speed)

    @property
    def errors(self) -> tuple[ForceError, ...]:
        """The missing force at each coordinate, by itself and by the actuators' forces."""
        return force_errors([self])


def force_errors(forces: Sequence[RecordForces]) -> tuple[ForceError, ...]:
    """The missing forces at each coordinate along the records of each split.

    Args:
        forces: the forces along records of the same coordinates.
    """
    errors: list[ForceError] = []
    for split in dict.fromkeys(part.split for part in forces):
        own = [part for part in forces if part.split == split]
        applied, needed, by_file, speed = (
            np.concatenate([getattr(part, name) for part in own])
            for name in ("applied", "needed", "needed_by_file", "speed")
        )
        sizes, moves = force_sizes(applied, needed), speed >= rest_speeds(speed)
        by_least_squares = [part.needed_by_least_squares for part in own]
        fitted = [x for x in by_least_squares if x is not None]
        least = _shares(np.concatenate(fitted) - applied, sizes) if fitted else None
        size, missing = (np.sqrt(np.mean(x**2, axis=0)) for x in (sizes, needed - applied))
        by_nominal = _shares(by_file - applied, sizes)
        moving = _shares((needed - applied) * moves, sizes * moves)
        errors += [
            ForceError(
                split=split,
                coordinate=c.name,
                unit=own[0].units[k],
                cutoff=own[0].cutoff,
                # not 0 where a joint has no force
                size=max(float(size[k]), 1e-12),
                missing=float(missing[k]),
                moving=moving[k],
                by_file=by_nominal[k],
                by_least_squares=None if least is None else least[k],
                is_driven=bool(applied[:, k].any()),
            )
            for k, c in enumerate(own[0].coordinates)
        ]
    return tuple(errors)


def _shares(missing: Float[np.ndarray, "k n_q"], sizes: Float[np.ndarray, "k n_q"]) -> list[float]:
    """Missing force by the actuators', root mean squares, of each coordinate."""
    lengths = np.linalg.norm(missing, axis=0), np.linalg.norm(sizes, axis=0)
    return [float(a / b) if b > 0 else 0.0 for a, b in zip(*lengths, strict=True)]
