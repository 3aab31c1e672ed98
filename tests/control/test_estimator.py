"""The filter of a controller: states from encoders, noise from records, tests of both."""

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import example
from swinging import CREEPING, DT, SWING, simulated, swing_model, voltage

import tustinnet as tn
from tustinnet.control.estimator import ExtendedKalmanFilter, check_filter, find_noise
from tustinnet.control.input_history import InputHistory, find_causal_layout
from tustinnet.control.plants import ModelPlant
from tustinnet.control.sampled_plant import PlantOptions
from tustinnet.errors import InputError
from tustinnet.simulate.filtering import FilterNoise, kalman_filter
from tustinnet.simulate.input_signal import input_signal

COUNT = 2 * np.pi / 2048


def noise(n_x: int, n_q: int = 1, process: float = 1e-3) -> FilterNoise:
    return FilterNoise(np.full(n_x, 2.0), np.full(n_x, process), np.full(n_q, COUNT / 4))


def quantised(name: str, u: np.ndarray, **values: float) -> tn.Experiment:
    """A run of the swing as an encoder reads it, which declares its counts."""
    record = simulated(name, [0.3, 0.0], u, {"gravity": 1.5, "gain": 0.15, **values})
    return tn.from_arrays(
        np.round(record.q / COUNT) * COUNT,
        u[:, None],
        dt=DT,
        name=name,
        coordinates=(tn.Coordinate("angle", "angular", COUNT),),
        inputs=SWING.inputs,
    )


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["qube memory", "network taps", "hybrid lag", "gru", "linear"])
def test_sample_by_sample_it_is_the_filter_of_a_record(name):
    model = example(name)
    n_q, n_u = model.channels.n_q, model.channels.n_u
    generator = np.random.default_rng(0)
    u, q = generator.normal(size=(60, n_u)), 0.02 * generator.normal(size=(60, n_q)).cumsum(axis=0)
    record = tn.from_arrays(
        q, u, dt=model.dt, coordinates=model.coordinates, inputs=model.inputs, name="run"
    )
    given = noise(model.state_size, n_q, 0.1)
    estimator = ExtendedKalmanFilter(model, given)
    first = estimator.reset(q[0])
    x0 = np.asarray(model.initial_state(jnp.asarray(np.r_[q[0], np.zeros(n_q)]), jnp.zeros(n_u)))
    expected = kalman_filter(model, record, x0, given).states
    np.testing.assert_allclose(first, expected[0], rtol=1e-9, atol=1e-12)
    rows = [estimator.update(y, v) for y, v in zip(q[1:], u[:-1], strict=True)]
    if max(model.step_layout.taps, default=0) <= 0 and name != "hybrid lag":
        # what it does not know yet is the next input
        np.testing.assert_allclose(rows[5:], expected[6:], rtol=1e-6, atol=1e-9)
    assert np.isfinite(rows).all()
    assert estimator.covariance.shape == (model.state_size,) * 2


def test_whole_turns_of_an_encoder_that_wraps_do_not_matter():
    model = example("qube")
    plain, wrapped = (ExtendedKalmanFilter(model, noise(4, 2)) for _ in range(2))
    q = np.stack([np.zeros(50), np.linspace(3.0, 3.4, 50)], axis=1)
    plain.reset(q[0])
    wrapped.reset(q[0])
    for y in q[1:]:
        x = plain.update(y, np.zeros(1))
        again = wrapped.update((y + np.pi) % (2 * np.pi) - np.pi, np.zeros(1))
        np.testing.assert_allclose(again, x, atol=1e-9)


def test_at_an_unstable_equilibrium_it_lasts():
    model = example("qube")
    estimator = ExtendedKalmanFilter(model, noise(4, 2, 0.1))
    x = estimator.reset(np.zeros(2))
    for _ in range(5000):
        x = estimator.update(np.zeros(2), np.zeros(1))
    assert np.abs(x).max() < 1e-6
    covariance = estimator.covariance
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-18)
    assert np.abs(estimator.normalised_innovations).max() < 1e-6


def test_a_delay_of_the_inputs_is_known():
    late = tn.Input("voltage", "V", delay=2.5 * DT)
    model = tn.discretise(swing_model(), DT, inputs=(late,))
    layout = find_causal_layout(model)
    history = InputHistory(len(layout.offsets))
    u = voltage(40, 3)[:, None]
    record = tn.from_arrays(
        np.zeros((40, 1)), u, dt=DT, coordinates=SWING.coordinates, inputs=(late,), name="late"
    )
    expected = np.asarray(input_signal(model, record).u).reshape(39, -1)
    rows = [layout.matrix @ history.add(now) for now in u[:-1]]
    np.testing.assert_allclose(rows[5:], expected[5:], rtol=1e-12)
    history.reset()
    np.testing.assert_array_equal(layout.matrix @ history.add(u[0]), np.zeros(2))


@pytest.mark.thorough
def test_noise_of_a_right_model_is_that_of_its_encoder():
    records = [quantised(f"run{i}", voltage(250, i)) for i in range(4)]
    right = tn.discretise(swing_model(), DT, 4)
    found = find_noise(right, records[:2])
    np.testing.assert_allclose(found.measured, COUNT / np.sqrt(12))
    consistency = check_filter(right, records[2:], found)
    assert consistency.is_consistent
    assert consistency.nis[0] > 0.7
    assert "innovations are" in consistency.sentences[0]
    # better than whatever has no model, which differs little in its two forms
    own, low_pass, parabola = consistency.velocity_errors[:, 0]
    assert own < 0.8 * parabola < 0.8 * low_pass
    assert "no use" not in consistency.sentences[1]

    wrong = tn.discretise(swing_model({"gravity": 1.2}), DT, 4)
    of_wrong = find_noise(wrong, records[:2])
    assert of_wrong.process[1] > 3 * found.process[1]
    # with noise that is too small for it the wrong model shows
    consistency = check_filter(wrong, records[2:], found)
    assert not consistency.is_consistent
    assert not consistency.is_white
    assert "too sure of itself" in consistency.sentences[0]
    assert "not white" in consistency.sentences[0]
    assert check_filter(wrong, records[2:], of_wrong).nis[0] < 2
    # a model of another machine, trusted wholly
    other = tn.discretise(swing_model({"gravity": 8.0}), DT, 4)
    assert "of no use to it" in check_filter(other, records[2:], found).sentences[1]


@pytest.mark.thorough
def test_noise_of_internal_states_and_of_an_unknown_resolution_is_found():
    model = tn.discretise(swing_model(system=CREEPING), DT, 2)
    generator = np.random.default_rng(1)
    record = simulated("creeping", [0.3, 0.0, 0.0], voltage(300, 1), system=CREEPING)
    q = record.q + 2e-3 * generator.normal(size=record.q.shape)
    noisy = tn.from_arrays(
        q, record.u, dt=DT, coordinates=SWING.coordinates, inputs=SWING.inputs, name="noisy"
    )
    found = find_noise(model, [noisy])
    assert found.process.shape == (3,)
    np.testing.assert_allclose(found.measured, 2e-3, rtol=0.3)


def test_what_it_cannot_compute_with_is_refused():
    with pytest.raises(InputError, match=r"start .* expected 4 finite"):
        ExtendedKalmanFilter(example("qube"), noise(3, 2))
    with pytest.raises(InputError, match="60 samples or more"):
        find_noise(example("qube"), [])


def test_the_filters_plant_is_followed_through_encoders():
    model = example("qube memory")
    plant = ModelPlant(model, options=PlantOptions(counts=[COUNT, COUNT]))
    estimator = ExtendedKalmanFilter(model, noise(5, 2))
    plant.reset(np.array([0.0, 2.5]), 1)
    x = estimator.reset(plant.measure())
    for k in range(300):
        u = np.array([2.0 * np.sin(k / 7)])
        plant.apply(u)
        x = estimator.update(plant.measure(), u)
    np.testing.assert_allclose(x[:2], plant.state[:2], atol=2 * COUNT)
    np.testing.assert_allclose(x[2:4], plant.state[2:4], atol=0.1)
