"""Identification by inverse dynamics: parameters by least squares on the forces of a motion.

Nothing is simulated, so feedback in the loop does not matter: positions are filtered and
differentiated, and the parameters are those whose equations of motion ask for the measured forces.
`identify_by_inverse_dynamics` takes the problem and the state to start from, and returns the
`Identification`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import numpy as np
import scipy.special
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.inverse_dynamics.along import (
    FilteredRecord,
    filter_record,
    require_possible,
)
from tustinnet.fitting.inverse_dynamics.candidates import Choice, Trial, choose_forces
from tustinnet.fitting.inverse_dynamics.column_mistakes import (
    describe_column_mistakes,
    describe_groups_apart,
    describe_odd_record,
)
from tustinnet.fitting.inverse_dynamics.cutoff import choose_cutoff
from tustinnet.fitting.inverse_dynamics.linear_forces import LinearForces, levels_of
from tustinnet.fitting.inverse_dynamics.record_forces import RecordForces, force_errors
from tustinnet.fitting.inverse_dynamics.solver import (
    Prior,
    Solution,
    fold_derivatives,
    folds_to_leave_out,
    least_squares,
    solve,
)
from tustinnet.fitting.inverse_dynamics.sums import Columns, ForceSums, sum_up
from tustinnet.fitting.report import BaseParameterEstimate, ForceError, Identification
from tustinnet.fitting.shooting import findings
from tustinnet.fitting.shooting.base_parameters import (
    LinearCoordinates,
    find_combinations,
    order_of,
)
from tustinnet.fitting.shooting.problem import (
    Problem,
    SearchState,
    make_model,
    report_step,
)
from tustinnet.fitting.shooting.results import make_estimates
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.fitting.shooting.stages import choose_substeps, update_horizons
from tustinnet.fitting.shooting.uncertainty import (
    CONFIDENCE,
    FEWEST_RECORDS,
    INFORMED,
)
from tustinnet.models.added import with_forces
from tustinnet.models.chains import CENTER, INERTIAL
from tustinnet.models.forces import OWN_LEVEL, SLIP, SLIP_TRAVELS
from tustinnet.models.lagrangian import LagrangianSystem

STAGE = "inverse dynamics"

_LINEARISED = 10  # times that forces are made linear anew, at most
_CONVERGED = 1e-2  # decrease of the cost, in squares of standard deviations
_QUANTILE = float(scipy.special.ndtri((1 + CONFIDENCE) / 2))  # errors in half an interval


@dataclass(frozen=True)
class _Fit:
    """Forces with the parameters that explain them best.

    Attributes:
        forces: the forces.
        solution: the parameters.
        columns: the forces of each record, linear about these parameters.
        sums: their sums of squares.
        missing: what is missing along each record by these parameters [N m or N].
        is_converged: whether forces made linear anew would change nothing.
    """

    forces: LinearForces
    solution: Solution
    columns: list[Columns]
    sums: ForceSums
    missing: list[Float[np.ndarray, "_ n_q"]]
    is_converged: bool


class _Errors(NamedTuple):
    """Errors of the estimates, NaN of those at a bound.

    Intervals are the larger of two: of the noise of the residuals, and of how records disagree.

    Attributes:
        noise: covariance by the noise of the residuals, (n_p, n_p).
        between: covariance by how the records disagree, as wide as normal errors whose intervals
            are those of so many records; None where too few can be left out.
    """

    noise: Float[np.ndarray, "n_p n_p"]
    between: Float[np.ndarray, "n_p n_p"] | None

    @property
    def covariance(self) -> Float[np.ndarray, "n_p n_p"]:
        """Covariance of normal errors with these intervals."""
        if self.between is None:
            return self.noise
        # rank is at most the number of records: in other directions the noise has to say it
        scale = np.sqrt(np.maximum(np.diag(self.between) / np.diag(self.noise), 1.0))
        return self.noise * np.outer(scale, scale)

    def deviation(self, row: Float[np.ndarray, " n_p"]) -> float:
        """Standard deviation of a combination of the estimates."""
        some = np.flatnonzero(row)
        kept, place = row[some], np.ix_(some, some)
        matrices = [m for m in (self.noise, self.between) if m is not None]
        return float(np.sqrt(max(kept @ matrix[place] @ kept for matrix in matrices)))


def identify_by_inverse_dynamics(problem: Problem, state: SearchState) -> Identification | None:
    """Identifies the parameters of a problem by the forces along the records' motion.

    Every joint is weighed by what it leaves at the end, moving and at rest apart. Priors
    keep directions that the records know nothing of near the nominal values. Of a closed loop the
    system alone is identified, by what its controller computed as recorded.

    Args:
        problem: the problem.
        state: the initial values.

    Returns:
        None where it was stopped before it had values.

    Raises:
        InputError: what `find_obstacle` finds, a record that is too short, or a force that is not
            finite.

    References:
        Gautier, Khalil (1990), Direct calculation of minimum set of inertial parameters of serial
        robots. Swevers, Verdonck, De Schutter (2007), Dynamic model identification for industrial
        robots, IEEE Control Systems 27(5).
    """
    closed_loop, problem = problem, problem.plant
    require_possible(problem.system, closed_loop.records)
    state = without_gains(closed_loop, state)
    if problem.should_stop():
        return None
    cutoff = problem.search.cutoff or choose_cutoff(
        problem.system, problem.records, state.space, state.vector
    )
    parts = tuple(filter_record(e, cutoff) for e in problem.records)
    number = 0

    def report(fit: _Fit) -> None:
        nonlocal number
        number += fit.solution.steps
        report_step(problem, state, STAGE, "", number, fit.solution.cost, 0.0, True)

    plain = LinearForces(problem.system, state.space, parts)
    fit = plain_fit = _fit(plain, state.vector, None, problem.should_stop, report)
    trials, is_stopped = (), not fit.is_converged and problem.should_stop()
    if problem.search.candidates and not problem.should_stop():
        choice = choose_forces(
            plain,
            fit.solution.vector,
            fit.columns,
            problem.search.candidates,
            problem.should_stop,
        )
        trials, is_stopped = choice.trials, problem.should_stop()
        if choice.forces.beside:
            forces, vector = _without_idle(choice)
            alone = fit.columns if fit.is_converged else None
            fit = _fit(forces, vector, alone, problem.should_stop, report)
    forces = fit.forces
    names = tuple(map(str, forces.beside))
    closed_loop = replace(
        closed_loop, system=with_forces(closed_loop.system, names, forces.brought)
    )
    state = replace(state, space=forces.space, vector=fit.solution.vector)
    return _make_identification(
        closed_loop, state, _Result(fit, plain_fit, trials, number, is_stopped)
    )


class _Result(NamedTuple):
    """The result of a search.

    Attributes:
        fit: the forces with what was added to them.
        plain: the forces of the system itself.
        trials: forces that were tried.
        steps: Newton steps.
        is_stopped: whether the time ended before the search did.
    """

    fit: _Fit
    plain: _Fit
    trials: tuple[Trial, ...]
    steps: int
    is_stopped: bool


def _fit(
    forces: LinearForces,
    vector: ParameterVector,
    alone: Sequence[Columns] | None,
    should_stop: Callable[[], bool],
    report: Callable[[_Fit], None],
) -> _Fit:
    """Forces fitted to the records, made linear anew until that changes nothing.

    Args:
        forces: the forces.
        vector: first values.
        alone: the forces of the system alone about these, where they are known.
        should_stop: asked before forces are made linear anew.
        report: called with each fit.
    """
    prior, missing = forces.prior, forces.missing(vector)
    for number in range(1, _LINEARISED + 1):
        columns = forces.columns(vector, alone)
        if not all(
            np.isfinite(own.rest).all() and np.isfinite(own.slopes).all() for own in columns
        ):
            where, found = f"system '{forces.system.name}'", "forces that are not finite"
            raise InputError(where, f"{found} along the records", "numbers")
        sums = sum_up(columns)
        solution = solve(sums, prior, vector)
        unit = np.sqrt(solution.variances.mean(axis=1))
        before, found = _cost(missing, unit, prior, vector), solution.vector
        missing = forces.missing(found)
        # where forces are far from linear a whole step may go too far
        for _ in range(10):
            if _cost(missing, unit, prior, found) < before + _CONVERGED:
                break
            found = vector + (found - vector) / 2
            missing = forces.missing(found)
        after = _cost(missing, unit, prior, found)
        is_converged = bool(before - after < _CONVERGED)
        solution = solution._replace(vector=found)
        fit = _Fit(forces, solution, columns, sums, missing, is_converged)
        report(fit)
        if is_converged or number == _LINEARISED or should_stop():
            return fit
        vector = found
    raise AssertionError


def _cost(
    missing: Sequence[Float[np.ndarray, "_ n_q"]],
    unit: Float[np.ndarray, " n_q"],
    prior: Prior,
    vector: ParameterVector,
) -> float:
    """Half the sum of squares of missing forces by their sizes, with what priors and gains add."""
    squares = sum(np.sum((own / unit) ** 2) for own in missing)
    samples = np.full(len(unit), float(sum(map(len, missing))))
    return float(squares / 2 + prior.at(vector)[0] + prior.of_gains(samples, vector)[0])


def _without_idle(choice: Choice) -> tuple[LinearForces, ParameterVector]:
    """The forces of a choice without those that give nothing, and their parameters."""
    forces, values = choice.forces, choice.forces.space.to_values_in_range(choice.vector)
    idle = [f for f in forces.beside if not any(values[name] for name in levels_of(f))]
    kept = forces.without(idle)
    places = [forces.space.names.index(name) for name in kept.space.names]
    return kept, choice.vector[places]


def without_gains(problem: Problem, state: SearchState) -> SearchState:
    """A state in which the gains of a controller are fixed: no force of the system tells them."""
    if problem.system.feedback is None:
        return state
    values = state.space.to_values(state.vector)
    gains = problem.system.nominal().keys() - problem.system.plant.nominal().keys()
    space = state.space.fixing({n: values[n] for n in state.space.names if n in gains})
    return replace(state, space=space, vector=space.to_vector(values))


def are_all_driven(system: LagrangianSystem, records: Sequence[Experiment]) -> bool:
    """Whether the inputs of a system drive all of its coordinates, each by itself.

    With its nominal values, at rest where records begin.

    Args:
        system: the system, without a controller in the loop.
        records: records of it.
    """
    n, n_u = len(system.coordinates), len(system.inputs)
    if system.input_map is None or n_u < n:
        return False
    drive, values = jax.jacobian(system.input_map, argnums=2), system.nominal()
    gains = np.array([drive(e.q[0], np.zeros(n), np.zeros(n_u), values) for e in records[:3]])
    if not np.isfinite(gains).all():
        return False
    # three records are enough; units differ: compared are the directions of the inputs' forces,
    # which are combinations of others up to a relative 1e-6
    sizes = np.linalg.norm(gains, axis=1, keepdims=True)
    ranks = np.linalg.matrix_rank(gains / np.where(sizes > 0, sizes, 1.0), tol=1e-6)
    return int(ranks.max()) == n


def _make_identification(
    closed_loop: Problem, state: SearchState, result: _Result
) -> Identification:
    """The result, with errors of parameters and of forces.

    Forces are those of the system alone; simulated is the closed loop, if there is one.
    """
    problem, fit, space = closed_loop.plant, result.fit, state.space
    records, prior, vector = problem.records, fit.forces.prior, state.vector
    cutoff = fit.forces.parts[0].cutoff
    parameter_errors = _errors(fit)
    covariance = parameter_errors.covariance
    deviations = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviations, deviations)
    # values in range that a simulation can begin with, and its period's steps
    # nothing is searched for by simulation, so nothing is differentiated
    fixed = space.fixing(space.to_values_in_range(vector))
    state = replace(state, space=fixed, vector=fixed.to_vector({}))
    state = choose_substeps(closed_loop, update_horizons(closed_loop, state))
    model = make_model(closed_loop, state)
    horizons = {name: steps * records[0].dt for name, steps in state.horizons.items()}
    errors = _force_errors(result, problem.validation)
    size = np.array([e.size for e in errors if e.split == "train"])
    informed = deviations < INFORMED * prior.spread
    # a level beside the system that is not needed is none of its parameters
    levels = {p.name for p in fit.forces.brought}
    estimates = tuple(
        replace(e, is_informed=e.is_informed and not (e.bound == "lower" and e.name in levels))
        for e in make_estimates(
            space, vector, deviations, deviations, np.full(len(vector), _QUANTILE), informed
        )
    )
    base_parameters = _estimate_base_parameters(fit, parameter_errors, size)
    all_findings = [
        *state.remarks,
        findings.describe_forces(errors),
        *findings.describe_trials(result.trials),
        findings.describe_informed(space.names, informed, len(base_parameters)),
        *_describe_slip(fit, parameter_errors),
        *findings.describe_bounds(
            [e for e in estimates if e.name not in _replaced(fit.forces)],
            np.inf,
            problem.system,
        ),
        *_describe_carried(space, vector, parameter_errors),
        *(
            describe_groups_apart(problem, fit.columns, prior, vector)
            or describe_odd_record(problem.records, fit.sums, prior, vector, errors)
            or describe_column_mistakes(
                replace(problem, system=result.plain.forces.system),
                result.plain.forces.space,
                errors,
                cutoff,
            )
        ),
    ]
    _, matrices = fold_derivatives(fit.sums, prior, fit.solution)
    matrix = matrices.sum(axis=0) + prior.at(vector)[2]
    eigenvalues = np.linalg.eigvalsh(matrix * np.outer(prior.spread, prior.spread))
    by_record = [float(np.sqrt(np.mean((r / size) ** 2) * r.shape[1])) for r in fit.missing]
    return Identification(
        system=closed_loop.system,
        model=model,
        estimates=estimates,
        fixed=dict(space.fixed_values),
        correlation=correlation,
        condition=float(np.sqrt(eigenvalues[-1] / eigenvalues[0])),
        converged=fit.is_converged,
        outcome=(
            findings.describe_stop(state)
            if result.is_stopped
            else make_finding(
                "converged forces" if fit.is_converged else "not converged forces",
                steps=result.steps,
            )
        ).text,
        reversed_signs=(),
        findings=tuple(all_findings),
        trust="residuals" if parameter_errors.between is None else "records",
        rmse={e.name: x for e, x in zip(records, by_record, strict=True)},
        autocorrelation=(),
        disagreements=(),
        initial="not simulated",
        initial_states={},
        start=closed_loop.default_start.name,
        horizons=horizons,
        validation_rmse=None,
        substeps=model.substeps,
        iterations=result.steps,
        force_errors=errors,
        base_parameters=base_parameters,
    )


def _force_errors(result: _Result, validation: Sequence[Experiment]) -> tuple[ForceError, ...]:
    """The force that is missing at each coordinate, beside that of trivial references."""
    fit, plain = result.fit, result.plain
    system = fit.forces.system
    values = fit.forces.space.to_values(fit.solution.vector)
    found = least_squares(plain.sums, plain.forces.gains_among(values))
    nominal = plain.forces.space.nominal
    by_file = plain.forces.missing(plain.forces.space.to_vector(nominal))

    def forces_along(
        split: str,
        part: FilteredRecord,
        columns: Columns,
        missing: Float[np.ndarray, "k n_q"],
        missing_by_file: Float[np.ndarray, "k n_q"],
    ) -> RecordForces:
        by_least_squares = columns.slopes[:, :, : len(found)] @ found + columns.rest
        return RecordForces(
            record=part.record.name,
            split=split,
            coordinates=system.coordinates,
            units=tuple(map(system.force_unit, system.coordinates)),
            cutoff=part.cutoff,
            t=part.times,
            applied=columns.applied,
            needed=columns.applied + missing,
            needed_by_file=columns.applied + missing_by_file,
            needed_by_least_squares=columns.applied + by_least_squares,
            speed=columns.speed,
        )

    train = zip(fit.forces.parts, fit.columns, fit.missing, by_file, strict=True)
    every = [forces_along("train", *row) for row in train]
    if validation:
        own, references = (f.of_records(validation) for f in (fit.forces, plain.forces))
        held_out = zip(
            own.parts,
            references.columns(plain.solution.vector),
            own.missing(fit.solution.vector),
            references.missing(references.space.to_vector(nominal)),
            strict=True,
        )
        every += [forces_along("validation", *row) for row in held_out]
    return force_errors(every)


def _errors(fit: _Fit) -> _Errors:
    """Errors of the estimates by the noise, and by the jackknife over folds."""
    prior, vector = fit.forces.prior, fit.solution.vector
    inside, n_p = prior.space.inside(vector), len(vector)
    both = np.ix_(inside, inside)
    gradients, matrices = fold_derivatives(fit.sums, prior, fit.solution)
    precision = prior.at(vector)[2][both]
    whole = matrices.sum(axis=0)[both]
    noise = np.full((n_p, n_p), np.nan)
    noise[both] = inverse = np.linalg.inv(whole + precision)
    left_out = folds_to_leave_out(fit.sums, prior, fit.solution)
    if (n := len(left_out)) < FEWEST_RECORDS:
        return _Errors(noise, None)
    steps = np.stack(
        [
            np.linalg.solve(whole + precision - matrices[k][both], gradients[k][inside])
            for k in left_out
        ]
    )
    steps -= steps.mean(axis=0)
    clustered = (n - 1) / n * steps.T @ steps + inverse @ precision @ inverse
    wider = scipy.special.stdtrit(n - 1, (1 + CONFIDENCE) / 2) / _QUANTILE
    between = np.full((n_p, n_p), np.nan)
    between[both] = wider**2 * clustered
    return _Errors(noise, between)


def _estimate_base_parameters(
    fit: _Fit, errors: _Errors, size: Float[np.ndarray, " n_q"]
) -> tuple[BaseParameterEstimate, ...]:
    """Estimates of the base parameters, in the order of the parameters that they are named after.

    Args:
        fit: the estimates.
        errors: their errors; parameters at a bound count as exact.
        size: of the actuators' force at each coordinate [N m or N].
    """
    space, vector = fit.forces.space, fit.solution.vector
    scale, inside = space.derivatives(vector), space.inside(vector)
    coordinates = LinearCoordinates(space, space.to_values_in_range(vector))
    names, spread = coordinates.names, coordinates.spread(scale * fit.forces.prior.spread)
    by_coordinate = np.concatenate([own.slopes for own in fit.columns]) / size[:, None]
    by_coordinate = by_coordinate.reshape(-1, len(names))
    combinations = find_combinations(by_coordinate, spread, order_of(names))
    estimates = []
    for row, pivot in sorted(enumerate(combinations.pivots), key=lambda pair: pair[1]):
        terms = combinations.terms(row, spread)
        factors = np.zeros(len(names))
        factors[[pivot, *terms]] = combinations.factors[row, [pivot, *terms]]
        value = float(factors @ coordinates.values)
        gradient = np.where(inside, factors @ coordinates.derivatives * scale, 0.0)
        half = _QUANTILE * errors.deviation(gradient)
        estimates.append(
            BaseParameterEstimate(
                names[pivot],
                coordinates.units[pivot],
                {names[i]: float(factors[i]) for i in terms},
                value,
                (value - half, value + half) if gradient.any() else None,
            )
        )
    return tuple(estimates)


def _replaced(forces: LinearForces) -> set[str]:
    """Parameters whose absence says nothing: levels beside the system, and what these stand for."""
    levels = {p.name for p in forces.brought}
    return levels | {f"{force.channel}.{OWN_LEVEL}" for force in forces.beside}


def _describe_slip(fit: _Fit, errors: _Errors) -> list[Finding]:
    """Dry friction of joints with a memory: all of it, what they hold, how far they wind up.

    Levels at a bound count as exact.
    """
    space, vector = fit.forces.space, fit.solution.vector
    values, inside = space.to_values_in_range(vector), space.inside(vector)
    slopes, listed = np.where(inside, space.derivatives(vector), 0.0), []
    for force in fit.forces.beside:
        if force.law.name != SLIP:
            continue
        names, own = levels_of(force), f"{force.channel}.{OWN_LEVEL}"
        levels = np.array([values[name] for name in names])
        row = np.isin(space.names, [*names, own]) * slopes
        travels = values[f"{force.channel}.{SLIP}_travel"] * np.array(SLIP_TRAVELS)
        coordinate = fit.forces.system.coordinates[force.index]
        listed.append(
            make_finding(
                "holds",
                joint=force.channel,
                dry=levels.sum() + values.get(own, 0.0),
                error=_QUANTILE * errors.deviation(row),
                level=levels.sum(),
                unit=fit.forces.system.force_unit(coordinate),
                travel=1e3 * travels[levels > 0].max(),
                travel_unit=f"m{coordinate.unit}",
            )
        )
    return [make_finding("holds at rest", joints=listed)] if listed else []


def _describe_carried(
    space: SearchSpace, vector: ParameterVector, errors: _Errors
) -> list[Finding]:
    """The payload of links in groups of records, beside that of the lightest group.

    The error of a mass is that of the difference: most of what is not known of a link is the same
    in all groups.
    """
    values = space.to_values_in_range(vector)
    slopes = np.abs(space.derivatives(vector))
    groups: dict[str, list[str]] = {}  # by link, the ends of its names: "[1kg]"
    for name in space.names:
        link, is_mass, group = name.partition(f".{INERTIAL[0]}[")
        if is_mass:
            groups.setdefault(link, []).append(f"[{group}")
    carried = []
    for link, ends in groups.items():
        lightest = min(ends, key=lambda end: values[f"{link}.mass{end}"])
        less = values[f"{link}.mass{lightest}"]
        for end in ends:
            if end == lightest:
                continue
            own = values[f"{link}.mass{end}"]
            mass = own - less

            def half(slope: Mapping[str, float]) -> float:
                """Half the interval of a quantity with these derivatives."""
                row = np.zeros(len(space.names))
                for name, value in slope.items():
                    row[space.names.index(name)] = value
                return _QUANTILE * errors.deviation(row * slopes)

            width = half({f"{link}.mass{end}": 1.0, f"{link}.mass{lightest}": -1.0})
            centers = []
            for c in CENTER:
                there, here = values[f"{link}.{c}{end}"], values[f"{link}.{c}{lightest}"]
                center = (own * there - less * here) / mass
                error = half(
                    {
                        f"{link}.mass{end}": (there - center) / mass,
                        f"{link}.{c}{end}": own / mass,
                        f"{link}.mass{lightest}": (center - here) / mass,
                        f"{link}.{c}{lightest}": -less / mass,
                    }
                )
                centers.append(make_finding("centre", value=center, error=error))
            carried.append(
                make_finding(
                    "carries",
                    link=link,
                    mass=mass,
                    error=width,
                    group=end[1:-1],
                    lightest=lightest[1:-1],
                    center=centers,
                )
            )
    return carried
