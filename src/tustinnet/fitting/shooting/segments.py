"""Records cut into segments that are simulated side by side."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.residual import Residual
from tustinnet.models.contract import Model
from tustinnet.models.sensors import delay_names, with_delays
from tustinnet.signals.derivatives import polynomial_fit
from tustinnet.signals.stacking import stack_padded
from tustinnet.simulate.starts import initial_state

_LEAST_ERROR = 1e-9  # rad or m
_DELAYED = 1e-3  # of a period: between two samples everything is smooth in a delay
_LOCAL = 3  # samples on either side of a segment's beginning that its state is read from


@dataclass(frozen=True)
class Segments:
    """Pieces of records; a whole record is one segment.

    What belongs to samples stands record after record, as often as there are samples: where one
    segment ends and the next begins both use the same row.

    Attributes:
        x0: states at their beginnings, (n_s, n_x).
        searched: which of them are searched for, (n_s, n_x), 1 or 0.
        expected: which begin with the internal states that the system expects there by its
            parameters, (n_s,), 1 or 0; `x0` then has what is added to them.
        precision: 1 over the error of each as measured, 0 where nothing was, (n_s, n_x).
        steps: steps of each, (n_s,).
        first: row of the first sample of each, (n_s,).
        record: index of the record each is a piece of, (n_s,).
        share: weight of a squared error of each, 1 over its record's samples, (n_s,).
        pick: which of their values parameters per group have in each, see `groups.picks`,
            (n_s, n_g).
        drive: what the inputs do from each sample to the next, (n, ...).
        periods: time from each sample to the next [s], (n,); 0 at the end of a record.
        target: measured positions, and velocities where the loss is of the state, (n, n_y).
        weight: weight of every residual, (n, n_y).
        later: how `drive` changes with the inputs' delays [1/s]; None where none is searched for.
        drive_at: `drive` by the values of the delays; None where none is searched for.
    """

    x0: Float[np.ndarray, "n_s n_x"]
    searched: Float[np.ndarray, "n_s n_x"]
    expected: Float[np.ndarray, " n_s"]
    precision: Float[np.ndarray, "n_s n_x"]
    steps: Int[np.ndarray, " n_s"]
    first: Int[np.ndarray, " n_s"]
    record: Int[np.ndarray, " n_s"]
    share: Float[np.ndarray, " n_s"]
    pick: Int[np.ndarray, "n_s n_g"]
    drive: Float[np.ndarray, "n *drive"]
    periods: Float[np.ndarray, " n"]
    target: Float[np.ndarray, "n n_y"]
    weight: Float[np.ndarray, "n n_y"]
    later: Float[np.ndarray, "n *drive"] | None = None
    drive_at: "Callable[[Mapping[str, float]], np.ndarray] | None" = None

    def driven(self, values: Mapping[str, float]) -> "Segments":
        """The same with the inputs as late as the parameters' values say."""
        if self.drive_at is None:
            return self
        step = _DELAYED * float(self.periods[0])
        names = delay_names(values)
        after, before = (
            self.drive_at({name: values[name] + change for name in names})
            for change in (step, -step)
        )
        return replace(self, drive=self.drive_at(values), later=(after - before) / (2 * step))

    def samples(self, row: int) -> slice:
        """The samples of a segment, both ends included."""
        return slice(int(self.first[row]), int(self.first[row] + self.steps[row] + 1))

    def side_by_side(
        self, array: Float[np.ndarray, "n *any"]
    ) -> Float[np.ndarray, "n_s longest *any"]:
        """What belongs to samples, segment by segment, zeros after the end of shorter ones."""
        return stack_padded([array[self.samples(row)] for row in range(len(self.steps))])

    @property
    def begins(self) -> Int[np.ndarray, " n_r"]:
        """The first segment of each record, by index."""
        return np.flatnonzero(np.diff(self.record, prepend=-1))

    def of(self, records: Collection[int]) -> "Segments":
        """The segments of some of the records, by index."""
        rows = np.flatnonzero(np.isin(self.record, list(records)))
        own = (
            "x0", "searched", "expected", "precision", "steps", "first", "record", "share", "pick",
        )  # fmt: skip
        return replace(self, **{name: getattr(self, name)[rows] for name in own})

    def beginning_at(self, x0: Float[np.ndarray, "n_s n_x"]) -> "Segments":
        """The same with given states at the beginnings, internal ones included."""
        nowhere = np.zeros_like(x0)
        return replace(self, x0=x0, searched=nowhere, expected=nowhere[:, 0], precision=nowhere)


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
        horizons: longest segment of single records in steps, by name, where they are shorter.
        delays: whether delays of inputs are searched for.
    """

    residual: Residual
    length: int | None = None
    start: str = "estimated"
    anchored: bool = True
    timestamps: bool = True
    horizons: Mapping[str, int] = field(default_factory=dict)
    delays: bool = False

    def longest(self, record: str) -> int | None:
        """Steps of the longest segment of a record; None for the whole."""
        return min((n for n in (self.length, self.horizons.get(record)) if n), default=None)


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
    n_y = how.residual.channels
    pieces = [
        (i, a, b)
        for i, e in enumerate(experiments)
        for a, b in _bounds(len(e) - 1, how.longest(e.name))
    ]
    x0, searched, precision = _beginnings(experiments, model, how, pieces)
    begins = np.cumsum([0, *(len(e) for e in experiments)])
    record = np.array([i for i, _, _ in pieces])
    periods = [np.diff(e.t) if how.timestamps else np.full(len(e) - 1, e.dt) for e in experiments]

    def drive_at(values: Mapping[str, float]) -> np.ndarray:
        inputs = with_delays(model.channels.inputs, values)
        each = (np.asarray(model.step_inputs(e.excitation(inputs))) for e in experiments)
        return np.concatenate([_with_end(u) for u in each])

    return Segments(
        x0=x0,
        searched=searched,
        expected=np.array([float(a == 0) for _, a, _ in pieces]),
        precision=precision,
        steps=np.array([b - a for _, a, b in pieces]),
        first=np.array([begins[i] + a for i, a, _ in pieces]),
        record=record,
        share=1 / np.array([len(experiments[i]) for i in record]),
        pick=np.zeros((len(pieces), 0), int) if picks is None else picks[record],
        drive=drive_at({}),
        drive_at=drive_at if how.delays else None,
        periods=np.concatenate([_with_end(p) for p in periods]),
        target=np.concatenate([_target(e, n_y) for e in experiments]),
        weight=np.concatenate(
            [np.tile(how.residual.weight / np.sqrt(len(e)), (len(e), 1)) for e in experiments]
        ),
    )


def _beginnings(
    experiments: Sequence[Experiment],
    model: Model,
    how: Cut,
    pieces: Sequence[tuple[int, int, int]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States at the beginnings of pieces: values, which are searched for, and precision."""
    of = model.channels
    x0 = np.zeros((len(pieces), model.state_size))
    searched, precision = np.ones_like(x0), np.zeros_like(x0)
    for s, (i, a, _) in enumerate(pieces):
        e = experiments[i]
        if a == 0:
            begin = "derived-6" if how.start == "estimated" else how.start
            x0[s, of.measured] = initial_state(e, begin)
            searched[s, of.measured] = float(how.start == "estimated")
            searched[s, of.internal] = 0.0  # a record's internal states start where expected
        else:
            x0[s, of.measured] = _local_state(e, a)
        if how.anchored:
            precision[s, of.position] = searched[s, of.position] / _position_error(e, a)
    return x0, searched, precision


def _with_end(array: np.ndarray) -> np.ndarray:
    """What belongs to steps with a row of zeros for the last sample, which has none."""
    return np.concatenate([array, np.zeros_like(array[:1])])


def _target(e: Experiment, n_y: int) -> Float[np.ndarray, "samples n_y"]:
    return e.q if n_y == e.channels.n_q else np.concatenate([e.q, e.velocities()], axis=1)


def _bounds(steps: int, length: int | None) -> list[tuple[int, int]]:
    count = 1 if length is None else -(-steps // length)
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
