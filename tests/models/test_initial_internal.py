"""Internal states that a model expects where a record begins."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import network
from swinging import CREEPING, DT, LAGGING, TURNED, read_by_encoder, simulated, swing_model, voltage

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.models.added import with_forces
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import Memory
from tustinnet.models.parameters import Parameter
from tustinnet.models.sensors import with_sensor_errors
from tustinnet.simulate.along import states_along
from tustinnet.simulate.starts import start_states

BEGIN = jnp.array([2.0, 0.5])


def turned(share: float = 0.8) -> tn.Model:
    return tn.discretise(swing_model({"turned": share}, TURNED), DT)


def remembering(initial: Callable[..., Any] | None) -> Memory:
    assert TURNED.memory
    return replace(TURNED.memory, initial=initial)


def record() -> tn.Experiment:
    return simulated("turned", [2.0, 0.5, 1.6], voltage(120, 3), system=TURNED)


def test_most_models_expect_zeros():
    for model in (network(0), tn.discretise(swing_model(system=CREEPING), DT)):
        assert not np.asarray(model.initial_internal(BEGIN)).any()
        assert model.initial_state(BEGIN).shape == (model.state_size,)


def test_a_system_says_what_it_expects():
    np.testing.assert_allclose(turned().initial_state(BEGIN), [2.0, 0.5, 1.6])


def test_a_wrong_shape_is_refused():
    wrong = remembering(lambda q, v, p: jnp.zeros(2))
    with pytest.raises(InputError, match=r"memory initial: returns shape \(2,\); expected \(1,\)"):
        replace(TURNED, memory=wrong)


@pytest.mark.parametrize("start", ["file", "derived-6"])
def test_starts_begin_there(start):
    states = start_states(turned(), [record()], start)
    np.testing.assert_allclose(states[0, 2], 0.8 * states[0, 0], rtol=1e-12)


def test_a_fitted_start_keeps_near_it():
    e = read_by_encoder(record())
    plain = tn.discretise(swing_model(system=CREEPING), DT)
    near, far = (start_states(m, [e], "model-3")[0, 2] for m in (turned(), plain))
    assert abs(near - 1.6) < 0.1 < abs(far - 1.6)


def test_states_along_a_record_begin_there():
    e = record()
    found = states_along(turned(), [e])[0]
    truth = np.asarray(
        tn.rollout(
            tn.discretise(swing_model(system=TURNED), DT, 8), np.array([2.0, 0.5, 1.6]), e.u[:-1]
        )
    )
    np.testing.assert_allclose(found[:, 2], truth[:, 2], atol=1e-4)


def test_models_of_models_say_what_their_parts_expect():
    grey = turned()
    hybrid = tn.HybridModel(grey, network(0))
    np.testing.assert_allclose(hybrid.initial_internal(BEGIN), [1.6])
    both = tn.committee([grey, hybrid, turned(0.5), network(1)])
    np.testing.assert_allclose(both.initial_state(BEGIN), [2.0, 0.5, 1.6, 1.6, 1.0])


def test_models_of_models_say_how_sure_their_parts_are():
    grey, remembers = turned(), network(0, times=(0.2,))
    units = replace(remembers.network.scaling, memory=jnp.array([0.3]))
    remembers = replace(remembers, network=replace(remembers.network, scaling=units))
    hybrid = tn.HybridModel(grey, remembers)
    np.testing.assert_allclose(hybrid.internal_spread, [1.0, 0.03], rtol=1e-6)
    both = tn.committee([network(1), hybrid, grey])
    np.testing.assert_allclose(both.internal_spread, [1.0, 0.03, 1.0], rtol=1e-6)


class Sure(Discretised):
    """A model whose internal states are hardly ever other than expected."""

    @property
    def internal_spread(self):
        return jnp.full(len(self.internal), 1e-3)


def test_a_fitted_start_goes_the_further_the_less_sure_a_model_is():
    e, unsure = read_by_encoder(record()), tn.discretise(swing_model(system=CREEPING), DT)
    sure = Sure(**{field.name: getattr(unsure, field.name) for field in fields(unsure)})
    near, far = (abs(start_states(m, [e], "model-20")[0, 2]) for m in (sure, unsure))
    assert near < 0.1 < 1.0 < far


def test_sensors_keep_it():
    bias = Parameter("angle.bias", "rad", 0.5, -1.0, 1.0)
    off = with_sensor_errors(TURNED, (bias,))
    values = {k: jnp.asarray(x) for k, x in (off.nominal() | {"turned": 0.8}).items()}
    # the true angle is what was read without the bias
    np.testing.assert_allclose(off.model(values).initial_internal(BEGIN), [0.8 * 1.5])


def test_added_forces_keep_it():
    units = {"maxwell": "N m/rad", "relaxation": "1/s", "turned": "1"}
    needs = tuple(Parameter(f"angle.{n}", unit, 0.1, 0.0, 1.0) for n, unit in units.items())
    more = with_forces(TURNED, ("maxwell",), needs)
    values = {k: jnp.asarray(x) for k, x in (more.nominal() | {"turned": 0.8}).items()}
    np.testing.assert_allclose(more.model(values).initial_internal(BEGIN), [1.6, 0.1 * 2.0])


def test_a_file_tells_when_it_has_changed(tmp_path):
    file = tmp_path / "model.safetensors"
    tn.save(turned(), file)
    loaded = tn.load_model(file, TURNED)
    np.testing.assert_allclose(loaded.initial_state(BEGIN), [2.0, 0.5, 1.6])
    other = remembering(lambda q, v, p: 2 * p["turned"] * q)
    with pytest.raises(InputError, match="'creep at a record's beginning' moves otherwise"):
        tn.load_model(file, replace(TURNED, memory=other))
    without = remembering(None)
    with pytest.raises(InputError, match="or begin otherwise"):
        tn.load_model(file, replace(TURNED, memory=without))


def test_what_is_expected_may_depend_on_the_first_input():
    model = tn.discretise(swing_model(system=LAGGING), DT)
    u = voltage(60, 1)
    e = simulated("lagging", [0.4, 0.1, 0.8 * u[0]], u, system=LAGGING)
    begin = 0.8 * e.u[0]
    for start in ("file", "derived-6"):
        np.testing.assert_allclose(start_states(model, [e, e], start)[:, 2], [*begin, *begin])
    np.testing.assert_allclose(states_along(model, [e])[0][0, 2:], begin)
    near = start_states(model, [read_by_encoder(e)], "model-20")
    np.testing.assert_allclose(near[0], [0.4, 0.1, begin[0]], atol=0.3)
    hybrid = tn.HybridModel(model, network(0, times=(0.2,)))
    both = tn.committee([network(1), hybrid, model])
    assert both.initial_needs_inputs
    expected = both.initial_state(BEGIN, jnp.array([2.0]))
    np.testing.assert_allclose(expected, [*BEGIN, 1.6, 0.0, 1.6], rtol=1e-6)
    np.testing.assert_allclose(start_states(both, [e], "file")[0, 2:], [*begin, 0.0, *begin])


def test_sensors_of_inputs_change_what_drives_internal_states():
    gain = Parameter("voltage.gain", "1", 2.0, 0.5, 3.0)
    off = with_sensor_errors(LAGGING, (gain,))
    model = off.model({k: jnp.asarray(x) for k, x in off.nominal().items()})
    np.testing.assert_allclose(model.initial_state(BEGIN, jnp.array([3.0]))[2], 0.8 * 6.0)
    rate = model.derivative(jnp.array([0.0, 0.0, 1.0]), jnp.array([3.0]))[2]
    np.testing.assert_allclose(rate, (6.0 - 1.0) / 0.05, rtol=1e-6)
