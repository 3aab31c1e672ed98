"""Weights of states and inputs by the deviations that are acceptable (Bryson's rule)."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.control.dynamics import ControlledModel, InputLimits, require_known
from tustinnet.errors import InputError
from tustinnet.simulate.range import Range

_POSITION = 1.0  # acceptable deviation of a position whose range is unknown [rad or m]
_MOTION_SECONDS = (
    0.1  # in which a position may move by its deviation, where no range of the speed is known
)

# share of an acceptable speed that is usual about an equilibrium; measured: with 0.03 a cart-pole
# falls, with 0.1, 0.3 and 1 it is balanced (docs/explanation/control.md)
_USUAL = 0.1

Deviations = Mapping[str, float]


class Weights(NamedTuple):
    """Weights of squared deviations.

    Attributes:
        states: (n_x,).
        inputs: (n_u,).
    """

    states: Float[np.ndarray, " n_x"]
    inputs: Float[np.ndarray, " n_u"]

    def usual_speeds(self, channels: Channels) -> Float[np.ndarray, " n_q"]:
        """Speeds that are usual about an equilibrium, a share of the acceptable ones, (n_q,).

        0 where any speed is acceptable. Records of falls and whirls have higher speeds than any
        motion about a point: more than 1 rad/s or m/s is not usual.
        """
        prices = self.states[channels.velocity]
        acceptable = 1 / np.sqrt(np.where(prices > 0, prices, 1.0))
        return np.where(
            prices > 0, _USUAL * np.minimum(acceptable, _POSITION / _MOTION_SECONDS), 0.0
        )


def bryson_weights(
    system: ControlledModel,
    limits: InputLimits,
    deviations: Deviations | None = None,
    range: Range | None = None,
) -> Weights:
    """Weights `1 / d^2` by acceptable deviations `d`.

    Those that are given count first. Others are half of the range of the training records, where it
    is known, of an angle at most 1 rad: a wheel may have turned a hundred times. Else they are 1
    rad or m, ten times that in a second for velocities. An input may use half of its limits' range.
    Internal states have no weight unless they are named.

    Args:
        system: the model.
        limits: limits of the inputs.
        deviations: acceptable deviations of states and inputs by name; infinity for no weight,
            which inputs may not have.
        range: the range of the training records.

    Raises:
        InputError: an unknown name, or a deviation that is not positive.

    References:
        Bryson and Ho (1975), Applied optimal control.
    """
    channels = system.model.channels
    inputs = [i.name for i in channels.inputs]
    given = dict(deviations or {})
    require_known(given, (*system.names, *inputs), "weights", "states and inputs")
    for name, value in given.items():
        if not (value > 0 and (name not in inputs or np.isfinite(value))):
            raise InputError("weights", f"{name} = {value:g}", "an acceptable deviation above 0")
    states = np.full(system.n_x, np.inf)
    for i, c in enumerate(channels.coordinates):
        position = given.get(c.name, _POSITION)
        states[[i, i + channels.n_q]] = position, position / _MOTION_SECONDS
    if range is not None:
        half = np.ptp(range.states, axis=1) / 2
        half[channels.position] = range.share_of_spans(0.5, channels, _POSITION)
        measured = channels.measured
        states[measured] = np.where(half[measured] > 0, half[measured], states[measured])
    states = np.array([given.get(name, d) for name, d in zip(system.names, states, strict=True)])
    half = (limits.upper - limits.lower) / 2
    allowed = np.array([given.get(name, d) for name, d in zip(inputs, half, strict=True)])
    return Weights(1 / states**2, 1 / allowed**2)
