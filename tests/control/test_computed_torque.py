"""Motions of fully driven machines by their inverse dynamics, in Python and in C."""

import ctypes
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import example

import tustinnet as tn
import tustinnet.control as tc
from tustinnet.control.computed_torque import smooth_motion
from tustinnet.control.design import ControlTask, design_controller
from tustinnet.control.mpc import make_controller
from tustinnet.control.variants import FRICTION, with_friction_factor
from tustinnet.export.c import compile_c, make_model_files
from tustinnet.export.source import make_source

JOINTS: tuple[str, ...] = ("base", "shoulder", "elbow")
AXES = ("0 0 1", "0 1 0", "0 1 0")
PERIOD, SECONDS = 0.008, 2.0
START, END = np.array([0.0, -1.0, 0.8]), np.array([0.6, -0.4, 1.4])
CHARACTERS = 60_000  # of model.c, for each joint


def arm_urdf() -> str:
    """An arm of three joints, each with friction."""
    parts = ['<robot name="arm"><link name="ground"/>']
    for i, (name, axis) in enumerate(zip(JOINTS, AXES, strict=True)):
        parent = f"{JOINTS[i - 1]}_link" if i else "ground"
        parts.append(
            f'<link name="{name}_link"><inertial><origin xyz="0.01 0.02 0.15"/><mass value="3"/>'
            '<inertia ixx="0.03" iyy="0.03" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><origin xyz="0 0 0.3"/>'
            f'<parent link="{parent}"/><child link="{name}_link"/><axis xyz="{axis}"/>'
            '<dynamics damping="0.8" friction="0.4"/>'
            '<limit lower="-3" upper="3" effort="60" velocity="4"/></joint>'
        )
    return "".join([*parts, "</robot>"])


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> tn.Model:
    (file := tmp_path_factory.mktemp("arm") / "arm.urdf").write_text(arm_urdf())
    system = tn.load_robot(file)
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    values |= {f"{name}.coulomb_speed": jnp.asarray(0.05) for name in JOINTS}
    values |= {f"{name}.armature": jnp.asarray(0.1) for name in JOINTS}
    model = tn.discretise(system.model(values), PERIOD)
    coordinates = tuple(replace(c, resolution=5e-5) for c in model.channels.coordinates)
    inputs = tuple(replace(i, limits=(-60.0, 60.0)) for i in model.channels.inputs)
    return replace(model, channels=replace(model.channels, coordinates=coordinates, inputs=inputs))


def positions(q: np.ndarray) -> dict[str, float]:
    return dict(zip(JOINTS, q.tolist(), strict=True))


def reference() -> np.ndarray:
    return smooth_motion(START, END, round(SECONDS / PERIOD), PERIOD)


@pytest.fixture(scope="module")
def design(arm):
    columns = dict(zip(JOINTS, reference()[:, :3].T, strict=True))
    return design_controller(arm, ControlTask(positions(END), positions(START), reference=columns))


def largest_errors(design, friction: float) -> tuple[float, float]:
    """Largest errors along the motion, and a second after its end [rad]."""
    device = with_friction_factor(design.model)
    plant = tc.ModelPlant(device, {FRICTION: friction})
    estimator = tc.ExtendedKalmanFilter(design.model, design.noise)
    steps = len(design.plan.u)
    run = tc.closed_loop(plant, make_controller(design.controller), estimator, steps + 125, START)
    errors = np.abs(run.states[:, :3] - np.concatenate([reference()[:, :3], [END] * 125]))
    return float(errors[: steps + 1].max()), float(errors[-1].max())


@pytest.mark.thorough
def test_an_arm_follows_a_motion_on_its_model_and_with_twice_the_friction(design):
    assert design.has_computed_torque
    along, end = largest_errors(design, 1.0)
    assert along < 0.5e-3
    assert end < 0.1e-3
    along, end = largest_errors(design, 2.0)
    assert along < 6e-3
    assert end < 1e-3


@pytest.mark.thorough
def test_its_code_is_small_and_its_loop_is_that_of_python(arm, design, tmp_path):
    export = tc.export_controller(arm, design.gains, design.noise, tmp_path / "out")
    assert export.checked.note or (export.checked.difference or 0.0) < 1e-9
    folder = tmp_path / "out"
    assert len((folder / "model.c").read_text()) < CHARACTERS * len(JOINTS)
    # a row of states for each sample, and no gains
    assert (folder / "controller.c").read_text().count("R(") < 8 * len(reference()) + 2000
    read = tc.read_controller(folder)
    assert isinstance(read, tc.Tracking)
    assert read.by_acceleration == design.gains.by_acceleration
    np.testing.assert_array_equal(read.gains, design.gains.gains)
    scripted = (folder / "README.md").read_text()
    assert "computed torque along it" in scripted


@pytest.mark.thorough
def test_a_motion_between_points_is_smooth_and_weights_ask_for_other_feedback(arm):
    task = ControlTask(positions(END), positions(START), SECONDS)
    smooth = design_controller(arm, task)
    assert smooth.has_computed_torque
    assert smooth.plan is not None
    np.testing.assert_allclose(smooth.plan.x, reference(), atol=1e-12)
    weighted = design_controller(arm, replace(task, seconds=0.4, deviations={"elbow": 0.1}))
    assert not weighted.has_computed_torque


@pytest.mark.thorough
def test_the_inputs_of_a_plan_accelerate_the_machine_as_it_should(arm, design):
    x, u = design.plan.x, design.plan.u
    middle, lagrangian = (x[1:] + x[:-1]) / 2, arm.continuous
    k = len(u) // 3
    acceleration = lagrangian.acceleration(jnp.asarray(middle[k]), jnp.asarray(u[k]))
    np.testing.assert_allclose(acceleration, (x[k + 1] - x[k])[3:] / PERIOD, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("qube", "1 inputs, 2 coordinates"),
        ("qube memory", r"internal states .*expected forces without memory"),
        ("network memory", "not only equations of motion"),
    ],
)
def test_machines_that_are_not_fully_driven_are_refused(name, message):
    model = example(name)
    n_x, n_u = model.state_size, model.channels.n_u
    limits = {i.name: (-10.0, 10.0) for i in model.channels.inputs}
    feedback = tc.Feedback(
        gain=np.zeros((n_u, n_x)),
        x0=np.zeros(n_x),
        u0=np.zeros(n_u),
        lower=np.full(n_u, -10.0),
        upper=np.full(n_u, 10.0),
        dt=float(model.dt),
        speeds=np.zeros(model.channels.n_q),
    )
    with pytest.raises(tn.InputError, match=message):
        tc.computed_torque(model, np.zeros((3, n_x)), feedback, limits=limits)


def test_late_inputs_limits_and_shapes_are_refused(arm, design):
    late = tuple(replace(i, delay=PERIOD) for i in arm.channels.inputs)
    with pytest.raises(tn.InputError, match="act late"):
        tc.computed_torque(
            replace(arm, channels=replace(arm.channels, inputs=late)), reference(), design.feedback
        )
    with pytest.raises(tn.InputError, match="beyond their limits"):
        tc.computed_torque(
            arm,
            reference(),
            design.feedback,
            limits=dict.fromkeys((i.name for i in arm.channels.inputs), (-1.0, 1.0)),
        )
    with pytest.raises(tn.InputError, match="a reference of shape"):
        tc.computed_torque(arm, reference()[:, :4], design.feedback)


@pytest.mark.thorough
def test_derivatives_of_a_step_are_the_same_in_c(arm, tmp_path):
    """The Jacobian by inverse dynamics against differences of the step."""
    source = make_source(arm)
    for name, text in make_model_files(source).items():
        (tmp_path / name).write_text(text)
    compile_c([tmp_path / "model.c"], library := tmp_path / "model.so", ("-O1", "-fPIC", "-shared"))
    function = ctypes.CDLL(str(library)).model_linearise
    x, u = (rows[0] for rows in source.samples(1))
    after, a, b = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 3))
    function(*(ctypes.c_void_p(array.ctypes.data) for array in (x, u, after, a, b)))
    step = 1e-6

    def stepped(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.asarray(source.function(jnp.asarray(x), jnp.asarray(u)))

    np.testing.assert_allclose(after, stepped(x, u), rtol=1e-12)
    for i, column in enumerate(np.eye(9)):
        dx, du = np.split(step * column, [6])
        slope = (stepped(x + dx, u + du) - stepped(x - dx, u - du)) / (2 * step)
        np.testing.assert_allclose(np.hstack([a, b])[:, i], slope, atol=1e-7)
