"""Identification of a grey-box model: from records and a system to parameters one can trust."""

import time
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.data.dataset import DataSet, require_same_system
from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import transient_end
from tustinnet.errors import InputError
from tustinnet.evaluation.free_run import require_float64
from tustinnet.identification import inverse_dynamics
from tustinnet.identification.least_squares import Iteration, prior_deviation
from tustinnet.identification.result import Identification, describe
from tustinnet.identification.search import DEFAULT_SETTINGS, Search, Settings
from tustinnet.identification.space import Searched, Space, make_space
from tustinnet.identification.uncertainty import uncertainty
from tustinnet.models.lagrangian import LagrangianSystem

# what right signs leave of the momentum is a few hundredths, what wrong ones leave over a half
_POORLY_EXPLAINED = 0.1
_SHORTEST = 10  # samples of a transient worth fitting


def identify(
    data: DataSet,
    system: LagrangianSystem,
    *,
    start_values: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    settings: Settings = DEFAULT_SETTINGS,
    told: Callable[[Iteration], None] = lambda _: None,
) -> Identification:
    """Identifies a system's parameters by the simulation error over all training records at once.

    First values come from the equations of motion on the measured motion; then the simulation
    error over segments of one swing, of four swings and over whole records is minimised.

    Args:
        data: records; those of the split `train` are used, or all where there are no splits.
        system: the system, see `LagrangianSystem`.
        start_values: where the search starts, by name; the nominal values for those not given.
        fixed: parameters to hold at a value, besides those that the system holds.
        settings: how to identify.
        told: who is told of every iteration.

    Returns:
        The model, its parameters with errors and correlations, and what there is to say of them.

    Raises:
        InputError: records of another system, a value outside its range, a mass matrix that is
            not positive definite, float64 is off.
    """
    require_float64("identify")
    begun = time.perf_counter()
    records = list(data.split("train") if data.splits else data)
    held = list(data.split("validation")) if "validation" in data.splits else []
    require_same_system(
        records[0], system.coordinates, system.inputs, f"the system '{system.name}'"
    )
    if settings.part == "transients":
        records = _transients(records)
    space = make_space(system, start_values or {}, fixed or {})
    start_values = system.nominal() | dict(start_values or {})
    vector = space.clipped(space.vector(start_values))
    _require_mass(system, space, vector, records)
    _require_finite(system, space, vector, records)
    work = Search(system, records, held, settings, space, told)
    vector, remarks = work.hold_confounded(vector)
    vector, unexplained = work.first_values(vector)
    fitted, initial, score = work.search(vector)
    prior = work.prior(fitted.cost)
    curvature = prior.weight * prior_deviation(prior, work.space, fitted.vector)[1] ** 2
    bounds = work.space.at_bounds(fitted.vector)
    moving = np.array([name not in bounds for name in work.space.names])
    certain = uncertainty(fitted.normal, work.segments(None, initial), curvature, moving)
    reversed_signs: tuple[tuple[str, ...], ...] = ()
    if unexplained > _POORLY_EXPLAINED:
        reversed_signs = inverse_dynamics.likely_reversals(
            system, work.space, work.space.vector(start_values), work.motion
        )
    return describe(
        system=system,
        space=work.space,
        fitted=fitted,
        certain=certain,
        records=records,
        model=work.model(fitted.vector),
        bounds=bounds,
        reversed_signs=reversed_signs,
        remarks=remarks,
        initial=initial,
        validation=score,
        seconds=time.perf_counter() - begun,
    )


def _transients(records: Sequence[Experiment]) -> list[Experiment]:
    """Records up to `k_bar`; those that hardly move before it are left out."""
    ends = [transient_end(e) for e in records]
    kept = [e[:end] for e, end in zip(records, ends, strict=True) if end >= _SHORTEST]
    if not kept:
        raise InputError("part 'transients'", "no record that moves", "records with a transient")
    return kept


def _require_mass(
    system: LagrangianSystem, space: Space, vector: Searched, records: Sequence[Experiment]
) -> None:
    """The mass matrix must be positive definite wherever the records have been."""
    values = space.values(vector)
    q = np.concatenate([e.q[:: max(1, len(e) // 50)] for e in records])
    hessian = jax.hessian(system.kinetic, argnums=1)
    still, moving = np.asarray(
        jax.jit(
            lambda at: jnp.stack(
                [
                    jax.vmap(lambda x, s=s: hessian(x, jnp.full_like(x, s), values))(at)
                    for s in (0.0, 1.0)
                ]
            )
        )(jnp.asarray(q))
    )
    where = f"system '{system.name}', kinetic"
    if not np.isfinite(still).all():
        raise InputError(where, "not a finite number at a measured position", "finite numbers")
    if not np.allclose(still, moving, rtol=1e-6, atol=1e-9 * np.abs(still).max()):
        raise InputError(
            where, "not quadratic in v", "T = v' M(q) v / 2", "leave higher powers out"
        )
    values = np.linalg.eigvalsh(still)
    k = int(np.argmin(values[:, 0]))
    if not values[k, 0] > 1e-12 * values[k, -1]:
        at = ", ".join(f"{c.name} {x:.3g}" for c, x in zip(system.coordinates, q[k], strict=True))
        raise InputError(
            where,
            f"a mass matrix that is singular or negative at {at} (eigenvalues "
            f"{', '.join(f'{x:.2g}' for x in values[k])})",
            "a positive definite one",
            "every coordinate needs an inertia; write T as a sum of squares with positive masses",
        )


def _require_finite(
    system: LagrangianSystem, space: Space, vector: Searched, records: Sequence[Experiment]
) -> None:
    """Energies and forces must be numbers, and have derivatives, at the first values."""
    values = space.values(vector)
    q = jnp.concatenate([jnp.asarray(e.q) for e in records])
    v = jnp.concatenate([jnp.asarray(e.velocities()) for e in records])
    u = jnp.concatenate([jnp.asarray(e.u) for e in records])
    asked = {
        "potential": (system.potential, lambda f, q, v, u: jax.grad(f)(q, values)),
        "dissipation": (system.dissipation, lambda f, q, v, u: jnp.asarray(f(q, v, values))),
        "input_map": (system.input_map, lambda f, q, v, u: jnp.asarray(f(q, v, u, values))),
    }
    for name, (function, answer) in asked.items():
        if function is None:
            continue
        found = jax.jit(jax.vmap(lambda *at, f=function, a=answer: a(f, *at)))(q, v, u)
        bad = np.flatnonzero(~np.isfinite(np.asarray(found)).all(axis=1))
        if len(bad):
            k = int(bad[0])
            at = [
                f"{c.name} {q[k, j]:.3g} at {v[k, j]:.3g}/s"
                for j, c in enumerate(system.coordinates)
            ]
            raise InputError(
                f"system '{system.name}', {name}",
                f"not a finite number for {', '.join(at)}",
                "finite numbers wherever the records have been",
                "guard divisions, logarithms and roots; start from other values",
            )
