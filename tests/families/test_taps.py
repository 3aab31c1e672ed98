"""Networks that see neighbouring samples of the inputs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import DT, records, swing_model

import tustinnet as tn
from tustinnet.families.hybrid import HybridModel
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.models.blocks import learn_scaling
from tustinnet.models.contract import with_dtype
from tustinnet.simulate.input_signal import input_signal

TAPS = (-1, 0, 2)
SMALL = {
    "name": "small",
    "model": {"kind": "tustin-net", "hidden": [6], "input_taps": list(TAPS)},
    "stages": [
        {
            "name": "one",
            "epochs": 1,
            "batch": 8,
            "rate": 1e-3,
            "windows": {"draw": "random", "length": 10, "count": 8},
        }
    ],
}


@pytest.fixture(scope="module")
def swings() -> tn.DataSet:
    """Records of a driven pendulum."""
    return tn.DataSet("swings", tuple(records()))


def tapped(swings: tn.DataSet) -> tn.TustinNet:
    model = random_tustin_net(
        swings.channels, learn_scaling(list(swings)), jax.random.key(0), taps=TAPS, hidden=(6,)
    )
    return with_dtype(model, np.float64)


def test_a_step_is_given_the_samples_at_the_taps(swings):
    model, e = tapped(swings), swings[-1]
    given = jnp.asarray(input_signal(model, e).u)
    np.testing.assert_array_equal(given[5], e.u[[4, 5, 7]])
    np.testing.assert_array_equal(given[0], e.u[[0, 0, 2]])  # before the record: its first sample
    np.testing.assert_array_equal(given[-1], e.u[[-3, -2, -1]])
    x = jnp.array([0.3, -0.2])
    held = jnp.repeat(jnp.asarray(e.u[:1]), 3, axis=0)
    np.testing.assert_array_equal(model.step(x, jnp.asarray(e.u[0])), model.step(x, held))
    assert np.any(
        model.step(x, given[5]) != model.step(x, jnp.repeat(jnp.asarray(e.u[5:6]), 3, axis=0))
    )


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["tustin-net", "gru", "hybrid"])
def test_a_network_with_taps_trains_and_is_restored(kind, swings, tmp_path):
    physics = tn.discretise(swing_model(), DT)
    tables = {
        "tustin-net": SMALL["model"],
        "gru": {"kind": "gru", "hidden": 3, "warm_up": 6, "input_taps": [0, 1]},
        "hybrid": {"kind": "hybrid", "correction": SMALL["model"]},
    }
    recipe = tn.read_recipe({**SMALL, "model": tables[kind]})
    found = tn.fit(swings, recipe, physics=physics if kind == "hybrid" else None)
    system = swing_model().system if kind == "hybrid" else None
    tn.save(found.model, tmp_path / "m.safetensors")
    loaded = tn.load_model(tmp_path / "m.safetensors", system)
    start = f"warm-up-{loaded.warm_up}" if loaded.warm_up else "derived-6"
    a, b = (tn.free_run(m, swings[-1], start)[0] for m in (found.model, loaded))
    np.testing.assert_allclose(a, b)


def test_a_correction_sees_its_taps_and_the_physics_what_it_always_did(swings):
    physics, e = tn.discretise(swing_model(), DT), swings[-1]
    correction = tapped(swings)
    silent = HybridModel(physics, correction.with_zero_output())
    x = np.array([0.4, 0.1])
    np.testing.assert_allclose(
        tn.rollout(silent, x, input_signal(silent, e)),
        tn.rollout(physics, x, input_signal(physics, e)),
        rtol=1e-12,
        atol=1e-14,
    )
    both = HybridModel(physics, correction)
    given = jnp.asarray(input_signal(both, e).u)[5]
    change = both.step(jnp.asarray(x), given) - physics.step(jnp.asarray(x), jnp.asarray(e.u[5]))
    expected = correction.acceleration(jnp.asarray(x), jnp.asarray(e.u[[4, 5, 7]]))
    np.testing.assert_allclose(change[1:] / DT, expected)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"kind": "tustin-net", "input_taps": [0, 0]}, r"input_taps.*a tap twice: \[0, 0\]"),
        ({"kind": "neural-ode", "input_taps": [0]}, "input_taps"),
    ],
)
def test_taps_that_mean_nothing_are_refused(model, message):
    with pytest.raises(tn.InputError, match=message):
        tn.read_recipe({**SMALL, "model": model})


def test_a_compiled_step_holds_its_input_at_all_taps(swings):
    model = tapped(swings)
    x, u = np.array([0.3, -0.2]), np.array([0.7])
    np.testing.assert_allclose(
        tn.compiled_step(model)(x, u), model.step(jnp.asarray(x), jnp.asarray(u))
    )
