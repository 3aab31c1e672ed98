"""Identification with the controller of the card in the loop: whole records, gains, refusals."""

import re
from pathlib import Path

import numpy as np
import pytest
from held_swings import KD, KP, held_swings
from robot_twins import record_in_loop, true_values
from swinging import SWING, TRUTH

import tustinnet as tn
from tustinnet.errors import InputError

PENDULUM = Path(__file__).parents[3] / "examples" / "robots" / "double_pendulum.urdf"


@pytest.fixture(scope="module")
def records() -> tn.DataSet:
    return held_swings(kp=None, kd=None)


@pytest.fixture(scope="module")
def result(records) -> tn.Identification:
    return tn.identify(records, SWING)


@pytest.mark.thorough
def test_records_are_simulated_as_a_whole(records, result):
    """Upright is unstable, and nothing is cut into segments: the controller holds it."""
    assert result.converged
    assert not result.horizons
    everything = {**result.values, **result.fixed}
    for name, value in TRUTH.items():
        assert everything[name] == pytest.approx(value, rel=0.05), name
    validation = list(records.split("validation"))
    (score,) = tn.evaluate(result.model, validation, result.start)
    assert score.rmse == pytest.approx(result.validation_rmse, rel=1e-6)
    assert score.rmse < 2 * records.coordinates[0].resolution


def test_gains_are_found_and_said(result):
    assert result.values["angle.kp"] == pytest.approx(KP, rel=0.003)
    assert result.values["angle.kd"] == pytest.approx(KD, rel=0.004)
    (first, gains, law) = [f.text for f in result.findings[:3]]
    assert first == (
        "the controller of the data card is in the loop: set points drive the simulations, the "
        "recorded inputs (voltage) are used for its gains alone"
    )
    assert re.match(r"gains of the controller, by the recorded inputs: angle\.kp (40|39\.9)", gains)
    assert "V s/rad" in gains
    assert "% of the recorded inputs unexplained" in law


def test_a_controller_with_integral_filter_and_delay_is_followed(tmp_path):
    """Whole records, the gain of the integral found; a file keeps what the controller remembers."""
    law = {"ki": 80.0, "velocity_filter": 0.01, "delay": 1}
    records = held_swings(3, law, kind="pid", kp=None, kd=None, velocity_filter=0.01, delay=1)
    result = tn.identify(records, SWING)
    assert not result.horizons
    for name, value, within in (("kp", KP, 0.01), ("kd", KD, 0.01), ("ki", 80.0, 0.03)):
        assert result.values[f"angle.{name}"] == pytest.approx(value, rel=within), name
    assert any("angle.ki" in f.text and "V/s/rad" in f.text for f in result.findings)
    validation = list(records.split("validation"))
    assert tn.evaluate(result.model, validation, "model-20")[0].rmse < 2e-3
    path = tmp_path / "model.safetensors"
    tn.save(result.model, path)
    loaded = tn.load_model(path, system=SWING)
    assert loaded.internal == ("angle.integral", "angle.filtered_velocity", "voltage.delayed1")
    scores = [tn.evaluate(m, validation, "model-20")[0].rmse for m in (loaded, result.model)]
    assert scores[0] == scores[1]


def test_a_model_file_keeps_the_loop(records, result, tmp_path):
    path = tmp_path / "model.safetensors"
    tn.save(result.model, path)
    model = tn.load_model(path, system=SWING)
    assert model.channels.controller == result.model.channels.controller
    validation = list(records.split("validation"))
    for system in (SWING, result.system):
        model = tn.load_model(path, system=system)
        scores = (tn.evaluate(m, validation, "derived-6")[0].rmse for m in (model, result.model))
        assert len(set(scores)) == 1


@pytest.mark.thorough
def test_a_law_that_is_not_the_cards_is_said():
    """Without its feed-forward and with another gain the voltage is another one."""
    result = tn.identify(
        held_swings(kp=2 * KP, feedforward=None),
        SWING,
        {"name": "one", "model": {"kind": "euler-lagrange"}, "search": {"iterations": 1}},
    )
    assert result.fixed["angle.kp"] == 2 * KP
    assert any(
        "computed voltage otherwise than the data card says" in f.text for f in result.findings
    )


def test_a_gain_of_the_wrong_sign_names_the_key():
    records = held_swings(2, kp=None)
    channels = records.channels
    turned = tn.DataSet(
        "turned",
        tuple(
            tn.Experiment(
                e.name, e.t, e.q, e.u, channels, split=e.split, outputs=-np.asarray(e.outputs)
            )
            for e in records
        ),
    )
    with pytest.raises(InputError, match=r"kp is found to be -.*check the key `sign`"):
        tn.identify(turned, SWING)


def test_kinds_without_use_for_a_controller_are_refused(records):
    with pytest.raises(InputError, match=r"\[controller\]: not applicable to models of kind 'gru'"):
        tn.fit(records, "gru")
    with pytest.raises(InputError, match="'mechanism': made for records without"):
        tn.identify(records, "mechanism")
    with pytest.raises(InputError, match=r"'voltage\.delay', of an input that the controller"):
        tn.identify(
            records,
            SWING,
            {"name": "d", "model": {"kind": "euler-lagrange", "free": ["voltage.delay"]}},
        )


@pytest.mark.thorough
def test_a_robot_is_identified_by_its_torques_then_in_the_loop():
    """Inverse dynamics uses the recorded torques, as without the controller; then it simulates."""
    system = tn.load_system(PENDULUM)
    truth = true_values(system, seed=1)
    in_loop, alone = (
        record_in_loop(system, truth, 3, 3.0, knows_controller=knows, knows_gains=False)
        for knows in (True, False)
    )
    recipe = tn.read_recipe("inverse-dynamics", ["search.candidates=[]"])
    first, plain = (tn.identify(data, system, recipe) for data in (in_loop, alone))
    for name, value in plain.values.items():
        assert first.values[name] == pytest.approx(value, rel=1e-9, abs=1e-12)
    assert plain.horizons
    assert not first.horizons, "in the loop records are simulated as a whole"
    held_out = list(in_loop.split("validation"))
    before = tn.mean_rmse(tn.evaluate(first.model, held_out, first.start))
    assert before < 5e-3
    assert "are compared with those that the motion needs" in first.findings[0].text
    begin = {name: first.values[name] for name in plain.values}
    result = tn.identify(in_loop, system, begin=begin)
    assert result.validation_rmse is not None
    assert in_loop.channels.controller is not None
    assert result.validation_rmse < 0.7 * before
    for loop in in_loop.channels.controller.loops:
        name = f"{loop.coordinate}.kp"
        assert result.values[name] == pytest.approx(first.values[name], rel=0.01)


def test_inverse_dynamics_requires_what_the_controller_computed():
    records = held_swings(2)
    silent = tn.DataSet(
        "silent",
        tuple(tn.Experiment(e.name, e.t, e.q, e.u, e.channels, split=e.split) for e in records),
    )
    with pytest.raises(InputError, match="without the inputs that the controller computed"):
        tn.identify(silent, SWING, "inverse-dynamics")
    # by simulation they are not needed
    recipe = {"name": "one", "model": {"kind": "euler-lagrange"}, "search": {"iterations": 2}}
    result = tn.identify(silent, SWING, recipe)
    assert result.values["gravity"] == pytest.approx(TRUTH["gravity"], rel=0.1)
