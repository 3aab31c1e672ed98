"""Errors of sensors and actuators: zero, gain and delay of a channel as parameters."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from tustinnet.channels import Input
from tustinnet.models.coordinates import in_coordinates
from tustinnet.models.internal_states import Values
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

_NEUTRAL = {"bias": 0.0, "gain": 1.0}


@lru_cache(maxsize=64)  # so that the same system serves the same compiled programs
def with_sensor_errors(
    system: LagrangianSystem, sensors: tuple[Parameter, ...]
) -> LagrangianSystem:
    """The system in measured coordinates and inputs, with its sensors' errors as parameters.

    Measured are `q = gain q_physical + bias` and `v = gain v_physical`; the system is given
    `u_physical = gain u + bias`. Lagrange's equations hold in any coordinates: energies are those
    of the physical motion, and a generalised force is divided by its coordinate's gain, so that
    its work stays the same. Simulation, starts and files need no change.

    A delay of an input changes no equation, only the time at which it acts, see `with_delays`.

    Args:
        system: the system in physical coordinates and inputs.
        sensors: parameters named `CHANNEL.bias`, `CHANNEL.gain` and, of an input,
            `CHANNEL.delay`; none leaves it as it is.

    Raises:
        InputError: a name of a parameter that the system has already.
    """
    if not sensors:
        return system
    names = {s.name for s in sensors}

    def values(channels: Sequence[Any], which: str, p: Values) -> Float[Array, " n"]:
        of_channels = [f"{c.name}.{which}" for c in channels]
        return jnp.stack(
            [jnp.asarray(p[n] if n in names else _NEUTRAL[which]) for n in of_channels]
        )

    def of_coordinates(which: str, like: Any, p: Values) -> Float[Array, " n"]:
        """Values of coordinates; unmeasured ones, which may stand behind them, have no sensor."""
        measured = values(system.coordinates, which, p)
        others = like.shape[0] - len(system.coordinates)
        neutral = jnp.full(others, _NEUTRAL[which], measured.dtype)
        return jnp.concatenate([measured, neutral]) if others else measured

    def physical(q: Any, p: Values) -> Any:
        return (q - of_coordinates("bias", q, p)) / of_coordinates("gain", q, p)

    def physical_inputs(u: Any, p: Values) -> Any:
        if not system.inputs:
            return u
        return values(system.inputs, "gain", p) * u + values(system.inputs, "bias", p)

    return replace(
        system,
        parameters=(*system.parameters, *sensors),
        sensors=tuple(s.name for s in sensors),
        **in_coordinates(system, physical, physical_inputs),
    )


def delay_name(channel: Input) -> str:
    """The name of the parameter of an input's delay."""
    return f"{channel.name}.delay"


def delay_names(names: Iterable[str]) -> tuple[str, ...]:
    """The names of delays among some parameters' names."""
    return tuple(name for name in names if name.endswith(".delay"))


def with_delays(inputs: Sequence[Input], values: Mapping[str, Any]) -> tuple[Input, ...]:
    """Inputs with the delays [s] that are among the values of parameters."""
    return tuple(replace(i, delay=float(values.get(delay_name(i), i.delay or 0.0))) for i in inputs)
