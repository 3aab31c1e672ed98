"""Identification of a grey-box model: from records and a system to parameters one can trust."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import transient_end
from tustinnet.engine.equations import Formula
from tustinnet.engine.runs import evaluate
from tustinnet.errors import InputError
from tustinnet.families.family import IdentifiedHyper
from tustinnet.fitting.listener import Iteration, Listener
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.report import Disagreement, FitResult, Identification
from tustinnet.fitting.shooting import inverse_dynamics
from tustinnet.fitting.shooting.agreement import Agreement
from tustinnet.fitting.shooting.findings import Found, described
from tustinnet.fitting.shooting.forces import with_added
from tustinnet.fitting.shooting.groups import spread
from tustinnet.fitting.shooting.holds import search_with_holds, with_some_hold
from tustinnet.fitting.shooting.least_squares import prior_deviation
from tustinnet.fitting.shooting.problem import Problem, State, model_of, prior, score
from tustinnet.fitting.shooting.refining import with_refined
from tustinnet.fitting.shooting.sensors import freed
from tustinnet.fitting.shooting.space import Searched, Space, make_space
from tustinnet.fitting.shooting.uncertainty import Uncertainty, uncertainty
from tustinnet.fitting.task import AnyRecipe, Member, Task, make_task
from tustinnet.models.contract import require_float64
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.models.sensors import with_delays, with_sensor_errors
from tustinnet.simulate.batches import batches
from tustinnet.systems.files import AnySystem, SystemTemplate

# what right signs leave of the momentum is a few hundredths, what wrong ones leave over a half
_POORLY_EXPLAINED = 0.1
_SHORTEST = 10  # samples of a transient worth fitting
DEFAULT_IDENTIFICATION = "grey"


def identify(
    data: DataSet,
    system: AnySystem,
    recipe: AnyRecipe = DEFAULT_IDENTIFICATION,
    *,
    begin: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    told: Callable[[Iteration], None] = lambda _: None,
) -> Identification:
    """Identifies a system's parameters by the simulation error over all training records at once.

    First values come from the equations of motion on the measured motion; then the simulation
    error over segments of one swing, of four swings and over whole records is minimised. Records
    along which errors grow without end, as about an unstable equilibrium that a controller
    holds, stay in segments; `findings` says which.

    Args:
        data: records; those of the split `train` are used, or all where there are no splits.
        system: the system, its name or its file, see `LagrangianSystem`.
        recipe: a recipe of a kind that is identified; `grey` by default.
        begin: where the search starts, by name, besides what the recipe says; the nominal values
            for those not given.
        fixed: parameters to fix at a value, besides those that the recipe and the system fix.
        told: called with every iteration.

    Returns:
        The model, its parameters with errors and correlations, and what there is to say of them.

    Raises:
        InputError: records of another system, a value outside its range, a mass matrix that is
            not positive definite, float64 is off.
    """
    chosen = read_recipe(recipe)
    given = {"begin": dict(begin or {}), "fixed": dict(fixed or {})}
    more = {key: {**getattr(chosen.model, key, {}), **values} for key, values in given.items()}
    changed = chosen.model_copy(update={"model": chosen.model.model_copy(update=more)})
    return _identify(make_task(data, changed, system=system), Member(), Listener(on_iteration=told))


def identify_task(task: Task, member: Member, listener: Listener) -> FitResult:
    """Identifies the system of a task from the records of a member's fold."""
    found = _identify(task, member, listener)
    return FitResult(
        model=found.model,
        recipe=task.recipe,
        member=member,
        outcome=found.outcome,
        sound=found.sound,
        start=found.start,
        validation_rmse=found.validation_rmse,
        seconds=found.seconds,
        details={"identification": found.as_plain()},
        findings=found.findings,
        identification=found,
        horizon=found.horizon,
    )


def _identify(task: Task, member: Member, listener: Listener) -> Identification:
    require_float64("identify")
    begun = time.perf_counter()
    recipe, roles = task.identification_recipe, task.folds[member.fold].roles
    system = task.system
    assert system is not None
    records = list(roles.train)
    system = system.for_records(records) if isinstance(system, SystemTemplate) else system
    system.channels.require_same(
        records[0].channels, records[0].name, f"the system '{system.name}'"
    )
    if recipe.search.part == "transients":
        records = _transients(records)
    system = _as_asked(system, recipe.model, records)
    # what nobody knows is searched for from 0 on
    acting = with_delays(records[0].inputs, {})
    problem = Problem(
        system, tuple(e.with_timing(acting) for e in records),
        tuple(e.with_timing(acting) for e in roles.validation), recipe.search, listener,
    )  # fmt: skip
    _require_refinable(with_some_hold(problem))
    space, first = _beginning(problem, recipe.model)
    values = {k: jnp.asarray(v, jnp.float64) for k, v in space.values(first).items()}
    for model, rows in batches(system.model(values), records):
        sharing = [records[i] for i in rows]
        _require_mass(model, sharing)
        _require_finite(model, sharing)
    begin_at = State(space, first, horizons=problem.asked or {})
    problem, ended, initial = search_with_holds(problem, begin_at)
    system = problem.system
    reversed_signs: tuple[tuple[str, ...], ...] = ()
    if ended.unexplained > _POORLY_EXPLAINED:
        reversed_signs = inverse_dynamics.likely_reversals(
            system, ended.space, ended.space.vector(space.numbers(first)), problem.motion
        )
    assert ended.fitted is not None
    assert ended.segments is not None
    found = Found(
        fitted=ended.fitted,
        segments=ended.segments,
        space=ended.space,
        model=model_of(problem, ended),
        records=problem.records,
        certain=_certain(problem, ended),
        disagreements=_disagreements(problem, ended),
        horizons={name: steps * records[0].dt for name, steps in ended.horizons.items()},
        asked=problem.asked is not None,
        reversed_signs=reversed_signs,
        remarks=ended.remarks,
        initial=initial,
        start=problem.judging_start(ended.horizon).name,
        validation_rmse=score(problem, ended) if problem.validation else None,
        weights=ended.weights,
    )
    told = described(system, found)
    if problem.refining:
        told = with_refined(problem, ended, problem.refining, told)
    return replace(told, seconds=time.perf_counter() - begun)


def _require_refinable(problem: Problem) -> None:
    """Refuses, before the search, records without what is needed after it."""
    start, shortest = problem.refining, min(problem.records, key=len)
    if start is None:
        return
    if len(shortest) < start.samples:
        raise InputError(
            "search.refine", f"'{start.name}', and record '{shortest.name}' has {len(shortest)} "
            "samples", f"records of at least {start.samples}",
            "leave the record out, or say search.refine=none",
        )  # fmt: skip
    start.start_data(problem.nominal, problem.records)  # as `file`, where no velocities are stored


def _as_asked(
    system: LagrangianSystem, model: IdentifiedHyper, records: Sequence[Experiment]
) -> LagrangianSystem:
    """The system with the forces and the parameters of sensors that a table `[model]` adds."""
    known = {**model.begin, **model.fixed}
    numbers = {name: x for name, x in known.items() if not isinstance(x, str)}
    system = with_added(system, model.forces, records, numbers)
    return with_sensor_errors(system, freed(system, model.free, records))


def _beginning(problem: Problem, model: IdentifiedHyper) -> tuple[Space, Searched]:
    """What is searched for, and where the search begins, by a recipe's table `[model]`."""
    known = {p.name: p for p in problem.parameters}
    begin = spread(problem.system, problem.parameters, model.begin)
    fixed = spread(problem.system, problem.parameters, model.fixed)
    fixed = {n: known[n].nominal if isinstance(x, str) else x for n, x in fixed.items()}
    space = make_space(problem.system, begin, fixed, problem.parameters)
    nominal = {name: p.nominal for name, p in known.items()}
    return space, space.clipped(space.vector(nominal | begin))


def _certain(problem: Problem, ended: State) -> Uncertainty:
    """How far the values found can be trusted; those at an end of their range have no errors."""
    fitted, segments, space = ended.fitted, ended.segments, ended.space
    assert fitted is not None
    assert segments is not None
    known = prior(problem, ended)
    curvature = known.weight * prior_deviation(known, space, fitted.vector)[1] ** 2
    bounds = space.at_bounds(fitted.vector)
    moving = np.array([name not in bounds for name in space.names])
    return uncertainty(fitted.normal, segments, curvature, moving)


def _disagreements(problem: Problem, ended: State) -> tuple[Disagreement, ...]:
    assert ended.fitted is not None
    assert ended.segments is not None
    if ended.fitted.why == "diverged":
        return ()
    return Agreement(problem, ended, ended.segments).disagreements()


def _transients(records: Sequence[Experiment]) -> list[Experiment]:
    """Records up to `k_bar`; those that hardly move before it are left out."""
    ends = [transient_end(e) for e in records]
    kept = [e[:end] for e, end in zip(records, ends, strict=True) if end >= _SHORTEST]
    if not kept:
        raise InputError("part 'transients'", "no record that moves", "records with a transient")
    return kept


def _mass_matrices(
    model: LagrangianModel, q: Float[np.ndarray, "n n_q"]
) -> Float[np.ndarray, "two n n_q n_q"]:
    """The mass matrix at some positions, as found at rest and in motion."""
    hessian, n_q = jax.hessian(model.system.kinetic, argnums=1), q.shape[1]

    def at(q: Array) -> Array:
        both = [hessian(q, jnp.full_like(q, speed), model.values) for speed in (0.0, 1.0)]
        return jnp.stack(both).ravel()

    where = f"system '{model.system.name}', kinetic"
    values = evaluate(Formula(at, n_q, where=where), q)
    return np.swapaxes(values.reshape(len(q), 2, n_q, n_q), 0, 1)


def _require_mass(model: LagrangianModel, records: Sequence[Experiment]) -> None:
    """The mass matrix must be positive definite wherever the records have been."""
    system = model.system
    q = np.concatenate([e.q[:: max(1, len(e) // 50)] for e in records])
    still, moving = _mass_matrices(model, q)
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


def _contributions(
    model: LagrangianModel, samples: Float[np.ndarray, "n n_s"]
) -> Iterator[tuple[str, Float[np.ndarray, "n n_q"]]]:
    """What energies and forces add to the equations of motion at samples [q, v, u]."""
    system, p, of = model.system, model.values, model.channels

    def parts(sample: Array) -> tuple[Array, Array, Array]:
        return sample[of.position], sample[of.velocity], sample[of.measured.stop :]

    formulas: dict[str, Callable[[Array], Array]] = {}
    if potential := system.potential:
        formulas["potential"] = lambda s: jax.grad(potential)(parts(s)[0], p)
    if dissipation := system.dissipation:
        formulas["dissipation"] = lambda s: jnp.asarray(dissipation(*parts(s)[:2], p))
    if input_map := system.input_map:
        formulas["input_map"] = lambda s: jnp.asarray(input_map(*parts(s), p))
    for name, formula in formulas.items():
        where = f"system '{system.name}', {name}"
        yield name, evaluate(Formula(formula, samples.shape[1], where=where), samples)


def _require_finite(model: LagrangianModel, records: Sequence[Experiment]) -> None:
    """Energies and forces must be numbers, and have derivatives, at the first values."""
    q, v, u = (
        np.concatenate(of)
        for of in zip(*[(e.q, e.velocities(), e.u) for e in records], strict=True)
    )
    for name, found in _contributions(model, np.concatenate([q, v, u], axis=1)):
        bad = np.flatnonzero(~np.isfinite(found).all(axis=1))
        if len(bad):
            k = int(bad[0])
            at = [
                f"{c.name} {q[k, j]:.3g} at {v[k, j]:.3g}/s"
                for j, c in enumerate(model.coordinates)
            ]
            raise InputError(
                f"system '{model.system.name}', {name}",
                f"not a finite number for {', '.join(at)}",
                "finite numbers wherever the records have been",
                "guard divisions, logarithms and roots; start from other values",
            )
