"""Coordinates, inputs and sampling period as one object, and the layout of a state."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.errors import InputError, require_name, require_text

Kind = Literal["angular", "linear"]
Hold = Literal["zero-order", "first-order", "band-limited", "unknown"]

SHORTEST_DT, LONGEST_DT = 1e-9, 1e4  # sampling periods [s] that cards and files may have
_USUAL = "zero-order"
_SAME_PERIOD = 1e-6  # relative; two periods this near are one


@dataclass(frozen=True)
class Coordinate:
    """A generalised coordinate of the system.

    Attributes:
        name: what it is called.
        kind: `angular` (radians, not wrapped) or `linear` (metres, or what `unit` says).
        resolution: encoder count [rad or m], if known.
        unit: `rad` of an angle; `m` of a linear coordinate, where it is not another SI unit, as V
            of a measured voltage. What is said of m elsewhere is in that unit then.
    """

    name: str
    kind: Kind
    resolution: float | None = None
    unit: str = ""

    def __post_init__(self) -> None:
        require_name(self.name, "coordinate")
        if self.kind not in get_args(Kind):
            raise InputError(
                f"coordinate '{self.name}'", f"kind '{self.kind}'", "'angular' or 'linear'"
            )
        usual = _usual_unit(self.kind)
        require_text(self.unit, f"unit of coordinate '{self.name}'")
        if (self.unit or usual) != usual and "rad" in (self.unit, usual):
            raise InputError(f"coordinate '{self.name}'", f"unit '{self.unit}'", usual)
        object.__setattr__(self, "unit", self.unit or usual)


def _usual_unit(kind: str) -> str:
    return "rad" if kind == "angular" else "m"


@dataclass(frozen=True)
class Input:
    """An input of the system.

    Attributes:
        name: what it is called.
        unit: its unit, as it stands in the data.
        hold: what happens between samples: held (`zero-order`), a straight line (`first-order`),
            what a signal without power above half of the sampling rate does (`band-limited`), or
            `unknown`. None where nothing is said: the data card or the records decide, and what
            nobody says is `zero-order`.
        limits: smallest and largest value the actuator takes, if known.
        delay: how much later it acts than it is written down [s], None where nobody knows.
    """

    name: str
    unit: str
    hold: Hold | None = None
    limits: tuple[float, float] | None = None
    delay: float | None = 0.0

    def __post_init__(self) -> None:
        require_name(self.name, "input")
        require_text(self.unit, f"unit of input '{self.name}'")
        if self.hold is not None and self.hold not in get_args(Hold):
            raise InputError(
                f"input '{self.name}'", f"hold '{self.hold}'", f"one of {', '.join(get_args(Hold))}"
            )
        if self.delay is not None and not abs(self.delay) < np.inf:
            raise InputError(f"input '{self.name}'", f"delay {self.delay} s", "a number of seconds")


def merge_timing(inputs: Sequence[Input], others: Sequence[Input]) -> tuple[Input, ...]:
    """Inputs with the delays of others, and their holds where they do not say one themselves."""
    return tuple(
        replace(
            i,
            hold=(other.hold or i.hold) if i.hold in (None, "unknown") else i.hold,
            delay=other.delay,
        )
        for i, other in zip(inputs, others, strict=True)
    )


@dataclass(frozen=True)
class Channels:
    """Coordinates, inputs and sampling period of a record, a data set, a model or a system.

    A state is `x = [q, v, z]`: positions [rad or m], velocities [rad/s or m/s] and, of models
    that have any, internal states. `position`, `velocity` and `internal` say where they stand on
    the last axis of an array of states.

    Attributes:
        coordinates: the columns of `q`.
        inputs: the columns of `u`.
        dt: sampling period [s]; 0 in continuous time.
    """

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...] = ()
    dt: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "coordinates", tuple(self.coordinates))
        object.__setattr__(self, "inputs", tuple(self.inputs))

    @property
    def n_q(self) -> int:
        """How many coordinates."""
        return len(self.coordinates)

    @property
    def n_u(self) -> int:
        """How many inputs."""
        return len(self.inputs)

    @property
    def position(self) -> slice:
        """Where the positions stand in a state."""
        return slice(0, self.n_q)

    @property
    def velocity(self) -> slice:
        """Where the velocities stand in a state."""
        return slice(self.n_q, 2 * self.n_q)

    @property
    def measured(self) -> slice:
        """Where positions and velocities stand, what a record says of a state."""
        return slice(0, 2 * self.n_q)

    @property
    def internal(self) -> slice:
        """Where the internal states stand."""
        return slice(2 * self.n_q, None)

    @cached_property
    def angular(self) -> Bool[np.ndarray, " n_q"]:
        """Which coordinates are angles."""
        return np.array([c.kind == "angular" for c in self.coordinates], dtype=bool)

    @cached_property
    def held(self) -> Bool[np.ndarray, " n_u"]:
        """Which inputs are held from sample to sample (zero-order hold)."""
        return np.array([i.hold in (None, "zero-order") for i in self.inputs], dtype=bool)

    @cached_property
    def resolution(self) -> Float[np.ndarray, " n_q"]:
        """Encoder counts [rad or m], 0 where unknown."""
        return np.array([c.resolution or 0.0 for c in self.coordinates])

    @property
    def unit(self) -> str:
        """`rad`, `m`, `rad and m`, `rad and V`: of a figure over all coordinates."""
        return " and ".join(dict.fromkeys(c.unit for c in self.coordinates))

    def require_same(
        self, other: "Channels", whose: object, where: str, *, open_holds: bool = True
    ) -> None:
        """Raises unless another object speaks of the same system at the same period.

        Names, kinds, units and order count, resolutions, limits and delays do not; holds and
        periods only where both have them.

        Args:
            other: the channels to check.
            whose: what they are of, for the message.
            where: what these are of, for the message.
            open_holds: whether an input that does not say what happens between samples is the same
                as one that does.
        """
        for what, have, want in (
            ("coordinates", _kinds(other), _kinds(self)),
            ("inputs", *_holds(other, self, open_holds=open_holds)),
        ):
            if have != want:
                raise InputError(
                    whose,
                    f"{what} {_listed(have)}",
                    f"{_listed(want)} as in {where}",
                    "check the data card: names, kinds, units and order must agree",
                )
        if self.dt and other.dt and abs(other.dt / self.dt - 1) > _SAME_PERIOD:
            raise InputError(
                whose,
                f"sampling period {other.dt:g} s",
                f"{self.dt:g} s as in {where}",
                "resample the records, or fit a model for this period",
            )

    def as_header(self) -> dict[str, Any]:
        """The same as plain values, as model files have it."""
        return {
            "coordinates": [_coordinate_header(c) for c in self.coordinates],
            "inputs": [asdict(i) for i in self.inputs],
            "dt": self.dt,
        }

    @classmethod
    def from_header(cls, header: dict[str, Any]) -> "Channels":
        """What `as_header` made."""
        limits = [tuple(i["limits"]) if i["limits"] else None for i in header["inputs"]]
        return cls(
            tuple(Coordinate(**c) for c in header["coordinates"]),
            tuple(
                Input(**{**i, "limits": limit})
                for i, limit in zip(header["inputs"], limits, strict=True)
            ),
            header["dt"],
        )


class HasChannels:
    """Short ways to the parts of `channels`, for everything that has them."""

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


def _coordinate_header(of: Coordinate) -> dict[str, Any]:
    """A coordinate as plain values, without the usual unit, as in files of earlier versions."""
    usual = of.unit == _usual_unit(of.kind)
    return {key: x for key, x in asdict(of).items() if key != "unit" or not usual}


def _kinds(of: Channels) -> Sequence[tuple[str, str]]:
    return [
        (c.name, c.kind if c.unit == _usual_unit(c.kind) else f"{c.kind}, {c.unit}")
        for c in of.coordinates
    ]


def _holds(*of: Channels, open_holds: bool) -> list[list[tuple[str, str]]]:
    """Names, units and holds of each; where holds may be open, those that all of them say."""
    said = [{i.hold for i in inputs} for inputs in zip(*(c.inputs for c in of), strict=False)]
    unsaid = [open_holds and bool(holds & {None, "unknown"}) for holds in said]
    return [
        [
            (i.name, i.unit if k < len(said) and unsaid[k] else f"{i.unit}, {i.hold or _USUAL}")
            for k, i in enumerate(c.inputs)
        ]
        for c in of
    ]


def _listed(pairs: Sequence[tuple[str, str]]) -> str:
    return ", ".join(f"{name} ({kind})" for name, kind in pairs) or "(none)"
