"""Continuous models made discrete, held inputs and straight lines, fixed and adaptive steps."""

import sys
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

import tustinnet as tn
from tustinnet.channels import Hold
from tustinnet.models.integrate import discretise
from tustinnet.simulate.input_signal import input_signal

DT = 0.02


def system(hold: Hold = "zero-order", gravity: float = 0.0) -> tn.LagrangianSystem:
    """A mass of 1 that a force pushes along; with gravity, a pendulum."""
    return tn.LagrangianSystem(
        name="body",
        coordinates=(tn.Coordinate("place", "angular"),),
        inputs=(tn.Input("force", "N", hold),),
        parameters=(tn.Parameter("gravity", "1/s^2", gravity, 0.0, 100.0),),
        kinetic=lambda q, v, p: v[0] ** 2 / 2,
        potential=lambda q, p: -p["gravity"] * jnp.cos(q[0]),
        input_map=lambda q, v, u, p: u,
    )


def body(hold: Hold = "zero-order", gravity: float = 0.0) -> tn.LagrangianModel:
    return tn.LagrangianModel(system(hold, gravity), {"gravity": jnp.asarray(gravity)})


def pushed(u: np.ndarray, hold: Hold = "zero-order", dt: float = DT) -> tn.Experiment:
    """A record of nothing but its input."""
    return tn.from_arrays(
        np.zeros(len(u)), u, dt=dt, coordinates=system().coordinates, inputs=system(hold).inputs
    )


def run(model: tn.LagrangianModel, e: tn.Experiment, substeps: int = 1) -> np.ndarray:
    discrete = discretise(model, e.dt, substeps)
    return np.asarray(tn.rollout(discrete, np.array([0.3, 0.0]), input_signal(discrete, e)))


def model_inputs(model: tn.LagrangianModel, e: tn.Experiment) -> Array:
    """What the steps of a record are driven by."""
    return jnp.asarray(input_signal(discretise(model, DT), e).u)


def test_a_held_input_drives_by_its_samples_and_a_straight_line_by_its_slope_too():
    u = np.array([1.0, 4.0, 2.0])
    held_samples = model_inputs(body(), pushed(u))
    np.testing.assert_array_equal(held_samples, [[1.0], [4.0]])
    lines = model_inputs(body("first-order"), pushed(u, "first-order"))
    np.testing.assert_array_equal(lines, [[[1.0], [3.0]], [[4.0], [-2.0]]])


def test_a_ramp_under_a_first_order_hold_is_integrated_exactly():
    t = np.arange(30) * DT
    result = run(body("first-order"), pushed(5.0 * t - 1.0, "first-order"))
    exact = np.stack([0.3 + 5.0 * t**3 / 6 - t**2 / 2, 5.0 * t**2 / 2 - t], axis=1)
    np.testing.assert_allclose(result, exact, rtol=1e-12, atol=1e-13)


def test_a_constant_under_a_zero_order_hold_is_integrated_exactly():
    t = np.arange(30) * DT
    result = run(body(), pushed(np.full(30, 7.0)), 3)
    np.testing.assert_allclose(result[:, 0], 0.3 + 3.5 * t**2, rtol=1e-12)


@pytest.mark.thorough
def test_the_order_is_four_while_the_input_follows_a_straight_line():
    e = pushed(np.linspace(-30.0, 40.0, 5), "first-order", 0.1)
    model = body("first-order", gravity=20.0)
    exact = run(model, e, 64)[-1]
    errors = [np.linalg.norm(run(model, e, n)[-1] - exact) for n in (2, 4, 8)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(orders - 4).max() < 0.35


@pytest.mark.thorough
def test_a_band_limited_input_is_followed_far_more_closely_than_by_straight_lines():
    """Up to 0.3 of the sampling rate, over 40 periods in the middle of a record."""
    t = np.arange(160) * DT
    rates = 2 * np.pi * np.array([0.07, 0.2, 0.3]) / DT
    u = np.cos(np.multiply.outer(t, rates)).sum(axis=1)
    exact = (np.sin(np.multiply.outer(t, rates)) / rates).sum(axis=1)

    def errs(hold: Hold) -> float:
        model = discretise(body(hold), DT, 4)
        drive = input_signal(model, pushed(u, hold))[60:100]
        v = tn.rollout(model, np.array([0.0, exact[60]]), drive)[:, 1]
        return float(np.abs(np.asarray(v) - exact[60:101]).max())

    assert errs("band-limited") < 1e-3 * errs("first-order") < 1e-3 * errs("zero-order")


@pytest.mark.thorough
@pytest.mark.parametrize(("hold", "order"), [("zero-order", 1), ("first-order", 2)])
def test_the_order_in_the_sampling_period_is_that_of_the_hold(hold, order):
    """Of a smooth input, what happens between the samples is lost to the hold."""

    def end(samples: int) -> float:
        t = np.linspace(0.0, 1.0, samples + 1)
        return float(run(body(hold), pushed(10 * np.cos(3 * t), hold, 1 / samples))[-1, 0])

    exact = 0.3 + 10 / 9 * (1 - np.cos(3.0))
    errors = np.abs(np.array([end(20), end(40)]) - exact)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_held_input_never_acts_before_its_sample(substeps):
    u = np.random.default_rng(0).normal(size=(20, 1))
    later = u.copy()
    later[8:] += 5.0
    model = discretise(body(gravity=9.0), DT, substeps)
    before, after = (np.asarray(tn.rollout(model, np.zeros(2), drive)) for drive in (u, later))
    np.testing.assert_array_equal(before[:9], after[:9])
    assert np.all(before[9:, 1] != after[9:, 1])


def test_only_inputs_on_a_straight_line_look_at_the_next_sample():
    both = replace(
        system(),
        inputs=(tn.Input("held", "N"), tn.Input("line", "N", "first-order")),
        input_map=lambda q, v, u, p: u[:1] + u[1:],
    )
    model = discretise(tn.LagrangianModel(both, {"gravity": jnp.asarray(0.0)}), DT)

    def velocity(u: list[list[float]]) -> float:
        e = tn.from_arrays(np.zeros(2), u, dt=DT, coordinates=both.coordinates, inputs=both.inputs)
        return float(tn.rollout(model, np.zeros(2), input_signal(model, e))[1, 1])

    assert velocity([[1.0, 2.0], [100.0, 2.0]]) == pytest.approx(3.0 * DT)
    assert velocity([[1.0, 2.0], [1.0, 6.0]]) == pytest.approx(5.0 * DT)


@pytest.mark.parametrize(("dt", "substeps"), [(0.0, 1), (-0.01, 1), (np.nan, 1), (0.01, -1)])
def test_steps_that_are_none_are_refused(dt, substeps):
    with pytest.raises(tn.InputError, match="discretise: period"):
        discretise(body(), dt, substeps)


# --- adaptive steps ---


@pytest.mark.thorough
@pytest.mark.parametrize("hold", ["zero-order", "first-order"])
def test_adaptive_steps_agree_with_many_fixed_ones(hold):
    noise = np.random.default_rng(1).uniform(-30, 30, 60)
    e = pushed(noise, hold)
    model = tn.discretise_adaptively(body(hold, gravity=20.0), DT, 1e-11)
    result = tn.rollout(model, np.array([0.3, 0.0]), input_signal(model, e))
    np.testing.assert_allclose(result, run(body(hold, gravity=20.0), e, 32), atol=1e-8)


def test_an_adaptive_model_is_one_like_any_other():
    e = pushed(np.zeros(20))
    model = tn.discretise_adaptively(body(gravity=20.0), DT)
    with pytest.warns(UserWarning, match="'maybe_set'.*simulated by JAX instead"):
        score = tn.evaluate(model, [e], "derived-6")[0]
    assert score.rmse == pytest.approx(0.0, abs=1e-12)
    assert tn.discretise_adaptively(body(), DT).internal == ()


def test_without_the_package_adaptive_steps_are_refused_with_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "diffrax", None)
    with pytest.raises(tn.InputError, match=r"diffrax is not installed.*tustinnet\[adaptive\]"):
        tn.discretise_adaptively(body(), DT)


@pytest.mark.parametrize(("dt", "tolerance"), [(0.0, 1e-9), (0.01, 0.0), (0.01, np.nan)])
def test_adaptive_steps_to_no_tolerance_are_refused(dt, tolerance):
    with pytest.raises(tn.InputError, match=r"discretise_adaptively: .*positive numbers"):
        tn.discretise_adaptively(body(), dt, tolerance)
