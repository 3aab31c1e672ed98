"""One recorded run of a mechanical system."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Channels, HasChannels, Input, merge_timing
from tustinnet.data.recording import Recording, describe_recording
from tustinnet.errors import InputError, require_name
from tustinnet.shown import Plotted
from tustinnet.signals import resampling, transients
from tustinnet.signals.derivatives import VelocityMethod, differentiate
from tustinnet.signals.excitation import HALF, DeclaredHold, Excitation, excitation
from tustinnet.signals.outliers import white_noise
from tustinnet.wording import counted

SplitName = Literal["train", "validation", "test"]
VelocitySource = Literal["auto", "file", "stencil", "savgol", "kalman", "wiener", "trapezoidal"]

LARGEST = 1e100  # of a position, input or velocity; squares of larger ones overflow
_STENCIL_SAMPLES = 5
_COLUMNS = {"u": "inputs", "outputs": "loops"}
_AT_REST = 0.05  # of the largest speed, as in `rest_thresholds`


def unwrap_angles(
    q: Float[np.ndarray, "n n_q"], names: Mapping[int, str]
) -> tuple[Float[np.ndarray, "n n_q"], tuple[str, ...]]:
    """Positions without the jumps of wrapped angles, and a note for each unwrapped angle.

    Args:
        q: positions, (n, n_q) [rad or m].
        names: names of the columns to unwrap, by index.
    """
    q, notes = q.copy(), []
    for j, name in names.items():
        q[:, j], jumps = resampling.unwrap_angle(q[:, j])
        if len(jumps):
            notes.append(f"{name}: unwrapped ({len(jumps)} jump{'s' * (len(jumps) > 1)})")
    return q, tuple(notes)


def begin_near_zero(experiment: "Experiment", wrapped: Iterable[int]) -> "Experiment":
    """The record with wrapped angles moved by whole turns to where a record begins.

    An encoder that wraps each turn begins at 0 or at a full turn, whichever side its first count
    is on; see `turns_to_beginning`.

    Args:
        experiment: the record, its angles unwrapped.
        wrapped: indices of the coordinates whose encoders wrap each turn.
    """
    q, notes = experiment.q.copy(), list(experiment.notes)
    for j in wrapped:
        turns = resampling.turns_to_beginning(q[0, j])
        if turns:
            q[:, j] += 2 * np.pi * turns
            plural = "s" * (abs(turns) > 1)
            notes.append(f"{experiment.coordinates[j].name}: moved by {turns:+d} turn{plural}")
    if len(notes) == len(experiment.notes):
        return experiment
    return replace(experiment, q=q, notes=tuple(notes))


def with_near_set_points(experiment: "Experiment") -> "Experiment":
    """The record with set points of angles unwrapped, and moved by whole turns to the angles.

    Args:
        experiment: the record, its angles as they stay.
    """
    channels, u = experiment.channels, experiment.u.copy()
    names = [i.name for i in channels.inputs]
    for loop in channels.controller.loops if channels.controller else ():
        j = next(j for j, c in enumerate(channels.coordinates) if c.name == loop.coordinate)
        if channels.angular[j]:
            k = names.index(loop.position)
            angle = resampling.unwrap_angle(u[:, k])[0]
            turns = np.round(np.median(experiment.q[:, j] - angle) / (2 * np.pi))
            u[:, k] = angle + 2 * np.pi * turns
    return experiment if (u == experiment.u).all() else replace(experiment, u=u)


@dataclass(frozen=True, eq=False)
class Experiment(HasChannels, Plotted):
    """One frozen record of one run. SI units, angles in radians and not wrapped.

    Attributes:
        name: name of the record.
        t: timestamps as recorded, (n,) [s].
        q: positions, (n, n_q) [rad or m].
        u: inputs, (n, n_u); `u[k]` acts from sample k on. With a controller in the loop its set
            points are among them, in the place of what it computes.
        channels: the columns of `q` and `u`, and the sampling period.
        v: velocities as they stand in the file, (n, n_q) [rad/s or m/s], or None.
        v_measured: whether `v` was measured by a sensor of its own.
        split: `train`, `validation`, `test` or None.
        k_bar: end of the transient as a sample index, where it is declared.
        groups: conditions of the record, as pairs of a name and its value (`payload`, `1kg`), in
            the order of the names.
        source: origin of the record, as its file.
        sha256: checksum of that file.
        first_row: row of sample 0 in the source.
        recording: time base of the whole record before it was resampled, None where it was not.
        notes: remarks on how it was read (jitter accepted, angles unwrapped or moved, ...).
        outputs: what a controller in the loop computed, as recorded, (n, loops), or None.
    """

    name: str
    t: Float[np.ndarray, " n"]
    q: Float[np.ndarray, "n n_q"]
    u: Float[np.ndarray, "n n_u"]
    channels: Channels
    v: Float[np.ndarray, "n n_q"] | None = None
    v_measured: bool = False
    split: str | None = None
    k_bar: int | None = None
    source: str = ""
    sha256: str = ""
    first_row: int = 0
    recording: Recording | None = None
    notes: tuple[str, ...] = field(default=())
    groups: tuple[tuple[str, str], ...] = field(default=())
    outputs: Float[np.ndarray, "n loops"] | None = None

    def __post_init__(self) -> None:
        require_name(self.name, "record")
        if self.split not in (None, *get_args(SplitName)):
            expected = f"{', '.join(get_args(SplitName))} or None"
            raise InputError(self.name, f"a split {self.split!r}", expected)
        object.__setattr__(self, "groups", tuple(sorted(dict(self.groups).items())))
        for pair in self.groups:
            for text in pair:
                require_name(text, f"{self.name}, groups")
        if not self.dt > 0 or not np.isfinite(self.dt):
            raise InputError(
                self.name, f"sampling period {self.dt}", "a positive number of seconds"
            )
        self._freeze("t", (None,))
        n = len(self.t)
        if n < 2:
            raise InputError(self.name, counted(n, "sample"), "at least 2")
        self._freeze("q", (n, len(self.coordinates)))
        self._freeze("u", (n, len(self.inputs)))
        if self.v is not None:
            self._freeze("v", (n, len(self.coordinates)))
        if self.outputs is not None:
            controller = self.channels.controller
            self._freeze("outputs", (n, len(controller.loops) if controller else 0))
        backward = np.flatnonzero(np.diff(self.t) <= 0)
        if len(backward):
            row = int(backward[0]) + 1
            raise InputError(
                self.name,
                f"time {self.t[row]:g} s of sample {row} does not follow {self.t[row - 1]:g} s",
                "strictly increasing times",
                "remove duplicate or misplaced rows",
            )
        if self.k_bar is not None and not 0 <= self.k_bar <= n:
            raise InputError(self.name, f"k_bar {self.k_bar}", f"a sample index from 0 to {n}")

    def _freeze(self, attribute: str, shape: tuple[int | None, ...]) -> None:
        array = np.array(getattr(self, attribute), dtype=np.float64, order="C")
        expected = tuple(array.shape[0] if n is None and array.ndim else n for n in shape)
        if array.shape != expected:
            raise InputError(
                self.name,
                f"{attribute} has shape {array.shape}",
                f"{expected}: samples by {_COLUMNS.get(attribute, 'coordinates')}",
            )
        usable = np.abs(array) <= LARGEST
        if not usable.all():
            row, *column = (int(index) for index in np.argwhere(~usable)[0])
            value = array[row, *column]
            problem = f"is {value:g}" if np.isfinite(value) else "is not finite"
            raise InputError(
                self.name,
                f"{attribute} {problem} at sample {row}",
                f"finite numbers of at most {LARGEST:g}",
            )
        array.setflags(write=False)
        object.__setattr__(self, attribute, array)

    @property
    def output_inputs(self) -> tuple[Input, ...]:
        """The inputs that a controller in the loop computes, in the order of `outputs`."""
        controller = self.channels.controller
        if controller is None:
            return ()
        inputs = {i.name: i for i in controller.inputs}
        return tuple(inputs[loop.input] for loop in controller.loops)

    def without_controller(self) -> "Experiment":
        """The record of the system alone: inputs as recorded, in the place of set points.

        Itself where there is no controller in the loop. Inputs that were not recorded are 0.
        """
        if self.channels.controller is None:
            return self
        columns = dict(zip((i.name for i in self.inputs), self.u.T, strict=True))
        if self.outputs is not None:
            columns |= zip((i.name for i in self.output_inputs), self.outputs.T, strict=True)
        plant, zero = self.channels.plant, np.zeros(len(self))
        inputs = [columns.get(i.name, zero) for i in plant.inputs]
        return replace(self, u=np.stack(inputs, axis=1), channels=plant, outputs=None)

    @property
    def logged_rows(self) -> tuple[int, int]:
        """First row in the source, and the row after the last."""
        samples = len(self) if self.recording is None else self.recording.samples
        return self.first_row, self.first_row + samples

    def __len__(self) -> int:
        return len(self.t)

    def group(self, name: str) -> str | None:
        """The record's value of a condition (`groups`), None where it has none."""
        return dict(self.groups).get(name)

    def __repr__(self) -> str:
        names = ", ".join(c.name for c in self.coordinates)
        return f"Experiment({self.name!r}, {len(self)} samples of {self.dt:g} s, {names})"

    def __getitem__(self, samples: slice) -> "Experiment":
        """A part of the record, with its timestamps, period, `k_bar` and first row."""
        if not isinstance(samples, slice):
            raise InputError(self.name, f"sample {samples!r}", "a range of samples, as [3:10]")
        start, stop, stride = samples.indices(len(self))
        if stride < 1:
            raise InputError(self.name, f"slice with step {stride}", "a positive step")
        if stride > 1:
            changed = np.diff(self.u[start:stop], axis=0) != 0
            changes = np.arange(1, len(changed) + 1)
            # a held input may change at a kept sample; a ramp that ends there began before it
            between = changes % stride != 0
            lost = changes[(changed & (between[:, None] | ~self.channels.zero_order)).any(axis=1)]
            if len(lost):
                raise InputError(
                    self.name,
                    f"a step of {stride} would drop the input's change at sample {start + lost[0]}",
                    "an input that is constant between the kept samples",
                    "use `resample`, which keeps the mean of the input",
                )
        k_bar = None if self.k_bar is None else max(0, min(self.k_bar, stop) - start)
        part = slice(start, stop, stride)
        cut = replace(
            self,
            t=self.t[part],
            q=self.q[part],
            u=self.u[part],
            v=None if self.v is None else self.v[part],
            outputs=None if self.outputs is None else self.outputs[part],
            channels=replace(self.channels, dt=self.dt * stride),
            k_bar=None if k_bar is None else -(-k_bar // stride),
            first_row=self.first_row + start,
        )
        if stride == 1:
            vars(cut)["_cut_from"] = self, part
        return cut

    def resample(self, dt: float) -> "Experiment":
        """The record on a regular grid of period `dt` [s] from its first timestamp on.

        Positions and band-limited inputs by cubic spline, velocities and first-order-held inputs
        linearly; a held input becomes its mean over each period of the grid, so that its impulse
        is kept.

        Raises:
            InputError: a period longer than the record, or a grid of more than 10 times its
                samples; the message names the longest interval. An input whose hold is `unknown`.
        """
        self._require_holds(self.inputs, "resampling", delays=False)
        if not 0 < dt < self.seconds:
            raise InputError(
                self.name, f"period {dt} s", f"more than 0 and less than {self.seconds:g} s"
            )
        resampling.require_short_grid(self.t, dt, lambda k: f"{self.name}, sample {k}")
        grid = resampling.regular_grid(self.t, dt)
        k_bar = None
        if self.k_bar is not None:
            end = len(self) == self.k_bar
            near = 1e-6 * dt  # rounding must not move it by a sample
            k_bar = len(grid) if end else int(np.searchsorted(grid, self.t[self.k_bar] - near))

        def resample_inputs(u: np.ndarray, inputs: Sequence[Input]) -> np.ndarray:
            columns = [
                resampling.BY_HOLD[i.hold or "zero-order"](self.t, u[:, k : k + 1], grid)
                for k, i in enumerate(inputs)
            ]
            return np.concatenate(columns, axis=1) if columns else np.zeros((len(grid), 0))

        outputs = self.outputs
        if outputs is not None:
            self._require_holds(self.output_inputs, "resampling", delays=False)
            outputs = resample_inputs(outputs, self.output_inputs)
        return replace(
            self,
            t=grid,
            channels=replace(self.channels, dt=dt),
            q=resampling.resample_positions(self.t, self.q, grid),
            u=resample_inputs(self.u, self.inputs),
            outputs=outputs,
            v=None if self.v is None else resampling.resample_linear(self.t, self.v, grid),
            k_bar=k_bar,
            recording=self.recording or describe_recording(self.t, self.q, self.dt),
        )

    def trim(self, start: float = 0.0, stop: float | None = None) -> "Experiment":
        """The part between two times [s], counted from the record's first sample."""
        elapsed = self.t - self.t[0]
        end = np.inf if stop is None else stop
        first = int(np.searchsorted(elapsed, start - self.dt / 2))
        last = int(np.searchsorted(elapsed, end + self.dt / 2))
        if last - first < 2:
            raise InputError(
                self.name,
                f"trimming to {start:g}..{end:g} s leaves "
                + counted(max(last - first, 0), "sample"),
                f"times within 0..{elapsed[-1]:g} s",
            )
        return self[first:last]

    def exclude(self, start: int, stop: int) -> tuple["Experiment", ...]:
        """The parts before and after the samples `start..stop-1`, as records of their own."""
        parts = [(0, start), (stop, len(self))]
        kept = [
            replace(self[a:b], name=f"{self.name}[{a}:{b}]") for a, b in parts if b - max(a, 0) >= 2
        ]
        if not kept or not 0 <= start < stop <= len(self):
            raise InputError(
                self.name,
                f"excluding samples {start}..{stop} of {len(self)}",
                "a part of the record that leaves at least 2 samples",
            )
        return tuple(kept)

    @property
    def seconds(self) -> float:
        """Duration from the first sample to the last [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def forced(self) -> bool:
        """Whether an input changes during the record."""
        return bool(np.ptp(self.u, axis=0).any()) if self.u.size else False

    @property
    def held_inputs(self) -> Float[np.ndarray, "steps n_u"]:
        """Mean of the inputs between each sample and the next, (n - 1, n_u)."""
        return self.excitation().mean

    def excitation(self, inputs: Sequence[Input] | None = None) -> Excitation:
        """The inputs as a function of time: at the samples and between them.

        A part of a record has those of the record, whose samples before and behind it are known.

        Args:
            inputs: the inputs of the model to simulate. Its delays are used, and its holds where
                the record declares none. By default the record's own.

        Raises:
            InputError: an input whose hold or delay is unknown; a record too short to interpolate
                a band-limited input, or shorter than a delay.
        """
        if "_cut_from" in vars(self):
            whole, part = vars(self)["_cut_from"]
            samples, periods = whole.excitation(inputs)
            return Excitation(samples[part], periods[part.start : max(part.stop - 1, part.start)])
        inputs = self.inputs if inputs is None else merge_timing(self.inputs, inputs)
        self._require_holds(inputs, "simulating", delays=True)
        # `unknown` was refused
        holds: list[DeclaredHold] = [i.hold or "zero-order" for i in inputs]  # pyright: ignore[reportAssignmentType]
        delays = [(i.delay or 0.0) / self.dt for i in inputs]
        for i, hold, delay in zip(inputs, holds, delays, strict=True):
            where = f"{self.name}, input '{i.name}'"
            if abs(delay) >= len(self) - 1:
                raise InputError(
                    where, f"a delay of {i.delay:g} s", f"less than its {self.seconds:g} s"
                )
            if hold == "band-limited" and len(self) <= HALF:
                raise InputError(
                    where,
                    f"hold 'band-limited' and {len(self)} samples",
                    f"more than {HALF}",
                    "leave the record out, or declare another hold",
                )
        # every free run needs it, and a record's parts; interpolation takes longer than a run
        key, kept = (tuple(holds), tuple(delays)), vars(self).get("_interpolated")
        if kept is None or kept[0] != key:
            kept = key, excitation(self.u, holds, delays)
            for values in kept[1]:
                values.flags.writeable = False  # others get them, too
            vars(self)["_interpolated"] = kept
        return kept[1]

    def with_timing(self, inputs: Sequence[Input]) -> "Experiment":
        """The record with the delays of a model's inputs, and their holds where it has none."""
        merged = merge_timing(self.inputs, inputs)
        return replace(self, channels=replace(self.channels, inputs=merged))

    def _require_holds(self, inputs: Sequence[Input], purpose: str, *, delays: bool) -> None:
        for i in inputs:
            if i.hold == "unknown":
                raise InputError(
                    f"{self.name}, input '{i.name}'",
                    f"hold 'unknown', and {purpose} needs one",
                    "zero-order, first-order or band-limited",
                    "declare it in the data card" + ("; `fit` finds it" if delays else ""),
                )
            if i.delay is None and delays:
                raise InputError(
                    f"{self.name}, input '{i.name}'",
                    f"delay 'unknown', and {purpose} needs one",
                    "a delay in seconds",
                    "declare it in the data card; `fit` searches for it",
                )

    def measured_states(
        self, velocity: VelocitySource = "auto"
    ) -> Float[np.ndarray, "n n_measured"]:
        """Positions and velocities [q, v] of every sample, (n, 2 n_q).

        Args:
            velocity: source of the velocities, see `velocities`.
        """
        return np.concatenate([self.q, self.velocities(velocity)], axis=1)

    def velocities(self, source: VelocitySource = "auto") -> Float[np.ndarray, "n n_q"]:
        """Velocities, (n, n_q) [rad/s or m/s].

        Args:
            source: `file` for the stored columns; `stencil`, `savgol`, `kalman`, `wiener`,
                `trapezoidal` to derive them from the positions (`differentiate`); `auto` for
                the stored ones where they were measured and are not padded with zero rows, else
                the stencil.
        """
        if source not in get_args(VelocitySource):
            sources = ", ".join(get_args(VelocitySource))
            raise InputError(self.name, f"velocities by '{source}'", f"one of {sources}")
        if source == "auto":
            source = "stencil" if self.sensor_velocities is None else "file"
        if source == "file":
            if self.v is None:
                raise InputError(
                    self.name,
                    "no velocity columns in the record",
                    "velocities in the file",
                    "use stencil, savgol, kalman, wiener or trapezoidal",
                )
            return self.v
        if len(self) < _STENCIL_SAMPLES:
            raise InputError(
                self.name,
                f"{counted(len(self), 'sample')}, too few to derive velocities from",
                f"at least {_STENCIL_SAMPLES}",
                "leave the record out",
            )
        method: VelocityMethod = source
        return differentiate(self.q, self.dt, method, self.channels.resolution)

    @property
    def sensor_velocities(self) -> Float[np.ndarray, "n n_q"] | None:
        """Stored velocities, (n, n_q), where a sensor measured them and no row is padding."""
        return self.v if self.v_measured and self.padded_rows == (0, 0) else None

    @property
    def padded_rows(self) -> tuple[int, int]:
        """Rows at the beginning and the end whose stored velocities are zero padding.

        Rows of exact zeros in every velocity column count as padding where the positions move
        during most of them, faster than at rest and than the smallest velocity of the columns. An
        arm that rests, whatever its readings flicker, has true zeros.
        """
        if self.v is None or len(self) < _STENCIL_SAMPLES:
            return (0, 0)
        zero = np.all(self.v == 0, axis=1)
        lead = len(zero) if zero.all() else int(np.argmin(zero))
        trail = len(zero) if zero.all() else int(np.argmin(zero[::-1]))
        # one zero row may be a release from rest: motion counts between padded rows only
        lead = lead if self._moves_mostly(slice(0, lead)) else 0
        trail = trail if self._moves_mostly(slice(len(self) - trail, None)) else 0
        return lead, trail

    def _moves_mostly(self, rows: slice) -> bool:
        """Whether a position moves during most of some rows, by more than noise."""
        assert self.v is not None
        q = self.q[rows]
        lag = min(_STENCIL_SAMPLES, len(q)) - 1
        if lag < 1:
            return False
        usual = np.median(np.abs(q[lag:] - q[:-lag]), axis=0)
        farthest = np.abs(self.q[lag:] - self.q[:-lag]).max(axis=0)
        size = np.abs(self.v)
        smallest = np.min(size, axis=0, initial=np.inf, where=size > 0)
        smallest[~np.isfinite(smallest)] = 0.0
        # within four standard deviations of the noise a position does not move
        hidden = np.maximum(4.0 * white_noise(self.q), smallest * self.dt * lag)
        return bool(np.any(usual > np.maximum(hidden, _AT_REST * farthest)))


def moving_coordinates(experiments: Sequence[Experiment]) -> Bool[np.ndarray, " n_q"]:
    """Mask of the coordinates that move in at least one of some records."""
    return np.any([transients.is_moving(e.q) for e in experiments], axis=0)
