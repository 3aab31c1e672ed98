"""Records cut into segments that are simulated side by side (multiple shooting).

`cut_records` makes `Segments` from records: initial states to start from, inputs, measurements to
compare with, and weights.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.fitting.residual import Residual
from tustinnet.models.contract import Model
from tustinnet.models.sensors import delay_names, with_delays
from tustinnet.signals.derivatives import polynomial_fit
from tustinnet.simulate.start_names import DERIVED
from tustinnet.simulate.starts import initial_state

_LOCAL = 3  # samples on either side of a segment's beginning that its state is read from


@dataclass(frozen=True)
class Segments:
    """Pieces of records, each with an initial state of its own; a whole record is one segment.

    Arrays over samples have the records one after the other, each sample once: the row where one
    segment ends is also the first row of the next.

    Attributes:
        x0: initial states to start from, (n_s, n_x); of a segment with `adds_expected` the internal
            ones are offsets from those that the system expects.
        is_free: which of them are searched for, 1 or 0, (n_s, n_x).
        adds_expected: which segments begin with the internal states that the system expects there
            by its parameters, with those of `x0` added to them, 1 or 0, (n_s,).
        precision: 1 over the error of each initial state as measured, 0 where none was measured,
            (n_s, n_x).
        steps: steps of each segment, (n_s,).
        first_row: row of the first sample of each, (n_s,).
        record: index of the record each is a piece of, (n_s,).
        share: weight of a squared error, 1 over the samples of its record, (n_s,).
        group_indices: which value of parameters per group applies in each, see
            `groups.group_indices`, (n_s, n_g).
        inputs: inputs from each sample to the next, (n, ...).
        periods: time from each sample to the next [s], (n,); 0 at the end of a record.
        measurements: measured positions and velocities, (n, n_y).
        weights: factor of every residual before it is squared, (n, n_y).
        inputs_by_delay: derivative of `inputs` by the inputs' delays [1/s]; None where no delay is
            searched for.
        delayed_inputs: function from the values of the delays to `inputs`; None where no delay is
            searched for.
    """

    x0: Float[np.ndarray, "n_s n_x"]
    is_free: Float[np.ndarray, "n_s n_x"]
    adds_expected: Float[np.ndarray, " n_s"]
    precision: Float[np.ndarray, "n_s n_x"]
    steps: Int[np.ndarray, " n_s"]
    first_row: Int[np.ndarray, " n_s"]
    record: Int[np.ndarray, " n_s"]
    share: Float[np.ndarray, " n_s"]
    group_indices: Int[np.ndarray, "n_s n_g"]
    inputs: Float[np.ndarray, "n *drive"]
    periods: Float[np.ndarray, " n"]
    measurements: Float[np.ndarray, "n n_y"]
    weights: Float[np.ndarray, "n n_y"]
    inputs_by_delay: Float[np.ndarray, "n *drive"] | None = None
    delayed_inputs: "Callable[[Mapping[str, float]], np.ndarray] | None" = None

    def with_delays(self, values: Mapping[str, float]) -> "Segments":
        """Segments whose inputs have the delays that are among the parameters' values."""
        if self.delayed_inputs is None:
            return self
        # within a thousandth of a period everything is smooth in a delay
        step = 1e-3 * float(self.periods[0])
        names = delay_names(values)
        after, before = (
            self.delayed_inputs({name: values[name] + change for name in names})
            for change in (step, -step)
        )
        return replace(
            self, inputs=self.delayed_inputs(values), inputs_by_delay=(after - before) / (2 * step)
        )

    def rows(self, segment: int) -> slice:
        """Rows of the samples of a segment, both ends included."""
        first = int(self.first_row[segment])
        return slice(first, first + int(self.steps[segment]) + 1)

    @property
    def first_of_records(self) -> Int[np.ndarray, " n_r"]:
        """Index of the first segment of each record."""
        return first_of_records(self.record)

    def without_velocities(self, channels: Channels) -> "Segments":
        """Segments of which positions alone are compared."""
        weights = self.weights.copy()
        weights[:, channels.velocity] = 0.0
        return replace(self, weights=weights)

    def for_records(self, records: Collection[int]) -> "Segments":
        """Segments of some of the records, given by index."""
        k = np.flatnonzero(np.isin(self.record, list(records)))
        return replace(
            self,
            x0=self.x0[k],
            is_free=self.is_free[k],
            adds_expected=self.adds_expected[k],
            precision=self.precision[k],
            steps=self.steps[k],
            first_row=self.first_row[k],
            record=self.record[k],
            share=self.share[k],
            group_indices=self.group_indices[k],
        )

    def with_fixed_states(self, x0: Float[np.ndarray, "n_s n_x"]) -> "Segments":
        """Segments with given initial states, internal ones included; none is searched for."""
        zero = np.zeros_like(x0)
        return replace(self, x0=x0, is_free=zero, adds_expected=zero[:, 0], precision=zero)


@dataclass(frozen=True)
class CutOptions:
    """Options of cutting records into segments.

    Attributes:
        residual: what is compared, with its units.
        steps: longest segment in steps; None for whole records.
        initial_treatment: how initial states are treated. `anchored`: they are searched for near
            their measurements; `unanchored`: searched for anywhere; else a start that
            `initial_state` knows, which finds those at the beginnings of records, while those
            inside a record are searched for near their measurements.
        timestamps: whether to step from timestamp to timestamp, or by the sampling period.
        horizons: longest segment of single records in steps, by name, where they are shorter.
        has_delays: whether delays of inputs are searched for.
    """

    residual: Residual
    steps: int | None = None
    initial_treatment: str = "anchored"
    timestamps: bool = True
    horizons: Mapping[str, int] = field(default_factory=dict)
    has_delays: bool = False


def cut_records(
    experiments: Sequence[Experiment],
    model: Model,
    options: CutOptions,
    group_indices: Int[np.ndarray, "n_r n_g"] | None = None,
) -> Segments:
    """Cuts records into segments of about equal length.

    Every residual of a record weighs `1 / T_i`, so that records count alike whatever their length
    (the paper's loss). The states inside a record are always searched for.

    Args:
        experiments: the records.
        model: the model that is to simulate them, for the layout of states and inputs.
        options: how to cut.
        group_indices: the values of parameters per group that apply in each record, see
            `groups.group_indices`; no parameter per group by default.

    References:
        Bock (1981), Numerical treatment of inverse problems in chemical reaction kinetics
        (multiple shooting); here continuity is reached by growing the segments.
        van Esch, Bonassi, Schön, section 2.2, loss over records.
    """
    channels = model.channels
    record, begins, ends = [], [], []
    for i, e in enumerate(experiments):
        last, count = len(e) - 1, 1
        if options.steps:  # a power of two: longer segments begin where shorter ones did
            count = 2 ** max(0, round(np.log2(last / options.steps)))
        if horizon := options.horizons.get(e.name):
            count = max(count, -(-last // horizon))
        edges = np.arange(count + 1) * last // count
        for begin, end in pairwise(edges.tolist()):
            record.append(i)
            begins.append(begin)
            ends.append(end)

    x0 = np.zeros((len(record), model.state_size))
    is_free, precision = np.ones_like(x0), np.zeros_like(x0)
    is_searched = model.searched_internal
    precision[:, channels.internal] = is_searched / np.asarray(model.internal_spread)
    is_estimated = options.initial_treatment in ("anchored", "unanchored")
    for s, (i, begin) in enumerate(zip(record, begins, strict=True)):
        e = experiments[i]
        near = slice(max(0, begin - _LOCAL), max(0, begin - _LOCAL) + 2 * _LOCAL + 1)
        if begin == 0:
            start = DERIVED.usual if is_estimated else options.initial_treatment
            x0[s, channels.measured] = initial_state(e, start)
            is_free[s, channels.measured] = float(is_estimated)
            # most internal states of a record start where expected
            is_free[s, channels.internal] = is_searched * float(is_estimated)
        else:
            q, v = polynomial_fit(e.t[near], e.q[near], 2, at=e.t[begin : begin + 1])
            x0[s, channels.measured] = np.concatenate([q[0], v[0]])
        if options.initial_treatment != "unanchored":
            # a measured position errs by half a count, or by what a parabola misses [rad or m]
            parabola, _ = polynomial_fit(e.t[near], e.q[near], 2, at=e.t[near])
            missed = np.sqrt(np.mean((parabola - e.q[near]) ** 2, axis=0))
            error = np.maximum(np.maximum(e.channels.resolution / 2, missed), 1e-9)
            precision[s, channels.position] = is_free[s, channels.position] / error

    def delayed_inputs(values: Mapping[str, float]) -> np.ndarray:
        inputs = with_delays(model.channels.inputs, values)
        # where delays are searched for, inputs may change between samples, and now and then do not
        signals = [e.excitation(inputs).with_order(1 + options.has_delays) for e in experiments]
        return join_steps(np.asarray(model.step_inputs(signal)) for signal in signals)

    n_y = options.residual.channels
    first_rows = np.cumsum([0, *(len(e) for e in experiments)])
    return Segments(
        x0=x0,
        is_free=is_free,
        # inside a record the inputs say where states that follow them are, roughly
        adds_expected=np.array(
            [float(begin == 0 or model.initial_needs_inputs) for begin in begins]
        ),
        precision=precision,
        steps=np.array(ends) - np.array(begins),
        first_row=first_rows[record] + np.array(begins),
        record=np.array(record),
        share=1 / np.array([len(experiments[i]) for i in record]),
        group_indices=(
            np.zeros((len(record), 0), int) if group_indices is None else group_indices[record]
        ),
        inputs=delayed_inputs({}),
        delayed_inputs=delayed_inputs if options.has_delays else None,
        periods=join_steps(
            np.diff(e.t) if options.timestamps else np.full(len(e) - 1, e.dt) for e in experiments
        ),
        measurements=np.concatenate(
            [
                e.q if n_y == e.channels.n_q else np.concatenate([e.q, e.velocities()], axis=1)
                for e in experiments
            ]
        ),
        weights=np.concatenate(
            [np.tile(options.residual.weight / np.sqrt(len(e)), (len(e), 1)) for e in experiments]
        ),
    )


def first_of_records(record: Int[np.ndarray, " n_s"]) -> Int[np.ndarray, " n_r"]:
    """Index of the first segment of each record, given the record of each segment, (n_r,)."""
    return np.flatnonzero(np.diff(record, prepend=-1))


def join_steps(arrays: Iterable[np.ndarray]) -> np.ndarray:
    """Arrays over steps, record after record, each with a row of zeros for its last sample."""
    return np.concatenate([np.concatenate([a, np.zeros_like(a[:1])]) for a in arrays])
