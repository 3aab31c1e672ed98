"""Delays of inputs as parameters that are searched for."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from test_holds import DT, SYSTEM, TRUTH, logged

import tustinnet as tn
from tustinnet.channels import Hold
from tustinnet.models.integrate import discretise
from tustinnet.simulate.input_signal import input_signal

RECIPE = {"name": "late", "model": {"kind": "euler-lagrange", "free": ["force.delay"]}}


def asking(name: str) -> dict[str, Any]:
    """The recipe with another parameter free."""
    return {**RECIPE, "model": {"kind": "euler-lagrange", "free": [name]}}


def late(delay: float, hold: Hold = "first-order") -> tn.DataSet:
    """Records whose input acts later than it is written down."""
    records = []
    for seed in range(3):
        e = logged(hold, seed)
        acting = (tn.Input("force", "N", hold, delay=delay),)
        model = discretise(
            SYSTEM.model({k: jnp.asarray(v) for k, v in TRUTH.items()}), DT, 4, inputs=acting
        )
        q = np.asarray(tn.rollout(model, np.zeros(2), input_signal(model, e)))[:, :1]
        records.append(replace(e, q=np.round(q / 1e-4) * 1e-4))
    return tn.DataSet("late", tuple(records))


def test_a_delay_that_the_card_calls_unknown_is_searched_for():
    unknown = (tn.Input("force", "N", "first-order", delay=None),)
    records = tuple(
        replace(e, channels=replace(e.channels, inputs=unknown)) for e in late(0.5 * DT)
    )
    result = tn.identify(tn.DataSet("late", records), SYSTEM)
    assert result.values["force.delay"] == pytest.approx(0.5 * DT, abs=0.01 * DT)
    with pytest.raises(tn.InputError, match=r"record0, input 'force': delay 'unknown', and simul"):
        records[0].excitation()


@pytest.mark.thorough
@pytest.mark.parametrize("hold", ["zero-order", "band-limited"])
def test_a_delay_of_parts_of_a_period_is_found_within_its_interval(hold):
    result = tn.identify(late(1.6 * DT, hold), SYSTEM, RECIPE)
    delay = next(e for e in result.estimates if e.name == "force.delay")
    assert delay.unit == "s"
    assert delay.value == pytest.approx(1.6 * DT, abs=0.01 * DT)
    assert result.model.inputs[0].delay == delay.value
    for name, value in TRUTH.items():
        assert result.values[name] == pytest.approx(value, rel=0.01)


@pytest.mark.thorough
def test_a_model_with_a_delay_is_restored_with_it(tmp_path):
    result = tn.identify(late(0.5 * DT), SYSTEM, RECIPE)
    tn.save(result.model, tmp_path / "m.safetensors")
    loaded = tn.load_model(tmp_path / "m.safetensors", SYSTEM)
    assert loaded.inputs[0].delay == result.model.inputs[0].delay
    e = late(0.5 * DT)[0]
    a, b = (tn.free_run(model, e, "model-20")[0] for model in (result.model, loaded))
    np.testing.assert_allclose(a, b)
    assert np.sqrt(np.mean((a[:, 0] - e.q[:, 0]) ** 2)) < 1e-4


def test_delays_that_cannot_be_found_are_refused():
    with pytest.raises(tn.InputError, match=r"'x.delay'.*common to all sensors"):
        tn.identify(late(0.0), SYSTEM, asking("x.delay"))
