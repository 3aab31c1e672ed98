"""Holds and delays of inputs, found before anything is fitted."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from swinging import DT, LAGGING, SWING, TRUTH, swing_model

import tustinnet as tn
from tustinnet.channels import Hold, Input
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.timing import determine_timing
from tustinnet.models.integrate import discretise
from tustinnet.simulate.input_signal import input_signal


def records(
    hold: Hold,
    delay: float,
    declared: Hold | None = None,
    known: float | None = 0.0,
    lag: float | None = None,
    samples: int = 300,
) -> tn.DataSet:
    """Records of the pendulum whose input acts in one way and is declared in another."""
    acting = Input("voltage", "V", hold, delay=delay)
    swing = swing_model()
    if lag is not None:
        values = {**TRUTH, "lag": lag, "share": 1.0}
        swing = LAGGING.model({name: jnp.asarray(x) for name, x in values.items()})
    model = discretise(swing, DT, 4, inputs=(acting,))
    made = []
    for seed in range(4):
        random = np.random.default_rng(seed)
        u = np.repeat(random.uniform(-4, 4, samples // 5), 5) + random.normal(0, 0.5, samples)
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


def test_a_delay_that_nobody_declared_is_found_with_its_error():
    timing = determine_timing(records("zero-order", DT))
    (found,) = timing.data.channels.inputs
    assert found.hold == "zero-order"
    assert found.delay == pytest.approx(DT, abs=0.1 * DT)
    assert timing.lags == ()
    (sentence,) = map(str, timing.findings)
    assert sentence.startswith("input 'voltage' acts with a delay of 0.0")
    assert " s (1 periods), or less of one before a short lag; hold zero-order" in sentence
    assert all(e.inputs == timing.data[0].inputs for e in timing.data)


def test_an_actuator_that_lags_is_no_delay():
    timing = determine_timing(records("zero-order", 0.0, "zero-order", lag=0.06))
    assert timing.lags == timing.delays == ("voltage",)  # a short delay would look like a lag
    (found,) = timing.data.channels.inputs
    assert found.delay == 0.0
    (sentence,) = map(str, timing.findings)
    assert sentence.startswith("input 'voltage' acts through a first-order lag of 0.06")
    # no equations of motion that could have the force
    assert sentence.endswith("or less of one after a delay")


def test_a_force_for_a_lag_is_advised_to_systems_without_one():
    data = records("zero-order", 0.0, "zero-order", lag=0.06)
    advised = [
        str(determine_timing(data, system).findings[0]).endswith(
            "; the force `lag` adds it to equations of motion"
        )
        for system in (SWING, LAGGING)
    ]
    assert advised == [True, False]


def test_a_delay_that_the_card_declares_is_not_searched_for_though_it_is_0():
    data = records("zero-order", DT, "zero-order")
    inputs = (replace(data.channels.inputs[0], is_delay_declared=True),)
    channels = replace(data.channels, inputs=inputs)
    data = tn.DataSet("late", tuple(replace(e, channels=channels) for e in data))
    timing = determine_timing(data)
    assert timing.data is data
    assert timing.findings == ()


def test_a_declared_delay_tells_the_hold_and_what_is_declared_stays():
    timing = determine_timing(records("first-order", DT, "unknown", DT))
    (found,) = timing.data.channels.inputs
    assert (found.hold, found.delay) == ("first-order", DT)
    (sentence,) = map(str, timing.findings)
    assert "acts with the declared delay of 0.02 s; hold first-order" in sentence
    data = records("zero-order", 0.5 * DT, "first-order", 0.5 * DT)
    timing = determine_timing(data, SWING)
    assert timing.data.channels.inputs == data.channels.inputs
    assert timing.findings == ()


@pytest.mark.parametrize(
    ("recipe", "known", "expected"),
    [("paper-standard", 0.0, 0.0), ("grey", None, DT), ("grey", 0.0, DT), ("standard", None, DT)],
)
def test_published_recipes_keep_records_and_identifications_refine_delays(recipe, known, expected):
    data = records("zero-order", DT, "zero-order", known)
    system = SWING if recipe == "grey" else None
    fit = prepare(FitRequest(data, recipe, system=system))
    (found,) = fit.records.data.channels.inputs
    assert found.delay == (expected and pytest.approx(expected, abs=0.1 * DT))
    assert bool(fit.records.timing) == bool(expected)
    # physics tells a delay that was found more exactly than the records alone
    is_refined = recipe == "grey" and bool(expected)
    free = getattr(fit.task.recipe.model, "free", ())
    assert free == (("voltage.delay",) if is_refined else ())


def test_the_card_decides_over_the_system_which_decides_over_the_records():
    declared = replace(SWING, inputs=(Input("voltage", "V", "zero-order"),))
    timing = determine_timing(records("zero-order", 0.0), declared)
    assert timing.data.channels.inputs[0].hold == "zero-order"
    assert [*map(str, timing.findings)] == ["input 'voltage' acts without delay"]
    timing = determine_timing(records("first-order", 0.0, "first-order"), declared)
    assert timing.data.channels.inputs[0].hold == "first-order"
    assert timing.findings[0].text.startswith("hold of 'voltage': first-order as in the data card")


def test_where_records_say_nothing_the_usual_timing_is_taken_and_said_where_it_was_asked_for():
    quiet = determine_timing(records("zero-order", DT, samples=40))
    assert quiet.findings == ()
    assert quiet.data.channels.inputs[0] == Input("voltage", "V", "zero-order")
    asked = determine_timing(records("zero-order", DT, "unknown", None, samples=40))
    assert asked.data.channels.inputs[0] == Input("voltage", "V", "zero-order")
    assert (quiet.delays, asked.delays) == ((), ("voltage",))
    (sentence,) = map(str, asked.findings)
    assert "zero-order and no delay taken where they are not known" in sentence


def test_records_without_inputs_have_no_timing():
    e = records("zero-order", 0.0)[0]
    free = tn.from_arrays(e.q, np.zeros((len(e), 0)), dt=DT, coordinates=e.coordinates, inputs=())
    data = tn.DataSet("free", (free,))
    assert determine_timing(data).data is data


@pytest.mark.thorough
def test_what_was_found_stands_among_the_findings_of_an_identification():
    data = records("zero-order", DT)
    result = tn.identify(data, SWING)
    assert any(
        str(f).startswith("input 'voltage' acts with a delay of 0.0") for f in result.findings
    )
    assert result.model.inputs[0].delay == pytest.approx(DT, abs=0.01 * DT)  # refined
    values = {e.name: e.value for e in result.estimates}
    assert values["gravity"] == pytest.approx(TRUTH["gravity"], rel=0.01)


@pytest.mark.thorough
def test_an_identification_tells_a_delay_from_the_lag_that_hides_it():
    data = records("zero-order", 0.3 * DT, "zero-order", lag=1.5 * DT)
    (found,) = determine_timing(data).data.channels.inputs
    assert found.delay == 0.0  # so little that the records alone need none
    result = tn.identify(data, LAGGING)
    assert result.model.inputs[0].delay == pytest.approx(0.3 * DT, abs=0.05 * DT)
    values = {e.name: e.value for e in result.estimates}
    assert values["lag"] == pytest.approx(1.5 * DT, rel=0.05)
