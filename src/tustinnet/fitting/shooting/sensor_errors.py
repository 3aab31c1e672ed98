"""Errors of sensors and actuators as parameters: biases, gains and delays of channels.

`sensor_parameters` takes names such as `angle.bias` and returns parameters with their ranges, also
for delays that the data card calls unknown.
"""

from collections.abc import Sequence

import numpy as np

from tustinnet.channels import Coordinate
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.models.sensors import delay_name

_WHERE = "model.free"


def sensor_parameters(
    system: LagrangianSystem, names: Sequence[str], experiments: Sequence[Experiment]
) -> tuple[Parameter, ...]:
    """The parameters that names stand for, with their ranges, and delays that are unknown.

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
    return tuple(_sensor_parameter(system, name, experiments) for name in names)


def _sensor_parameter(
    system: LagrangianSystem, name: str, experiments: Sequence[Experiment]
) -> Parameter:
    """The bias, gain or delay of one channel."""
    channel_name, _, kind = name.rpartition(".")
    channels = {c.name: c for c in (*system.inputs, *system.coordinates)}
    if channel_name not in channels:
        names = ", ".join(c.name for c in (*system.coordinates, *system.inputs))
        raise InputError(
            _WHERE,
            f"'{name}': no channel '{channel_name}'",
            f"CHANNEL.bias, CHANNEL.gain or, of an input, CHANNEL.delay of {names}",
        )
    channel = channels[channel_name]
    if kind == "delay":
        if isinstance(channel, Coordinate):
            raise InputError(
                _WHERE,
                f"'{name}'",
                "a bias or a gain",
                "a delay common to all sensors is the same as one of the inputs",
            )
        declared = experiments[0].inputs[system.inputs.index(channel)].delay or 0.0
        # ten periods at most
        dt, longest = experiments[0].dt, min(map(len, experiments)) - 2
        return Parameter(name, "s", declared, declared - dt, declared + min(10, longest) * dt)
    if kind == "gain":
        return Parameter(name, "1", 1.0, 0.5, 2.0)
    if kind != "bias":
        of_input = "" if isinstance(channel, Coordinate) else f" or {channel_name}.delay"
        expected = f"{channel_name}.bias or {channel_name}.gain{of_input}"
        raise InputError(_WHERE, f"'{name}'", expected)

    if not isinstance(channel, Coordinate):
        k = system.inputs.index(channel)
        largest = max(float(np.abs(e.u[:, k]).max()) for e in experiments)
    elif channel.kind == "angular":
        largest = 0.5  # rad
    else:
        k = system.coordinates.index(channel)
        largest = (
            max(e.q[:, k].max() for e in experiments) - min(e.q[:, k].min() for e in experiments)
        ) / 2
    if not largest > 0:
        raise InputError(
            _WHERE,
            f"'{name}': '{channel_name}' never moves in the training records",
            "a channel that moves",
            "leave it out",
        )
    return Parameter(name, channel.unit, 0.0, -largest, largest)
