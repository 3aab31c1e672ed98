"""Sensors and actuators that are off, sensor_parameters as parameters."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from swinging import CART, SWING, TRUTH, changed, data_set, falls, records

import tustinnet as tn
from tustinnet.fitting.shooting.sensor_errors import sensor_parameters
from tustinnet.models.lagrangian import Parameter
from tustinnet.models.sensors import with_sensor_errors

BIAS, INPUT_GAIN = 0.035, 1.1
KNOWN_GAIN = changed("gain", nominal=TRUTH["gain"], fixed=True)


def skewed() -> list[tn.Experiment]:
    """The records as an encoder with another zero reads them, the voltage read too small."""
    return [replace(e, q=e.q + BIAS, u=e.u / INPUT_GAIN) for e in records()]


@pytest.fixture(scope="module")
def result() -> tn.Identification:
    recipe = tn.read_recipe("grey", ['model.free=["angle.bias", "voltage.gain"]'])
    return tn.identify(data_set(skewed()), KNOWN_GAIN, recipe)


def test_bias_and_gain_are_found_with_the_parameters(result):
    values = {e.name: e.value for e in result.estimates}
    assert values["angle.bias"] == pytest.approx(BIAS, abs=1e-4)
    assert values["voltage.gain"] == pytest.approx(INPUT_GAIN, rel=1e-3)
    assert values["gravity"] == pytest.approx(TRUTH["gravity"], rel=1e-3)
    units = {e.name: (e.unit, e.lower, e.upper) for e in result.estimates}
    assert units["angle.bias"] == ("rad", -0.5, 0.5)
    assert units["voltage.gain"] == ("1", 0.5, 2.0)
    assert tn.mean_rmse(tn.evaluate(result.model, skewed(), "file")) < 1e-3


def test_a_file_keeps_them(result, tmp_path):
    tn.save(result.model, tmp_path / "m.safetensors")
    again = tn.load_model(tmp_path / "m.safetensors", KNOWN_GAIN)
    x, u = jnp.array([0.3, -1.0]), jnp.array([2.0])
    np.testing.assert_allclose(again.step(x, u), result.model.step(x, u), rtol=1e-12)


@pytest.mark.thorough
def test_what_stands_for_the_same_is_said():
    loose = tn.read_recipe("grey", ['model.free=["voltage.gain"]'])
    message = " ".join(map(str, tn.identify(data_set(records()), SWING, loose).findings))
    assert "gain and voltage.gain are not identifiable separately" in message
    assert "was fixed at its first value" in message


@pytest.mark.thorough
def test_measured_motion_is_the_physical_one_through_the_sensors():
    """A cart with a pendulum: accelerations, mass matrix and energy of both descriptions."""
    cart = CART
    off = {"x.gain": 1.2, "x.bias": 0.1, "angle.bias": 0.3, "force.gain": 0.8, "force.bias": 0.5}
    sensors = tuple(Parameter(name, "", value, 0.0, 2.0) for name, value in off.items())
    measured_model = with_sensor_errors(cart, sensors).model({"mass": jnp.asarray(1.0), **off})
    plain = cart.model({"mass": jnp.asarray(1.0)})
    q, v, u = jnp.array([0.4, 0.9]), jnp.array([0.7, -1.1]), jnp.array([2.0])
    gain, bias = jnp.array([1.2, 1.0]), jnp.array([0.1, 0.3])
    measured = jnp.concatenate([gain * q + bias, gain * v])
    physical = plain.acceleration(jnp.concatenate([q, v]), 0.8 * u + 0.5)
    np.testing.assert_allclose(
        measured_model.acceleration(measured, u), gain * physical, rtol=1e-10
    )
    np.testing.assert_allclose(
        measured_model.energy(measured), plain.energy(jnp.concatenate([q, v]))
    )
    assert with_sensor_errors(cart, ()) is cart


@pytest.mark.parametrize(
    ("free", "message"),
    [
        (["tilt.bias"], "no channel 'tilt'"),
        (
            ["bias"],
            r"no channel ''; expected CHANNEL\.bias, .* of an input, CHANNEL\.delay of angle",
        ),
        (["angle.bias", "angle.bias"], "'angle.bias' twice"),
        (["angle.delay"], "a delay common to all sensors is the same as one of the inputs"),
        (["angle.scale"], "expected angle.bias or angle.gain"),
    ],
)
def test_what_cannot_be_freed_is_refused_by_name(free, message):
    with pytest.raises(tn.InputError, match=message) as refused:
        sensor_parameters(SWING, free, falls())
    assert "\n" not in str(refused.value)


def test_an_input_that_is_never_used_has_no_bias():
    with pytest.raises(tn.InputError, match="'voltage' never moves"):
        sensor_parameters(SWING, ["voltage.bias"], falls())


@pytest.mark.thorough
def test_they_are_fixed_and_begun_like_any_other():
    recipe = tn.read_recipe(
        "grey", ['model.free=["angle.bias", "voltage.gain"]', "model.fixed.angle.bias=0.035"]
    )
    result = tn.identify(data_set(skewed()), KNOWN_GAIN, recipe, begin={"voltage.gain": 1.3})
    assert result.fixed["angle.bias"] == 0.035
    assert "voltage.gain" in {e.name for e in result.estimates}


def test_kinds_with_weights_do_not_know_the_key():
    with pytest.raises(tn.InputError, match="free"):
        tn.read_recipe("standard", ['model.free=["angle.bias"]'])
