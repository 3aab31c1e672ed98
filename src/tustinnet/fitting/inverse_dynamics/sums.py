"""Sums of squares of missing forces, by which a fit takes no longer than a few matrices do.

Forces are linear in the coordinates of `LinearCoordinates` about a point. Of a record there remain
the products of its columns, one matrix for each joint, for the time in which it moves and for that
in which it rests: at rest friction holds any force, so that these are weighed by themselves.
Forces are filtered, so that a rest reaches to the samples beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

_REST = 0.02  # speed by its root mean square below which a joint rests


@dataclass(frozen=True)
class Columns:
    """Missing forces along a record, linear in coordinates: `slopes @ coordinates + rest`.

    Attributes:
        slopes: derivatives by the coordinates, (k, n_q, n_c).
        rest: what is there without any, (k, n_q) [N m or N].
        applied: forces of the actuators, (k, n_q) [N m or N].
        needed: forces that the motion needs with the values about which they are linear, (k, n_q).
        speed: size of the velocities, (k, n_q) [rad/s or m/s].
        weight: independent measurements by sample.
    """

    slopes: Float[np.ndarray, "k n_q n_c"]
    rest: Float[np.ndarray, "k n_q"]
    applied: Float[np.ndarray, "k n_q"]
    needed: Float[np.ndarray, "k n_q"]
    speed: Float[np.ndarray, "k n_q"]
    weight: float

    @property
    def sizes(self) -> Float[np.ndarray, "k n_q"]:
        """Forces of the actuators, where a joint has none those that its motion needs."""
        return force_sizes(self.applied, self.needed)

    def __getitem__(self, samples: np.ndarray) -> "Columns":
        """The columns at some samples."""
        parts = (self.slopes, self.rest, self.applied, self.needed, self.speed)
        slopes, rest, applied, needed, speed = (x[samples] for x in parts)
        return Columns(slopes, rest, applied, needed, speed, self.weight)

    def followed_by(self, slopes: Float[np.ndarray, "k n_q more"]) -> "Columns":
        """The columns, then those of further coordinates."""
        return replace(self, slopes=np.concatenate([self.slopes, slopes], axis=2))


@dataclass(frozen=True)
class ForceSums:
    """Sums of squares of missing forces, of each fold, joint, and of motion and rest.

    Attributes:
        matrices: products of the columns and, last, of the rest, (f, n_q, 2, n_c + 1, n_c + 1).
        counts: independent measurements, (f, n_q, 2).
        sizes: sums of squares of the sizes of forces, see `Columns`, (f, n_q, 2).
    """

    matrices: Float[np.ndarray, "f n_q 2 n n"]
    counts: Float[np.ndarray, "f n_q 2"]
    sizes: Float[np.ndarray, "f n_q 2"]

    def of_folds(self, folds: Sequence[int] | Bool[np.ndarray, " f"]) -> "ForceSums":
        """The sums of some folds."""
        return ForceSums(self.matrices[folds], self.counts[folds], self.sizes[folds])

    @property
    def total(self) -> "ForceSums":
        """The sums of all folds, as one fold."""
        parts = (self.matrices, self.counts, self.sizes)
        return ForceSums(*(part.sum(axis=0, keepdims=True) for part in parts))

    def squares(self, coordinates: Float[np.ndarray, " n_c"]) -> Float[np.ndarray, "f n_q 2"]:
        """Sums of squares of the missing forces at a point."""
        point = np.append(coordinates, 1.0)
        return np.maximum(np.einsum("fjrkl,k,l->fjr", self.matrices, point, point), 0.0)


def rest_speeds(speed: Float[np.ndarray, "k n_q"]) -> Float[np.ndarray, " n_q"]:
    """Speeds below which the joints rest, by the size of their velocities [rad/s or m/s]."""
    return _REST * np.sqrt(np.mean(speed**2, axis=0))


def force_sizes(
    applied: Float[np.ndarray, "k n_q"], needed: Float[np.ndarray, "k n_q"]
) -> Float[np.ndarray, "k n_q"]:
    """Forces of the actuators, where a joint has none those that its motion needs."""
    return np.where(applied.any(axis=0), applied, needed)


def fold_pieces(part: Columns, records: int) -> list[np.ndarray]:
    """Samples of a record in each of its folds: all, or of one or two records five pieces of it."""
    return np.array_split(np.arange(len(part.rest)), 5 if records < 3 else 1)


def sum_up(parts: Sequence[Columns]) -> ForceSums:
    """The sums of records, in folds.

    Folds are records, or some of these together where there are many, or five pieces of each of
    one or two.
    """
    slow = rest_speeds(np.concatenate([part.speed for part in parts]))
    sums = [_sum_up(part[piece], slow) for part in parts for piece in fold_pieces(part, len(parts))]
    together = np.array_split(np.arange(len(sums)), min(len(sums), 10))
    folds = [[sum(x) for x in zip(*(sums[i] for i in some), strict=True)] for some in together]
    return ForceSums(*(np.stack(x) for x in zip(*folds, strict=True)))


def _sum_up(part: Columns, slow: Float[np.ndarray, " n_q"]) -> tuple[np.ndarray, ...]:
    """Matrices, counts and squares of the sizes of forces of one fold."""
    _, n_q, n_c = part.slopes.shape
    matrices, counts = np.zeros((n_q, 2, n_c + 1, n_c + 1)), np.zeros((n_q, 2))
    sizes, size = np.zeros((n_q, 2)), part.sizes
    for j in range(n_q):
        is_slow = np.pad(part.speed[:, j] < slow[j], 1)
        rests = is_slow[1:-1] | is_slow[:-2] | is_slow[2:]
        for r, kept in enumerate((~rests, rests)):
            rows = np.concatenate([part.slopes[kept, j], part.rest[kept, j, None]], axis=1)
            some = np.flatnonzero(rows.any(axis=0))
            matrices[j, r][np.ix_(some, some)] = part.weight * rows[:, some].T @ rows[:, some]
            counts[j, r] = part.weight * np.count_nonzero(kept)
            sizes[j, r] = part.weight * np.sum(size[kept, j] ** 2)
    return matrices, counts, sizes
