"""Checks before a search: can the system be simulated where the records have been?

`require_mass_matrix` and `require_finite_terms` evaluate a model along records,
`require_refit_possible` looks at the records; each raises an `InputError` that says what is wrong.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.fitting.shooting.problem import Problem
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.lagrangian import LagrangianModel


def require_refit_possible(problem: Problem) -> None:
    """Refuses records that are too short for the start of the refit, or lack what it needs."""
    start, shortest = problem.refit_start, min(problem.records, key=len)
    if start is None:
        return
    if len(shortest) < start.samples:
        raise InputError(
            "search.refine",
            f"'{start.name}', and record '{shortest.name}' has {len(shortest)} samples",
            f"records of at least {start.samples}",
            "leave the record out, or set search.refine=none",
        )
    # raises an error, as `file` does where no velocities are stored
    start.start_data(problem.nominal_model, problem.records)


def require_mass_matrix(model: LagrangianModel, records: Sequence[Experiment]) -> None:
    """Refuses a kinetic energy without a positive definite mass matrix along the records."""
    system = model.system
    q = np.concatenate([e.q[:: max(1, len(e) // 50)] for e in records])
    hessian, n_m = jax.hessian(system.kinetic, argnums=1), q.shape[1]
    n_q, complete = len(system.coordinate_names), system.states.unmeasured.complete
    where = f"system '{system.name}', kinetic"

    def at_rest_and_moving(q: Array) -> Array:
        q = complete(q, model.values)
        if system.inertia:  # it does not depend on the velocity
            return jnp.stack([model.mass_matrix(q)] * 2).ravel()
        both = [hessian(q, jnp.full_like(q, speed), model.values) for speed in (0.0, 1.0)]
        return jnp.stack(both).ravel()

    matrices = evaluate(Formula(at_rest_and_moving, n_m, where=where), q)
    at_rest, moving = np.swapaxes(matrices.reshape(len(q), 2, n_q, n_q), 0, 1)
    if not np.isfinite(at_rest).all():
        raise InputError(where, "not a finite number at a measured position", "finite numbers")
    if not np.allclose(at_rest, moving, rtol=1e-6, atol=1e-9 * np.abs(at_rest).max()):
        raise InputError(
            where, "not quadratic in v", "T = v' M(q) v / 2", "leave higher powers out"
        )
    eigenvalues = np.linalg.eigvalsh(at_rest)
    k = int(np.argmin(eigenvalues[:, 0]))
    if not eigenvalues[k, 0] > 1e-12 * eigenvalues[k, -1]:
        at = ", ".join(f"{c.name} {x:.3g}" for c, x in zip(system.coordinates, q[k], strict=True))
        raise InputError(
            where,
            f"a mass matrix that is singular or negative at {at} (eigenvalues "
            f"{', '.join(f'{x:.2g}' for x in eigenvalues[k])})",
            "a positive definite one",
            "every coordinate needs an inertia; write T as a sum of squares with positive masses",
        )


def require_finite_terms(model: LagrangianModel, records: Sequence[Experiment]) -> None:
    """Refuses energies and forces, or derivatives of them, that are not finite along records."""
    system, p = rigid_system(model.system), model.values
    channels = model.channels
    q = np.concatenate([e.q for e in records])
    v = np.concatenate([e.velocities() for e in records])
    samples = np.concatenate([q, v, np.concatenate([e.u for e in records])], axis=1)

    def split(sample: Array) -> tuple[Array, Array, Array]:
        position, velocity = sample[channels.position], sample[channels.velocity]
        return position, velocity, sample[channels.measured.stop :]

    terms: dict[str, Callable[[Array], Array]] = {}
    if potential := system.potential:
        terms["potential"] = lambda s: jax.grad(potential)(split(s)[0], p)
    if dissipation := system.dissipation:
        terms["dissipation"] = lambda s: jnp.asarray(dissipation(*split(s)[:2], p))
    if input_map := system.input_map:
        terms["input_map"] = lambda s: jnp.asarray(input_map(*split(s), p))
    for name, term in terms.items():
        where = f"system '{system.name}', {name}"
        values = evaluate(Formula(term, samples.shape[1], where=where), samples)
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(bad):
            k = int(bad[0])
            at = [
                f"{c.name} {q[k, j]:.3g} at {v[k, j]:.3g}/s"
                for j, c in enumerate(model.coordinates)
            ]
            raise InputError(
                where,
                f"not a finite number for {', '.join(at)}",
                "finite numbers wherever the records have been",
                "guard divisions, logarithms and roots; start from other values",
            )
