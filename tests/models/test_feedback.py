"""Controllers in the loop: what is held from sample to sample, and what acts all the time."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from held_swings import KD, KP, LIMIT, held_swings
from swinging import COUNT, LAGGING, SWING, TRUTH

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.models.added import with_forces
from tustinnet.models.closed_loop import with_controller
from tustinnet.models.lagrangian import LagrangianModel

GAINS = (
    tn.Parameter("angle.kp", "V/rad", KP, KP, KP, fixed=True),
    tn.Parameter("angle.kd", "V s/rad", KD, KD, KD, fixed=True),
)


@pytest.fixture(scope="module")
def record() -> tn.Experiment:
    return held_swings(1)[0]


def closed_model(record, system=SWING, substeps=4, **values):
    closed = with_controller(system, record.channels, GAINS)
    everything = closed.nominal() | TRUTH | values
    model = closed.model({name: jnp.asarray(x) for name, x in everything.items()})
    return tn.discretise(model, record.dt, substeps, inputs=record.inputs)


def test_whole_records_are_followed_to_the_encoders_counts(record):
    model = closed_model(record)
    (score,) = tn.evaluate(model, [record], "derived-6")
    assert score.rmse < 2 * record.coordinates[0].resolution
    # what the record's voltage alone does is far from it: the pendulum falls over
    open_loop = tn.discretise(
        SWING.model({name: jnp.asarray(x) for name, x in TRUTH.items()}), record.dt, 4
    )
    (fallen,) = tn.evaluate(open_loop, [record.without_controller()], "derived-6")
    assert fallen.rmse > 0.5


def test_what_is_computed_at_a_sample_is_held(record):
    """A step is one of the system alone with the voltage of the sample, within its limits."""
    model, plant = (
        closed_model(record),
        tn.discretise(
            SWING.model({name: jnp.asarray(x) for name, x in TRUTH.items()}), record.dt, 4
        ),
    )
    for x, w in (([3.4, 0.3], [3.5, 0.1, 0.2]), ([3.4, 9.0], [3.0, 0.1, 0.2])):
        volts = KP * (w[0] - x[0]) + KD * (w[1] - x[1]) + w[2]
        u = jnp.clip(jnp.array([volts]), -LIMIT, LIMIT)
        following = model.step(jnp.array(x), jnp.array(w))
        np.testing.assert_allclose(following, plant.step(jnp.array(x), u), rtol=1e-12)
    assert abs(volts) > LIMIT


def test_a_controller_that_computes_all_the_time(record):
    """Of inputs that are declared first-order: the derivative has the feedback of its state."""
    inputs = tuple(replace(i, hold="first-order") for i in record.channels.inputs)
    channels = replace(record.channels, inputs=inputs)
    continuous = replace(record, channels=channels)
    fine = closed_model(continuous, substeps=8)
    assert isinstance(fine.continuous, LagrangianModel)
    assert fine.continuous.system.feedback is not None
    assert not fine.continuous.system.feedback.is_sampled
    x, w = jnp.array([3.4, 0.3]), jnp.array([3.5, 0.1, 0.2])
    volts = KP * 0.1 - KD * 0.2 + 0.2
    rate = SWING.model({n: jnp.asarray(v) for n, v in TRUTH.items()}).derivative(
        x, jnp.array([volts])
    )
    np.testing.assert_allclose(fine.continuous.derivative(x, w), rate, rtol=1e-12)
    # it responds without the delay of half a period, so it is damped more
    held = tn.evaluate(closed_model(record), [record], "derived-6")[0].rmse
    assert tn.evaluate(fine, [continuous], "derived-6")[0].rmse > 2 * held


LAW = {"ki": 60.0, "velocity_filter": 0.02, "delay": 2}
STATES = ("angle.integral", "angle.filtered_velocity", "voltage.delayed1", "voltage.delayed2")
WITH_INTEGRAL = (*GAINS, tn.Parameter("angle.ki", "V/rad/s", 60.0, 60.0, 60.0, fixed=True))


@pytest.mark.thorough
def test_integral_filter_and_delay_are_those_of_a_sampled_controller():
    """Step by step against the law written by hand, also where the voltage is at its limit."""
    record = held_swings(1, law=LAW, kind="pid", **LAW)[0]
    closed = with_controller(SWING, record.channels, WITH_INTEGRAL)
    assert closed.internal == STATES
    values = {name: jnp.asarray(x) for name, x in (closed.nominal() | TRUTH).items()}
    model = tn.discretise(closed.model(values), record.dt, 4, inputs=record.inputs)
    plant = tn.discretise(
        SWING.model({name: jnp.asarray(x) for name, x in TRUTH.items()}), record.dt, 4
    )
    move, move_plant = eqx.filter_jit(model.step), eqx.filter_jit(plant.step)
    share = 1.0 - np.exp(-record.dt / 0.02)
    x, integral, speed, coming = jnp.array([3.4, 0.3]), 0.7, 0.1, [1.0, -2.0]
    own, at_limit = jnp.array([3.4, 0.3, integral, speed, coming[1], coming[0]]), 0
    for w in [[3.5, 0.1, 0.2]] * 4 + [[3.0, 0.0, 0.0]] * 4 + [[4.0, 0.0, 0.0]] * 3:
        error = w[0] - float(x[0])
        speed += share * (float(x[1]) - speed)
        u = KP * error + KD * (w[1] - speed) + integral + w[2]
        at_limit += abs(u) >= LIMIT
        integral += record.dt * 60.0 * error if abs(u) < LIMIT or error * u < 0 else 0.0
        coming.append(float(np.clip(u, -LIMIT, LIMIT)))
        x = move_plant(x, jnp.array([coming.pop(0)]))
        own = move(own, jnp.array(w))
        expected = [*x, integral, speed, coming[1], coming[0]]
        np.testing.assert_allclose(own, expected, rtol=1e-9, atol=1e-12)
    assert 0 < at_limit < 11
    # free runs by the engine are those of the steps, and begin with the integral that holds
    (score,) = tn.evaluate(model, [record], "model-20")
    assert score.rmse < 3 * COUNT


@pytest.mark.thorough
def test_an_integral_begins_with_what_holds_the_system():
    record = held_swings(1, law={"ki": 60.0}, kind="pid", ki=60.0)[0]
    closed = with_controller(SWING, record.channels, WITH_INTEGRAL)
    values = {name: jnp.asarray(x) for name, x in (closed.nominal() | TRUTH).items()}
    model = closed.model(values)
    w = jnp.array([3.0, 0.0, 0.5])
    begun = model.initial_state(jnp.array([2.8, 0.0]), w)
    assert abs(float(model.derivative(begun, w)[1])) < 1e-6
    assert model.searched_internal.tolist() == [True]
    assert model.internal_spread.tolist() == [KP]


def test_a_controller_with_an_integral_that_computes_all_the_time():
    record = held_swings(1, law={"ki": 60.0}, kind="pid", ki=60.0, velocity_filter=0.02)[0]
    inputs = tuple(replace(i, hold="first-order") for i in record.channels.inputs)
    channels = replace(record.channels, inputs=inputs)
    closed = with_controller(SWING, channels, WITH_INTEGRAL)
    values = {name: jnp.asarray(x) for name, x in (closed.nominal() | TRUTH).items()}
    x, w = jnp.array([3.4, 0.3, 0.7, 0.1]), jnp.array([3.5, 0.1, 0.2])
    rate = closed.model(values).derivative(x, w)
    volts = jnp.array([KP * 0.1 + KD * (0.1 - 0.1) + 0.7 + 0.2])
    alone = SWING.model({n: jnp.asarray(v) for n, v in TRUTH.items()}).derivative(x[:2], volts)
    np.testing.assert_allclose(rate[:2], alone, rtol=1e-12)
    np.testing.assert_allclose(rate[2:], [60.0 * 0.1, (0.3 - 0.1) / 0.02], rtol=1e-12)


def test_lags_and_forces_of_the_system_inside(record):
    """A motor that lags follows the controller's voltage; added forces are those of the system."""
    closed = with_controller(LAGGING, record.channels, GAINS)
    assert closed.internal == LAGGING.internal
    assert closed.inputs == record.channels.inputs
    values = {name: jnp.asarray(x) for name, x in closed.nominal().items()}
    x, w = jnp.array([3.4, 0.3, 0.05]), jnp.array([3.5, 0.1, 0.2])
    volts = jnp.array([KP * 0.1 - KD * 0.2 + 0.2])
    np.testing.assert_allclose(
        closed.model(values).derivative(x, w),
        LAGGING.model(values).derivative(x, volts),
        rtol=1e-12,
    )
    stiffness = tn.Parameter("angle.spring", "N m/rad", 0.3, 0.0, 1.0)
    within = with_forces(closed, ("spring:angle",), (stiffness,))
    assert within.plant == with_forces(LAGGING, ("spring:angle",), (stiffness,))
    assert within.feedback is not None
    assert "angle.spring" in within.nominal()


def test_a_gain_of_the_name_of_a_parameter(record):
    named = replace(SWING, parameters=(*SWING.parameters, GAINS[0]))
    with pytest.raises(InputError, match=r"a parameter 'angle\.kp', as the controller has a gain"):
        with_controller(named, record.channels, GAINS)
