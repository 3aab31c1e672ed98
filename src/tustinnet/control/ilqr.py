"""Trajectories planned on a model by iterative LQR."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import ArrayLike

from tustinnet.control.cost import Cost
from tustinnet.control.dynamics import (
    ControlledModel,
    InputLimits,
    Limits,
    controlled,
    input_limits,
    require_known,
)
from tustinnet.control.lqr import Holding, gains_along, hold
from tustinnet.control.plan import Plan
from tustinnet.control.reference import checked_reference
from tustinnet.control.riccati import Policy, backward_pass
from tustinnet.control.weights import Deviations, Weights, bryson_weights
from tustinnet.engine.engines import simulate
from tustinnet.engine.equations import Equations
from tustinnet.engine.runs import Runs
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.simulate.filtering import checked_vector
from tustinnet.simulate.range import Range

SHARES = (1.0, 0.5, 0.2, 0.05)  # of the change of the inputs, that are tried
_FARTHEST = 1.5 * np.pi  # rad, of a goal from a start


class PlanSearch(NamedTuple):
    """Settings of the search for a plan.

    All are set by hand, not measured.

    Attributes:
        accepted: share of the expected decrease of the cost that has to come.
        converged: expected decrease of the cost, as a share of it, below which the search
            ends.
        stronger: factor of the damping after a step that is no better.
        weaker: divisor of the damping after a step that is better.
        least_damping: smallest damping but 0, as a share of the weights of the inputs.
        most_damping: largest damping, as a share of these.
        penalty: weight of a deviation beyond a limit, by its own weight.
        earlier: shifts in time that are tried side by side.
        every: iterations from one trial of them to the next.
        first_iterations: iterations of every guess.
        finished: guesses, the best so far, that are gone on with.
        correlated: time for which random inputs of a first guess last [s].
        amplitude: range of these inputs, as a share of their limits' range.
        holding: share of the limits of inputs, up to which feedback about a goal that is
            reached needs them.
    """

    accepted: float = 1e-4
    converged: float = 1e-7
    stronger: float = 8.0
    weaker: float = 4.0
    least_damping: float = 1e-6
    most_damping: float = 1e8
    penalty: float = 1e4
    earlier: int = 8
    every: int = 4
    first_iterations: int = 20
    finished: int = 3
    correlated: float = 0.3
    amplitude: float = 0.3
    holding: float = 0.5


PLANNING = PlanSearch()


class Motion(NamedTuple):
    """A motion of a controlled model, and its cost.

    Attributes:
        z: states, (N + 1, n_z).
        u: commands, (N, n_u).
        cost: its cost.
    """

    z: Float[np.ndarray, "samples n_z"]
    u: Float[np.ndarray, "N n_u"]
    cost: float


@dataclass
class Solver:
    """Iterative LQR on a model with a cost; a plan and predictive control share it.

    Attributes:
        system: the model.
        limits: limits of the inputs.
        cost: the cost.
    """

    system: ControlledModel
    limits: InputLimits
    cost: Cost

    def __post_init__(self) -> None:
        self._equations = closed_loop_equations(self.system)

    def roll_out(
        self,
        start: Float[np.ndarray, " n_z"],
        reference: Motion,
        policy: Policy,
        shares: Float[np.ndarray, " runs"],
        earlier: Int[np.ndarray, " runs"] | None = None,
    ) -> Motion:
        """The best of some motions from a start, by feedback about a reference.

        Args:
            start: the state at the beginning, (n_z,).
            reference: the motion about which the feedback is.
            policy: the feedback, and changes of the inputs.
            shares: of these changes, a motion for each.
            earlier: by how many samples each motion is ahead of the reference, whose end is held
                then; by default 0.
        """
        count, n_u = policy.feedforward.shape
        runs = len(shares)
        first = np.zeros(runs, int) if earlier is None else earlier
        rows = np.concatenate(
            [reference.u, policy.feedforward, policy.gain.reshape(count, -1), reference.z[:-1]],
            axis=1,
        )
        longest_lead = int(first.max())
        drive = np.zeros((count + longest_lead + 1, 1, rows.shape[1]))
        drive[:count, 0], drive[count:, 0] = rows, rows[-1]
        parameters = np.empty((runs, 1 + 2 * n_u))
        parameters[:, 0], parameters[:, 1:] = shares, np.concatenate(self.limits)
        states = simulate(
            self._equations,
            Runs(
                start=np.tile(start, (runs, 1)),
                parameters=parameters,
                steps=np.full(runs, count),
                first=first,
                drive=drive,
                periods=np.ones(len(drive)),
            ),
        ).reshape(runs, count + 1, -1)
        at = np.minimum(np.arange(count) + first[:, None], count - 1)
        with np.errstate(invalid="ignore", over="ignore"):
            errors = states[:, :-1] - reference.z[at]
            u = reference.u[at] + shares[:, None, None] * policy.feedforward[at]
            u = self.limits.clip(u + np.matmul(policy.gain[at], errors[..., None])[..., 0])
            cost = self.cost.total(states, u)
        best = int(np.argmin(cost))
        return Motion(states[best], u[best], float(cost[best]))

    def without_feedback(self, steps: int) -> Policy:
        """The policy that keeps the inputs of a reference."""
        n_z, n_u = self.system.size, self.system.n_u
        return Policy(np.zeros((steps, n_u)), np.zeros((steps, n_u, n_z)), 0.0, 0.0)

    def begin(self, start: Float[np.ndarray, " n_z"], u: Float[np.ndarray, "N n_u"]) -> Motion:
        """The motion from a start under some inputs."""
        still = Motion(np.zeros((len(u) + 1, self.system.size)), u, np.inf)
        return self.roll_out(start, still, self.without_feedback(len(u)), np.ones(1))

    def policy(self, motion: Motion, damping: float) -> Policy:
        """The policy that improves a motion, to second order."""
        derivatives = self.system.derivatives(motion.z[:-1], motion.u)
        expansion = self.cost.expand(motion.z, motion.u)
        room = self.limits.lower - motion.u, self.limits.upper - motion.u
        return backward_pass(derivatives, expansion, room, damping * self.cost.inputs)

    def improve(self, motion: Motion, policy: Policy) -> Motion | None:
        """The motion after a line search, None where none is better enough."""
        better = self.roll_out(motion.z[0], motion, policy, np.array(SHARES))
        most = PLANNING.accepted * policy.expected
        return better if better.cost - motion.cost <= most < 0 else None

    def begin_earlier(self, motion: Motion, policy: Policy) -> Motion | None:
        """The motion that leaves out a part of its beginning, None where that is no better.

        Steps along the gradient move a motion that waits at its beginning by a sample each.
        """
        earlier = 2 ** np.arange(int(np.log2(len(motion.u))) + 1)[: PLANNING.earlier]
        kept = policy._replace(feedforward=np.zeros_like(policy.feedforward))
        better = self.roll_out(motion.z[0], motion, kept, np.zeros(len(earlier)), earlier)
        return better if better.cost < motion.cost + policy.expected else None

    def minimise(self, motion: Motion, most: int) -> tuple[Motion, bool, int]:
        """The motion of least cost near a first one, whether that is a minimum, and iterations."""
        damping, iterations = 0.0, 0
        if not np.isfinite(motion.cost):
            return motion, False, 0
        while iterations < most:
            policy = self.policy(motion, damping)
            if not np.isfinite(policy.expected):
                return motion, False, iterations
            small = -policy.expected <= PLANNING.converged * abs(motion.cost)
            if small and damping <= PLANNING.weaker * PLANNING.least_damping:
                return motion, True, iterations
            better = self.improve(motion, policy)
            if iterations % PLANNING.every == 0:
                better = self.begin_earlier(better or motion, policy) or better
            motion, iterations = better or motion, iterations + 1
            if better is None and damping >= PLANNING.most_damping:
                return motion, small, iterations  # rounding is all that is left
            damping = next_damping(damping, is_better=better is not None)
        return motion, False, iterations


def next_damping(damping: float, *, is_better: bool) -> float:
    """The damping of the next iteration: less after a better motion, more where there was none."""
    if is_better:
        return damping / PLANNING.weaker if damping > PLANNING.least_damping else 0.0
    return min(max(damping * PLANNING.stronger, PLANNING.least_damping), PLANNING.most_damping)


def closed_loop_equations(system: ControlledModel) -> Equations:
    """The model with feedback about a reference, as one step for the engine.

    Its inputs are reference inputs, feedforward, gain and reference state; its parameters the share
    of the feedforward, lower and upper limits.
    """
    n_z, n_u = system.size, system.n_u

    def step(z: Array, row: Array, none: Array, parameters: Array) -> Array:
        u, feedforward = row[:n_u], row[n_u : 2 * n_u]
        gain = row[2 * n_u : 2 * n_u + n_u * n_z].reshape(n_u, n_z)
        share, lower, upper = parameters[0], parameters[1 : 1 + n_u], parameters[1 + n_u :]
        error = z - row[2 * n_u + n_u * n_z :]
        command = u + share * feedforward + gain @ error
        return system.function(z, jnp.minimum(jnp.maximum(command, lower), upper))

    return Equations(
        step,
        n_x=n_z,
        n_u=2 * n_u + n_u * n_z + n_z,
        n_c=1 + 2 * n_u,
        continuous=False,
        where=system.where,
    )


def ilqr(
    model: Model,
    start: ArrayLike,
    goal: ArrayLike,
    steps: int,
    *,
    goal_inputs: ArrayLike | None = None,
    deviations: Deviations | None = None,
    range: Range | None = None,
    within: Limits | None = None,
    limits: Limits | None = None,
    end_weight: float = 100.0,
    guesses: Sequence[ArrayLike | Plan] | int = 4,
    turns: bool = True,
    delay: int = 0,
    iterations: int = 300,
    seed: int = 0,
) -> Plan:
    """A motion from a start to a goal, planned by iterative LQR under the limits of the inputs.

    It minimises the sum of squared errors from the goal and of inputs, each divided by its
    acceptable deviation, and at the end the cost of holding the goal ever after by linear feedback.
    Second derivatives are those of Gauss and Newton. The plan is the cheapest of those found from
    several first guesses: inputs of the goal, and random ones.

    Args:
        model: a model that steps from sample to sample.
        start: the state to begin in, (n_x,).
        goal: the state to end in, (n_x,), an equilibrium.
        steps: number of steps, N.
        goal_inputs: the inputs that hold the goal, (n_u,); 0 by default.
        deviations: acceptable deviations of states and inputs by name, as in `lqr`.
        range: the range of the training records.
        within: limits of states by name, `{"theta": (-2, 2)}`; what is beyond costs ten
            thousand times the weight of the state, or of half of this range where that is more.
        limits: limits of inputs by name, instead of those that the model declares.
        end_weight: factor of the end's cost, so that the goal is reached rather than approached.
        guesses: first guesses: inputs, (steps, n_u), or plans from other starts to this goal, which
            feedback follows; or how many are made.
        turns: whether angles may arrive at the goal by whole turns, where the model is the same.
        delay: samples from when an input is computed to when it acts.
        iterations: the most, for each guess.
        seed: of random guesses.

    Returns:
        The plan. `converged` says whether the search came to an end, `reached` whether the motion
        ends so near to the goal that feedback holds it, `miss` how far from it.

    Raises:
        InputError: an input without limits, other shapes, names that the model does not have, a
            goal that no feedback can hold, a model that diverges under every guess.

    References:
        Tassa, Mansard and Todorov (2014), Control-limited differential dynamic programming, ICRA.
    """
    if steps < 1 or iterations < 1:
        raise InputError("ilqr", f"{steps} steps, {iterations} iterations", "at least 1 of each")
    system, bounds = controlled(model, delay), input_limits(model, limits)
    x0 = checked_vector("start", start, system.n_x, "ilqr")
    x_end = checked_vector("goal", goal, system.n_x, "ilqr")
    u_end = np.zeros(system.n_u) if goal_inputs is None else goal_inputs
    u_end = bounds.clip(checked_vector("goal_inputs", u_end, system.n_u, "ilqr"))
    cost, holding = make_cost(
        system,
        bounds,
        x_end,
        u_end,
        deviations=deviations,
        range=range,
        within=within,
        end_weight=end_weight,
    )
    before = bounds.clip(np.zeros(system.n_u))
    first = system.augment(x0, before)
    targets = _targets(system, x0, x_end) if turns else [x_end]
    solvers = [Solver(system, bounds, replace(cost, x=target)) for target in targets]
    first_searches = [
        (solver, *solver.minimise(motion, min(iterations, PLANNING.first_iterations)))
        for solver, motion in _first_motions(solvers, first, guesses, steps, seed)
    ]
    finite = [search for search in first_searches if np.isfinite(search[1].cost)]
    if not finite:
        raise InputError(
            "ilqr",
            f"{system.where} diverges under every first guess",
            "a motion to begin with",
            "plan fewer steps, or give guesses",
        )
    finite.sort(key=lambda search: search[1].cost)
    plans: list[Plan] = []
    for solver, motion, is_converged, count in finite:
        if not is_converged and count < iterations:
            motion, is_converged, more = solver.minimise(motion, iterations - count)
            count += more
        plans.append(_make_plan(solver, motion, is_converged, count, holding, before))
        if len(plans) >= PLANNING.finished and any(p.reached and p.converged for p in plans):
            break
    return min(plans, key=lambda plan: (not plan.reached, not plan.converged, plan.cost))


def follow(
    model: Model,
    reference: ArrayLike,
    *,
    goal_inputs: ArrayLike | None = None,
    deviations: Deviations | None = None,
    range: Range | None = None,
    within: Limits | None = None,
    limits: Limits | None = None,
    delay: int = 0,
    iterations: int = 300,
) -> Plan:
    """The motion nearest to a reference that a model can do under the limits of its inputs.

    It minimises the sum of squared errors from the reference and of inputs, each divided by its
    acceptable deviation, as `ilqr` does for a goal.

    Args:
        model: a model that steps from sample to sample.
        reference: a state for each sample, (N + 1, n_x); the last is an equilibrium.
        goal_inputs: the inputs that hold the last one, (n_u,); 0 by default.
        deviations: acceptable deviations of states and inputs by name, as in `lqr`.
        range: the range of the training records.
        within: limits of states by name, as in `ilqr`.
        limits: limits of inputs by name, instead of those that the model declares.
        delay: samples from when an input is computed to when it acts.
        iterations: the most.

    Raises:
        InputError: another shape, an input without limits, names that the model does not have, an
            end that no feedback can hold, a model that diverges along the reference.
    """
    system, bounds = controlled(model, delay), input_limits(model, limits)
    x = checked_reference(reference, system.n_x, "follow")
    u_end = np.zeros(system.n_u) if goal_inputs is None else goal_inputs
    u_end = bounds.clip(checked_vector("goal_inputs", u_end, system.n_u, "follow"))
    cost, holding = make_cost(
        system, bounds, x[-1], u_end, deviations=deviations, range=range, within=within
    )
    solver, before = Solver(system, bounds, replace(cost, x=x)), bounds.clip(np.zeros(system.n_u))
    first, u = system.augment(x[0], before), np.tile(u_end, (len(x) - 1, 1))
    along = Plan(x, u, np.inf, False, False, 0, system.dt, x[-1], before, delay)
    motion = min(
        (solver.begin(first, u), _follow(solver, first, along)), key=lambda motion: motion.cost
    )
    if not np.isfinite(motion.cost):
        raise InputError(
            "follow",
            f"{system.where} diverges along the reference",
            "one that it can follow",
            "a slower one",
        )
    motion, is_converged, count = solver.minimise(motion, iterations)
    return _make_plan(solver, motion, is_converged, count, holding, before)


def _make_plan(
    solver: Solver,
    motion: Motion,
    is_converged: bool,
    iterations: int,
    holding: Holding,
    before: Float[np.ndarray, " n_u"],
) -> Plan:
    """The plan of a motion that a solver came to; `holding` is the feedback about its goal."""
    return Plan(
        x=motion.z[:, : solver.system.n_x],
        u=motion.u,
        cost=motion.cost,
        converged=is_converged,
        reached=_is_held(holding.gain, motion.z[-1], solver.cost, solver.limits),
        iterations=iterations,
        dt=solver.system.dt,
        goal=solver.cost.goal,
        before=before,
        delay=solver.system.delay,
    )


def _is_held(
    gain: Float[np.ndarray, "n_u n_z"],
    end: Float[np.ndarray, " n_z"],
    cost: Cost,
    limits: InputLimits,
) -> bool:
    """Whether feedback about the goal would need no more than a part of the inputs' limits."""
    needed = np.abs(gain @ cost.end_error(end))
    room = np.minimum(limits.upper - cost.u, cost.u - limits.lower)
    return bool(np.all(needed <= PLANNING.holding * np.maximum(room, 0.0)))


def make_cost(
    system: ControlledModel,
    limits: InputLimits,
    x: Float[np.ndarray, " n_x"],
    u: Float[np.ndarray, " n_u"],
    *,
    deviations: Deviations | None,
    range: Range | None,
    within: Limits | None,
    end_weight: float = 1.0,
) -> tuple[Cost, Holding]:
    """The cost of motions to a goal, and the feedback that holds it.

    The end costs what this feedback needs to hold the goal ever after.

    Args:
        system: the model.
        limits: limits of the inputs.
        x: the goal, (n_x,).
        u: the inputs that hold it, (n_u,).
        deviations: acceptable deviations by name.
        range: the range of the training records.
        within: limits of states by name.
        end_weight: factor of the end's cost.
    """
    weights = bryson_weights(system, limits, deviations, range)
    require_known(within or {}, system.names, "within", "states")
    lower, upper = np.full(system.n_x, -np.inf), np.full(system.n_x, np.inf)
    penalty = np.zeros(system.n_x)
    for name, (low, high) in (within or {}).items():
        if not low < high:
            raise InputError("within", f"{name} from {low} to {high}", "the smaller one first")
        i = system.names.index(name)
        lower[i], upper[i] = low, high
        half = (high - low) / 2
        own = 1 / half**2 if np.isfinite(half) else 0.0
        penalty[i] = PLANNING.penalty * max(own, weights.states[i], 1.0 if not own else 0.0)
    holding = hold(system, x, u, weights)
    end = end_weight * holding.value
    return Cost(x, u, weights.states, weights.inputs, end, lower, upper, penalty), holding


def _targets(
    system: ControlledModel, start: Float[np.ndarray, " n_x"], goal: Float[np.ndarray, " n_x"]
) -> list[Float[np.ndarray, " n_x"]]:
    """The goal, each angle with the whole turns that are nearest to the start, from both sides."""
    choices = []
    for i, value in enumerate(goal):
        turn = 2 * np.pi
        if i not in system.periodic:
            choices.append([value])
            continue
        below = value + turn * np.floor((start[i] - value) / turn)
        # from where the start is nearly there, a whole turn is no way to it
        near = [v for v in (below, below + turn) if abs(v - start[i]) <= _FARTHEST]
        choices.append(near)
    return [np.array(target) for target in itertools.product(*choices)]


def _first_motions(
    solvers: Sequence[Solver],
    start: Float[np.ndarray, " n_z"],
    guesses: Sequence[ArrayLike | Plan] | int,
    steps: int,
    seed: int,
) -> list[tuple[Solver, Motion]]:
    """Motions to begin searches with, and the solver of each: one for each goal.

    They are along the guesses, or of the goal's and random inputs. A plan keeps its own goal.
    """
    if guesses == 0 or (not isinstance(guesses, int) and not len(guesses)):
        raise InputError("guesses", "none", "at least one")
    if isinstance(guesses, int):
        made = _smooth_inputs(solvers[0], guesses, steps, seed)
        return [(solver, solver.begin(start, u)) for solver in solvers for u in made]
    system, motions = solvers[0].system, []
    for guess in guesses:
        u = np.asarray(guess.u if isinstance(guess, Plan) else guess, np.float64)
        if u.shape != (steps, system.n_u) or not np.isfinite(u).all():
            raise InputError("guesses", f"inputs of shape {u.shape}", f"({steps}, {system.n_u})")
        if not isinstance(guess, Plan):
            u = solvers[0].limits.clip(u)
            motions += [(solver, solver.begin(start, u)) for solver in solvers]
            continue
        guess.require_for(system.n_x, system.n_u, system.dt, system.delay, "guesses")
        goal = solvers[0].cost.x
        if not np.allclose(guess.goal + turns_to(system, guess.goal, goal), goal, atol=1e-6):
            raise InputError("guesses", "a plan to another goal", "plans that end where this does")
        solver = replace(solvers[0], cost=replace(solvers[0].cost, x=guess.goal))
        motions.append((solver, _follow(solver, start, guess)))
    return motions


def _follow(solver: Solver, start: Float[np.ndarray, " n_z"], plan: Plan) -> Motion:
    """The motion from a start by time-varying linear feedback along a plan."""
    system, cost = solver.system, solver.cost
    gains, _ = gains_along(system, plan, cost.end, Weights(cost.states, cost.inputs))
    z = np.hstack([plan.x[:-1], plan.previous_inputs(system.previous)])
    reference = Motion(np.concatenate([z, z[-1:]]), plan.u, np.inf)
    policy = solver.without_feedback(len(plan.u))._replace(gain=-gains)
    return solver.roll_out(start, reference, policy, np.ones(1))


def _smooth_inputs(
    solver: Solver, count: int, steps: int, seed: int
) -> list[Float[np.ndarray, "steps n_u"]]:
    """Inputs of the goal, and random smooth ones about them."""
    rest, limits = solver.cost.u, solver.limits
    generator = np.random.default_rng(seed)
    made = [np.tile(rest, (steps, 1))]
    span = max(1, round(PLANNING.correlated / solver.system.dt))
    for _ in itertools.repeat(None, count - 1):
        knots = generator.uniform(-1, 1, (steps // span + 2, len(rest)))
        knots = limits.clip(rest + PLANNING.amplitude / 2 * (limits.upper - limits.lower) * knots)
        at = np.arange(steps) / span
        made.append(
            np.stack([np.interp(at, np.arange(len(knots)), column) for column in knots.T], axis=1)
        )
    return made


def shift(values: Float[np.ndarray, "n *rest"]) -> Float[np.ndarray, "n *rest"]:
    """Rows one sample on; the last is repeated."""
    return np.concatenate([values[1:], values[-1:]])


def turns_to(
    system: ControlledModel, x: Float[np.ndarray, " n_x"], near: Float[np.ndarray, " n_x"]
) -> Float[np.ndarray, " n_x"]:
    """Whole turns of angles to add to a state so that it comes nearest to another."""
    turns = np.zeros(len(x))
    for i in system.periodic:
        turns[i] = -2 * np.pi * np.round((x[i] - near[i]) / (2 * np.pi))
    return turns
