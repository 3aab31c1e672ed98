"""Linear-quadratic feedback against scipy and python-control, and in the loop."""

from dataclasses import replace
from itertools import groupby

import control
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from every_family import example
from linear_machines import LinearMachine, double_integrator, two_masses

import tustinnet as tn
from tustinnet.control import (
    LinearFeedback,
    TrackingFeedback,
    find_equilibrium,
    ilqr,
    lqr,
    margins,
    time_varying_lqr,
)
from tustinnet.control.design import ControlTask, design_controller
from tustinnet.control.dynamics import controlled
from tustinnet.control.lqr import FAST, loop_matrices, loop_without_friction
from tustinnet.control.sticking import sticking_distances
from tustinnet.models import forces
from tustinnet.simulate.filtering import FilterNoise
from tustinnet.simulate.range import Range
from tustinnet.systems.library.link_chain import TWO_LINKS


def play(model, controller, x, samples):
    """States of a model under a controller."""
    step, states = tn.compiled_step(model), [np.asarray(x, float)]
    controller.reset()
    for k in range(samples):
        states.append(step(states[-1], controller.inputs(k, states[-1])))
    return np.stack(states)


@pytest.mark.parametrize("machine", [double_integrator, two_masses])
def test_gains_are_those_of_scipy_and_python_control(machine):
    model = machine()
    n_x, n_u = model.b.shape
    names = [*(c.name for c in model.coordinates), *(f"der_{c.name}" for c in model.coordinates)]
    deviations = dict(zip(names, np.linspace(0.1, 1.0, n_x), strict=True))
    deviations |= {i.name: 0.5 + j for j, i in enumerate(model.inputs)}
    found = lqr(model, np.zeros(n_x), np.zeros(n_u), deviations=deviations).gain
    q, r = (
        np.diag(1 / np.array(list(deviations.values())[part]) ** 2)
        for part in (slice(0, n_x), slice(n_x, None))
    )
    value = scipy.linalg.solve_discrete_are(model.a, model.b, q, r)
    expected = np.linalg.solve(r + model.b.T @ value @ model.b, model.b.T @ value @ model.a)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    np.testing.assert_allclose(found, control.dlqr(model.a, model.b, q, r)[0], rtol=1e-6)


def test_weights_follow_from_the_records_and_from_what_is_named():
    model = double_integrator(limit=4.0)
    ranges = Range(np.array([[-0.5, 0.5], [-2.0, 2.0]]), np.array([[-1.0, 1.0]]))
    from_range = lqr(model, np.zeros(2), np.zeros(1), range=ranges)
    named = lqr(model, np.zeros(2), np.zeros(1), deviations={"s": 0.5, "der_s": 2.0, "force": 4.0})
    np.testing.assert_allclose(from_range.gain, named.gain)
    stiffer = lqr(model, np.zeros(2), np.zeros(1), range=ranges, deviations={"s": 0.01})
    assert stiffer.gain[0, 0] > 2 * named.gain[0, 0]


def test_a_wheel_that_turned_a_hundred_times_is_held_as_tightly_as_one_that_turned_once():
    model = double_integrator()
    channels = replace(model.channels, coordinates=(tn.Coordinate("s", "angular"),))
    wheel = LinearMachine(model.a, model.b, channels)

    def gain(range=None, **deviations):
        return lqr(wheel, np.zeros(2), np.zeros(1), range=range, deviations=deviations).gain

    far = Range(np.array([[-300.0, 300.0], [-2.0, 2.0]]), np.array([[-1.0, 1.0]]))
    np.testing.assert_allclose(gain(far), gain(s=1.0, der_s=2.0))


@pytest.mark.thorough
def test_dry_friction_is_a_force_whatever_the_speed_at_which_it_is_rounded():
    """At the point itself it is viscous friction of `force / width`, here up to 5000 N s/m."""
    gains = []
    for width in (1e-2, 1e-3, 1e-4):
        cart = tn.LagrangianSystem(
            name="cart",
            coordinates=(tn.Coordinate("s", "linear"),),
            inputs=(tn.Input("force", "N", limits=(-5.0, 5.0)),),
            parameters=(tn.Parameter("friction", "N", 0.5, 0.0, 5.0),),
            kinetic=lambda q, v, p: v[0] ** 2 / 2,
            dissipation=lambda q, v, p, width=width: forces.coulomb(v, p["friction"], width),
            input_map=lambda q, v, u, p: u,
        )
        model = tn.discretise(cart.model({"friction": jnp.asarray(0.5)}), 0.01, 5)
        gains.append(lqr(model, np.zeros(2), np.zeros(1), deviations={"der_s": 1.0}).gain)
    np.testing.assert_allclose(gains[1:], [gains[0]] * 2, rtol=0.02)
    # a force of 0.5 N at a speed of 0.1 m/s
    a, b = np.array([[1.0, 0.01], [0.0, 1.0 - 0.01 * 0.5 / 0.1]]), np.array([[0.0], [0.01]])
    viscous = LinearMachine(a, b, model.channels)
    expected = lqr(viscous, np.zeros(2), np.zeros(1), deviations={"der_s": 1.0}).gain
    np.testing.assert_allclose(gains[2], expected, rtol=0.05)


@pytest.mark.thorough
def test_dry_friction_of_a_joint_without_input_does_not_turn_the_feedback_round():
    """Stuck joints make one rigid pendulum of two; feedback for that pushes the wrong way."""
    gains = []
    for dry in (1e-6, 2e-3, 5e-3, 1e-2):
        pendubot = replace(
            TWO_LINKS,
            inputs=(tn.Input("torque", "N m", limits=(-3.0, 3.0)),),
            dissipation=lambda q, v, p, dry=dry: forces.coulomb(v, jnp.array([0.0, dry]), 0.01),
        )
        values = {p.name: jnp.asarray(p.nominal) for p in pendubot.parameters}
        model = tn.discretise(pendubot.model(values), 0.005, 4)
        deviations = {"joint1": 1.0, "joint2": 1.0, "der_joint1": 1.0, "der_joint2": 1.0}
        upright = np.array([np.pi, 0.0, 0.0, 0.0])
        gains.append(lqr(model, upright, np.zeros(1), deviations=deviations).gain[0])
    frictionless, *rubbing = gains
    for gain in rubbing:
        assert (np.sign(gain) == np.sign(frictionless)).all()
        np.testing.assert_allclose(gain, frictionless, rtol=0.8)


@pytest.mark.thorough
def test_records_of_a_whirling_machine_do_not_turn_the_feedback_round():
    """Forces grow with squared speeds: about a point they are none, however fast records are."""
    pendubot = replace(
        TWO_LINKS,
        inputs=(tn.Input("torque", "N m", limits=(-3.0, 3.0)),),
    )
    values = {p.name: jnp.asarray(p.nominal) for p in pendubot.parameters}
    model = tn.discretise(pendubot.model(values), 0.01, 4)
    upright = np.array([np.pi, 0.0, 0.0, 0.0])
    exact, b = controlled(model).tangent(upright, np.zeros(1))
    moving, moving_b = controlled(model).tangent(upright, np.zeros(1), np.array([1.0, 1.0]))
    np.testing.assert_allclose(moving, exact, atol=2e-3)
    np.testing.assert_allclose(moving_b, b, rtol=2e-3)
    gains = []
    for speed in (5.0, 50.0):
        ends = np.array([3.0, 3.0, speed, speed])
        ranges = Range(np.stack([-ends, ends], axis=1), np.array([[-3.0, 3.0]]))
        gains.append(lqr(model, upright, np.zeros(1), range=ranges).gain[0])
    assert (np.sign(gains[0]) == np.sign(gains[1])).all()


def test_a_sample_of_delay_is_accounted_for():
    model = double_integrator(limit=50.0)
    feedback = lqr(model, np.zeros(2), np.zeros(1), deviations={"force": 0.3}, delay=1)
    assert (feedback.gain.shape, feedback.previous, feedback.delay) == ((1, 3), 1, 1)
    # the loop with the late input by hand
    a = np.block([[model.a, model.b], [np.zeros((1, 3))]])
    b = np.array([[0.0], [0.0], [1.0]])
    price = np.diag([1.0, 0.01, 0.0])  # deviations of 1 m and 10 m/s
    value = scipy.linalg.solve_discrete_are(a, b, price + 1e-9 * np.eye(3), np.eye(1) / 0.09)
    expected = np.linalg.solve(np.eye(1) / 0.09 + b.T @ value @ b, b.T @ value @ a)
    np.testing.assert_allclose(feedback.gain, expected, rtol=1e-6)
    # where the model's input is late, nothing need be said
    late = lqr(
        double_integrator(50.0, delay=0.1), np.zeros(2), np.zeros(1), deviations={"force": 0.3}
    )
    np.testing.assert_allclose(late.gain, expected, rtol=1e-6)
    # half a period: half of the latest and half of the command before
    half = lqr(double_integrator(50.0, delay=0.05), np.zeros(2), np.zeros(1))
    assert half.previous == 1


def test_integral_action_takes_a_constant_force_away():
    model = double_integrator()
    pushed = LinearMachine(model.a, model.b, model.channels)
    feedback = lqr(model, np.zeros(2), np.zeros(1), integral=["s"])
    plain = lqr(model, np.zeros(2), np.zeros(1))
    step = tn.compiled_step(pushed)
    ends = []
    for each in (feedback, plain):
        controller, x = LinearFeedback(each), np.zeros(2)
        for k in range(400):
            x = step(x, controller.inputs(k, x) + 0.3)
        ends.append(abs(x[0]))
    assert ends[0] < 1e-6 < 0.1 < ends[1]


def test_integrals_wait_while_an_input_is_at_its_limit():
    feedback = lqr(double_integrator(limit=0.1), np.zeros(2), np.zeros(1), integral=["s"])
    controller = LinearFeedback(feedback)
    for k in range(10):
        assert controller.inputs(k, np.array([5.0, 0.0])) == [-0.1]
    fresh = LinearFeedback(feedback)
    x = np.array([1e-3, 0.0])
    assert controller.inputs(10, x) == fresh.inputs(0, x)


def test_the_pendulum_is_caught_whole_turns_away():
    model = example("qube")
    feedback = lqr(model, np.zeros(4), np.zeros(1))
    assert feedback.periodic == (1,)  # the cable knows the turns of the arm
    states = play(model, LinearFeedback(feedback), [0.2, 4 * np.pi + 0.1, 0.0, 0.0], 400)
    np.testing.assert_allclose(states[-1], [0, 4 * np.pi, 0, 0], atol=1e-3)


def test_margins_of_a_loop():
    model = double_integrator()
    feedback = lqr(model, np.zeros(2), np.zeros(1))
    found = margins(model, feedback)
    (at_input,) = found.inputs

    # the gain at which the loop is unstable, by its eigenvalues
    def is_stable(factor):
        return np.abs(np.linalg.eigvals(model.a - factor * model.b @ feedback.gain)).max() < 1

    assert is_stable(0.999 * at_input.gain_up)
    assert not is_stable(1.001 * at_input.gain_up)
    assert at_input.gain_down == 0.0  # at the poles of both integrators
    loop = control.StateSpace(model.a, model.b, feedback.gain, [[0.0]], model.dt)
    assert at_input.phase == pytest.approx(np.radians(control.margin(loop)[1]), rel=1e-3)
    # the distance from -1 bounds what the margins can be
    assert 2 * np.arcsin(0.5 / found.sensitivity_peak) <= at_input.phase
    assert at_input.delay == pytest.approx(at_input.phase / at_input.crossover, rel=1e-6)


def test_margins_are_those_of_each_input_where_there_are_several():
    model = two_masses()
    feedback = lqr(model, np.zeros(4), np.zeros(2))
    found = margins(model, feedback)
    assert [m.input for m in found.inputs] == ["force_1", "force_2"]
    for j, m in enumerate(found.inputs):
        factors = np.ones(2)
        for scale, stable in ((0.999, True), (1.001, False)):
            factors[j] = scale * m.gain_up
            loop = model.a - model.b @ np.diag(factors) @ feedback.gain
            assert (np.abs(np.linalg.eigvals(loop)).max() < 1) == stable
    with pytest.raises(tn.InputError, match="the closed loop has an eigenvalue"):
        margins(LinearMachine(1.2 * model.a, model.b, model.channels), feedback)


def test_modes_that_no_input_moves_are_named():
    model = double_integrator()
    stuck = LinearMachine(
        np.array([[1.0, 0.1, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0.1], [0, 0, 0.1, 1.1]]),
        np.array([[0.005], [0.1], [0.0], [0.0]]),
        tn.Channels(
            (tn.Coordinate("s", "linear"), tn.Coordinate("r", "linear")), model.inputs, 0.1
        ),
    )
    reordered = [0, 2, 1, 3]
    stuck = LinearMachine(stuck.a[np.ix_(reordered, reordered)], stuck.b[reordered], stuck.channels)
    with pytest.raises(
        tn.InputError, match=r"the mode of r with the eigenvalue 1\.\d+ is not cont"
    ):
        lqr(stuck, np.zeros(4), np.zeros(1))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"deviations": {"q": 1.0}}, "no 'q' among the states and inputs"),
        ({"deviations": {"s": 0.0}}, "s = 0"),
        ({"deviations": {"integral_s": 1.0}}, "no 'integral_s'"),
        ({"integral": ["q"]}, "no 'q' among the coordinates"),
        ({"delay": -1}, "a delay of -1 samples"),
        ({"x": np.zeros(3)}, "2 finite numbers"),
    ],
)
def test_wrong_arguments_are_refused(options, words):
    arguments = {"x": np.zeros(2), "u": np.zeros(1)} | options
    with pytest.raises(tn.InputError, match=words):
        lqr(double_integrator(), **arguments)


@pytest.mark.thorough
def test_feedback_along_a_plan_brings_disturbed_starts_to_its_end():
    model = example("qube")
    limits = {"voltage": (-10.0, 10.0)}
    plan = ilqr(model, [0, np.pi, 0, 0], np.zeros(4), 250, limits={"voltage": (-8.0, 8.0)})
    final = lqr(model, np.zeros(4), np.zeros(1), limits=limits)
    tracking = time_varying_lqr(model, plan, final)
    assert tracking.gains.shape == (250, 1, 4)
    states = play(model, TrackingFeedback(tracking), [0.05, np.pi + 0.05, 0, 0], 500)
    np.testing.assert_allclose(states[-1], plan.goal, atol=1e-3)
    late = lqr(model, np.zeros(4), np.zeros(1), limits=limits, delay=1)
    with pytest.raises(tn.InputError, match=r"a plan of 0\.01 s a sample, 0 samples late"):
        time_varying_lqr(model, plan, late)


def test_after_a_fall_it_settles_and_begins_again():
    model, hanging = example("qube"), np.array([0, np.pi, 0, 0])
    limits = {"voltage": (-10.0, 10.0)}
    plan = ilqr(model, hanging, np.zeros(4), 250, limits={"voltage": (-8.0, 8.0)})
    final = lqr(model, np.zeros(4), np.zeros(1), limits=limits)
    settle = lqr(model, hanging, np.zeros(1), limits=limits)
    tracking = time_varying_lqr(model, plan, final, settle=settle)
    recovery = tracking.recovery
    assert recovery is not None
    # a quarter of the pendulum's way, which is half a turn; a tenth of all ranges along the plan
    np.testing.assert_allclose(recovery.fallen_beyond, [0, np.pi / 4, 0, 0])
    np.testing.assert_allclose(recovery.settled_within, 0.1 * np.ptp(plan.x, axis=0))
    step, phases, x, controller = tn.compiled_step(model), [], hanging, TrackingFeedback(tracking)
    for k in range(1500):
        x = step(x, controller.inputs(k, x))
        phases.append(controller.phase)
        if k == 400:
            x = np.add(x, [0, 0, 0, 30.0])
    assert [phase for phase, _ in groupby(phases)] == ["plan", "hold", "settle", "plan", "hold"]
    assert phases[400] == "hold"
    np.testing.assert_allclose(np.sin(x), np.zeros(4), atol=1e-3)
    assert np.cos(x[1]) > 0
    summed = lqr(model, hanging, np.zeros(1), limits=limits, integral=["theta"])
    weak = lqr(model, hanging, np.zeros(1), limits={"voltage": (-5.0, 5.0)})
    for other in (summed, weak):
        with pytest.raises(tn.InputError, match="settle: a feedback with integrals, or of another"):
            time_varying_lqr(model, plan, final, settle=other)


def test_gains_along_a_plan_at_rest_are_those_of_the_point():
    model = double_integrator()
    plan = ilqr(model, np.zeros(2), np.zeros(2), 20)
    final = lqr(model, np.zeros(2), np.zeros(1))
    tracking = time_varying_lqr(model, plan, final)
    np.testing.assert_allclose(tracking.gains, np.tile(final.gain, (20, 1, 1)), rtol=1e-6)


def test_the_operating_point_may_be_an_equilibrium_with_inputs():
    model = example("qube")
    point = find_equilibrium(model, {"theta": 0.5, "alpha": 0.0})
    controller = LinearFeedback(lqr(model, point.x, point.u))
    states = play(model, controller, point.x + np.array([0.1, 0.1, 0, 0]), 500)
    np.testing.assert_allclose(states[-1], point.x, atol=1e-3)


def test_an_estimator_in_the_loop_makes_its_margins_smaller():
    model = double_integrator()
    feedback = lqr(model, np.zeros(2), np.zeros(1))
    noise = FilterNoise(np.ones(2), np.array([1e-3, 1e-2]), np.array([1e-2]))
    known, found = margins(model, feedback), margins(model, feedback, noise)
    assert (known.has_estimator, found.has_estimator) == (False, True)
    assert found.inputs[0].delay < known.inputs[0].delay

    def last(factor):
        """The state after many periods, with a filter over the model and a stronger input."""
        p, x, estimate, shown = np.eye(2), np.ones(2), np.zeros(2), np.eye(1, 2)
        for _ in range(6000):
            k = p @ shown.T / (shown @ p @ shown.T + noise.measured[0] ** 2)
            estimate = estimate + k @ (shown @ (x - estimate))
            u = -feedback.gain @ estimate
            x = model.a @ x + model.b @ (factor * u)
            estimate = model.a @ estimate + model.b @ u
            p = model.a @ (p - k @ shown @ p) @ model.a.T + np.diag(noise.process**2)
        return np.abs(x).max()

    gain = found.inputs[0].gain_up
    assert last(0.98 * gain) < 0.1 < last(1.02 * gain)


class _Rubbing(LinearMachine):
    """Two masses on a damped shaft; both rub, and the first one is driven."""

    def step(self, x, u):
        shaft = 200 * (x[1] - x[0]) + 0.1 * (x[3] - x[2])
        dry = 0.5 * jnp.tanh(x[2:] / 1e-3)
        v = x[2:] + 0.01 * (jnp.array([1.0, -1.0]) * shaft - dry + jnp.array([1.0, 0.0]) * u)
        return jnp.concatenate([x[:2] + 0.01 * v, v])


def rubbing_masses():
    coordinates = (tn.Coordinate("motor", "linear"), tn.Coordinate("load", "linear"))
    channels = tn.Channels(coordinates, (tn.Input("u", "N", None, (-50.0, 50.0)),), 0.01)
    return _Rubbing(np.eye(4), np.zeros((4, 1)), channels)


def test_feedback_needs_no_dry_friction_to_be_stable():
    model = rubbing_masses()
    feedback = lqr(model, np.zeros(4), np.zeros(1), deviations={"load": 0.02})
    assert not margins(model, feedback).needs_friction
    usual, fast = (
        loop_matrices(controlled(model), feedback.x0, feedback.u0, k * feedback.speeds)
        for k in (1, FAST)
    )
    without = loop_without_friction(usual, fast)
    x = np.array([0.0, 0.0, 1.0, 1.0])
    free = _Rubbing.step(model, 1e3 * x, np.zeros(1)) - 1e3 * x
    np.testing.assert_allclose(without.a @ x - x, free / 1e3, atol=1e-3)
    needy = replace(feedback, gain=50 * feedback.gain)
    with pytest.raises(tn.InputError, match="eigenvalue"):
        margins(model, needy)


def test_masses_on_a_shaft_stick_together():
    model = rubbing_masses()
    feedback = lqr(model, np.zeros(4), np.zeros(1), deviations={"load": 0.1})
    motor, load = feedback.gain[0, :2]
    # the input gives the friction of both, and the shaft is twisted by that of the load
    farthest = (0.5 + 0.5 * (1 + motor / 200)) / (motor + load)
    found = sticking_distances(model, feedback)
    assert found["load"] == pytest.approx(farthest, rel=0.02)


def test_a_short_way_makes_feedback_and_goal_stricter():
    model = double_integrator()
    ranges = Range(np.array([[-2.0, 2.0], [-3.0, 3.0]]), np.array([[-2.0, 2.0]]))
    short, long = (
        design_controller(model, ControlTask({"s": goal}, start={"s": 0.0}), range=ranges)
        for goal in (0.2, 1.9)
    )
    assert short.goal.window["s"] == pytest.approx(0.02)
    assert long.goal.window["s"] == pytest.approx(0.19)
    assert short.feedback.gain[0, 0] > 2 * long.feedback.gain[0, 0]
