"""The example of an actuator that lags: its equations, and a lag that is found from a file."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn

FILE = Path(__file__).parents[2] / "examples" / "propeller_pendulum.py"
TRUTH = {"gravity": 21.0, "damping": 0.4, "thrust": 14.0, "lag": 0.09}


@pytest.fixture(scope="module")
def model() -> tn.LagrangianModel:
    system = tn.load_system(FILE)
    return system.model({k: jnp.asarray(x) for k, x in (system.nominal() | TRUTH).items()})


def test_the_thrust_is_that_of_the_speed_which_follows_the_command(model):
    found = model.derivative(jnp.array([0.3, 0.5, -0.6]), jnp.array([0.9]))
    acceleration = -14.0 * 0.6**2 - 21.0 * np.sin(0.3) - 0.4 * 0.5
    np.testing.assert_allclose(found, [0.5, acceleration, 1.5 / 0.09], rtol=1e-6)


def test_the_lag_is_identified_and_loaded_again_with_the_file(model, tmp_path):
    u = np.repeat(np.random.default_rng(0).uniform(-0.9, 0.9, 20), 15)
    simulated = tn.discretise(model, 0.02, 4)
    x = np.asarray(tn.rollout(simulated, np.array([0.2, 0.0, u[0]]), u[:-1, None]))
    channels = {"coordinates": model.system.coordinates, "inputs": model.system.inputs}
    record = tn.from_arrays(x[:, 0], u, v=x[:, 1], dt=0.02, name="steps", **channels)
    result = tn.identify(tn.DataSet("made", (record,)), model.system, tn.read_recipe("grey", []))
    values = {e.name: e.value for e in result.estimates}
    assert values == pytest.approx(TRUTH, rel=0.01)
    tn.save(result.model, tmp_path / "model.safetensors")
    again = tn.load_model(tmp_path / "model.safetensors", FILE)
    assert again.internal == ("spin",)
    np.testing.assert_allclose(again.initial_state(jnp.zeros(2), jnp.array([0.4])), [0, 0, 0.4])
