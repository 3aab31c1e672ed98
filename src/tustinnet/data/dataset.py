"""Several records of one system as one data set."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict, Unpack, overload

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from tustinnet.channels import Channels, Coordinate, HasChannels, Input, Kind
from tustinnet.data.experiment import Experiment, begin_near_zero, unwrap_angles
from tustinnet.errors import InputError, require_text
from tustinnet.shown import Plotted
from tustinnet.signals import resampling


@dataclass(frozen=True)
class DataSet(HasChannels, Plotted):
    """Records of one system, of any lengths, with the same coordinates, inputs and period.

    Encoder counts and limits of inputs that some records do not declare are taken from the first
    record that does; a warning says so.

    Attributes:
        name: name of the data set.
        experiments: the records.
    """

    name: str
    experiments: tuple[Experiment, ...]

    def __post_init__(self) -> None:
        if isinstance(self.experiments, Experiment) or not isinstance(self.experiments, Iterable):
            kind = type(self.experiments).__name__
            raise InputError(str(self.name), f"{kind} as experiments", "a tuple of records")
        object.__setattr__(self, "experiments", tuple(self.experiments))
        require_text(self.name, "data set")
        if not self.experiments:
            raise InputError(self.name, "no experiments", "at least one")
        if other := [e for e in self.experiments if not isinstance(e, Experiment)]:
            kind = type(other[0]).__name__
            raise InputError(self.name, f"{kind} among the experiments", "records alone")
        first, names = self.experiments[0], set()
        for experiment in self.experiments:
            if experiment.name in names:
                raise InputError(self.name, f"two experiments named '{experiment.name}'", "one")
            names.add(experiment.name)
            first.channels.require_same(
                experiment.channels, experiment.name, first.name, open_holds=False
            )
            loops = [
                e.channels.controller and e.channels.controller.loops for e in (first, experiment)
            ]
            if loops[0] != loops[1]:
                raise InputError(experiment.name, "another controller", f"that of {first.name}")
        self._complete_channels()

    def _complete_channels(self) -> None:
        """Gives records the encoder counts and limits that only other records declare."""
        distinct = list(dict.fromkeys(e.channels for e in self.experiments))
        if len(distinct) == 1:
            return
        completed = {channels: channels.completed_by(distinct) for channels in distinct}
        added = dict.fromkeys(name for _, names in completed.values() for name in names)
        if not added:
            return
        lacking = [e.name for e in self.experiments if completed[e.channels][1]]
        more = f" and {len(lacking) - 1} more" if lacking[1:] else ""
        warnings.warn(
            f"{self.name}: no {', '.join(added)} in '{lacking[0]}'{more}: taken from the records "
            "that declare them",
            stacklevel=4,  # who makes the data set
        )
        experiments = (replace(e, channels=completed[e.channels][0]) for e in self.experiments)
        object.__setattr__(self, "experiments", tuple(experiments))

    def __len__(self) -> int:
        return len(self.experiments)

    def __iter__(self) -> Iterator[Experiment]:
        return iter(self.experiments)

    @overload
    def __getitem__(self, key: int | str) -> Experiment: ...
    @overload
    def __getitem__(self, key: slice) -> "DataSet": ...
    def __getitem__(self, key: Any) -> "Experiment | DataSet":
        if isinstance(key, slice):
            return replace(self, experiments=self.experiments[key])
        if isinstance(key, str):
            for experiment in self.experiments:
                if experiment.name == key:
                    return experiment
            names = ", ".join(e.name for e in self.experiments)
            raise InputError(self.name, f"no experiment '{key}'", f"one of {names}")
        return self.experiments[key]

    def __repr__(self) -> str:
        return f"DataSet({self.name!r}, {len(self)} experiments)"

    # a property in the place of a field of the base class: nobody assigns it
    @property
    def channels(self) -> Channels:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Coordinates, inputs and sampling period of all records."""
        return self.experiments[0].channels

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits of the records, in order of appearance."""
        return tuple(dict.fromkeys(e.split for e in self.experiments if e.split is not None))

    def split(self, name: str) -> "DataSet":
        """The records of one split."""
        chosen = tuple(e for e in self.experiments if e.split == name)
        if not chosen:
            names = ", ".join(self.splits) or "none (the records are not split)"
            raise InputError(self.name, f"no split '{name}'", f"one of: {names}")
        return replace(self, experiments=chosen)

    def trim(self, start: float = 0.0, stop: float | None = None) -> "DataSet":
        """Every record between two times [s], counted from its own first sample."""
        return replace(self, experiments=tuple(e.trim(start, stop) for e in self.experiments))

    def exclude(self, *names: str) -> "DataSet":
        """The data set without some records."""
        for name in names:
            self[name]
        kept = tuple(e for e in self.experiments if e.name not in names)
        return replace(self, experiments=kept)

    def merge(self, *others: "DataSet | Iterable[Experiment]") -> "DataSet":
        """The records of several data sets as one."""
        added = [e for other in others for e in other]
        return replace(self, experiments=(*self.experiments, *added))


class RecordFields(TypedDict, total=False):
    """Keyword arguments of `from_arrays` that describe a record, which its docstring explains."""

    t: ArrayLike | None
    v: ArrayLike | None
    v_measured: bool
    name: str
    split: str | None
    groups: Mapping[str, str]


def from_arrays(
    q: ArrayLike,
    u: ArrayLike | None = None,
    *,
    dt: float,
    coordinates: Sequence[Coordinate] | Mapping[str, Kind],
    inputs: Sequence[Input] | Mapping[str, str] = (),
    **record: Unpack[RecordFields],
) -> Experiment:
    """One record from arrays.

    Args:
        q: positions in radians or metres, (n, n_q), or (n,) for one coordinate. Jumps of more
            than half a turn in an angle are taken for wraps and removed; an angle that wraps each
            turn is then moved by whole turns, to begin above -135 and at most at 225 degrees.
        u: inputs, (n, n_u), or (n,) for one input.
        dt: sampling period [s].
        coordinates: the columns of `q`, as `Coordinate`s or as `{name: "angular" or "linear"}`.
        inputs: the columns of `u`, as `Input`s or, under a zero-order hold, as `{name: unit}`.
        record: further fields of the record by keyword. `t`: timestamps [s], multiples of `dt` by
            default; for a log that is irregular beyond jitter, follow with `resample`. `v`:
            velocities, shaped like `q`. `v_measured`: whether a sensor measured them, by default
            yes. `name`, by default `experiment`. `split`: `train`, `validation`, `test` or None.
            `groups`: conditions of the record, as `{"payload": "1kg"}`.

    Raises:
        InputError: shapes that do not fit, numbers that are not finite, timestamps whose median
            interval is not `dt`.
        TypeError: another field of a record.
    """
    if unknown := sorted(record.keys() - RecordFields.__annotations__.keys()):
        fields = ", ".join(RecordFields.__annotations__)
        raise TypeError(f"from_arrays takes no '{unknown[0]}'; of a record it takes {fields}")
    name, t, v = record.get("name", "experiment"), record.get("t"), record.get("v")
    groups = record.get("groups", {})
    if not isinstance(groups, Mapping):
        raise InputError(name, f"groups of {groups!r}", 'a mapping, as {"payload": "1kg"}')
    if isinstance(coordinates, Mapping):
        coordinates = [Coordinate(c, kind) for c, kind in coordinates.items()]
    if isinstance(inputs, Mapping):
        inputs = [Input(i, unit) for i, unit in inputs.items()]
    if not all(isinstance(c, Coordinate) for c in coordinates):
        raise InputError(name, "coordinates without a kind", '{"arm": "angular", "cart": "linear"}')
    if not all(isinstance(i, Input) for i in inputs):
        raise InputError(name, "inputs without a unit", '{"motor": "V"}')
    channels = Channels(tuple(coordinates), tuple(inputs), dt)
    positions = _matrix(q, name)
    n = len(positions)
    angles = {
        j: c.name
        for j, c in enumerate(channels.coordinates[: positions.shape[1]])
        if c.kind == "angular"
    }
    wrapped = [j for j in angles if resampling.wraps_within_turn(positions[:, j])]
    positions, notes = unwrap_angles(positions, angles)
    times = np.arange(n) * dt if t is None else np.asarray(t, dtype=float)
    median = float(np.median(np.diff(times))) if n > 1 else dt
    # a median interval this far from `dt` is another period
    if dt > 0 and np.isfinite(dt) and not abs(median / dt - 1) < 0.2:
        raise InputError(name, f"samples {median:g} s apart", f"dt = {dt:g} s", "times in seconds")
    experiment = Experiment(
        name=name,
        t=times,
        q=positions,
        u=np.zeros((n, 0)) if u is None else _matrix(u, name),
        v=None if v is None else _matrix(v, name),
        v_measured=v is not None and record.get("v_measured", True),
        channels=channels,
        split=record.get("split"),
        groups=tuple(groups.items()),
        notes=(*notes, *_describe_times(times, dt)),
    )
    return begin_near_zero(experiment, wrapped)


def _describe_times(t: Float[np.ndarray, " n"], dt: float) -> tuple[str, ...]:
    """A note where timestamps [s] are irregular beyond jitter, which fits know nothing of."""
    if len(t) < 2 or (times := resampling.regularity(t, dt)).worst <= resampling.JITTER * dt:
        return ()
    worst = resampling.describe_worst(t, times)
    return (f"irregular times kept as recorded: {worst}; `resample` brings them onto a grid",)


def _matrix(values: ArrayLike, name: str) -> Float[np.ndarray, "n c"]:
    try:
        with warnings.catch_warnings(action="error"):  # of imaginary parts that would be lost
            array = np.array(values, dtype=float)
    except (TypeError, ValueError, np.exceptions.ComplexWarning) as error:
        raise InputError(
            name, f"values that are not numbers ({error})", "arrays of floats"
        ) from None
    if array.ndim not in (1, 2):
        raise InputError(name, f"an array of shape {array.shape}", "(samples, channels)")
    return array[:, None] if array.ndim == 1 else array
