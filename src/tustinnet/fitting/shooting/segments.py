"""Records cut into segments that are simulated side by side."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.residual import Residual
from tustinnet.models.contract import Model
from tustinnet.signals.derivatives import polynomial_fit
from tustinnet.simulate.starts import initial_state, padded

_LEAST_ERROR = 1e-9  # rad or m
_LOCAL = 3  # samples on either side of a segment's beginning that its state is read from


@dataclass(frozen=True)
class Segments:
    """Pieces of records, padded to one length; a whole record is one segment.

    Attributes:
        x0: states at their beginnings, (n_s, n_x).
        searched: which of them are searched for, (n_s, n_x), 1 or 0.
        precision: 1 over the error of each as measured, 0 where nothing was, (n_s, n_x).
        drive: what the inputs do, (n_s, steps, ...).
        periods: time from each sample to the next [s], (n_s, steps).
        target: measured positions, and velocities where the loss is of the state,
            (n_s, steps + 1, n_y).
        weight: weight of every residual, (n_s, steps + 1, n_y); 0 in the padding.
        steps: steps of each, (n_s,).
        record: index of the record each is a piece of, (n_s,).
        share: weight of a squared error of each, 1 over its record's samples, (n_s,).
        pick: which of their values parameters per group have in each, see `groups.picks`,
            (n_s, n_g).
    """

    x0: Float[np.ndarray, "n_s n_x"]
    searched: Float[np.ndarray, "n_s n_x"]
    precision: Float[np.ndarray, "n_s n_x"]
    drive: Float[np.ndarray, "n_s steps *drive"]
    periods: Float[np.ndarray, "n_s steps"]
    target: Float[np.ndarray, "n_s samples n_y"]
    weight: Float[np.ndarray, "n_s samples n_y"]
    steps: Int[np.ndarray, " n_s"]
    record: Int[np.ndarray, " n_s"]
    share: Float[np.ndarray, " n_s"]
    pick: Int[np.ndarray, "n_s n_g"]

    def of(self, records: Collection[int]) -> "Segments":
        """The segments of some of the records, by index."""
        rows = np.flatnonzero(np.isin(self.record, list(records)))
        return Segments(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True)
class Cut:
    """How records are cut.

    Attributes:
        residual: what is compared.
        length: longest segment in steps; None for whole records.
        start: "estimated", then the state at a record's beginning is searched for; or a start
            that `initial_state` knows, then it is not.
        anchored: whether states that are searched for are kept near what the encoder read.
        timestamps: whether to step from timestamp to timestamp, or by the sampling period.
    """

    residual: Residual
    length: int | None = None
    start: str = "estimated"
    anchored: bool = True
    timestamps: bool = True


def cut(
    experiments: Sequence[Experiment],
    model: Model,
    how: Cut,
    picks: Int[np.ndarray, "n_r n_g"] | None = None,
) -> Segments:
    """Cuts records into segments of about equal length.

    Every residual of a record weighs `1 / T_i`, so that records count alike whatever their length
    (the paper's loss). The states inside a record are always searched for.

    Args:
        experiments: the records.
        model: who is to simulate them.
        how: how.
        picks: what each record has of parameters per group, see `groups.picks`; none by default.

    References:
        Bock (1981), Numerical treatment of inverse problems in chemical reaction kinetics
        (multiple shooting); here continuity is reached by growing the segments.
        van Esch, Bonassi, Schön, section 2.2, loss over records.
    """
    of, n_y = model.channels, how.residual.channels
    pieces = [
        (i, a, b) for i, e in enumerate(experiments) for a, b in _bounds(len(e) - 1, how.length)
    ]
    longest = max(b - a for _, a, b in pieces)
    drives = [np.asarray(model.seen(e.input_ends)) for e in experiments]
    x0 = np.zeros((len(pieces), model.state_size))
    searched, precision = np.ones_like(x0), np.zeros_like(x0)
    drive = np.zeros((len(pieces), longest, *drives[0].shape[1:]))
    periods = np.zeros((len(pieces), longest))
    target = np.zeros((len(pieces), longest + 1, n_y))
    weight = np.zeros_like(target)
    for s, (i, a, b) in enumerate(pieces):
        e = experiments[i]
        if a == 0:
            begin = "derived-6" if how.start == "estimated" else how.start
            x0[s] = padded(model, initial_state(e, begin))
            searched[s, of.measured] = float(how.start == "estimated")
            searched[s, of.internal] = 0.0  # a record's internal states start at 0
        else:
            x0[s] = padded(model, _local_state(e, a))
        if how.anchored:
            precision[s, of.position] = searched[s, of.position] / _position_error(e, a)
        drive[s, : b - a] = drives[i][a:b]
        periods[s, : b - a] = np.diff(e.t[a : b + 1]) if how.timestamps else e.dt
        target[s, : b - a + 1, of.position] = e.q[a : b + 1]
        if n_y > of.n_q:
            target[s, : b - a + 1, of.velocity] = e.velocities()[a : b + 1]
        weight[s, : b - a + 1] = how.residual.weight / np.sqrt(len(e))
    steps = np.array([b - a for _, a, b in pieces])
    record = np.array([i for i, _, _ in pieces])
    share = 1 / np.array([len(experiments[i]) for i in record])
    pick = np.zeros((len(pieces), 0), int) if picks is None else picks[record]
    return Segments(
        x0, searched, precision, drive, periods, target, weight, steps, record, share, pick
    )


def _bounds(steps: int, length: int | None) -> list[tuple[int, int]]:
    count = 1 if length is None else max(1, round(steps / length))
    edges = np.linspace(0, steps, count + 1).round().astype(int)
    return list(pairwise(edges.tolist()))


def _near(e: Experiment, k: int) -> slice:
    return slice(max(0, k - _LOCAL), max(0, k - _LOCAL) + 2 * _LOCAL + 1)


def _local_state(e: Experiment, k: int) -> Float[np.ndarray, " n_x"]:
    near = _near(e, k)
    q, v = polynomial_fit(e.t[near], e.q[near], 2, at=e.t[k : k + 1])
    return np.concatenate([q[0], v[0]])


def _position_error(e: Experiment, k: int) -> Float[np.ndarray, " n_q"]:
    """How far a position read at a sample may be off: half a count, or what a parabola misses."""
    near = _near(e, k)
    fitted, _ = polynomial_fit(e.t[near], e.q[near], 2, at=e.t[near])
    missed = np.sqrt(np.mean((fitted - e.q[near]) ** 2, axis=0))
    return np.maximum(np.maximum(e.channels.resolution / 2, missed), _LEAST_ERROR)
