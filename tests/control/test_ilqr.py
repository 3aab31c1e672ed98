"""Plans: linear problems whose solution is known, swing-ups, every family."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from every_family import NAMES, example
from linear_machines import double_integrator, two_masses

import tustinnet as tn
from tustinnet.control import ilqr
from tustinnet.control.cost import Cost
from tustinnet.control.dynamics import controlled, input_limits
from tustinnet.control.ilqr import Solver
from tustinnet.control.riccati import backward_pass

UPRIGHT, HANGING = np.zeros(4), np.array([0.0, np.pi, 0.0, 0.0])


def quadratic_cost(n_x, n_u, n_z=None):
    generator = np.random.default_rng(1)
    end = generator.normal(size=(n_z or n_x, n_z or n_x))
    return Cost(
        x=generator.normal(size=n_x),
        u=generator.normal(size=n_u) / 5,
        states=generator.uniform(0.5, 2, n_x),
        inputs=generator.uniform(0.1, 0.5, n_u),
        end=end @ end.T,
        lower=np.full(n_x, -np.inf),
        upper=np.full(n_x, np.inf),
        penalty=np.zeros(n_x),
    )


def least_squares(model, cost, start, steps, limits):
    """Inputs of least cost under limits, by a solver of bounded least squares."""
    n_x, n_u = model.b.shape
    powers = [np.linalg.matrix_power(model.a, k) for k in range(steps + 1)]
    response = np.zeros((steps + 1, n_x, steps, n_u))
    for k in range(steps + 1):
        for j in range(k):
            response[k, :, j] = powers[k - 1 - j] @ model.b
    response = response.reshape(steps + 1, n_x, steps * n_u)
    root = np.sqrt(cost.states)
    end = np.linalg.cholesky(cost.end).T
    free = np.stack([p @ start for p in powers]) - cost.x
    rows = [
        *(root[:, None] * response[k] for k in range(steps)),
        end @ response[-1],
        np.diag(np.tile(np.sqrt(cost.inputs), steps)),
    ]
    right = [
        *(root * free[k] for k in range(steps)),
        end @ free[-1],
        -np.tile(np.sqrt(cost.inputs) * cost.u, steps),
    ]
    found = scipy.optimize.lsq_linear(
        np.concatenate(rows),
        -np.concatenate(right),
        [np.tile(side, steps) for side in limits],
        tol=1e-14,
    )
    return found.x.reshape(steps, n_u), found.cost


@pytest.mark.thorough
@pytest.mark.parametrize("machine", [double_integrator, two_masses])
def test_a_linear_problem_is_solved_in_one_iteration(machine):
    model = machine(limit=1e3)
    n_x, n_u = model.b.shape
    cost, limits, start = quadratic_cost(n_x, n_u), input_limits(model), np.ones(n_x)
    solver = Solver(controlled(model), limits, cost)
    motion, converged, iterations = solver.minimise(solver.begin(start, np.zeros((25, n_u))), 10)
    assert (converged, iterations) == (True, 1)
    u, least = least_squares(model, cost, start, 25, limits)
    np.testing.assert_allclose(motion.u, u, atol=1e-6)
    assert motion.cost == pytest.approx(least, rel=1e-9)


@pytest.mark.parametrize(("machine", "limit"), [(double_integrator, 0.4), (two_masses, 0.5)])
def test_a_linear_problem_under_limits_is_solved(machine, limit):
    model = machine(limit=limit)
    n_x, n_u = model.b.shape
    cost, limits, start = quadratic_cost(n_x, n_u), input_limits(model), np.ones(n_x)
    solver = Solver(controlled(model), limits, cost)
    motion, converged, _ = solver.minimise(solver.begin(start, np.zeros((25, n_u))), 200)
    u, least = least_squares(model, cost, start, 25, limits)
    assert converged
    assert (np.abs(np.abs(u) - limit) < 1e-6).sum() >= 5  # limits are active
    assert motion.cost == pytest.approx(least, rel=1e-6)
    np.testing.assert_allclose(motion.u, u, atol=3e-2 * limit)


def test_policies_of_machine_code_are_those_of_jax(monkeypatch):
    model = two_masses(limit=0.5)
    cost, limits = quadratic_cost(4, 2), input_limits(model)
    solver = Solver(controlled(model), limits, cost)
    motion = solver.begin(np.ones(4), np.zeros((12, 2)))
    derivatives = solver.system.derivatives(motion.z[:-1], motion.u)
    arguments = (
        derivatives,
        cost.expand(motion.z, motion.u),
        (limits.lower - motion.u, limits.upper - motion.u),
        np.full(2, 1e-3),
    )
    compiled = backward_pass(*arguments)
    monkeypatch.setattr("tustinnet.control.riccati._MOST_WRITTEN_OUT", 0)
    for found, expected in zip(backward_pass(*arguments), compiled, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("limit", [15.0, 3.0])
def test_the_pendulum_swings_up(limit):
    model = example("qube")
    plan = ilqr(model, HANGING, UPRIGHT, 450, limits={"voltage": (-limit, limit)})
    assert plan.converged
    assert plan.reached
    np.testing.assert_allclose(plan.miss, 0, atol=0.02)
    assert np.abs(plan.u).max() <= limit
    # it is a motion of the model
    np.testing.assert_allclose(controlled(model).steps(plan.x[:-1], plan.u), plan.x[1:], atol=1e-9)


@pytest.mark.thorough
def test_limits_of_states_are_kept_and_turns_can_be_forbidden():
    model, limits = example("qube"), {"voltage": (-5.0, 5.0)}
    free = ilqr(model, HANGING, UPRIGHT, 300, limits=limits)
    narrow = ilqr(model, HANGING, UPRIGHT, 300, limits=limits, within={"theta": (-0.6, 0.6)})
    assert np.abs(free.x[:, 0]).max() > 0.7
    assert np.abs(narrow.x[:, 0]).max() < 0.62
    assert narrow.reached
    start = HANGING + np.array([0, 0.5, 0, 0])  # nearer to a turn
    assert ilqr(model, start, UPRIGHT, 200, limits=limits, turns=False).goal[1] == 0


def test_a_plan_that_found_no_way_says_so():
    model = example("qube")
    short = ilqr(model, HANGING, UPRIGHT, 15, limits={"voltage": (-3.0, 3.0)})
    assert not short.reached
    assert np.abs(short.miss).max() > 0.5
    stopped = ilqr(model, HANGING, UPRIGHT, 200, iterations=3, guesses=1)
    assert not stopped.converged


def test_a_plan_is_a_first_guess_of_another():
    model, limits = example("qube"), {"voltage": (-5.0, 5.0)}
    plan = ilqr(model, HANGING, UPRIGHT, 300, limits=limits)
    again = ilqr(
        model, HANGING + np.array([0.02, 0.05, 0, 0]), UPRIGHT, 300, limits=limits, guesses=[plan]
    )
    assert again.reached
    assert again.iterations < 60
    np.testing.assert_array_equal(again.goal, plan.goal)


@pytest.mark.thorough
def test_a_late_input_is_planned_for():
    model = example("qube")
    plan = ilqr(model, HANGING, UPRIGHT, 250, limits={"voltage": (-10.0, 10.0)}, delay=2)
    assert plan.reached
    late = np.concatenate([np.zeros((2, 1)), plan.u[:-2]])
    np.testing.assert_allclose(controlled(model).steps(plan.x[:-1], late), plan.x[1:], atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_plans_are_made_on_every_family(name):
    model = example(name)
    system = controlled(model)
    limits = {i.name: (-10.0, 10.0) for i in model.inputs}
    bounds = input_limits(model, limits)
    start = np.zeros(model.state_size)
    start[model.channels.position] = 0.3
    cost = quadratic_cost(system.n_x, system.n_u, system.size)
    solver = Solver(system, bounds, cost)
    before = solver.begin(system.augment(start, np.zeros(system.n_u)), np.zeros((30, system.n_u)))
    after, _, iterations = solver.minimise(before, 15)
    assert np.isfinite(before.cost)
    assert iterations > 0
    assert after.cost < before.cost
    assert np.abs(after.u).max() <= 10
    # derivatives of the step, previous commands included, are those of differences
    z, u = after.z[:1], after.u[:1]
    slope = system.derivatives(z, u)[0]
    for j, moved in enumerate(1e-5 * np.eye(system.size + system.n_u)):
        dz, du = moved[: system.size], moved[system.size :]
        change = (system.steps(z + dz, u + du) - system.steps(z - dz, u - du))[0] / 2e-5
        np.testing.assert_allclose(slope[:, j], change, rtol=1e-3, atol=1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["hybrid", "network taps", "first-order"])
def test_a_held_command_is_a_record_whose_input_is_held(name):
    model = example(name)
    system = controlled(model)
    x = np.zeros(model.state_size)
    x[model.channels.position] = 0.3
    following = system.steps(system.augment(x, np.ones(1))[None], np.ones((1, 1)))[0]
    expected = np.asarray(model.step(jnp.asarray(x), jnp.ones(1)))
    np.testing.assert_allclose(following[: system.n_x], expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"steps": 0}, "0 steps"),
        ({"goal": np.zeros(3)}, "4 finite numbers"),
        ({"within": {"beta": (0.0, 1.0)}}, "no 'beta' among the states"),
        ({"within": {"theta": (1.0, 0.0)}}, "the smaller one first"),
        ({"guesses": [np.zeros((3, 1))]}, r"inputs of shape \(3, 1\)"),
        ({"guesses": 0}, "at least one"),
        ({"goal": np.array([0, np.nan, 0, 0])}, "finite"),
    ],
)
def test_wrong_arguments_are_refused(arguments, words):
    given = {"start": HANGING, "goal": UPRIGHT, "steps": 20} | arguments
    with pytest.raises(tn.InputError, match=words):
        ilqr(example("qube"), **given)


def test_models_that_cannot_be_controlled_are_refused():
    from every_step import without_inputs

    with pytest.raises(tn.InputError, match="a model without inputs"):
        ilqr(without_inputs(), np.zeros(2), np.zeros(2), 10)
