"""Design of a record: the motion that tells the most about the parameters of a robot.

`design_record` takes a system with an input for each coordinate, or a model of one, and limits of
its motion. It returns a periodic motion that begins and ends at rest, and the errors
that the parameters are expected to have once it has been recorded. Forces along the motion count,
as in the identification by inverse dynamics.

References:
    Swevers, Ganseman, Tükel, De Schutter, Van Brussel (1997), Optimal robot excitation and
    identification, IEEE Transactions on Robotics and Automation 13(5): Fourier series, the
    determinant of the covariance. Gautier, Khalil (1992), Exciting trajectories for the
    identification of base inertial parameters of robots, International Journal of Robotics
    Research 11(4). Gautier (1991), Numerical calculation of the base inertial parameters of
    robots, Journal of Robotic Systems 8(4).
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.data.dataset import from_arrays
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError, convert_errors
from tustinnet.evaluate.next_record import (
    SHRINKAGE,
    equations_of_motion,
    parameter_covariance,
)
from tustinnet.fitting.inverse_dynamics.along import missing_forces
from tustinnet.fitting.inverse_dynamics.cutoff import compared_samples, cutoff_for
from tustinnet.fitting.inverse_dynamics.solver import Prior
from tustinnet.fitting.shooting.base_parameters import Combinations, find_combinations, order_of
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.groups import (
    expand_parameters,
    expand_parameters_by_values,
    group_indices,
)
from tustinnet.fitting.shooting.space import SearchSpace, make_search_space
from tustinnet.models.contract import Model, require_float64
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.models.motion_limits import MotionLimits
from tustinnet.shown import Brief
from tustinnet.signals.fourier_series import FourierMotion, harmonics, motions_from_rest
from tustinnet.wording import counted

_POINTS_A_PERIOD = 16  # of a period of the highest harmonic at which a motion is judged
_NULL = 1e-5  # of the largest direction, below which parameters change no force
_LEAST_NOISE = 1e-6  # of a force, and in N m or N: a fit to exact records leaves none
_MOST_SAMPLES = 10**6
_PLACE = "design_record"  # of messages
_RANK = "propose records: tn.rank_proposals"
_DIRECTIONS = ("position", "velocity", "acceleration", "input", "force")


@dataclass(frozen=True)
class DesignOptions:
    """Options of the design of a record.

    Attributes:
        seconds: length of the record [s], a whole number of periods.
        frequency: base frequency [Hz]; None for one period.
        harmonics: number of harmonics.
        dt: sampling period [s].
        margin: share of each limit that is kept free, for a controller that does not follow
            exactly.
        noise: what stays unexplained of a force, by its root mean square along random motions
            within the limits; None for what the fit has left, or 2 %.
        starts: number of random motions that the search starts from.
        seed: seed of these.
        iterations: steps of each of the two stages of the search, at most; 0 for the best of the
            random motions.
        budget: time that the search may take [s], None for no limit.
    """

    seconds: float = 10.0
    frequency: float | None = None
    harmonics: int = 10
    dt: float = 0.005
    margin: float = 0.1
    noise: float | None = None
    starts: int = 4
    seed: int = 0
    iterations: int = 150
    budget: float | None = 60.0

    def __post_init__(self) -> None:
        for option, value, is_valid, expected in (
            ("`seconds=`", self.seconds, 0 < self.seconds <= 1e4, "above 0, and at most 10000"),
            ("`harmonics=`", self.harmonics, 2 <= self.harmonics <= 50, "from 2 to 50"),
            (
                "`dt=`",
                self.dt,
                1e-6 <= self.dt <= self.seconds / 10,
                "from 1e-6 s to a tenth of `seconds=`",
            ),
            ("`margin=`", self.margin, 0 <= self.margin < 1, "a share from 0 to below 1"),
            ("`starts=`", self.starts, 1 <= self.starts <= 100, "from 1 to 100"),
            ("`seed=`", self.seed, 0 <= self.seed < 2**32, "from 0 to 2^32 - 1"),
            (
                "`frequency=`",
                self.frequency or 0.0,
                self.frequency is None or 0 < self.frequency <= 1e4,
                "above 0, and at most 10000 Hz",
            ),
            (
                "`noise=`",
                self.noise or 0.0,
                self.noise is None or 0 < self.noise <= 10,
                "a share of the force, above 0",
            ),
        ):
            if not is_valid:
                raise InputError(option, f"{value:g}", expected)
        periods = 1.0 if self.frequency is None else self.seconds * self.frequency
        if periods < 1 - 1e-6 or abs(periods - round(periods)) > 1e-6 * periods:
            raise InputError(
                "`frequency=`",
                f"{periods:.4g} periods in {self.seconds:g} s",
                "a whole number",
                f"for instance `frequency=` {max(1, round(periods)) / self.seconds:.6g}",
            )
        if self.seconds / self.dt > _MOST_SAMPLES:
            raise InputError(
                "`dt=`",
                f"{self.seconds / self.dt:.3g} samples in {self.seconds:g} s",
                f"at most {_MOST_SAMPLES:.0e}",
                "fewer seconds, or a longer period",
            )
        if self.highest > 0.1 / self.dt:
            raise InputError(
                "`harmonics=`",
                f"a highest frequency of {self.highest:.4g} Hz",
                f"at most a tenth of the sampling rate, {0.1 / self.dt:.4g} Hz",
                "fewer harmonics, a lower `frequency=` or a shorter `dt=`",
            )

    @property
    def base_frequency(self) -> float:
        """Frequency of the first harmonic [Hz]; by default that of a whole number of samples."""
        if self.frequency is not None:
            return self.frequency
        return 1 / (round(self.seconds / self.dt) * self.dt)

    @property
    def highest(self) -> float:
        """Frequency of the highest harmonic [Hz]."""
        return self.harmonics * self.base_frequency


@dataclass(frozen=True)
class DesignLimits:
    """Limits of the motion and of the inputs of a system.

    Attributes:
        motion: limits of each coordinate; position and velocity are there.
        inputs: smallest and largest value of each input, None without limits.
    """

    motion: tuple[MotionLimits, ...]
    inputs: tuple[tuple[float, float] | None, ...]


class Knowledge(NamedTuple):
    """Knowledge about the parameters of a system before a record is made.

    Attributes:
        space: the free parameters, and the values of the others.
        values: the values of all parameters.
        covariance: covariance of the free parameters by the records so far, in the coordinates of
            the space, (n_p, n_p); None without records: the priors count.
        noise: missing force of each coordinate that a fit has left, (n_q,) [N m or N], None
            without one.
    """

    space: SearchSpace
    values: Mapping[str, float]
    covariance: Float[np.ndarray, "n_p n_p"] | None = None
    noise: Float[np.ndarray, " n_q"] | None = None


@dataclass(frozen=True)
class BaseParameter:
    """A combination of parameters that forces tell by itself, with its errors.

    Attributes:
        name: the parameter that it is named after.
        unit: its unit.
        terms: the other parameters in it, each with its factor, by which a change of it counts as
            one of the first.
        file: standard error by the priors, which is by the robot's file.
        known: standard error by the records so far, None without records.
        expected: standard error with the designed record.
    """

    name: str
    unit: str
    terms: Mapping[str, float]
    file: float
    known: float | None
    expected: float

    @property
    def remaining(self) -> float:
        """The expected error by that of the file."""
        return self.expected / self.file


@dataclass(frozen=True, repr=False)
class RecordDesign(Brief):
    """A designed record.

    Attributes:
        channels: coordinates, inputs and sampling period.
        options: options of the design.
        limits: limits that it keeps.
        motion: the motion.
        t: times of the samples [s], (n,).
        q: positions there, (n, n_q) [rad or m].
        v: velocities, (n, n_q).
        a: accelerations, (n, n_q).
        u: inputs that are expected, (n, n_u), in the units of the inputs.
        force: forces of the actuators that are expected, (n, n_q).
        force_units: the unit of the force on each coordinate.
        noise: force that is taken to be missing at each coordinate, (n_q,).
        base_parameters: base parameters, the best determined one first.
        by_random: errors of random motions within the limits by those of this one: the geometric
            mean over the base parameters, the median over the motions.
        stopped: whether the time ended before the search did.
    """

    channels: Channels
    options: DesignOptions
    limits: DesignLimits
    motion: FourierMotion
    t: Float[np.ndarray, " n"]
    q: Float[np.ndarray, "n n_q"]
    v: Float[np.ndarray, "n n_q"]
    a: Float[np.ndarray, "n n_q"]
    u: Float[np.ndarray, "n n_u"]
    force: Float[np.ndarray, "n n_q"]
    force_units: tuple[str, ...]
    noise: Float[np.ndarray, " n_q"]
    base_parameters: tuple[BaseParameter, ...]
    by_random: float
    stopped: bool

    def as_plain(self) -> dict[str, Any]:
        """The design as plain values, its samples left out."""
        names = [c.name for c in self.channels.coordinates]
        return {
            "seconds": self.options.seconds,
            "rate": 1 / self.options.dt,
            "frequency": self.motion.frequency,
            "offset": dict(zip(names, self.motion.offset.tolist(), strict=True)),
            "sine": dict(zip(names, self.motion.sine.T.tolist(), strict=True)),
            "cosine": dict(zip(names, self.motion.cosine.T.tolist(), strict=True)),
            "margin": self.options.margin,
            "seed": self.options.seed,
            "noise": dict(zip(names, self.noise.tolist(), strict=True)),
            "random_errors_by_these": self.by_random,
            "stopped": self.stopped,
            "base_parameters": [asdict(b) for b in self.base_parameters],
        }


class DesignProgress(NamedTuple):
    """State of the search for a motion.

    Attributes:
        start: number of the random motion that it started from, from 1.
        starts: the number of these.
        iteration: steps of the search.
        gain: information by that of the first motion [nats].
    """

    start: int
    starts: int
    iteration: int
    gain: float


def prior_knowledge(system: LagrangianSystem, groups: Mapping[str, str]) -> Knowledge:
    """Knowledge about the parameters of a system by its declaration, or by a robot's file.

    Args:
        system: the system.
        groups: the groups of the record to be made, as `{"payload": "1kg"}`.

    Raises:
        InputError: a group is missing.
    """
    _require_groups(system, groups)
    parameters = expand_parameters(system, [_blank_record(system, groups)])
    space = make_search_space(system, {}, {}, parameters)
    nominal = {p.name: p.nominal for p in parameters}
    return Knowledge(space, nominal)


def fitted_knowledge(
    model: LagrangianModel, identification: Mapping[str, Any] | None, groups: Mapping[str, str]
) -> Knowledge:
    """Knowledge about the parameters of a system by a fit, and the forces that this left.

    Args:
        model: the equations of motion.
        identification: the identification, as model files have it; None where only the values are
            known, beside the priors.
        groups: the groups of the record to be made, as `{"payload": "1kg"}`.

    Raises:
        InputError: no parameter has an error, or a group is missing.
    """
    _require_groups(model.system, groups)
    values = {name: float(x) for name, x in model.values.items()}
    if identification is None:
        parameters = expand_parameters_by_values(model.system, values)
        return Knowledge(make_search_space(model.system, values, {}, parameters), values)
    with convert_errors(_PLACE, "errors that do not fit", "those of an identified system"):
        errors = {
            e["coordinate"]: max(float(e["missing"]), _LEAST_NOISE * float(e["size"]), _LEAST_NOISE)
            for e in identification.get("force_errors", ())
            if e["split"] == "train"
        }
        # a covariance by inverse dynamics has its priors in it, so all directions have errors
        shrinkage = 0.0 if errors else SHRINKAGE
        space, covariance, _ = parameter_covariance(model, identification, shrinkage)
        noise = np.array([errors[c.name] for c in model.system.coordinates]) if errors else None
    return Knowledge(space, values, covariance, noise)


def _require_groups(system: LagrangianSystem, groups: Mapping[str, str]) -> None:
    """Raises unless the groups are those by which parameters of a system differ."""
    needed = {str(p.per): p.name for p in reversed(system.grouped)}
    for per, name in needed.items():
        if per not in groups:
            raise InputError(
                _PLACE,
                f"no group '{per}', which '{name}' is per",
                "the group of the record to be made",
                f"`groups=` {{'{per}': NAME}}",
            )
    if unknown := [name for name in groups if name not in needed]:
        raise InputError(
            "`groups=`",
            f"'{unknown[0]}', which nothing in the system is per",
            f"one of {', '.join(needed)}" if needed else "no `groups=`",
        )


def require_inputs(system: LagrangianSystem) -> None:
    """Raises unless forces follow from a motion, and a system has an input for each coordinate."""
    if system.internal:
        raise InputError(
            _PLACE,
            f"the system '{system.name}' has internal states ({', '.join(system.internal)})",
            "forces by position, velocity and inputs alone",
            _RANK,
        )
    n, n_u = len(system.coordinates), len(system.inputs)
    if n_u != n:
        raise InputError(
            _PLACE,
            f"{counted(n_u, 'input')} of {counted(n, 'coordinate')} of '{system.name}'",
            "an input for each coordinate",
            _RANK,
        )


def gather_limits(
    system: LagrangianSystem,
    within: Mapping[str, tuple[float, float]],
    inputs: Mapping[str, tuple[float, float]],
    channels: Channels,
) -> DesignLimits:
    """The limits of a system: those that are given, else those of its declaration or file.

    Args:
        system: the system.
        within: limits of positions by the names of coordinates, of velocities by `NAME_dot`, of
            accelerations by `NAME_ddot`.
        inputs: limits of inputs by name.
        channels: the inputs of the records, which may have limits as well.

    Raises:
        InputError: a limit of a position, a velocity or an actuator is missing, or there is
            nothing of a name.
    """
    coordinates = system.coordinates
    names = [c.name + end for end in ("", "_dot", "_ddot") for c in coordinates]
    if unknown := [name for name in within if name not in names]:
        raise InputError("`within=`", f"no '{unknown[0]}'", f"one of {', '.join(names)}")
    if unknown := [name for name in inputs if name not in [i.name for i in system.inputs]]:
        raise InputError(
            "`limits=`",
            f"no input '{unknown[0]}'",
            f"one of {', '.join(i.name for i in system.inputs)}",
        )
    for name, (low, high) in within.items():
        if name not in names[: len(coordinates)] and not low < 0 < high:
            raise InputError(
                f"`within=` {name} = {low:g}..{high:g}",
                "one direction alone",
                "limits on both sides of 0",
            )
    bounds = [inputs.get(i.name, i.limits) for i in channels.inputs]
    limits = []
    for k, c in enumerate(coordinates):
        own = system.limits[k] if system.limits else MotionLimits()
        velocity, acceleration = (
            min(-within[c.name + end][0], within[c.name + end][1]) if c.name + end in within else x
            for end, x in (("_dot", own.velocity), ("_ddot", own.acceleration))
        )
        own = MotionLimits(within.get(c.name, own.position), velocity, acceleration, own.force)
        for what, value, name, size in (
            ("position", own.position, c.name, "(-1, 1)"),
            ("velocity", own.velocity, f"{c.name}_dot", "(-1.5, 1.5)"),
        ):
            if value is None:
                raise InputError(
                    f"system '{system.name}'",
                    f"no limits of the {what} of '{c.name}'",
                    "limits of every position and velocity",
                    f"for instance `within=` {{'{name}': {size}}}",
                )
        limits.append(own)
    return DesignLimits(tuple(limits), tuple(bounds))


def design_record(
    source: Model | LagrangianSystem,
    header: Mapping[str, Any] | None = None,
    *,
    within: Mapping[str, tuple[float, float]] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    groups: Mapping[str, str] | None = None,
    options: DesignOptions | None = None,
    on_progress: Callable[[DesignProgress], None] | None = None,
) -> RecordDesign:
    """Designs the motion of a robot that tells the most about its parameters, within limits.

    The determinant of the information matrix is maximised by L-BFGS, with penalties beyond the
    limits, from several random motions. Collisions are not considered.

    Args:
        source: the system, as `load_robot` gives it, or a model that was identified.
        header: the header of the model's file, see `read_header`. It knows the errors of the
            parameters, which the record is to make smaller.
        within: limits of positions by the names of coordinates, of velocities by `NAME_dot`, of
            accelerations by `NAME_ddot`, in SI units; by default those of the robot's file.
        limits: limits of inputs by name, in their units, beside those of the file.
        groups: the groups of the record, as `{"payload": "1kg"}`.
        options: length, harmonics, margin and search; by default `DesignOptions()` with the
            sampling period of the model.
        on_progress: called after each step of the search.

    Raises:
        InputError: a model without equations of motion, a system with internal states or without
            an input for each coordinate, missing limits, or limits that no motion keeps.
    """
    groups = groups or {}
    if isinstance(source, LagrangianSystem):
        system, channels, usual = source, source.channels, DesignOptions()
        require_inputs(system)
        knowledge = prior_knowledge(system, groups)
    else:
        mechanics = equations_of_motion(source)
        if mechanics is None:
            raise InputError(
                _PLACE, "a model without equations of motion", "an identified system or a system"
            )
        system, channels = mechanics.system, source.channels
        usual = DesignOptions(dt=source.dt)
        require_inputs(system)
        knowledge = fitted_knowledge(mechanics, (header or {}).get("identification"), groups)
    box = gather_limits(system, within or {}, limits or {}, channels)
    return _find_motion(system, knowledge, box, options or usual, groups, on_progress)


def _find_motion(
    system: LagrangianSystem,
    knowledge: Knowledge,
    limits: DesignLimits,
    options: DesignOptions,
    groups: Mapping[str, str],
    on_progress: Callable[[DesignProgress], None] | None,
) -> RecordDesign:
    """The motion of `design_record`, by what is known of the parameters and all limits."""
    require_float64(_PLACE)
    start_time = time.monotonic()
    dynamics = _Dynamics(system, knowledge, groups)
    motions = _Motions(dynamics, limits, options)
    rng = np.random.default_rng(options.seed)
    _require_actuated(system, motions, limits, rng)
    t = np.arange(round(options.seconds / options.dt) + 1) * options.dt
    judged = np.arange(_POINTS_A_PERIOD * options.harmonics) / (_POINTS_A_PERIOD * options.highest)
    every = np.union1d(judged, t[t < 1 / options.base_frequency])
    starts = [_random_motion(system, motions, every, rng) for _ in range(options.starts)]
    noise = _choose_noise(knowledge, options, motions, starts, judged)
    count = compared_samples(options.seconds, cutoff_for(options.highest, options.dt))
    prior_information = _information(knowledge, dynamics)
    problem = _Problem(motions, prior_information, count / len(judged) / noise**2, judged)
    by_start = [problem.information(x) for x in starts]
    first = by_start[0][0]
    results, stopped = [], False
    for k, x in enumerate(starts):
        remaining = np.inf
        if options.budget is not None:
            remaining = start_time + options.budget - time.monotonic()
        deadline = time.monotonic() + remaining / (options.starts - k)

        def on_step(iteration: int, cost: float, k: int = k) -> None:
            if on_progress is not None:
                on_progress(DesignProgress(k + 1, options.starts, iteration, -cost - first))

        solution, is_late = _search(problem, x, options.iterations, deadline, on_step)
        reached = motions.shrink(solution, every)
        results.append(x if reached is None else reached)
        stopped = stopped or is_late
    by_result = [problem.information(x) for x in results]
    best = int(np.argmax([logarithm for logarithm, _ in by_result]))
    combinations = _find_combinations(motions, noise, rng)
    factors = combinations.factors
    file = _errors(factors, dynamics.prior_information)
    before = None if knowledge.covariance is None else _errors(factors, prior_information)
    expected = _errors(factors, by_result[best][1])
    ratios = [
        np.exp(np.mean(np.log(_errors(factors, matrix) / expected))) for _, matrix in by_start
    ]
    q, v, a, u, force = np.split(motions.along(results[best], t), 5, axis=1)
    return RecordDesign(
        replace(system.channels, dt=options.dt),
        options,
        limits,
        motions.motion(results[best]),
        t,
        q,
        v,
        a,
        u,
        force,
        tuple(map(system.force_unit, system.coordinates)),
        noise,
        _base_parameters(dynamics, combinations, file, before, expected),
        float(np.median(ratios)),
        stopped,
    )


class _Dynamics:
    """Forces along motions, and their derivatives by the parameters.

    Args:
        system: the system.
        knowledge: values and free parameters.
        groups: the groups of the record.

    Attributes:
        space: the free parameters.
        prior: their priors.
        selection: from derivatives by the parameters of the equations to those by the free ones, in
            standard deviations of their priors, (n_e, n_p).
        units: a standard deviation of each prior, in the parameter's own unit, (n_p,).
        prior_information: information of the priors, in their standard deviations, (n_p, n_p).
    """

    def __init__(
        self, system: LagrangianSystem, knowledge: Knowledge, groups: Mapping[str, str]
    ) -> None:
        self.space, values = knowledge.space, knowledge.values
        self._equations = system_equations(system, self.space.names)
        parameters = expand_parameters_by_values(system, values)
        indices = group_indices(system, parameters, [_blank_record(system, groups)])
        self._row = self._equations.parameter_rows(values, indices)[0]
        self._n, self._n_u = len(system.coordinates), len(system.inputs)
        self._missing = missing_forces(self._equations)
        self._actuators = self._actuator_formula(system)
        vector = self.space.to_vector(values)
        self.prior = Prior(self.space)
        chain = self._equations.coordinate_derivatives(self.space, vector, indices)[0]
        scale = chain * self.prior.spread
        self.selection = np.zeros((self._equations.n_p, len(scale)))
        self.selection[self._equations.free_columns(self.space), range(len(scale))] = scale
        self.units = self.space.derivatives(vector) * self.prior.spread
        spread = self.prior.spread
        self.prior_information = self.prior.at(self.prior.centre)[2] * np.outer(spread, spread)

    def _actuator_formula(self, system: LagrangianSystem) -> Formula:
        """Forces of the inputs at 0, and derivatives by the inputs, by q, v and parameters."""
        n, equations = self._n, self._equations

        def actuators(point: Array) -> Array:
            values = equations.values_in_row(point[2 * n :])

            def force(u: Array) -> Array:
                if system.input_map is None:
                    return jnp.zeros_like(point[:n])
                return jnp.asarray(system.input_map(point[:n], point[n : 2 * n], u, values))

            none = jnp.zeros(len(system.inputs), point.dtype)
            return jnp.concatenate([force(none), jax.jacfwd(force)(none).ravel()])

        where = f"system '{system.name}'"
        return Formula(actuators, 2 * n + equations.n_columns, range(0), where)

    def actuators_at(
        self, points: Float[np.ndarray, "n n_m"]
    ) -> tuple[Float[np.ndarray, "n n_q"], Float[np.ndarray, "n n_q n_u"]]:
        """Forces of the inputs at 0, (n, n_q), and by the inputs, (n, n_q, n_u)."""
        rows = np.broadcast_to(self._row, (len(points), len(self._row)))
        values = evaluate(self._actuators, np.concatenate([points[:, : 2 * self._n], rows], axis=1))
        return values[:, : self._n], values[:, self._n :].reshape(-1, self._n, self._n_u)

    def actuation(self, points: Float[np.ndarray, "n n_m"]) -> Float[np.ndarray, "n n_f"]:
        """Inputs that a motion needs, and the actuators' forces with them, (n, n_u + n_q)."""
        without = evaluate(self._missing, self._with_inputs(points, np.zeros((1, self._n_u))))
        offset, gains = self.actuators_at(points)
        u = np.linalg.solve(gains, without[:, :, None])[:, :, 0]
        return np.concatenate([u, without + offset], axis=1)

    def _with_inputs(
        self, points: Float[np.ndarray, "n n_m"], u: Float[np.ndarray, "_ n_u"]
    ) -> Float[np.ndarray, "n n_in"]:
        n = len(points)
        rows = np.broadcast_to(self._row, (n, len(self._row)))
        return np.concatenate([points, np.broadcast_to(u, (n, self._n_u)), rows], axis=1)

    def remainder(self, points: Float[np.ndarray, "n n_m"]) -> Float[np.ndarray, "n n_q"]:
        """Forces that are missing with these inputs: 0 where the inputs act linearly."""
        u = self.actuation(points)[:, : self._n_u]
        return evaluate(self._missing, self._with_inputs(points, u))

    def slopes(
        self, points: Float[np.ndarray, "n n_m"], u: Float[np.ndarray, "n n_u"]
    ) -> Float[np.ndarray, "n n_q n_e"]:
        """Derivatives of forces by the parameters of the equations, see `selection`."""
        rows = evaluate(self._missing, self._with_inputs(points, u), derivatives=True)
        return rows.reshape(len(points), self._n, -1)


class _Motions:
    """Motions as vectors: the offset and the size of each shape, by coordinate.

    Limits of points and of actuation are one box, less a margin.

    Args:
        dynamics: the dynamics.
        limits: the limits, by which vectors are about 1.
        options: harmonics, base frequency, and the share of each limit that is kept free.

    Attributes:
        dynamics: the dynamics.
        count: number of rows of a vector.
        middle: middle of the positions, (n_q,).
        sizes: half of the ranges of position, velocity and acceleration, (3, n_q); acceleration
            by the limit, or what the highest harmonic has at the largest velocity.
        half: half of the box, (5 n_q,).
    """

    def __init__(self, dynamics: _Dynamics, limits: DesignLimits, options: DesignOptions) -> None:
        position, velocity, acceleration, force = (
            [getattr(own, name) for own in limits.motion]
            for name in ("position", "velocity", "acceleration", "force")
        )
        both_ways = [
            [None if x is None else (-x, x) for x in ends]
            for ends in (velocity, acceleration, force)
        ]
        ranges = [*position, *both_ways[0], *both_ways[1], *limits.inputs, *both_ways[2]]
        self._box_middle = np.array([np.mean(ends) if ends else 0.0 for ends in ranges])
        sizes = np.array([np.ptp(ends) if ends else np.inf for ends in ranges])
        self.half = (1 - options.margin) * sizes / 2
        n, usual = len(position), 2 * np.pi * options.highest * np.array(velocity)
        self.middle, (size, speed, most) = self._box_middle[:n], np.split(sizes[: 3 * n] / 2, 3)
        self.sizes = np.stack([size, speed, np.where(np.isfinite(most), most, usual)])
        self.dynamics, self._options = dynamics, options
        self._shapes = motions_from_rest(options.harmonics, options.base_frequency)
        self.count = 1 + len(self._shapes)

    def motion(self, x: Float[np.ndarray, "count n_q"]) -> FourierMotion:
        """The motion of a vector."""
        offset = self.middle + self.sizes[0] * x[0]
        sine, cosine = np.split(self._shapes.T @ (x[1:] * self.sizes[1]), 2)
        return FourierMotion(self._options.base_frequency, offset, sine, cosine)

    def points(
        self, x: Float[np.ndarray, "count n_q"], t: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n n_m"]:
        """Positions, velocities and accelerations of a vector at times, (n, 3 n_q)."""
        return np.concatenate(self.motion(x).sample(t), axis=1)

    def along(
        self, x: Float[np.ndarray, "count n_q"], t: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n m"]:
        """Points of a vector at times, and the actuation that they need, (n, 5 n_q)."""
        points = self.points(x, t)
        return np.concatenate([points, self.dynamics.actuation(points)], axis=1)

    def shares(self, values: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
        """Points and actuation by the limits: within -1 and 1 where they are kept."""
        return (values - self._box_middle) / self.half

    def shrink(
        self, x: Float[np.ndarray, "count n_q"], t: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "count n_q"] | None:
        """A motion made smaller until it keeps the limits at all times; None if its pose cannot."""

        def scaled(size: float) -> Float[np.ndarray, "count n_q"]:
            return np.concatenate([x[:1], size * x[1:]])

        def is_within(size: float) -> bool:
            return bool((np.abs(self.shares(self.along(scaled(size), t))) <= 1).all())

        if is_within(1.0):
            return x
        if not is_within(0.0):
            return None
        low, high = 0.0, 1.0
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (middle, high) if is_within(middle) else (low, middle)
        return scaled(low)

    def gradient(
        self, by_points: Float[np.ndarray, "n n_m"], t: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "count n_q"]:
        """Derivatives by the vector, from those by the points at times."""
        sine, cosine = harmonics(self._options.harmonics, self._options.base_frequency, t)
        values = np.concatenate([sine, cosine], axis=2) @ self._shapes.T  # (3, n, shapes)
        parts = np.stack(np.split(by_points, 3, axis=1))
        shapes = np.einsum("dns,dnq->sq", values, parts) * self.sizes[1]
        return np.concatenate([(parts[0].sum(axis=0) * self.sizes[0])[None], shapes])

    def random_points(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n n_m"]:
        """Random positions, velocities and accelerations within limits, (n, 3 n_q)."""
        points = rng.uniform(-1, 1, (count, *self.sizes.shape)) * self.sizes
        points[:, 0] += self.middle
        return points.reshape(count, -1)


class _Problem:
    """The search for a motion: information, and how far limits are exceeded.

    Args:
        motions: the motions, with their dynamics and limits.
        prior_information: information before the record, in standard deviations of the priors,
            (n_p, n_p).
        weights: weight of a squared force of each coordinate at a point, (n_q,).
        t: times at which motions are judged [s], (n,).
    """

    def __init__(
        self,
        motions: _Motions,
        prior_information: Float[np.ndarray, "n_p n_p"],
        weights: Float[np.ndarray, " n_q"],
        t: Float[np.ndarray, " n"],
    ) -> None:
        self._motions, self._dynamics = motions, motions.dynamics
        self._prior_information = prior_information
        self._weights, self._t, self._n = weights, t, len(weights)
        # derivatives are differences over a share of the limits of a motion
        self._steps = 1e-5 * motions.sizes.ravel()

    def information(
        self, x: Float[np.ndarray, "count n_q"]
    ) -> tuple[float, Float[np.ndarray, "n_p n_p"]]:
        """Half the logarithm of the determinant of the information of a motion, and the matrix."""
        points = self._motions.points(x, self._t)
        u = self._dynamics.actuation(points)[:, : self._n]
        matrix = self._matrix(self._dynamics.slopes(points, u) @ self._dynamics.selection)
        return float(np.linalg.slogdet(matrix)[1]) / 2, matrix

    def _matrix(self, slopes: Float[np.ndarray, "n n_q n_p"]) -> Float[np.ndarray, "n_p n_p"]:
        rows = (slopes * np.sqrt(self._weights)[:, None]).reshape(-1, slopes.shape[2])
        return self._prior_information + rows.T @ rows

    def cost(
        self, x: Float[np.ndarray, "count n_q"], penalty: float
    ) -> tuple[float, Float[np.ndarray, " size"]]:
        """The cost of a motion and its derivatives: the penalty less the information.

        Derivatives by the points are central differences, for a point costs a microsecond.
        """
        points = self._motions.points(x, self._t)
        n, n_m = points.shape
        moved = points[:, None] + np.concatenate([np.diag(self._steps), -np.diag(self._steps)])
        everywhere = np.concatenate([points, moved.reshape(-1, n_m)])
        actuation = self._dynamics.actuation(everywhere)
        slopes = self._dynamics.slopes(everywhere, actuation[:, : self._n])
        selection = self._dynamics.selection
        own = slopes[:n] @ selection
        matrix = self._matrix(own)
        _, logarithm = np.linalg.slogdet(matrix)
        shares = self._motions.shares(np.concatenate([points, actuation[:n]], axis=1))
        beyond = np.maximum(np.abs(shares) - 1, 0.0)
        cost = penalty * float(np.sum(beyond**2)) - float(logarithm) / 2
        # derivatives of the information by the derivatives of forces, of the cost by limits
        weighted = (own * self._weights[:, None]) @ np.linalg.inv(matrix) @ selection.T
        by_share = 2 * penalty * beyond * np.sign(shares) / self._motions.half
        along = np.einsum(
            "nqe,nkqe->nk",
            weighted,
            slopes[n:].reshape(n, 2 * n_m, *slopes.shape[1:]),
            optimize=True,
        )
        changed = actuation[n:].reshape(n, 2 * n_m, -1)
        limited = np.einsum("nf,nkf->nk", by_share[:, n_m:], changed)
        both = limited - along
        by_points = (both[:, :n_m] - both[:, n_m:]) / (2 * self._steps) + by_share[:, :n_m]
        return cost, self._motions.gradient(by_points, self._t).ravel()


def _blank_record(system: LagrangianSystem, groups: Mapping[str, str]) -> Any:
    """A record of some groups, without a motion."""
    return from_arrays(
        np.zeros((2, len(system.coordinates))),
        np.zeros((2, len(system.inputs))),
        dt=1.0,
        coordinates=system.coordinates,
        inputs=system.inputs,
        name="to be made",
        groups=groups,
    )


def _require_actuated(
    system: LagrangianSystem, motions: _Motions, limits: DesignLimits, rng: np.random.Generator
) -> None:
    """Raises unless inputs drive all coordinates, each by itself, and all of them have limits."""
    n, dynamics = len(system.coordinates), motions.dynamics
    _, gains = dynamics.actuators_at(motions.random_points(8, rng))
    sizes = np.abs(gains).max(axis=0)
    is_regular = np.isfinite(gains).all() and (sizes.max(axis=0) > 0).all()
    if not is_regular or (np.linalg.cond(gains / sizes.max(axis=0)) > 1 / _NULL).any():
        raise InputError(
            _PLACE,
            f"the inputs of '{system.name}' do not drive every coordinate",
            "an input for each coordinate",
            _RANK,
        )
    points = motions.random_points(8, rng)
    forces = dynamics.actuation(points)[:, n:]
    if np.abs(dynamics.remainder(points)).max() > _NULL * np.abs(forces).max():
        raise InputError(
            _PLACE,
            f"an input of '{system.name}' that does not act linearly",
            "forces that are linear in the inputs",
            _RANK,
        )
    for i, channel in enumerate(system.inputs):
        k = int(np.argmax(sizes[:, i]))
        if limits.inputs[i] is None and limits.motion[k].force is None:
            raise InputError(
                f"system '{system.name}'",
                f"no limits of the input '{channel.name}' at '{system.coordinates[k].name}'",
                "limits of every input",
                f"for instance `limits=` {channel.name}=-10:10",
            )


def _random_motion(
    system: LagrangianSystem,
    motions: _Motions,
    t: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "count n_q"]:
    """A random motion about a random pose, as large as the limits allow.

    Raises:
        InputError: no pose is within the limits of the actuators.
    """
    n = len(system.coordinates)
    nearest = np.full(len(motions.half), np.inf)  # of poses: by how much limits are exceeded
    for _ in range(200):  # random motions
        x = rng.normal(size=(motions.count, n))
        x[0] = rng.uniform(-0.5, 0.5, n)
        x[1:] *= 4.0  # larger than any limit allows
        motion = motions.shrink(x, t)
        if motion is not None:
            return motion
        x[1:] = 0.0
        shares = np.abs(motions.shares(motions.along(x, t[:1]))[0])
        if shares.max() < nearest.max():
            nearest = shares
    k = int(np.argmax(nearest))
    what, name = _DIRECTIONS[k // n], system.coordinates[k % n].name
    name = system.inputs[k % n].name if what == "input" else name
    raise InputError(
        f"system '{system.name}'",
        f"no pose within the limits: it needs {nearest[k]:.3g} times "
        f"the {what} limit of '{name}' at rest",
        "poses that actuators can hold",
        "check the limits, or give others by `within=` and `limits=`",
    )


def _search(
    problem: _Problem,
    x: Float[np.ndarray, "count n_q"],
    iterations: int,
    deadline: float,
    on_step: Callable[[int, float], None],
) -> tuple[Float[np.ndarray, "count n_q"], bool]:
    """The motion that a search ends at, and whether the time ended before.

    Args:
        problem: the problem.
        x: the motion that it starts from.
        iterations: steps of each stage, at most.
        deadline: when it has to end, by the monotonic clock [s].
        on_step: called after each step with its number and the cost.
    """
    import scipy.optimize

    steps, vector = 0, x.ravel()

    def step(intermediate_result: Any) -> None:
        nonlocal steps
        steps += 1
        on_step(steps, float(intermediate_result.fun))
        if time.monotonic() > deadline:
            raise StopIteration

    # of squares of what is beyond the limits, one stage each
    for penalty in (1e2, 1e4) if iterations else ():
        vector = scipy.optimize.minimize(
            lambda y, penalty=penalty: problem.cost(y.reshape(x.shape), penalty),
            vector,
            method="L-BFGS-B",
            jac=True,
            callback=step,
            options={"maxiter": iterations},
        ).x
        if time.monotonic() > deadline:
            return vector.reshape(x.shape), True
    return vector.reshape(x.shape), False


def _choose_noise(
    knowledge: Knowledge,
    options: DesignOptions,
    motions: _Motions,
    starts: Sequence[Float[np.ndarray, "count n_q"]],
    t: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n_q"]:
    """The missing force of each coordinate: what a fit has left, or a share of that of motions."""
    if options.noise is None and knowledge.noise is not None:
        return knowledge.noise
    force = [motions.along(x, t)[:, -len(motions.middle) :] for x in starts]
    size = np.sqrt(np.mean(np.concatenate(force) ** 2, axis=0))
    # without a fit 2 % of the force of a motion
    return (options.noise or 0.02) * np.maximum(size, 1e-6 * size.max() + 1e-12)


def _information(knowledge: Knowledge, dynamics: _Dynamics) -> Float[np.ndarray, "n_p n_p"]:
    """Information before the record, in standard deviations of the priors."""
    if knowledge.covariance is None:
        return dynamics.prior_information
    covariance = knowledge.covariance / np.outer(dynamics.prior.spread, dynamics.prior.spread)
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    return (axes / np.maximum(values, 1e-14 * values[-1])) @ axes.T


def _find_combinations(
    motions: _Motions, noise: Float[np.ndarray, " n_q"], rng: np.random.Generator
) -> Combinations:
    """The base parameters by the parameters, in standard deviations of their priors."""
    points, dynamics = motions.random_points(300, rng), motions.dynamics
    u = dynamics.actuation(points)[:, : len(noise)]
    slopes = dynamics.slopes(points, u) @ dynamics.selection
    rows = (slopes / noise[:, None]).reshape(-1, len(dynamics.units))
    return find_combinations(rows, np.ones(len(dynamics.units)), order_of(dynamics.space.names))


def _errors(
    combinations: Float[np.ndarray, "n_b n_p"], information: Float[np.ndarray, "n_p n_p"]
) -> Float[np.ndarray, " n_b"]:
    """Standard errors of base parameters, in standard deviations of the priors."""
    covariance = np.linalg.inv(information)
    return np.sqrt(np.einsum("bp,pk,bk->b", combinations, covariance, combinations, optimize=True))


def _base_parameters(
    dynamics: _Dynamics,
    combinations: Combinations,
    file: Float[np.ndarray, " n_b"],
    known: Float[np.ndarray, " n_b"] | None,
    expected: Float[np.ndarray, " n_b"],
) -> tuple[BaseParameter, ...]:
    """The base parameters with their errors, the best determined one first."""
    names, parameters = dynamics.space.names, []
    for b, (i, row) in enumerate(zip(combinations.pivots, combinations.factors, strict=True)):
        unit = dynamics.units[i]
        terms = {
            names[j]: float(row[j] * unit / dynamics.units[j])
            for j in combinations.terms(b, np.ones(len(row)))
        }
        parameters.append(
            BaseParameter(
                names[i],
                dynamics.space.free_parameters[i].unit,
                terms,
                float(unit * file[b]),
                None if known is None else float(unit * known[b]),
                float(unit * expected[b]),
            )
        )
    return tuple(sorted(parameters, key=lambda parameter: parameter.remaining))
