"""Coordinates, inputs and sampling period as one object, and the layout of a state."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from textwrap import shorten
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Bool, Float
from pydantic import BeforeValidator, TypeAdapter

from tustinnet.errors import InputError, require_name, require_number, require_text

Kind = Literal["angular", "linear"]
Hold = Literal["zero-order", "first-order", "band-limited", "unknown"]

SHORTEST_DT, LONGEST_DT = 1e-9, 1e4  # sampling periods [s] that cards and files may have
_DEFAULT_HOLD = "zero-order"
SAME_PERIOD = 1e-6  # relative; two periods this near are one


def _refuse(value: object) -> None:
    raise ValueError("a key of records, not of models")


OfRecords = BeforeValidator(_refuse)  # fields that no model has
LATER = {"later": True}  # fields that older model files lack: none has them at their defaults


class Described:
    """Base class of what model files, exports and data cards describe by the same keys.

    The keys are the fields, those `OfRecords` excepted. A model file with any other is refused.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    def as_header(self) -> dict[str, Any]:
        """The keys with plain values, as in model files: without `LATER` ones at their defaults."""
        values = [(f, getattr(self, f.name)) for f in fields(self) if f.compare]  # pyright: ignore[reportArgumentType]
        kept = [(f.name, x) for f, x in values if not (f.metadata and x == f.default)]
        return {name: _plain(value) for name, value in kept}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(x) for x in value]
    return value.as_header() if isinstance(value, Described) else value


class ColumnUnit(NamedTuple):
    """The unit of a column of positions.

    Attributes:
        name: as a data card has it: `deg`, `mm`, `counts`.
        factor: how much one of it is in the unit of the coordinate.
    """

    name: str
    factor: float


@dataclass(frozen=True)
class Coordinate(Described):
    """A generalised coordinate of the system.

    Attributes:
        name: name of the coordinate.
        kind: `angular` (radians, not wrapped) or `linear` (metres, or what `unit` says).
        resolution: encoder count [rad or m], if known.
        unit: `rad` of an angle; `m` of a linear coordinate, where it is not another SI unit, as V
            of a measured voltage. Where documentation says m, that unit is meant then.
        column: unit of the column in the logs, in which the command takes numbers; None for `unit`.
    """

    name: str
    kind: Kind
    resolution: float | None = None
    unit: str = ""
    column: Annotated[ColumnUnit | None, OfRecords] = field(default=None, compare=False)

    def __post_init__(self) -> None:
        require_name(self.name, "coordinate")
        if self.kind not in get_args(Kind):
            raise InputError(
                f"coordinate '{self.name}'", f"kind '{self.kind}'", "'angular' or 'linear'"
            )
        if self.resolution is not None and not 0 < self.resolution < np.inf:
            raise InputError(
                f"coordinate '{self.name}'",
                f"resolution {self.resolution}",
                "a positive number, or None",
            )
        default = _default_unit(self.kind)
        require_text(self.unit, f"unit of coordinate '{self.name}'")
        if (self.unit or default) != default and "rad" in (self.unit, default):
            raise InputError(f"coordinate '{self.name}'", f"unit '{self.unit}'", default)
        object.__setattr__(self, "unit", self.unit or default)

    def as_header(self) -> dict[str, Any]:
        """The keys with plain values; `unit` where the kind does not say it."""
        plain = super().as_header()
        if self.unit == _default_unit(self.kind):
            del plain["unit"]
        return plain


def _default_unit(kind: str) -> str:
    return "rad" if kind == "angular" else "m"


@dataclass(frozen=True)
class Input(Described):
    """An input of the system.

    Attributes:
        name: name of the input.
        unit: its unit, as it stands in the data.
        hold: its course between samples: held (`zero-order`), a straight line (`first-order`),
            that of a signal without power above half of the sampling rate (`band-limited`), or
            `unknown`. None where it is not declared: the data card or the records decide, and the
            default is `zero-order`.
        limits: smallest and largest value the actuator takes, if known.
        delay: time from a logged sample to its effect [s], None if unknown.
        is_delay_declared: whether the data card declares it, so that a delay of 0 s is not searched
            for.
    """

    name: str
    unit: str
    hold: Hold | None = None
    limits: tuple[float, float] | None = None
    delay: float | None = 0.0
    is_delay_declared: Annotated[bool, OfRecords] = field(default=False, compare=False)

    def __post_init__(self) -> None:
        require_name(self.name, "input")
        require_text(self.unit, f"unit of input '{self.name}'")
        if self.hold is not None and self.hold not in get_args(Hold):
            raise InputError(
                f"input '{self.name}'", f"hold '{self.hold}'", f"one of {', '.join(get_args(Hold))}"
            )
        if self.limits is not None and not -np.inf < self.limits[0] < self.limits[1] < np.inf:
            raise InputError(
                f"input '{self.name}'",
                f"limits {list(self.limits)}",
                "two numbers, the smaller one first",
            )
        if self.delay is not None:
            require_number(self.delay, f"input '{self.name}', delay")
        if self.delay is not None and not abs(self.delay) < np.inf:
            raise InputError(f"input '{self.name}'", f"delay {self.delay} s", "a number of seconds")

    @property
    def has_hold(self) -> bool:
        """Whether its course between samples is known."""
        return self.hold not in (None, "unknown")


MOST_DELAY = 100  # samples between what a controller computes and what acts


@dataclass(frozen=True)
class PDLoop(Described):
    """The loop by which a controller computes an input from a coordinate and its set points.

    `input = kp (position - q) + kd (velocity - v) + ki integral(position - q) + feedforward`,
    within the input's limits. While an input is at a limit, its integral does not grow towards it.

    Attributes:
        input: name of the input of the system.
        coordinate: name of the coordinate that is controlled.
        position: name of the set point of its position, an input of the closed loop.
        velocity: name of the set point of its velocity; "" where it is 0.
        feedforward: name of what is added to the input; "" where nothing is.
        kp: gain [unit of the input by rad or m], None where it is to be found.
        kd: gain [unit of the input by rad/s or m/s], None where it is to be found.
        ki: gain [unit of the input by rad s or m s], None where it is to be found, 0 for no
            integral.
        velocity_filter: time constant of the low-pass filter of the measured velocity [s]; 0 for
            none.
        delay: samples after which what it computes acts, for a controller that computes at samples.
    """

    input: str
    coordinate: str
    position: str
    velocity: str = ""
    feedforward: str = ""
    kp: float | None = None
    kd: float | None = None
    ki: float | None = field(default=0.0, metadata=LATER)
    velocity_filter: float = field(default=0.0, metadata=LATER)
    delay: int = field(default=0, metadata=LATER)

    @property
    def gains(self) -> tuple[str, ...]:
        """The names of its gains."""
        return ("kp", "kd") if self.ki == 0 else ("kp", "kd", "ki")

    @property
    def set_points(self) -> tuple[str, ...]:
        """Names of the inputs of the closed loop that it brings, in their order."""
        return tuple(name for name in (self.position, self.velocity, self.feedforward) if name)


@dataclass(frozen=True)
class PDController(Described):
    """A controller in the loop: proportional and derivative feedback to set points.

    Attributes:
        inputs: the inputs of the system, those included that it does not compute.
        loops: a loop for each input that it computes.
    """

    inputs: tuple[Input, ...]
    loops: tuple[PDLoop, ...]

    def require_loops(self, coordinates: Sequence[Coordinate], where: object) -> None:
        """Raises unless each loop has an input and a coordinate of its own.

        Raises:
            InputError: no loop; an input or a coordinate that is not there, or is in two loops; a
                gain that is negative or not finite.
        """
        if not self.loops:
            raise InputError(where, "no loop", "one for each input that is computed")
        for kind, present, names in (
            ("input", [i.name for i in self.inputs], [loop.input for loop in self.loops]),
            ("coordinate", [c.name for c in coordinates], [x.coordinate for x in self.loops]),
        ):
            for k, name in enumerate(names):
                if name not in present:
                    raise InputError(
                        where, f"no {kind} '{name}'", f"one of {', '.join(present) or '(none)'}"
                    )
                if name in names[:k]:
                    raise InputError(where, f"two loops of the {kind} '{name}'", "one")
        for loop in self.loops:
            if not 0 <= loop.velocity_filter < np.inf or not 0 <= loop.delay <= MOST_DELAY:
                raise InputError(
                    where,
                    f"velocity_filter {loop.velocity_filter:g}, delay {loop.delay} of the "
                    f"loop of '{loop.input}'",
                    f"0 s or more, 0 to {MOST_DELAY} samples",
                )
            for gain in loop.gains:
                value = getattr(loop, gain)
                if value is not None and not 0 <= value < np.inf:
                    raise InputError(
                        where,
                        f"{gain} = {value:g} of the loop of '{loop.input}'",
                        "0 or more",
                        "the sign of an input, or of a coordinate, is set by its key `sign`",
                    )


def merge_timing(inputs: Sequence[Input], others: Sequence[Input]) -> tuple[Input, ...]:
    """Inputs with the delays of `others`, and with their holds where the inputs declare none."""
    return tuple(
        replace(
            i,
            hold=i.hold if i.has_hold else other.hold or i.hold,
            delay=other.delay,
        )
        for i, other in zip(inputs, others, strict=True)
    )


@dataclass(frozen=True)
class Channels(Described):
    """Coordinates, inputs and sampling period of a record, a data set, a model or a system.

    A state is `x = [q, v, z]`: positions [rad or m], velocities [rad/s or m/s] and, of models
    that have any, internal states. `position`, `velocity` and `internal` say where they stand on
    the last axis of an array of states. All coordinates and inputs have names of their own.

    Attributes:
        coordinates: the columns of `q`.
        inputs: the columns of `u`.
        dt: sampling period [s]; 0 in continuous time.
        controller: the controller in the loop, whose set points are among the inputs in the place
            of the inputs that it computes; None without one.
    """

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...] = ()
    dt: float = 0.0
    controller: PDController | None = field(default=None, repr=False, metadata=LATER)

    def __post_init__(self) -> None:
        object.__setattr__(self, "coordinates", tuple(self.coordinates))
        object.__setattr__(self, "inputs", tuple(self.inputs))
        if not 0 <= self.dt < np.inf:
            raise InputError(
                "channels", f"sampling period {self.dt}", "a time above 0, or 0 in continuous time"
            )
        names = [channel.name for channel in (*self.coordinates, *self.inputs)]
        if duplicates := sorted({name for name in names if names.count(name) > 1}):
            raise InputError("names", f"two channels are called '{duplicates[0]}'", "others")

    @property
    def plant(self) -> "Channels":
        """The channels of the system without the controller in the loop, if there is one."""
        if self.controller is None:
            return self
        return Channels(self.coordinates, self.controller.inputs, self.dt)

    @property
    def brief(self) -> str:
        """Names of coordinates and inputs as `repr` has them, of many the first."""
        names = ", ".join(channel.name for channel in (*self.coordinates, *self.inputs))
        return shorten(names, 60, placeholder=" ...")

    @property
    def n_q(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def position(self) -> slice:
        """Slice of the positions in a state."""
        return slice(0, self.n_q)

    @property
    def velocity(self) -> slice:
        """Slice of the velocities in a state."""
        return slice(self.n_q, 2 * self.n_q)

    @property
    def measured(self) -> slice:
        """Slice of positions and velocities, the part of a state that records contain."""
        return slice(0, 2 * self.n_q)

    @property
    def internal(self) -> slice:
        """Slice of the internal states in a state."""
        return slice(2 * self.n_q, None)

    @cached_property
    def angular(self) -> Bool[np.ndarray, " n_q"]:
        """Mask of the coordinates that are angles."""
        return np.array([c.kind == "angular" for c in self.coordinates], dtype=bool)

    @cached_property
    def zero_order(self) -> Bool[np.ndarray, " n_u"]:
        """Mask of the inputs that are constant from sample to sample (zero-order hold)."""
        return np.array([i.hold in (None, "zero-order") for i in self.inputs], dtype=bool)

    @cached_property
    def resolution(self) -> Float[np.ndarray, " n_q"]:
        """Encoder counts [rad or m], 0 where unknown."""
        return np.array([c.resolution or 0.0 for c in self.coordinates])

    @cached_property
    def units(self) -> tuple[str, ...]:
        """The units of the coordinates, each once, in the order of their first coordinates."""
        return tuple(self.places_by_unit)

    @cached_property
    def places_by_unit(self) -> dict[str, list[int]]:
        """Indices of the coordinates of each unit, by unit."""
        places: dict[str, list[int]] = {}
        for j, c in enumerate(self.coordinates):
            places.setdefault(c.unit, []).append(j)
        return places

    @property
    def unit(self) -> str:
        """Unit of a number over all coordinates: `rad`, `m`, `rad and m`, `rad and V`."""
        return " and ".join(self.units)

    def require_same(
        self,
        other: "Channels",
        other_name: object,
        own_name: str,
        *,
        open_holds: bool = True,
        remedy: str = "",
    ) -> None:
        """Raises unless other channels are those of the same system at the same period.

        Names, kinds, units and order count, resolutions, limits and delays do not; holds and
        periods only where both have them.

        Args:
            other: the channels to check.
            other_name: owner of the other channels, for the message.
            own_name: owner of these channels, for the message.
            open_holds: whether an input without a declared hold agrees with an input that has one.
            remedy: what may be done besides checking the data card, for the message.

        Raises:
            InputError: other coordinates, inputs or another period; a controller in the loop of one
                of them.
        """
        if (self.controller is None) != (other.controller is None):
            problem, expected = "no controller in the loop", f"one, as in {own_name}"
            if self.controller is None:
                problem, expected = "a controller in the loop", f"none, as in {own_name}"
            raise InputError(
                other_name, problem, expected, "check the table [controller] of the data card"
            )
        for noun, actual, expected in (
            ("coordinates", _describe_coordinates(other), _describe_coordinates(self)),
            ("inputs", *_describe_inputs(other, self, open_holds=open_holds)),
        ):
            if actual != expected:
                raise InputError(
                    other_name,
                    f"{noun} {_join(actual)}",
                    f"{_join(expected)} as in {own_name}",
                    f"check the data card: names, kinds, units and order must agree{remedy}",
                )
        if self.dt and other.dt and abs(other.dt / self.dt - 1) > SAME_PERIOD:
            raise InputError(
                other_name,
                f"sampling period {other.dt:g} s",
                f"{self.dt:g} s as in {own_name}",
                "resample the records, or fit a model for this period",
            )

    def completed_by(self, others: Sequence["Channels"]) -> tuple["Channels", tuple[str, ...]]:
        """The channels with encoder counts and limits that only others declare, and their names.

        Args:
            others: channels of the same system; the first that declare something decide.
        """
        coordinates, inputs, added = list(self.coordinates), list(self.inputs), []
        for j, c in enumerate(self.coordinates):
            declared = next((o.coordinates[j] for o in others if o.coordinates[j].resolution), None)
            if c.resolution is None and declared is not None:
                coordinates[j] = replace(c, resolution=declared.resolution)
                added.append(f"encoder count of {c.name}")
        for j, i in enumerate(self.inputs):
            declared = next((o.inputs[j] for o in others if o.inputs[j].limits), None)
            if i.limits is None and declared is not None:
                inputs[j] = replace(i, limits=declared.limits)
                added.append(f"limits of {i.name}")
        return replace(self, coordinates=tuple(coordinates), inputs=tuple(inputs)), tuple(added)

    @classmethod
    def from_header(cls, header: dict[str, Any]) -> "Channels":
        """The channels that `as_header` wrote, among other keys."""
        known = {f.name: header[f.name] for f in fields(cls) if f.name in header}
        return TypeAdapter(cls).validate_python(known)


class HasChannels:
    """Base class with short ways to the parts of `channels`."""

    channels: Channels

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates, in the order of `q`."""
        return self.channels.coordinates

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The inputs, in the order of `u`."""
        return self.channels.inputs

    @property
    def dt(self) -> float:
        """Sampling period [s]."""
        return self.channels.dt


def _describe_coordinates(channels: Channels) -> Sequence[tuple[str, str]]:
    return [
        (c.name, c.kind if c.unit == _default_unit(c.kind) else f"{c.kind}, {c.unit}")
        for c in channels.coordinates
    ]


def _describe_inputs(
    first: Channels, second: Channels, *, open_holds: bool
) -> list[list[tuple[str, str]]]:
    """Names, units and holds of the inputs of two channels.

    Where holds may be open, only those that both declare.
    """
    pairs = zip(first.inputs, second.inputs, strict=False)
    compared = [not open_holds or all(i.has_hold for i in pair) for pair in pairs]
    return [
        [
            (
                i.name,
                f"{i.unit}, {i.hold or _DEFAULT_HOLD}"
                if k >= len(compared) or compared[k]
                else i.unit,
            )
            for k, i in enumerate(channels.inputs)
        ]
        for channels in (first, second)
    ]


def _join(pairs: Sequence[tuple[str, str]]) -> str:
    return ", ".join(f"{name} ({text})" for name, text in pairs) or "(none)"
