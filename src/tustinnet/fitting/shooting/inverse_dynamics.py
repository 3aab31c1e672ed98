"""Identification by inverse dynamics: parameters by least squares on the forces of a motion.

Nothing is simulated, so feedback in the loop does not matter: positions are filtered and
differentiated, and the parameters are those whose equations of motion ask for the measured forces.
`identify_by_inverse_dynamics` takes the problem and the state to start from, and returns the
`Identification`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Bool, Float

from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.fitting.report import BaseParameterEstimate, Estimate, ForceError, Identification
from tustinnet.fitting.shooting import findings
from tustinnet.fitting.shooting.base_parameters import (
    LinearCoordinates,
    find_combinations,
    order_of,
)
from tustinnet.fitting.shooting.equations import SystemEquations, system_equations
from tustinnet.fitting.shooting.groups import expand_parameters_by_values, group_indices
from tustinnet.fitting.shooting.levenberg_marquardt import DampingRule, iterate
from tustinnet.fitting.shooting.problem import (
    Problem,
    SearchState,
    make_model,
    report_step,
    score_validation,
)
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.fitting.shooting.stages import choose_substeps, update_horizons
from tustinnet.fitting.shooting.uncertainty import CONFIDENCE, FEWEST_RECORDS, INFORMED
from tustinnet.models.added import parse_forces
from tustinnet.models.chains import CENTER, INERTIAL
from tustinnet.models.forces import curve_terms, slow_speed
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.models.sensors import delay_names
from tustinnet.signals.low_pass import low_pass, noise_bandwidth, occupied_band

STAGE = "inverse dynamics"

_BAND = 3.0  # cut-off frequency by the highest frequency of the motion
_HIGHEST = 0.4  # cut-off frequency by the sampling rate, at most
_SAMPLES = 2.5  # that are compared for each period of the cut-off frequency
_EVALUATED = 20  # samples for each period of it at which forces are evaluated, at most
_MOTION = 3.0  # cut-off frequency of the motion by that of the forces
_INPUTS = 6.0  # cut-off frequency of inputs before samples are left out
_FEWEST = 20  # samples that must be left of a record
_REWEIGHTINGS = 3  # each after the iteration has converged
_EXPLAINED = 0.67  # share of the missing forces that a friction curve leaves, to be worth a word
_QUANTILE = float(scipy.special.ndtri((1 + CONFIDENCE) / 2))  # errors in half an interval
_POSES = 3  # in which it is looked which coordinates the inputs drive
_RANK = 1e-6  # of inputs' directions, below which one is a combination of others


class Obstacle(NamedTuple):
    """Reason why a system cannot be identified by inverse dynamics.

    Attributes:
        problem: what it is, as words behind "inverse dynamics".
        expected: what is needed instead.
        remedy: what to do.
    """

    problem: str
    expected: str
    remedy: str


class MeasuredForces(NamedTuple):
    """The motion and the inputs of a record, and how forces along it are compared.

    Attributes:
        points: positions, velocities, accelerations and inputs, (n, 3 n_q + n_u).
        record: the record.
        dt: period of these samples [s].
        cutoff: frequency up to which forces are compared [Hz].
    """

    points: Float[np.ndarray, "n n_in"]
    record: Experiment
    dt: float
    cutoff: float

    @property
    def step(self) -> int:
        """Number of samples from one at which forces are compared to the next."""
        return max(1, int(1 / (_SAMPLES * self.cutoff * self.dt)))

    @property
    def weight(self) -> float:
        """Independent measurements by compared sample: filtered noise is correlated."""
        return min(1.0, 2 * noise_bandwidth(self.cutoff) * self.step * self.dt)

    def compare(self, forces: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "k m"]:
        """Forces along the record as they are compared: filtered, at nearly independent samples."""
        edge = round(1 / (self.cutoff * self.dt))
        return low_pass(forces, self.dt, self.cutoff)[edge : len(forces) - edge : self.step]


class ForcesAlong(NamedTuple):
    """Forces on the coordinates along filtered records, as they are compared [N m or N].

    Attributes:
        missing: what the motion needs and the actuators do not give, (k, n_q).
        needed: what the motion needs, (k, n_q).
    """

    missing: Float[np.ndarray, "k n_q"]
    needed: Float[np.ndarray, "k n_q"]

    @property
    def applied(self) -> Float[np.ndarray, "k n_q"]:
        """Forces of the actuators."""
        return self.needed - self.missing

    @property
    def sizes(self) -> Float[np.ndarray, " n_q"]:
        """Root mean square of the actuators' forces on each coordinate, (n_q,).

        Of a coordinate without an actuator that of the forces that its motion needs.
        """
        by_input, by_motion = _root_mean_square(self.applied), _root_mean_square(self.needed)
        return np.where(by_input > 0, by_input, np.maximum(by_motion, 1e-12))


@dataclass(frozen=True)
class _Point:
    """A point of the iteration.

    Attributes:
        vector: the parameters.
        cost: half the sum of squares, the prior's included.
        matrices: products of derivatives by record, (n_r, n_p, n_p).
        gradients: derivatives of half the sums of squares by record, (n_r, n_p).
        residuals: missing forces of each record, (n, n_q) [N m or N].
    """

    vector: ParameterVector
    cost: float
    matrices: Float[np.ndarray, "n_r n_p n_p"]
    gradients: Float[np.ndarray, "n_r n_p"]
    residuals: tuple[Float[np.ndarray, "_ n_q"], ...]


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
        with np.errstate(invalid="ignore"):
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

    Every coordinate's equation is weighed by what it leaves at the end; the prior of each parameter
    counts as one measurement of its nominal value, so directions that the records know nothing of
    stay there. Of a closed loop the system alone is identified, by what its controller computed as
    recorded.

    Args:
        problem: the problem.
        state: the initial values.

    Returns:
        None where it was stopped before it had converged with its first weights.

    Raises:
        InputError: what `find_obstacle` finds, a record that is too short, or a force that is not
            finite.

    References:
        Gautier, Khalil (1990), Direct calculation of minimum set of inertial parameters of serial
        robots. Swevers, Verdonck, De Schutter (2007), Dynamic model identification for industrial
        robots, IEEE Control Systems 27(5).
    """
    closed_loop, problem = problem, problem.plant
    system = problem.system
    require_possible(system, closed_loop.records)
    state = without_gains(closed_loop, state)
    values, space = state.space.to_values(state.vector), state.space
    cutoff = problem.search.cutoff or choose_cutoff(problem.records)
    train = [filter_record(e, cutoff) for e in problem.records]
    equations = system_equations(system, space.names)
    formula = missing_forces(equations)
    unit = forces_along(formula, equations, train, values).sizes
    prior = Prior(space)
    point = _evaluate(formula, equations, problem, space, prior, train, unit, state.vector)
    if not np.isfinite(point.cost):
        raise InputError(
            f"system '{system.name}'", "forces that are not finite along the records", "numbers"
        )
    iterations, status = 0, ""
    for k in range(_REWEIGHTINGS):
        result = iterate(
            point,
            lambda p, damping, unit=unit: _propose(
                formula, equations, problem, space, prior, train, unit, p, damping
            ),
            lambda p, before: before - p.cost < problem.search.tolerance * p.cost,
            DampingRule(1e-6, 1e8, 10.0, lambda damping, gain: damping / 10, 0.0),
            problem.search.iterations,
            lambda number, p, damping, is_accepted: report_step(
                problem, state, STAGE, "", number, p.cost, damping, is_accepted
            ),
            problem.should_stop,
        )
        iterations, status = iterations + result.iterations, result.status
        if status == "stopped" and not k:
            return None
        residuals = np.concatenate(result.point.residuals)
        unit = np.maximum(np.sqrt(np.mean(residuals**2, axis=0)), 1e-9 * unit)
        point = _evaluate(
            formula, equations, problem, space, prior, train, unit, result.point.vector
        )
        if status == "stopped":
            break
    held_out = [filter_record(e, cutoff) for e in problem.validation]
    return _make_identification(
        closed_loop,
        replace(state, vector=point.vector),
        formula,
        equations,
        prior,
        train,
        held_out,
        point,
        iterations,
        status,
        cutoff,
    )


def without_gains(problem: Problem, state: SearchState) -> SearchState:
    """A state in which the gains of a controller are fixed: no force of the system tells them."""
    if problem.system.feedback is None:
        return state
    values = state.space.to_values(state.vector)
    gains = problem.system.nominal().keys() - problem.system.plant.nominal().keys()
    space = state.space.fixing({n: values[n] for n in state.space.names if n in gains})
    return replace(state, space=space, vector=space.to_vector(values))


def find_obstacle(system: LagrangianSystem, records: Sequence[Experiment]) -> Obstacle | None:
    """Why a system cannot be identified by forces along the motion of records; None if it can.

    Args:
        system: the system, without a controller in the loop.
        records: the records.
    """
    if system.internal or delay_names(system.sensors):
        what = "internal states" if system.internal else "delays"
        remedy = "identify it by simulation: `recipe=` grey"
        return Obstacle(f"of a system with {what}", "one without", remedy)
    if any(e.channels.controller is not None and e.outputs is None for e in records):
        return Obstacle(
            "without the inputs that the controller computed",
            "their columns in the data card",
            "add them, or identify by simulation: `recipe=` grey",
        )
    return None


def require_possible(system: LagrangianSystem, records: Sequence[Experiment]) -> None:
    """Raises where `find_obstacle` finds one."""
    if (obstacle := find_obstacle(system, records)) is not None:
        raise InputError(
            "search.method",
            f"inverse-dynamics, {obstacle.problem}",
            obstacle.expected,
            obstacle.remedy,
        )


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
    gains = np.array([drive(e.q[0], np.zeros(n), np.zeros(n_u), values) for e in records[:_POSES]])
    if not np.isfinite(gains).all():
        return False
    # their units differ: compared are the directions of the inputs' forces
    sizes = np.linalg.norm(gains, axis=1, keepdims=True)
    ranks = np.linalg.matrix_rank(gains / np.where(sizes > 0, sizes, 1.0), tol=_RANK)
    return int(ranks.max()) == n


def unexplained_forces(
    model: LagrangianModel, records: Sequence[Experiment], cutoff: float
) -> dict[str, float]:
    """The force at each coordinate that a model does not explain, as a share of the inputs' force.

    Both are root mean squares along the records. Without an actuator at a coordinate it is a share
    of the force that the motion needs.

    Args:
        model: equations of motion to which `find_obstacle` finds no obstacle.
        records: records that were not fitted to.
        cutoff: frequency up to which forces are compared [Hz].

    Raises:
        InputError: a record that is too short.
    """
    system = model.system.plant
    equations = system_equations(system)
    formula = missing_forces(equations)
    values = {name: float(x) for name, x in model.values.items()}
    parts = [filter_record(e.without_controller(), cutoff) for e in records]
    forces = forces_along(formula, equations, parts, values)
    shares = _root_mean_square(forces.missing) / forces.sizes
    return {c.name: float(x) for c, x in zip(system.coordinates, shares, strict=True)}


@lru_cache(maxsize=64)  # so that it is compiled once
def missing_forces(equations: SystemEquations) -> Formula:
    """Forces that a motion needs and the inputs do not give, (n_q,), by [q, v, a, u, parameters].

    Differentiated by the free parameters.
    """
    system = equations.system
    n, first = len(system.coordinates), 3 * len(system.coordinates) + len(system.inputs)

    def missing(point: Array) -> Array:
        q, v, a, u = point[:n], point[n : 2 * n], point[2 * n : 3 * n], point[3 * n : first]
        model = system.model(equations.values_in_row(point[first:]))
        applied = model.applied(q, v, jnp.zeros(0, q.dtype), u)
        return model.mass_matrix(q) @ a - model.conservative(q, v) - applied

    free = range(first, first + equations.n_p)
    return Formula(missing, first + equations.n_columns, free, f"system '{system.name}'")


def filter_record(e: Experiment, cutoff: float) -> MeasuredForces:
    """The motion of a record and its derivatives, as smooth as forces up to a frequency need them.

    Forces are filtered after they were evaluated, those of the equations and of the inputs alike:
    friction changes its sign faster than a filtered velocity shows.

    Args:
        e: the record.
        cutoff: frequency up to which forces are compared [Hz].

    Raises:
        InputError: the record is too short.
    """
    motion_cutoff = min(_MOTION * cutoff, _HIGHEST / e.dt)
    motion = [low_pass(e.q, e.dt, motion_cutoff, derivative) for derivative in range(3)]
    # what a held input is around a sample, to fourth order: their mean would be too smooth
    first, last = e.held_inputs[:1], e.held_inputs[-1:]
    padded = np.vstack([first, first, e.held_inputs, last, last])
    u = (13 * (padded[1:-2] + padded[2:-1]) - padded[:-3] - padded[3:]) / 24
    every = max(1, int(1 / (_EVALUATED * cutoff * e.dt)))
    if every > 1:
        u = low_pass(u, e.dt, _INPUTS * cutoff)
    points = np.concatenate([*motion, u], axis=1)[::every]
    part = MeasuredForces(points, e, every * e.dt, cutoff)
    if (remaining := len(points) - 2 * round(1 / (cutoff * part.dt))) < _FEWEST:
        raise InputError(
            f"record '{e.name}'",
            f"{len(e)} samples, of which a filter of {cutoff:.3g} Hz leaves {max(remaining, 0)}",
            f"at least {_FEWEST}",
            "longer records, or another search.cutoff",
        )
    return part


def choose_cutoff(records: Sequence[Experiment]) -> float:
    """The frequency up to which forces along records are compared [Hz].

    It is well above the motion and below the sampling rate.
    """
    band = max(occupied_band(e.q, e.dt) for e in records)
    return cutoff_for(band, records[0].dt)


def cutoff_for(band: float, dt: float) -> float:
    """The frequency up to which forces of a motion are compared [Hz].

    Args:
        band: highest frequency of the motion [Hz].
        dt: sampling period [s].
    """
    return min(_BAND * band, _HIGHEST * (1 / dt))


def compared_samples(seconds: float, cutoff: float) -> float:
    """The number of nearly independent samples of forces that a record has.

    Args:
        seconds: length of the record [s].
        cutoff: frequency up to which forces are compared [Hz].
    """
    return _SAMPLES * cutoff * seconds


class Prior:
    """Priors in the coordinates of a search, about the nominal values.

    Args:
        space: the search space. A parameter without a prior has one of half its range.

    Attributes:
        spread: standard deviations, (n_p,).
        centre: the nominal values, (n_p,).
    """

    def __init__(self, space: SearchSpace) -> None:
        nominal = space.to_vector({p.name: p.nominal for p in space.free_parameters})
        slope = space.derivatives(nominal)
        priors = np.array([p.prior or np.inf for p in space.free_parameters])
        self.spread = np.minimum(priors / slope, (space.upper - space.lower) / 2)
        self.centre = nominal

    def cost(self, vector: ParameterVector) -> float:
        """Half the sum of squares at a vector."""
        return float(np.sum(((vector - self.centre) / self.spread) ** 2) / 2)

    def gradient(self, vector: ParameterVector) -> ParameterVector:
        """Derivative of the cost."""
        return (vector - self.centre) / self.spread**2


def _evaluate(
    formula: Formula,
    equations: SystemEquations,
    problem: Problem,
    space: SearchSpace,
    prior: Prior,
    train: Sequence[MeasuredForces],
    unit: Float[np.ndarray, " n_q"],
    vector: ParameterVector,
) -> _Point:
    """Residuals and their products of derivatives at a vector.

    Args:
        formula: the missing forces.
        equations: the equations, which know the order of the parameters.
        problem: the problem.
        space: the search space.
        prior: the priors.
        train: the filtered records.
        unit: size of the residuals of each coordinate [N m or N].
        vector: the parameters.
    """
    values = space.to_values(vector)
    matrices, gradients, residuals, cost = [], [], [], prior.cost(vector)
    for part in train:
        points = with_parameters(equations, part, values)
        residual = part.compare(evaluate(formula, points))
        slopes = force_slopes(formula, equations, problem, space, part, points, vector)
        weighted = (slopes / unit[:, None]).reshape(-1, len(vector))
        matrices.append(part.weight * weighted.T @ weighted)
        gradients.append(part.weight * weighted.T @ (residual / unit).ravel())
        cost += part.weight * float(np.sum((residual / unit) ** 2) / 2)
        residuals.append(residual)
    return _Point(vector, cost, np.stack(matrices), np.stack(gradients), tuple(residuals))


def force_slopes(
    formula: Formula,
    equations: SystemEquations,
    problem: Problem,
    space: SearchSpace,
    part: MeasuredForces,
    points: Float[np.ndarray, "n n_in"],
    vector: ParameterVector,
) -> Float[np.ndarray, "k n_q n_p"]:
    """Derivatives of the missing forces along a filtered record by the coordinates of a search.

    Args:
        formula: the missing forces.
        equations: the equations, which know the order of the parameters.
        problem: the problem.
        space: the search space.
        part: the record.
        points: its points, with the parameters behind them.
        vector: the parameters.
    """
    slopes = part.compare(evaluate(formula, points, derivatives=True))
    n_q = len(equations.system.coordinates)
    slopes = slopes.reshape(len(slopes), n_q, -1)[:, :, equations.free_columns(space)]
    indices = np.repeat(problem.group_indices([part.record]), len(slopes), axis=0)
    return slopes * equations.coordinate_derivatives(space, vector, indices)[:, None]


def _propose(
    formula: Formula,
    equations: SystemEquations,
    problem: Problem,
    space: SearchSpace,
    prior: Prior,
    train: Sequence[MeasuredForces],
    unit: Float[np.ndarray, " n_q"],
    point: _Point,
    damping: float,
) -> tuple[_Point, float]:
    """The point of a damped Gauss-Newton step, and how much lower its model of the cost is."""
    matrix = point.matrices.sum(axis=0) + np.diag(1 / prior.spread**2)
    gradient = point.gradients.sum(axis=0) + prior.gradient(point.vector)
    lower, upper = space.lower, space.upper
    margin = 1e-12 * (upper - lower)
    is_held = ((point.vector <= lower + margin) & (gradient > 0)) | (
        (point.vector >= upper - margin) & (gradient < 0)
    )
    free = ~is_held
    damped = matrix + damping * np.diag(np.diag(matrix))
    step = np.zeros(len(gradient))
    step[free] = -np.linalg.solve(damped[np.ix_(free, free)], gradient[free])
    vector = np.clip(point.vector + step, lower, upper)
    step = vector - point.vector
    predicted = -float(gradient @ step + step @ matrix @ step / 2)
    trial = _evaluate(formula, equations, problem, space, prior, train, unit, vector)
    return trial, max(predicted, 1e-300)


def with_parameters(
    equations: SystemEquations, part: MeasuredForces, values: Mapping[str, float]
) -> Float[np.ndarray, "n n_in"]:
    """Points of a filtered record with the parameters behind them, as the formula takes them."""
    parameters = expand_parameters_by_values(equations.system, values)
    indices = group_indices(equations.system, parameters, [part.record])
    indices = np.repeat(indices, len(part.points), axis=0)
    return np.concatenate([part.points, equations.parameter_rows(values, indices)], axis=1)


def forces_along(
    formula: Formula,
    equations: SystemEquations,
    parts: Sequence[MeasuredForces],
    values: Mapping[str, float],
) -> ForcesAlong:
    """Forces on the coordinates along filtered records, one after the other."""
    n, n_u = len(equations.system.coordinates), len(equations.system.inputs)
    needed = []
    for part in parts:
        points = with_parameters(equations, part, values)
        points[:, 3 * n : 3 * n + n_u] = 0.0
        needed.append(part.compare(evaluate(formula, points)))
    return ForcesAlong(_missing_along(formula, equations, parts, values), np.concatenate(needed))


def _missing_along(
    formula: Formula,
    equations: SystemEquations,
    parts: Sequence[MeasuredForces],
    values: Mapping[str, float],
) -> Float[np.ndarray, "k n_q"]:
    """Missing forces of each coordinate along filtered records, one after the other [N m or N]."""
    return np.concatenate(
        [
            part.compare(evaluate(formula, with_parameters(equations, part, values)))
            for part in parts
        ]
    )


def _root_mean_square(forces: Float[np.ndarray, "k n_q"]) -> Float[np.ndarray, " n_q"]:
    return np.sqrt(np.mean(forces**2, axis=0))


def _make_identification(
    closed_loop: Problem,
    state: SearchState,
    formula: Formula,
    equations: SystemEquations,
    prior: Prior,
    train: Sequence[MeasuredForces],
    held_out: Sequence[MeasuredForces],
    point: _Point,
    iterations: int,
    status: str,
    cutoff: float,
) -> Identification:
    """The result, with errors of parameters and of forces.

    Forces are those of the system alone; simulated is the closed loop, if there is one.
    """
    problem = closed_loop.plant
    space, records = state.space, problem.records
    values = space.to_values_in_range(point.vector)
    indices = problem.group_indices(records)
    is_alone = np.array(
        [bool(indices.shape[1] and np.min(np.sum(indices == row, axis=0)) == 1) for row in indices]
    )
    parameter_errors = _errors(point, prior, space, is_alone)
    covariance = parameter_errors.covariance
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(deviations, deviations)
    # values in range that a simulation can begin with, and its period's steps
    state = choose_substeps(closed_loop, update_horizons(closed_loop, state))
    model = make_model(closed_loop, state)
    horizons = {name: steps * records[0].dt for name, steps in state.horizons.items()}
    forces = forces_along(formula, equations, train, values)
    size, rms = forces.sizes, _root_mean_square(forces.missing)
    missing_held_out = _missing_along(formula, equations, held_out, values) if held_out else None
    rms_held_out = None if missing_held_out is None else _root_mean_square(missing_held_out)
    errors = [
        ForceError(
            c.name,
            "N m" if c.kind == "angular" else "N",
            float(size[k]),
            float(rms[k]),
            None if rms_held_out is None else float(rms_held_out[k]),
        )
        for k, c in enumerate(problem.system.coordinates)
    ]
    informed = deviations < INFORMED * prior.spread
    estimates = _estimates(point, space, deviations, informed)
    points = [with_parameters(equations, part, space.to_values(point.vector)) for part in train]
    slopes = [
        force_slopes(formula, equations, problem, space, part, own, point.vector)
        for part, own in zip(train, points, strict=True)
    ]
    slopes = (np.concatenate(slopes) / size[:, None]).reshape(-1, len(point.vector))
    base_parameters = _estimate_base_parameters(slopes, space, prior, point, parameter_errors)
    sentences = [
        *state.remarks,
        findings.describe_forces(errors, cutoff),
        *findings.describe_informed(space.names, informed, len(base_parameters)),
        *findings.describe_bounds(estimates, np.inf, problem.system),
        *_describe_curves(problem, train, held_out, forces.missing, missing_held_out, values),
        *_describe_carried(space, point, parameter_errors),
    ]
    matrix = point.matrices.sum(axis=0) + np.diag(1 / prior.spread**2)
    eigenvalues = np.linalg.eigvalsh(matrix * np.outer(prior.spread, prior.spread))
    converged = status in ("converged", "stalled")
    by_record = [float(np.sqrt(np.mean((r / size) ** 2) * r.shape[1])) for r in point.residuals]
    return Identification(
        system=closed_loop.system,
        model=model,
        estimates=estimates,
        fixed=dict(space.fixed_values),
        correlation=correlation,
        condition=float(np.sqrt(eigenvalues[-1] / eigenvalues[0])),
        converged=converged,
        outcome=(
            f"converged after {iterations} iterations of inverse dynamics"
            if converged
            else findings.describe_stop(replace(state, is_stopped=True))
            if status == "stopped"
            else f"not converged after {iterations} iterations of inverse dynamics"
        ),
        reversed_signs=(),
        findings=tuple(sentences),
        trust="residuals" if parameter_errors.between is None else "records",
        rmse={part.record.name: x for part, x in zip(train, by_record, strict=True)},
        autocorrelation=(),
        disagreements=(),
        initial="not simulated",
        initial_states={},
        start=closed_loop.scoring_start(state.shortest_horizon).name,
        horizons=horizons,
        validation_rmse=score_validation(closed_loop, state) if problem.validation else None,
        substeps=model.substeps,
        iterations=iterations,
        force_errors=tuple(errors),
        base_parameters=base_parameters,
    )


def _describe_curves(
    problem: Problem,
    train: Sequence[MeasuredForces],
    held_out: Sequence[MeasuredForces],
    missing: Float[np.ndarray, "_ n_q"],
    missing_held_out: Float[np.ndarray, "_ n_q"] | None,
    values: Mapping[str, float],
) -> list[str]:
    """Sentence on the coordinates whose missing forces are a curve over the speed.

    A curve is fitted to what is missing in the training records, and has to explain most of what
    is missing in the held-out ones.
    """
    if missing_held_out is None:
        return []
    system = problem.system
    n, of_system, helpful = len(system.coordinates), system.nominal().keys(), []
    for curve in parse_forces(system, ["curve"]):
        k, (*weights, width_name) = curve.index, curve.parameter_names
        speed = float(np.sqrt(np.mean(np.concatenate([x.points[:, n + k] for x in train]) ** 2)))
        if of_system & {*weights} or speed == 0:
            continue  # it has one, or is at rest
        width = values.get(width_name, slow_speed(speed))
        regressors, others = (
            np.concatenate(
                [
                    part.compare(
                        np.asarray(curve_terms(jnp.asarray(part.points[:, n + k]), width)).T
                    )
                    for part in parts
                ]
            )
            for parts in (train, held_out)
        )
        solution = np.linalg.lstsq(regressors, missing[:, k], rcond=1e-8)[0]
        force = missing_held_out[:, k]
        if np.sum((force - others @ solution) ** 2) < _EXPLAINED**2 * np.sum(force**2):
            helpful.append(curve)
    return findings.describe_curves(helpful, system.added) if helpful else []


def _describe_carried(
    space: SearchSpace,
    point: _Point,
    errors: _Errors,
) -> list[str]:
    """Sentences on what links carry in groups of records beside what they do in the lightest one.

    The error of a mass is that of the difference: most of what is not known of a link is the same
    in all groups.
    """
    values = space.to_values_in_range(point.vector)
    slopes = np.abs(space.derivatives(point.vector))
    groups: dict[str, list[str]] = {}  # by link, the ends of its names: "[1kg]"
    for name in space.names:
        link, is_mass, group = name.partition(f".{INERTIAL[0]}[")
        if is_mass:
            groups.setdefault(link, []).append(f"[{group}")
    sentences = []
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
                centers.append(f"{center:.3g} ± {error:.2g}")
            sentences.append(
                f"'{link}' carries {mass:.4g} ± {width:.2g} kg (95 %) more in records of "
                f"{end[1:-1]} than in those of {lightest[1:-1]}, centre at {', '.join(centers)} m"
            )
    return sentences


def _estimate_base_parameters(
    slopes: Float[np.ndarray, "n n_p"],
    space: SearchSpace,
    prior: Prior,
    point: _Point,
    errors: _Errors,
) -> tuple[BaseParameterEstimate, ...]:
    """Estimates of the base parameters, in the order of the parameters that they are named after.

    Args:
        slopes: derivatives of the residuals along the records by the vector.
        space: the search space.
        prior: the priors.
        point: the estimates.
        errors: their errors; parameters at a bound count as exact.
    """
    scale, inside = space.derivatives(point.vector), space.inside(point.vector)
    coordinates = LinearCoordinates(space, space.to_values_in_range(point.vector))
    names, spread = coordinates.names, coordinates.spread(scale * prior.spread)
    by_coordinate = slopes / scale @ coordinates.inverse
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


def _errors(point: _Point, prior: Prior, space: SearchSpace, is_alone: np.ndarray) -> _Errors:
    """Errors of the estimates by the noise, and by the jackknife over records.

    Args:
        point: the estimates.
        prior: the priors.
        space: the search space.
        is_alone: which records are the only ones of a group, (n_r,). Without such a record nothing
            is known of the group, so they are not left out.
    """
    inside, n_p = space.inside(point.vector), len(point.vector)
    both = np.ix_(inside, inside)
    precision = np.diag(1 / prior.spread**2)
    whole = (point.matrices.sum(axis=0) + precision)[both]
    noise = np.full((n_p, n_p), np.nan)
    noise[both] = inverse = np.linalg.inv(whole)
    left_out = np.flatnonzero(~is_alone)
    n = len(left_out)
    if n < FEWEST_RECORDS:
        return _Errors(noise, None)
    steps = np.stack(
        [
            np.linalg.solve(whole - point.matrices[k][both], point.gradients[k][inside])
            for k in left_out
        ]
    )
    steps -= steps.mean(axis=0)
    clustered = (n - 1) / n * steps.T @ steps + inverse @ precision[both] @ inverse
    wider = scipy.special.stdtrit(n - 1, (1 + CONFIDENCE) / 2) / _QUANTILE
    between = np.full((n_p, n_p), np.nan)
    between[both] = wider**2 * clustered
    return _Errors(noise, between)


def _estimates(
    point: _Point,
    space: SearchSpace,
    deviations: Float[np.ndarray, " n_p"],
    informed: Bool[np.ndarray, " n_p"],
) -> tuple[Estimate, ...]:
    """Estimates of the free parameters, with errors and intervals of those not at a bound."""
    bounds, values = space.active_bounds(point.vector), space.to_values_in_range(point.vector)
    derivatives, lower, upper = space.derivatives(point.vector), space.lower, space.upper
    estimates = []
    for i, p in enumerate(space.free_parameters):
        has_error = p.name not in bounds and bool(np.isfinite(deviations[i]))
        error, half = deviations[i] * abs(derivatives[i]), _QUANTILE * deviations[i]
        edges = np.clip([point.vector[i] - half, point.vector[i] + half], lower[i], upper[i])
        interval = np.exp(edges) if p.positive else edges * derivatives[i]
        estimates.append(
            Estimate(
                name=p.name,
                unit=p.unit,
                value=values[p.name],
                error=float(error) if has_error else None,
                naive_error=float(error) if has_error else None,
                interval=(float(interval[0]), float(interval[1])) if has_error else None,
                lower=p.lower,
                upper=p.upper,
                bound=bounds.get(p.name, ""),
                is_informed=bool(informed[i]) or p.name in bounds,
            )
        )
    return tuple(estimates)
