"""A filter that is told the positions follows the states of a record."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from every_family import example

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.simulate.filtering import FilterNoise, FilterResult, KalmanFilter, kalman_filter

COUNT = 1e-3  # standard deviation of the measured angle [rad]
LINEAR = "linear"


def run(name: str = "physics", samples: int = 150) -> tuple[tn.Model, tn.Experiment, np.ndarray]:
    """A model, its own noisy run, and its true states."""
    model, generator = example(name), np.random.default_rng(3)
    u = np.cumsum(generator.normal(size=(samples, 1)), axis=0) / 4
    x0 = np.r_[0.4, 1.0, np.zeros(model.state_size - 2)]
    states = np.asarray(tn.rollout(model, x0, u[:-1]))
    q = states[:, :1] + COUNT * generator.normal(size=(samples, 1))
    record = tn.from_arrays(
        q, u, dt=model.dt, coordinates=model.coordinates, inputs=model.inputs, name="run"
    )
    return model, record, states


def noise(n_x: int = 3) -> FilterNoise:
    return FilterNoise(np.full(n_x, 2.0), np.full(n_x, 1e-6), np.full(1, COUNT))


def filtered(record: tn.Experiment, model: tn.Model, n_x: int = 3) -> FilterResult:
    return kalman_filter(model, record, np.zeros(n_x), noise(n_x))


def test_it_finds_states_that_nobody_measured():
    model, record, states = run()
    result = filtered(record, model)
    missed = np.abs(result.states - states)[50:]
    assert missed.max(axis=0)[0] < COUNT  # nearer than what was measured
    assert np.mean(missed < 3 * result.deviations[50:]) > 0.9
    assert np.all(result.deviations[-1] < result.deviations[0])


@pytest.mark.thorough
def test_of_a_linear_model_it_is_the_filter_of_the_textbook():
    model, record, _ = run(LINEAR, 30)
    zero = jnp.zeros(3)
    a, b = jax.jacfwd(model.step, argnums=(0, 1))(zero, jnp.zeros(1))
    drift, given = model.step(zero, jnp.zeros(1)), noise()
    x, p = np.zeros(3), np.diag(np.asarray(given.start) ** 2)
    result = filtered(record, model)
    for k in range(len(record)):
        gain = p[:, :1] / (p[0, 0] + COUNT**2)
        x, p = x + gain @ (record.q[k] - x[:1]), p - gain @ p[:1]
        np.testing.assert_allclose(result.states[k], x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(result.deviations[k], np.sqrt(np.diag(p)), rtol=1e-6)
        x, p = a @ x + b @ record.u[k] + drift, a @ p @ a.T + np.diag(given.process**2)


def test_it_does_not_look_ahead():
    model, record, _ = run()
    whole, half = filtered(record, model), filtered(record[:70], model)
    np.testing.assert_allclose(half.states, whole.states[:70], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": np.ones(2)}, "start .* expected 3 finite numbers"),
        ({"process": np.array([1.0, np.nan, 1.0])}, "process .* expected 3 finite"),
        ({"process": -np.ones(3)}, "process .* standard deviations"),
        ({"measured": np.zeros(1)}, "measured .* above 0"),
    ],
)
def test_what_it_cannot_compute_with_is_refused(change, message):
    model, record, _ = run()
    with pytest.raises(InputError, match=message):
        kalman_filter(model, record, np.zeros(3), dataclasses.replace(noise(), **change))


def test_a_record_of_another_system_is_refused():
    with pytest.raises(InputError, match="coordinates"):
        kalman_filter(example("qube"), run()[1], np.zeros(4), noise(4))


def test_an_estimate_that_diverges_is_not_warned_of_at_every_step():
    """Of a plant that has fallen over; who uses the estimate sees that it is not finite."""
    steep = 1e200 * np.eye(2)
    kalman = KalmanFilter(
        lambda x, u: (steep @ x, steep, np.zeros((2, 1))),
        FilterNoise(np.ones(2), np.ones(2), np.ones(1)),
        run()[1].channels,
        lambda q: np.full(2, np.inf),
    )
    kalman.restart(np.ones(2))
    for _ in range(3):
        kalman.correct(np.ones(1))
        kalman.predict(np.zeros(1))
    assert not np.isfinite(kalman.x).all()
