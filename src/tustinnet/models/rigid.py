"""Systems with unmeasured coordinates as rigid ones, for estimates along the measured motion."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, wraps
from typing import Any

import jax
import jax.numpy as jnp

from tustinnet.models.lagrangian import Inertia, LagrangianSystem, Memory, Values


@lru_cache(maxsize=64)  # so that the same system serves the same compiled programs
def rigid_system(system: LagrangianSystem) -> LagrangianSystem:
    """The system whose unmeasured coordinates follow the measured ones as if nothing gave.

    Energies are those of the motion of all coordinates; generalised forces do the work along the
    measured ones that they do along all (d'Alembert's principle). So a robot with elastic gears
    becomes one with rigid gears.

    Args:
        system: the system without a controller; one without unmeasured coordinates is returned as
            it is. `with_changed_plant` makes the system in a closed loop rigid.
    """
    unmeasured, n = system.unmeasured, len(system.coordinates)
    if unmeasured is None:
        return system

    def jacobian(q: Any, p: Values) -> Any:
        """Velocities of all coordinates by those of the measured ones, (n_q + n_h, n_q)."""
        return jnp.vstack([jnp.eye(n, dtype=q.dtype), jax.jacfwd(unmeasured.follow)(q, p)])

    def rigid(function: Callable[..., Any], *, is_force: bool = False) -> Callable[..., Any]:
        """A function of the motion of all coordinates as one of the measured motion."""

        @wraps(function)
        def of_measured(q: Any, v: Any, *others: Any) -> Any:
            p = others[-1]
            result = function(*unmeasured.complete(q, v, p), *others)
            return jacobian(q, p).T @ jnp.asarray(result) if is_force else result

        return of_measured

    def potential(q: Any, p: Values) -> Any:
        assert system.potential is not None
        return system.potential(unmeasured.complete(q, q, p)[0], p)

    def mass_matrix(q: Any, p: Values) -> Any:
        assert system.inertia is not None
        by = jacobian(q, p)
        return by.T @ system.inertia.mass_matrix(unmeasured.complete(q, q, p)[0], p) @ by

    def coriolis(q: Any, v: Any, p: Values) -> Any:
        assert system.inertia is not None
        (at, rate), by = unmeasured.complete(q, v, p), jacobian(q, p)
        # accelerations of all coordinates while those of the measured ones are 0
        _, turning = jax.jvp(lambda x: unmeasured.complete(x, v, p)[1], (q,), (v,))
        return by.T @ (
            system.inertia.coriolis(at, rate, p) - system.inertia.mass_matrix(at, p) @ turning
        )

    memory = system.memory
    return replace(
        system,
        kinetic=rigid(system.kinetic),
        potential=potential if system.potential else None,
        dissipation=system.dissipation and rigid(system.dissipation, is_force=True),
        input_map=system.input_map and rigid(system.input_map, is_force=True),
        memory=memory
        and Memory(
            memory.names,
            rigid(memory.rate),
            rigid(memory.force, is_force=True),
            memory.initial and rigid(memory.initial),
        ),
        inertia=system.inertia and Inertia(mass_matrix, coriolis),
        unmeasured=None,
    )
