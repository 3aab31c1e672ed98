"""Predictive control: linear problems, the pendulum, limits, plans that are followed, IPOPT."""

from dataclasses import replace

import numpy as np
import pytest
from every_family import example
from linear_machines import double_integrator

import tustinnet as tn
from tustinnet.control import Controller, Feedback, LinearFeedback, Mpc, ilqr, lqr, time_varying_lqr
from tustinnet.control.dynamics import controlled
from tustinnet.control.mpc import LONGEST
from tustinnet.export.casadi import TARGET
from tustinnet.export.source import make_source
from tustinnet.store.files import write_into

LIMITS = {"voltage": (-10.0, 10.0)}


def hold(model: tn.Model, x: np.ndarray, **options) -> Feedback:
    """Feedback about a point without inputs."""
    return lqr(model, x, np.zeros(model.channels.n_u), **options)


def test_far_from_limits_it_is_linear_feedback():
    model = double_integrator(limit=1e3)
    feedback = hold(model, np.zeros(2))
    mpc, linear = Mpc(model, feedback, steps=10), LinearFeedback(feedback)
    for k, x in enumerate(np.random.default_rng(0).normal(size=(5, 2))):
        np.testing.assert_allclose(mpc.inputs(k, x), linear.inputs(k, x), rtol=1e-6)


@pytest.mark.thorough
def test_it_balances_whole_turns_away_and_within_limits():
    model = example("qube")
    step = tn.compiled_step(model)
    mpc: Controller = Mpc(model, hold(model, np.zeros(4), limits=LIMITS))
    x, inputs = np.array([0.3, 2 * np.pi + 0.25, 0.0, 0.0]), []
    for k in range(250):
        inputs.append(mpc.inputs(k, x))
        x = step(x, inputs[-1])
    np.testing.assert_allclose(x, [0, 2 * np.pi, 0, 0], atol=1e-3)
    assert np.abs(inputs).max() <= 10
    assert np.abs(inputs).max() > 5


@pytest.mark.thorough
def test_it_moves_to_another_goal_and_forgets_after_a_reset():
    model = double_integrator()
    step = tn.compiled_step(model)
    deviations = {"force": 0.5}
    feedback = hold(model, np.array([1.0, 0.0]), deviations=deviations)
    mpc = Mpc(model, feedback, deviations=deviations)
    runs = []
    for _ in range(2):
        mpc.reset()
        x, states = np.zeros(2), []
        for k in range(150):
            x = step(x, mpc.inputs(k, x))
            states.append(x)
        runs.append(states)
    np.testing.assert_allclose(runs[0][-1], [1, 0], atol=1e-3)
    np.testing.assert_array_equal(*runs)


@pytest.mark.thorough
def test_it_follows_a_plan_and_then_balances():
    model = example("qube")
    step = tn.compiled_step(model)
    start = np.array([0.0, np.pi, 0.0, 0.0])
    plan = ilqr(model, start, np.zeros(4), 200, limits={"voltage": (-8.0, 8.0)})
    feedback = hold(model, np.zeros(4), limits=LIMITS)
    tracking = time_varying_lqr(model, plan, feedback)
    mpc = Mpc(model, tracking)
    x = start + np.array([0.05, 0.05, 0, 0])
    for k in range(330):
        x = step(x, mpc.inputs(k, x))
    np.testing.assert_allclose(x, plan.goal, atol=1e-3)
    late = hold(model, np.zeros(4), limits=LIMITS, delay=1)
    with pytest.raises(tn.InputError, match="1 sample late"):
        Mpc(model, replace(tracking, final=late))


@pytest.mark.thorough
def test_it_balances_with_a_late_input():
    delay = 2
    model = example("qube memory")
    step = tn.compiled_step(model)
    mpc = Mpc(model, hold(model, np.zeros(5), limits=LIMITS, delay=delay))
    x, late = np.array([0.1, 0.1, 0, 0, 0]), [np.zeros(1)] * delay
    for k in range(250):
        late.append(mpc.inputs(k, x))
        x = step(x, late.pop(0))
    np.testing.assert_allclose(x, 0, atol=2e-3)


@pytest.mark.thorough
def test_a_limit_of_a_state_is_kept_where_linear_feedback_breaks_it():
    model = double_integrator()
    step, within = tn.compiled_step(model), {"der_s": (-0.3, 0.3)}
    feedback = hold(model, np.array([1.0, 0.0]))
    fastest = []
    for controller in (LinearFeedback(feedback), Mpc(model, feedback, steps=20, within=within)):
        x, speeds = np.zeros(2), []
        for k in range(400):
            x = step(x, controller.inputs(k, x))
            speeds.append(abs(x[1]))
        np.testing.assert_allclose(x, [1, 0], atol=0.01)
        fastest.append(max(speeds))
    assert fastest[0] > 0.5
    assert fastest[1] < 0.301


@pytest.mark.thorough
def test_converged_it_commands_what_ipopt_finds(tmp_path):
    casadi = pytest.importorskip("casadi")
    model, steps = example("qube"), 20
    mpc = Mpc(
        model,
        hold(model, np.zeros(4), limits=LIMITS),
        steps=steps,
        iterations=30,
        within={"der_theta": (-3.0, 3.0)},
    )
    cost = mpc.cost
    for name, content in TARGET.files(make_source(model)).items():
        write_into(tmp_path, name, content)
    step = casadi.Function.load(str(tmp_path / "step.casadi"))

    def beyond(z):
        return sum(
            cost.penalty[i]
            * (
                casadi.fmax(z[i] - cost.upper[i], 0) ** 2
                + casadi.fmax(cost.lower[i] - z[i], 0) ** 2
            )
            for i in np.flatnonzero(cost.penalty)
        )

    for start in ([0.3, 0.25, 0.0, 0.0], [-0.5, 0.1, 2.0, -1.0], [0.1, -0.3, -2.9, 0.0]):
        problem = casadi.Opti()
        z, u = problem.variable(4, steps + 1), problem.variable(1, steps)
        total = z[:, -1].T @ cost.end @ z[:, -1] + beyond(z[:, -1])
        for k in range(steps):
            total += cost.states.reshape(1, 4) @ z[:, k] ** 2 + cost.inputs[0] * u[k] ** 2
            total += beyond(z[:, k])
        problem.minimize(total / 2)
        problem.subject_to(z[:, 0] == start)
        problem.subject_to(z[:, 1:] == step.map(steps)(z[:, :-1], u))
        problem.subject_to(problem.bounded(-10, u, 10))
        quiet = {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-10}
        problem.solver("ipopt", *quiet)
        expected = problem.solve().value(u)
        mpc.reset()
        command = mpc.inputs(0, np.array(start))
        assert abs(command[0] - expected[0]) < 1e-3 * 20  # of the range of the input
        assert mpc.motion is not None
        # where the speed is at its limit the cost has a kink, and inputs matter little
        np.testing.assert_allclose(mpc.motion.u[:, 0], expected, atol=3e-3 * 20)


@pytest.mark.thorough
def test_after_a_fall_it_settles_by_feedback_and_swings_up_again():
    model = example("qube")
    step = tn.compiled_step(model)
    hanging = np.array([0.0, np.pi, 0.0, 0.0])
    plan = ilqr(model, hanging, np.zeros(4), 200, limits={"voltage": (-8.0, 8.0)})
    up, down = (hold(model, x, limits=LIMITS) for x in (np.zeros(4), hanging))
    mpc = Mpc(model, time_varying_lqr(model, plan, up, settle=down), steps=20)
    x, near = hanging, []
    for k in range(1500):
        if k == 300:
            x = hanging + np.array([0.0, -0.5, 0.0, 0.0])
        x = step(x, mpc.inputs(k, x))
        near.append(np.cos(x[1]) > 0.99)
    assert near[299]
    assert not near[310]
    assert all(near[-20:])


def test_what_it_cannot_do_is_refused():
    model = double_integrator()
    feedback = hold(model, np.zeros(2))
    for steps in (0, LONGEST + 1):
        with pytest.raises(tn.InputError, match=f"{steps} steps"):
            Mpc(model, feedback, steps=steps)
    with pytest.raises(tn.InputError, match="0 iterations"):
        Mpc(model, feedback, iterations=0)
    with pytest.raises(tn.InputError, match="feedback with integrals"):
        Mpc(model, hold(model, np.zeros(2), integral=["s"]))
    with pytest.raises(tn.InputError, match="no 'y'"):
        Mpc(model, feedback, within={"y": (-1.0, 1.0)})
    other = example("qube")
    with pytest.raises(tn.InputError, match="2 states"):
        Mpc(other, feedback)
    assert controlled(other).n_x == 4
