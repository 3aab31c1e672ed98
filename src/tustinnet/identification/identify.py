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
from tustinnet.identification.least_squares import Iteration
from tustinnet.identification.result import Identification, describe
from tustinnet.identification.search import DEFAULT_SETTINGS, Search, Settings
from tustinnet.identification.space import Searched, Space, make_space
from tustinnet.identification.uncertainty import uncertainty
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem

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
    work = Search(system, records, held, settings, space, told)
    vector, remarks = work.hold_confounded(vector)
    vector, unexplained = work.first_values(vector)
    fitted, initial, score = work.search(vector)
    curvature = (
        work.prior(fitted.cost).weight
        * (work.space.slopes(fitted.vector) * work.prior(fitted.cost).precision) ** 2
    )
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
    model = LagrangianModel(system, space.values(vector))
    q = np.concatenate([e.q[:: max(1, len(e) // 50)] for e in records])
    values = np.linalg.eigvalsh(np.asarray(jax.jit(jax.vmap(model.mass_matrix))(jnp.asarray(q))))
    k = int(np.argmin(values[:, 0]))
    if not values[k, 0] > 1e-12 * values[k, -1]:
        at = ", ".join(f"{c.name} {x:.3g}" for c, x in zip(system.coordinates, q[k], strict=True))
        raise InputError(
            f"system '{system.name}', kinetic",
            f"a mass matrix that is singular or negative at {at} (eigenvalues "
            f"{', '.join(f'{x:.2g}' for x in values[k])})",
            "a positive definite one",
            "every coordinate needs an inertia; write T as a sum of squares with positive masses",
        )
