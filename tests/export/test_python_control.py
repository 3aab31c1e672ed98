"""Models as systems of python-control: the simulation is the rollout, the matrices are exact."""

import sys
from importlib import import_module

import numpy as np
import pytest
from documented import blocks
from every_family import example, nominal
from every_step import require_same_run

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.systems.qube_servo2 import SYSTEM

control = import_module("control")  # no types are known


@pytest.mark.parametrize("name", ["qube", "gru", "network memory"])
def test_a_response_is_the_rollout(name):
    model = example(name)
    system = tn.control_system(model)
    assert system.dt == model.dt
    u = np.random.default_rng(0).uniform(-1, 1, (40, 1))
    x0 = np.linspace(0.1, 0.3, model.state_size)
    found = control.input_output_response(system, model.dt * np.arange(40), u.T, x0)
    expected = np.asarray(tn.rollout(model, x0, u[:-1]))
    require_same_run(found.outputs.T, expected)
    np.testing.assert_array_equal(found.states, found.outputs)
    assert not any("." in label for label in system.state_labels)  # "relaxing in 0.5 s"


def test_inputs_at_other_samples_are_inputs_of_their_own():
    model = example("hybrid")
    system = tn.control_system(model)
    assert system.input_labels == ["voltage", "voltage_after_1", "voltage_before_1"]
    assert system.state_labels == system.output_labels == ["angle", "der_angle", "creep"]
    u = np.random.default_rng(0).uniform(-1, 1, 22)
    record = tn.from_arrays(
        np.zeros((22, 1)), u, dt=model.dt, coordinates=model.coordinates, inputs=model.inputs
    )
    expected = tn.rollout(model, np.zeros(3), tn.input_signal(model, record)[1:])
    rows = np.stack([u[1:-1], u[2:], u[:-2]])
    found = control.input_output_response(system, model.dt * np.arange(20), rows, np.zeros(3))
    require_same_run(found.outputs.T, expected[:20])


def test_the_pages_program_designs_a_controller_and_tries_it_on_the_model():
    model = nominal(SYSTEM, 1)
    upright, still = np.zeros(4), np.zeros(1)
    plant = tn.state_space(model, upright, still)
    exact = tn.linearize(model, upright, still)
    np.testing.assert_allclose(plant.A, exact.a, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(plant.B, exact.b, rtol=1e-12, atol=1e-14)
    assert (plant.dt, plant.input_labels) == (model.dt, ["voltage"])
    assert plant.state_labels == ["theta", "alpha", "der_theta", "der_alpha"]
    (program,) = blocks("python-control", "python")
    exec(compile(program, "control.md", "exec"), known := {"model": model})
    alpha = np.ravel(known["found"].outputs)
    assert np.abs(alpha).max() < 0.5
    assert np.abs(alpha[-50:]).max() < 0.01


def test_shapes_that_the_model_does_not_have_are_refused():
    with pytest.raises(InputError, match=r"x of shape \(2,\), u of shape \(1,\).*\(4,\) and"):
        tn.state_space(example("qube"), np.zeros(2), np.zeros(1))


def test_it_asks_for_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    for make in (tn.control_system, lambda model: tn.state_space(model, np.zeros(4), np.zeros(1))):
        with pytest.raises(InputError, match=r"control is not installed.*'tustinnet\[control\]'"):
            make(example("qube"))
