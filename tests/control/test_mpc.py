"""Predictive control: linear problems, the pendulum, plans that are followed."""

import numpy as np
import pytest
from every_family import example
from linear_machines import double_integrator

import tustinnet as tn
from tustinnet.control import Controller, LinearFeedback, Mpc, ilqr, lqr

LIMITS = {"voltage": (-10.0, 10.0)}


def test_far_from_limits_it_is_linear_feedback():
    model = double_integrator(limit=1e3)
    mpc = Mpc(model, np.zeros(2), np.zeros(1), steps=10)
    feedback = LinearFeedback(lqr(model, np.zeros(2), np.zeros(1)))
    for k, x in enumerate(np.random.default_rng(0).normal(size=(5, 2))):
        np.testing.assert_allclose(mpc.inputs(k, x), feedback.inputs(k, x), rtol=1e-6)


def test_it_balances_whole_turns_away_and_within_limits():
    model = example("qube")
    step = tn.compiled_step(model)
    mpc: Controller = Mpc(model, np.zeros(4), np.zeros(1), limits=LIMITS)
    x, inputs = np.array([0.3, 2 * np.pi + 0.25, 0.0, 0.0]), []
    for k in range(250):
        inputs.append(mpc.inputs(k, x))
        x = step(x, inputs[-1])
    np.testing.assert_allclose(x, [0, 2 * np.pi, 0, 0], atol=1e-3)
    assert np.abs(inputs).max() <= 10
    assert np.abs(inputs).max() > 5


def test_it_moves_to_another_goal_and_forgets_after_a_reset():
    model = double_integrator()
    step = tn.compiled_step(model)
    mpc = Mpc(model, np.array([1.0, 0.0]), np.zeros(1), deviations={"force": 0.5})
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


def test_it_follows_a_plan_and_then_balances():
    model = example("qube")
    step = tn.compiled_step(model)
    start = np.array([0.0, np.pi, 0.0, 0.0])
    plan = ilqr(model, start, np.zeros(4), 200, limits={"voltage": (-8.0, 8.0)})
    mpc = Mpc(model, np.zeros(4), np.zeros(1), plan=plan, limits=LIMITS)
    x = start + np.array([0.05, 0.05, 0, 0])
    for k in range(330):
        x = step(x, mpc.inputs(k, x))
    np.testing.assert_allclose(x, plan.goal, atol=1e-3)
    with pytest.raises(tn.InputError, match="1 sample late"):
        Mpc(model, np.zeros(4), np.zeros(1), plan=plan, limits=LIMITS, delay=1)


def test_it_balances_with_a_late_input():
    delay = 2
    model = example("qube memory")
    step = tn.compiled_step(model)
    mpc = Mpc(model, np.zeros(5), np.zeros(1), limits=LIMITS, delay=delay)
    x, late = np.array([0.1, 0.1, 0, 0, 0]), [np.zeros(1)] * delay
    for k in range(250):
        late.append(mpc.inputs(k, x))
        x = step(x, late.pop(0))
    np.testing.assert_allclose(x, 0, atol=2e-3)


def test_goals_that_no_feedback_holds_are_refused():
    with pytest.raises(tn.InputError, match="0 steps"):
        Mpc(double_integrator(), np.zeros(2), np.zeros(1), steps=0)
    with pytest.raises(tn.InputError, match="2 finite numbers"):
        Mpc(double_integrator(), np.zeros(3), np.zeros(1))
