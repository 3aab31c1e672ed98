"""Systems in other coordinates than those of their energies and forces."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, wraps
from typing import Any

import jax
import jax.numpy as jnp

from tustinnet.models.internal_states import Values, takes_inputs
from tustinnet.models.lagrangian import Inertia, LagrangianSystem


def in_coordinates(
    system: LagrangianSystem,
    position: Callable[[Any, Values], Any],
    inputs: Callable[[Any, Values], Any] = lambda u, p: u,
) -> dict[str, Any]:
    """Functions of a system's own motion as those of the motion in other coordinates.

    Lagrange's equations hold in any coordinates: energies are those of the same motion, and
    generalised forces do the same work (d'Alembert's principle).

    Args:
        system: the system.
        position: `position(q, p)`, the coordinates of the system by the others.
        inputs: `inputs(u, p)`, the inputs of the system by the others.

    Returns:
        Attributes of the system in the other coordinates.
    """
    memory, inertia, unmeasured = system.memory, system.inertia, system.unmeasured

    def motion(q: Any, v: Any, p: Values) -> tuple[Any, Any]:
        return jax.jvp(lambda x: position(x, p), (q,), (v,))

    def forces(own: Any, q: Any, p: Values) -> Any:
        """Generalised forces on the other coordinates, by rows of those on the system's own."""
        at, back = jax.vjp(lambda x: position(x, p), q)
        own = jnp.asarray(own, at.dtype)
        return back(own)[0] if own.ndim == 1 else jax.vmap(lambda row: back(row)[0])(own)

    def changed(
        function: Callable[..., Any] | None, *, is_force: bool = False, has_inputs: bool = False
    ) -> Any:
        if function is None:
            return None

        @wraps(function)
        def of_others(q: Any, v: Any, *others: Any) -> Any:
            *before, p = others
            if has_inputs:
                before[-1] = inputs(before[-1], p)
            result = function(*motion(q, v, p), *before, p)
            return forces(result, q, p) if is_force else result

        return of_others

    def at_position(function: Callable[..., Any]) -> Any:
        return wraps(function)(lambda q, p: function(position(q, p), p))

    def mass_matrix(q: Any, p: Values) -> Any:
        assert inertia is not None
        half = forces(inertia.mass_matrix(position(q, p), p), q, p)
        return forces(half.T, q, p)

    def coriolis(q: Any, v: Any, p: Values) -> Any:
        assert inertia is not None
        at, rate = motion(q, v, p)
        # accelerations of the system's coordinates while those of the others are 0
        _, turning = jax.jvp(lambda x: motion(x, v, p)[1], (q,), (v,))
        return forces(inertia.coriolis(at, rate, p) - inertia.mass_matrix(at, p) @ turning, q, p)

    return {
        "kinetic": changed(system.kinetic),
        "potential": system.potential and at_position(system.potential),
        "dissipation": changed(system.dissipation, is_force=True),
        "input_map": changed(system.input_map, is_force=True, has_inputs=True),
        "memory": memory
        and replace(
            memory,
            rate=changed(memory.rate, has_inputs=takes_inputs(memory.rate, "qvzp")),
            force=memory.force
            and changed(memory.force, is_force=True, has_inputs=takes_inputs(memory.force, "qvzp")),
            initial=changed(memory.initial, has_inputs=memory.initial_needs_inputs),
        ),
        "inertia": inertia and Inertia(mass_matrix, coriolis, inertia.uncoupled),
        "unmeasured": unmeasured
        and replace(
            unmeasured,
            follow=at_position(unmeasured.follow),
            initial=changed(unmeasured.initial, has_inputs=True),
        ),
    }


@lru_cache(maxsize=64)  # so that the same system serves the same compiled programs
def rigid_system(system: LagrangianSystem) -> LagrangianSystem:
    """The system whose unmeasured coordinates follow the measured ones as if nothing gave.

    So a robot with elastic gears becomes one with rigid gears, for estimates along the measured
    motion.

    Args:
        system: the system; one without unmeasured coordinates is returned as it is.
    """
    if system.unmeasured is None:
        return system
    rigid = in_coordinates(system, system.unmeasured.complete) | {"unmeasured": None}
    if rigid["inertia"] is not None:
        rigid["inertia"] = replace(rigid["inertia"], uncoupled=())
    return replace(system, **rigid, alone=system.alone and rigid_system(system.alone))
