"""Disturbances that an observer finds, and inputs that take them away."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import DT, LAGGING, simulated, swing_model, voltage

import tustinnet as tn
from tustinnet.control.closed_loop import closed_loop
from tustinnet.control.design import ControlTask, design_controller
from tustinnet.control.disturbances import observe_disturbances
from tustinnet.control.dynamics import input_limits
from tustinnet.control.estimator import ExtendedKalmanFilter
from tustinnet.control.export.write import export_controller
from tustinnet.control.mpc import make_controller
from tustinnet.control.plants import ModelPlant
from tustinnet.control.sampled_plant import PlantOptions
from tustinnet.control.stepped_model import SteppedModel
from tustinnet.models import forces

COUNT = 1e-4  # m
SLIDE = tn.LagrangianSystem(
    name="slide",
    coordinates=(tn.Coordinate("s", "linear", resolution=COUNT),),
    inputs=(tn.Input("force", "N", limits=(-20.0, 20.0)),),
    parameters=(
        tn.Parameter("mass", "kg", 1.0, 0.1, 5.0),
        tn.Parameter("viscous", "N s/m", 1.0, 0.0, 10.0),
        tn.Parameter("slope", "N", 0.0, -10.0, 10.0),
    ),
    kinetic=lambda q, v, p: p["mass"] * v[0] ** 2 / 2,
    potential=lambda q, p: p["slope"] * q[0],
    dissipation=lambda q, v, p: forces.viscous(v, p["viscous"]),
    input_map=lambda q, v, u, p: u,
)
WAY = 0.1 * (1 - np.cos(np.linspace(0, np.pi, 101)))  # m, to 0.2 m in a second


def level_slide() -> tn.Model:
    values = {p.name: jnp.asarray(p.nominal) for p in SLIDE.parameters}
    return tn.discretise(SLIDE.model(values), 0.01, 2)


def play_on_a_slope(task: ControlTask):
    """A run on a slope that the model does not know, and the design."""
    model = level_slide()
    design = design_controller(model, task)
    options = PlantOptions(counts=[COUNT], limits=[[-20.0, 20.0]], delay=task.delay)
    plant = ModelPlant(SteppedModel(model), {"slope": 3.0}, options)
    estimator = ExtendedKalmanFilter(design.estimated, design.noise, delay=task.delay)
    run = closed_loop(
        plant, make_controller(design.controller), estimator, 400, design.first_positions
    )
    return run, design


@pytest.mark.thorough
@pytest.mark.parametrize("follows", [False, True])
def test_a_force_that_the_model_does_not_know_moves_the_device_without_an_observer(follows):
    # weights are those of feedback along a plan; computed torque has integrals of its own
    way = {"start": {"s": 0.0}, "reference": {"s": WAY}, "deviations": {"s": 1.0}}
    way = way if follows else {}
    at = {"s": float(WAY[-1])} if follows else {"s": 0.0}
    tasks = [ControlTask(at, trust_beyond=True, observer=b, **way) for b in (False, True)]
    (without, _), (observed, design) = map(play_on_a_slope, tasks)
    errors = [np.abs(run.states[-50:, 0] - at["s"]).max() for run in (without, observed)]
    assert errors[0] > 0.02
    assert errors[1] < 3 * COUNT
    assert design.estimated.internal == ("disturbance_force",)
    np.testing.assert_allclose(observed.estimates[-50:, 2], -3.0, atol=0.1)
    # two states of the model, and what is taken away as it is
    assert design.feedback.gain.shape == (1, 3)
    assert design.feedback.gain[0, 2] == 1.0


def test_the_same_in_c_and_no_solver_scripts(tmp_path):
    task = ControlTask({"s": 0.2}, {"s": 0.0}, reference={"s": WAY}, observer=True)
    design = design_controller(level_slide(), task)
    export = export_controller(design.estimated, design.gains, design.noise, tmp_path / "c")
    assert export.checked.difference is not None
    assert export.checked.difference < 1e-9
    assert "problem.py" not in export.files
    assert any("disturbances" in note for note in export.notes)


@pytest.mark.thorough
def test_inputs_that_act_late_are_disturbed_late():
    """The gain of the disturbance stands between those of states and of earlier commands."""
    task = ControlTask({"s": 0.0}, delay=2, observer=True)
    run, design = play_on_a_slope(task)
    assert design.feedback.gain.shape == (1, 5)
    # the estimator knows how late: what it expects of velocities is right
    np.testing.assert_allclose(run.estimates[50:, 1], run.states[50:, 1], atol=0.01)
    assert np.abs(run.states[-50:, 0]).max() < 3 * COUNT


def test_a_lag_behind_the_disturbed_input_begins_by_the_inputs_of_the_record():
    u, values = voltage(60, 3), {"lag": 0.12, "share": 0.4}
    record = simulated("lagging", [0.5, 0.0, 0.4 * u[0]], u, values, LAGGING)
    inner = tn.discretise(swing_model(values, LAGGING), DT, 2)
    model = observe_disturbances(inner, input_limits(inner, {"voltage": (-8.0, 8.0)}))
    (expected,), (state,) = (tn.start_states(m, [record], "derived-6") for m in (inner, model))
    assert expected[2] != 0
    np.testing.assert_array_equal(state, [*expected, 0.0])


@pytest.mark.thorough
def test_derivatives_of_the_disturbed_model_are_those_of_its_step():
    model = observe_disturbances(level_slide(), input_limits(level_slide()))
    x, u = jnp.array([0.1, -0.3, 0.7]), jnp.array([2.0])
    dx, du = np.split(np.eye(4), [3])
    assert model.step_along is not None
    columns = model.step_along(x, u, dx, du)
    by_x, by_u = jax.jacfwd(model.step, argnums=(0, 1))(x, u)
    np.testing.assert_allclose(columns[:, 0], model.step(x, u), rtol=1e-12)
    np.testing.assert_allclose(columns[:, 1:], np.hstack([by_x, by_u]), atol=1e-12)
