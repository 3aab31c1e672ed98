"""What sensors and actuators may be off by, as parameters that are searched for."""

from collections.abc import Sequence

import numpy as np

from tustinnet.channels import Coordinate
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.models.sensors import delay_name

_WHERE = "model.free"
_ANGLE = 0.5  # rad that the zero of an angle may be off by
_GAINS = (0.5, 2.0)
_LATEST = 10  # periods that an input may act later than the card says


def freed(
    system: LagrangianSystem, names: Sequence[str], experiments: Sequence[Experiment]
) -> tuple[Parameter, ...]:
    """The parameters that the names stand for, with their ranges, and delays that nobody knows.

    A gain is within 0.5..2, the zero of an angle within 0.5 rad, that of a length within half of
    its travel in the records, the bias of an input within its peak. A delay of an input is
    between a period less and 10 periods more than the data card says.

    Args:
        system: the system.
        names: `CHANNEL.bias`, `CHANNEL.gain` or, of an input, `CHANNEL.delay`.
        experiments: the training records.

    Raises:
        InputError: a name twice, no such channel, something else than bias, gain and delay, a
            channel that the records do not move.
    """
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(_WHERE, f"'{name}' twice", "once")
    unknown = [delay_name(i) for i in experiments[0].inputs if i.delay is None]
    names = [*names, *(name for name in unknown if name not in names)]
    return tuple(_parameter(system, name, experiments) for name in names)


def _parameter(system: LagrangianSystem, name: str, experiments: Sequence[Experiment]) -> Parameter:
    channels = [*system.coordinates, *system.inputs]
    channel, _, part = name.rpartition(".")
    of = next((c for c in channels if c.name == channel), None)
    if of is None:
        known = ", ".join(c.name for c in channels)
        raise InputError(
            _WHERE, f"'{name}': no channel '{channel}'", f"CHANNEL.bias or CHANNEL.gain of {known}"
        )
    if part == "delay":
        return _delay(system, name, of, experiments)
    if part not in ("bias", "gain"):
        raise InputError(_WHERE, f"'{name}'", f"{channel}.bias or {channel}.gain")
    if part == "gain":
        return Parameter(name, "1", 1.0, *_GAINS)
    reach = _reach(system, of, experiments)
    if not reach > 0:
        raise InputError(
            _WHERE, f"'{name}': '{channel}' never moves in the training records",
            "a channel that moves", "leave it out",
        )  # fmt: skip
    return Parameter(name, of.unit, 0.0, -reach, reach)


def _delay(
    system: LagrangianSystem, name: str, of: object, experiments: Sequence[Experiment]
) -> Parameter:
    if isinstance(of, Coordinate):
        raise InputError(
            _WHERE, f"'{name}'", "a bias or a gain",
            "a delay common to all sensors is the same as one of the inputs",
        )  # fmt: skip
    k, dt = [c is of for c in system.inputs].index(True), experiments[0].dt
    known, longest = experiments[0].inputs[k].delay or 0.0, min(map(len, experiments)) - 2
    return Parameter(name, "s", known, known - dt, known + min(_LATEST, longest) * dt)


def _reach(system: LagrangianSystem, of: object, experiments: Sequence[Experiment]) -> float:
    """How far a channel's zero may be off."""
    if not isinstance(of, Coordinate):
        k = [c is of for c in system.inputs].index(True)
        return max(float(np.abs(e.u[:, k]).max()) for e in experiments)
    if of.kind == "angular":
        return _ANGLE
    k = [c is of for c in system.coordinates].index(True)
    return (
        max(e.q[:, k].max() for e in experiments) - min(e.q[:, k].min() for e in experiments)
    ) / 2
