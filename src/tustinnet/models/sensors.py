"""Sensors and actuators that are off: zero and gain of a channel as parameters of a system."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, wraps
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from tustinnet.channels import Input
from tustinnet.models.lagrangian import LagrangianSystem, Memory, Parameter, Values

_NEUTRAL = {"bias": 0.0, "gain": 1.0}


@lru_cache(maxsize=64)  # so that the same system serves the same compiled programs
def with_sensor_errors(system: LagrangianSystem, sensors: tuple[Parameter, ...]) -> LagrangianSystem:
    """The system in measured coordinates and inputs, what its sensors are off by as parameters.

    Measured are `q = gain q_physical + bias` and `v = gain v_physical`; the system is given
    `u_physical = gain u + bias`. Lagrange's equations hold in any coordinates: energies are those
    of the physical motion, and a generalised force is divided by its coordinate's gain, so that
    its work stays the same. Simulation, starts and files know of nothing else.

    A delay of an input changes no equation, only when the inputs act, see `with_delays`.

    Args:
        system: the system in physical coordinates and inputs.
        sensors: parameters named `CHANNEL.bias`, `CHANNEL.gain` and, of an input,
            `CHANNEL.delay`; none leaves it as it is.

    Raises:
        InputError: a name that the system has already.
    """
    if not sensors:
        return system
    names = {s.name for s in sensors}

    def part(channels: Sequence[Any], which: str, p: Values) -> Float[Array, " n"]:
        each = [f"{c.name}.{which}" for c in channels]
        return jnp.stack([jnp.asarray(p[n] if n in names else _NEUTRAL[which]) for n in each])

    def motion(q: Any, v: Any, p: Values) -> tuple[Any, Any, Any]:
        gain = part(system.coordinates, "gain", p)
        return (q - part(system.coordinates, "bias", p)) / gain, v / gain, gain

    def kinetic(q: Any, v: Any, p: Values) -> Any:
        at, speed, _ = motion(q, v, p)
        return system.kinetic(at, speed, p)

    def potential(q: Any, p: Values) -> Any:
        assert system.potential
        return system.potential(motion(q, q, p)[0], p)

    def dissipation(q: Any, v: Any, p: Values) -> Any:
        assert system.dissipation
        at, speed, gain = motion(q, v, p)
        return jnp.asarray(system.dissipation(at, speed, p)) / gain

    def input_map(q: Any, v: Any, u: Any, p: Values) -> Any:
        assert system.input_map
        at, speed, gain = motion(q, v, p)
        if system.inputs:
            u = part(system.inputs, "gain", p) * u + part(system.inputs, "bias", p)
        return jnp.asarray(system.input_map(at, speed, u, p)) / gain

    return replace(
        system,
        parameters=(*system.parameters, *sensors),
        kinetic=wraps(system.kinetic)(kinetic),
        potential=system.potential and wraps(system.potential)(potential),
        dissipation=system.dissipation and wraps(system.dissipation)(dissipation),
        input_map=system.input_map and wraps(system.input_map)(input_map),
        memory=system.memory and _remembering(system.memory, motion),
        sensors=tuple(s.name for s in sensors),
    )


def delay_name(of: Input) -> str:
    """What the parameter of an input's delay is called."""
    return f"{of.name}.delay"


def delay_names(names: Iterable[str]) -> tuple[str, ...]:
    """Those of some parameters' names that are of delays."""
    return tuple(name for name in names if name.endswith(".delay"))


def with_delays(inputs: Sequence[Input], values: Mapping[str, Any]) -> tuple[Input, ...]:
    """Inputs with the delays [s] that are among the values of parameters."""
    known = [values.get(delay_name(i), i.delay or 0.0) for i in inputs]
    return tuple(replace(i, delay=float(x)) for i, x in zip(inputs, known, strict=True))


def _remembering(memory: Memory, motion: Callable[..., tuple[Any, Any, Any]]) -> Memory:
    """Forces with memory, given the physical motion that belongs to the measured one."""

    def rate(q: Any, v: Any, z: Any, p: Values) -> Any:
        at, speed, _ = motion(q, v, p)
        return memory.rate(at, speed, z, p)

    def force(q: Any, v: Any, z: Any, p: Values) -> Any:
        at, speed, gain = motion(q, v, p)
        return jnp.asarray(memory.force(at, speed, z, p)) / gain

    def initial(q: Any, v: Any, p: Values) -> Any:
        at, speed, _ = motion(q, v, p)
        assert memory.initial
        return memory.initial(at, speed, p)

    return Memory(memory.names, rate, force, memory.initial and initial)
