"""Holds and delays of inputs, found once for all candidates of a selection."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from swinging import DT, LAGGING, SWING, TRUTH, swing_model, voltage

import tustinnet as tn
from tustinnet.channels import Hold, Input
from tustinnet.fits.deadline import Deadline
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.timing import determine_timing
from tustinnet.fitting.shooting import identify
from tustinnet.models.integrate import discretise
from tustinnet.simulate.input_signal import input_signal


def records(
    hold: Hold,
    delay: float,
    declared: Hold | None = None,
    known: float | None = 0.0,
    lag: float | None = None,
):
    """Records of the pendulum whose input acts in one way and is declared in another."""
    acting = Input("voltage", "V", hold, delay=delay)
    swing = swing_model()
    if lag is not None:
        values = {**TRUTH, "lag": lag, "share": 1.0}
        swing = LAGGING.model({name: jnp.asarray(x) for name, x in values.items()})
    model = discretise(swing, DT, 4, inputs=(acting,))
    made = []
    for seed in range(4):
        u = voltage(200, seed)
        blank = tn.from_arrays(
            np.zeros(len(u)),
            u,
            dt=DT,
            name=f"noise{seed}",
            coordinates=SWING.coordinates,
            inputs=(acting,),
        )
        x0 = np.array([0.0, 0.0, u[0]] if lag else [0.0, 0.0])
        q = np.asarray(tn.rollout(model, x0, input_signal(model, blank)))[:, :1]
        inputs = (Input("voltage", "V", declared, delay=known),)
        channels = replace(blank.channels, inputs=inputs)
        made.append(replace(blank, q=np.round(q / 1e-4) * 1e-4, channels=channels))
    return tn.DataSet("late", tuple(made))


@pytest.mark.parametrize("system", [None, SWING])
def test_a_delay_that_nobody_declared_is_found_with_its_error(system, monkeypatch):
    # signs are of no use there, and take most of the time where a robot has many parameters
    monkeypatch.setattr(identify, "find_reversed_signs", None)
    monkeypatch.setattr(identify, "_POORLY_EXPLAINED", -1.0)
    timing = determine_timing(records("zero-order", DT), system)
    (found,) = timing.data.channels.inputs
    assert found.hold == "zero-order"
    assert found.delay == pytest.approx(DT, abs=0.1 * DT)
    assert (
        "hold of 'voltage': zero-order; simulation errors [rad]: zero-order" in timing.sentences[0]
    )
    assert timing.lags == ()
    assert timing.sentences[1].startswith("delay of 'voltage': 0.0")
    assert ", with a lag instead 0." in timing.sentences[1]
    assert "periods); the simulation error is 0." in timing.sentences[1]


@pytest.mark.parametrize("system", [None, SWING])
def test_an_actuator_that_lags_is_no_delay(system):
    timing = determine_timing(records("zero-order", 0.0, "zero-order", lag=0.06), system)
    assert timing.lags == ("voltage",)
    (found,) = timing.data.channels.inputs
    assert found.delay == 0.0
    (sentence,) = timing.sentences
    assert sentence.startswith("lag of 'voltage': first order with a time constant of 0.0")
    assert "and no delay; the simulation error is 0." in sentence
    assert "periods) instead 0." in sentence


def test_a_delay_that_the_card_declares_is_not_searched_for_though_it_is_0():
    data = records("zero-order", DT, "zero-order")
    inputs = (replace(data.channels.inputs[0], is_delay_declared=True),)
    channels = replace(data.channels, inputs=inputs)
    data = tn.DataSet("late", tuple(replace(e, channels=channels) for e in data))
    messages: list[str] = []
    assert determine_timing(data, SWING, on_message=messages.append).data is data
    assert messages == []


@pytest.mark.parametrize(
    ("recipe", "known"), [("paper-standard", 0.0), ("grey", None), ("grey", 0.0)]
)
def test_only_recipes_that_search_themselves_or_are_published_have_no_search(recipe, known):
    data, messages = records("zero-order", DT, "zero-order", known), list[str]()
    system = SWING if recipe == "grey" else None
    fit = prepare(FitRequest(data, recipe, system=system), on_message=messages.append)
    searches = (recipe, known) == ("grey", 0.0)
    assert bool(messages) == searches
    assert (fit.records.data is data) != searches


def test_a_hold_that_the_card_calls_unknown_is_found():
    timing = determine_timing(records("first-order", 0.0, "unknown"), SWING)
    (found,) = timing.data.channels.inputs
    assert found.hold in ("first-order", "band-limited")  # alike at these samples
    assert not found.delay
    assert all(e.inputs == timing.data[0].inputs for e in timing.data)


def test_what_is_declared_stays_and_the_card_decides_over_the_system():
    data = records("zero-order", 0.5 * DT, "first-order", 0.5 * DT)
    timing = determine_timing(data, SWING)
    assert timing.data.channels.inputs == data.channels.inputs
    assert timing.sentences == ()


def test_where_time_is_up_the_usual_timing_is_taken_and_said_where_it_was_asked_for():
    passed = Deadline.after(-1.0).has_passed
    quiet = determine_timing(records("zero-order", DT), SWING, passed)
    assert quiet.sentences == ()
    assert quiet.data.channels.inputs[0].delay == 0.0
    asked = determine_timing(records("zero-order", DT, "unknown", None), SWING, passed)
    assert asked.data.channels.inputs[0].hold == "zero-order"
    (sentence,) = asked.sentences
    assert "zero-order and no delay taken where they are not known" in sentence


def test_records_without_inputs_have_no_timing():
    e = records("zero-order", 0.0)[0]
    free = tn.from_arrays(e.q, np.zeros((len(e), 0)), dt=DT, coordinates=e.coordinates, inputs=())
    data = tn.DataSet("free", (free,))
    messages: list[str] = []
    assert determine_timing(data, on_message=messages.append).data is data
    assert messages == []
