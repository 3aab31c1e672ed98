"""Robots from files: equations of motion as MuJoCo has them, messages about what is no robot."""

import re
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from robot_files import random_urdf

import tustinnet as tn
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.models.added import parse_forces, with_forces
from tustinnet.models.chains import DIAGONAL, inertial_parameters
from tustinnet.models.forces import LAWS, Motion
from tustinnet.models.kinematics import parent_indices
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.motion_limits import MotionLimits
from tustinnet.systems import mjcf
from tustinnet.systems.qube_servo2 import SYSTEM as QUBE
from tustinnet.systems.robot_reading import read_robot
from tustinnet.systems.robots import RobotFile

mujoco = import_module("mujoco")  # no types are known

EXAMPLES = Path(__file__).parents[2] / "examples"
ROBOTS = EXAMPLES / "robots"
PRECISION = 1e-10  # relative


def terms_of(system: LagrangianSystem, points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Mass matrix, and forces that keep a velocity, at points [q, v]."""
    n = len(system.coordinates)
    model = system.model({k: jnp.asarray(v) for k, v in system.nominal().items()})

    def terms(x):
        q, v = x[:n], x[n:]
        return jnp.concatenate([model.mass_matrix(q).ravel(), -model.conservative(q, v)])

    out = evaluate(Formula(terms, 2 * n), points)
    return [(row[: n * n].reshape(n, n), row[n * n :]) for row in out]


class InMuJoCo:
    """A file as MuJoCo itself simulates it, without meshes."""

    def __init__(self, text: str) -> None:
        spec = mujoco.MjSpec.from_string(text)
        for element in [*spec.geoms, *spec.meshes] if "<robot" in text else []:
            spec.delete(element)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def place(self, joint: str) -> int:
        index = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        return int(self.model.jnt_dofadr[index])

    def terms(self, q: dict[str, float], v: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Mass matrix and bias forces, in the order of the joints of q."""
        places = [self.place(name) for name in q]
        self.data.qpos[places], self.data.qvel[places] = list(q.values()), list(v.values())
        mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return full[np.ix_(places, places)], self.data.qfrc_bias[places]


def points(system: LagrangianSystem, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(3, 2 * len(system.coordinates))) * 1.5


def assert_near(actual: np.ndarray, expected: np.ndarray) -> None:
    size = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(actual, expected, rtol=0, atol=PRECISION * size)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(6))
def test_equations_of_random_chains_are_those_of_mujoco(seed, tmp_path):
    text = random_urdf(seed)
    (file := tmp_path / "random.urdf").write_text(text)
    system, there = tn.load_system(file), InMuJoCo(text)
    names = [c.name for c in system.coordinates]
    for x, (mass, bias) in zip(p := points(system), terms_of(system, p), strict=True):
        q, v = np.split(x, 2)
        expected = there.terms(dict(zip(names, q, strict=True)), dict(zip(names, v, strict=True)))
        assert_near(mass, expected[0])
        assert_near(bias, expected[1])


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [5, 7])
def test_a_mimic_joint_moves_as_the_joint_that_it_follows(seed, tmp_path):
    """By the equations of all joints and the constant ratios between them."""
    text = random_urdf(seed, mimic=True)
    (file := tmp_path / "random.urdf").write_text(text)
    system, there = tn.load_system(file), InMuJoCo(text)
    names = [c.name for c in system.coordinates]
    source = system.source
    assert source is not None
    movers = source._channels().tree.moved_by  # pyright: ignore[reportAttributeAccessIssue]
    assert len(movers) > len(names)
    ratios = np.array([[m.ratio * (m.joint == name) for name in names] for m in movers.values()])
    offsets = np.array([m.offset for m in movers.values()])
    for x, (mass, bias) in zip(p := points(system), terms_of(system, p), strict=True):
        q, v = np.split(x, 2)
        travel, speed = ratios @ q + offsets, ratios @ v
        expected = there.terms(
            dict(zip(movers, travel, strict=True)), dict(zip(movers, speed, strict=True))
        )
        assert_near(mass, ratios.T @ expected[0] @ ratios)
        assert_near(bias, ratios.T @ expected[1])


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", ["arm7.urdf", "scara.urdf", "gripper.urdf", "double_pendulum.urdf"]
)
def test_recursions_agree_with_derivatives_of_the_energy(name):
    """Kinetic energy by velocities, and the mass matrix by composite bodies."""
    system = tn.load_system(ROBOTS / name)
    n, p = len(system.coordinates), system.nominal()
    x = points(system, 1)
    energy = evaluate(Formula(lambda x: jnp.atleast_1d(system.kinetic(x[:n], x[n:], p)), 2 * n), x)
    for state, (mass, _), e in zip(x, terms_of(system, x), energy, strict=True):
        assert_near(e[0], state[n:] @ mass @ state[n:] / 2)


@pytest.mark.thorough
def test_rates_have_the_precision_of_the_state():
    """As where a network in single precision corrects a robot, whose file's numbers are double."""
    system = tn.load_system(ROBOTS / "scara.urdf")
    single = system.model({n: jnp.float32(value) for n, value in system.nominal().items()})
    x, u = (jnp.zeros(n, jnp.float32) for n in (single.state_size, len(single.inputs)))
    assert single.derivative(x, u).dtype == jnp.float32


def test_the_example_in_mujocos_format_is_the_packaged_system():
    """Spring, damping, gear and back-EMF of the file; the link's thickness of 1e-7 m is not 0."""
    robot = tn.load_system(EXAMPLES / "rotary_pendulum.xml")
    robot = robot.for_channels(QUBE.coordinates, QUBE.inputs, "the packaged system")
    assert robot.channels.coordinates == QUBE.channels.coordinates
    # friction that the file has not
    values = QUBE.nominal() | {"cable_quadratic": 0.0}
    own = QUBE.model({k: jnp.asarray(v) for k, v in values.items()})
    other = robot.model({k: jnp.asarray(v) for k, v in robot.nominal().items()})
    rng = np.random.default_rng(0)
    for _ in range(3):
        x, u = jnp.asarray(rng.normal(size=4)), jnp.asarray(rng.normal(size=1))
        np.testing.assert_allclose(other.derivative(x, u), own.derivative(x, u), rtol=1e-4)


def test_a_robot_of_mujoco_moves_as_there():
    text = (ROBOTS / "cart_pole.xml").read_text()
    system = tn.load_system(ROBOTS / "cart_pole.xml")
    assert [c.name for c in system.coordinates] == ["slide", "pole"]
    assert [(i.name, i.unit) for i in system.inputs] == [("force", "N")]
    parameters = system.nominal()
    assert parameters["slide.armature"] == 0.2
    assert parameters["pole.coulomb"] == 0.003
    seen = text.replace('<mesh name="cart" file="cart.stl"/>', "")
    there = InMuJoCo(seen.replace('<geom class="seen" mesh="cart"/>', ""))
    for x, (mass, bias) in zip(p := points(system), terms_of(system, p), strict=True):
        names: list[str] = ["slide", "pole"]
        q, v = (dict(zip(names, part.tolist(), strict=True)) for part in np.split(x, 2))
        expected = there.terms(q, v)
        assert_near(mass, expected[0])
        assert_near(bias, expected[1])


@pytest.mark.thorough
def test_locked_joints_are_a_part_of_the_link_that_carries_them():
    whole = tn.load_system(ROBOTS / "scara.urdf")
    part = tn.load_robot(ROBOTS / "scara.urdf", locked={"lift": -0.1, "elbow": 0.7})
    assert [c.name for c in part.coordinates] == ["shoulder", "roll"]
    assert "outer_arm.mass" not in part.nominal()
    assert part.nominal()["inner_arm.mass"] == pytest.approx(4.0 + 3.0 + 0.8)
    (mass, _), (expected, _) = (
        terms_of(system, np.array([[*q, *np.zeros(len(q))]]))[0]
        for system, q in ((part, [0.4, 1.0]), (whole, [0.4, 0.7, -0.1, 1.0]))
    )
    assert_near(mass, expected[np.ix_([0, 3], [0, 3])])


@pytest.mark.parametrize("name", ["scara.urdf", "cart_pole.xml"])
def test_gravity_is_that_of_the_place_where_a_robot_stands(name, tmp_path):
    usual = tn.load_system(ROBOTS / name)
    system = tn.load_robot(ROBOTS / name, gravity=(3.0, -2.0, 9.0))
    n = len(system.coordinates)
    states = np.random.default_rng(0).normal(size=(3, 2 * n))

    def energies(system: tn.LagrangianSystem) -> np.ndarray:
        values = {key: jnp.asarray(x) for key, x in system.nominal().items()}
        assert system.potential is not None
        return np.array([float(system.potential(jnp.asarray(x[:n]), values)) for x in states])

    values = {key: jnp.asarray(x) for key, x in system.nominal().items()}
    tn.write_robot(system.model(values), tmp_path / "moved.xml")
    again = tn.load_system(tmp_path / "moved.xml")
    assert np.allclose(np.ptp(energies(system) - energies(again)), 0.0, atol=1e-9)
    assert np.ptp(energies(system) - energies(usual)) > 0.1
    assert isinstance(system.source, RobotFile)
    assert "gravity=(3.0, -2.0, 9.0)" in system.source.call()


def test_a_current_drives_a_joint_by_its_motor_constant():
    currents = tuple(tn.Input(f"current_{i}", "A") for i in ("shoulder",))
    coordinates = tn.load_system(ROBOTS / "scara.urdf").coordinates
    with pytest.raises(InputError, match=r"input 'current_shoulder' in A; expected N m; a current"):
        tn.load_system(ROBOTS / "scara.urdf").for_channels(coordinates, currents, "the card")
    system = tn.load_robot(ROBOTS / "scara.urdf", motor_constants={"shoulder": -2.5})
    system = system.for_channels(coordinates[::-1], currents, "the card")
    assert [c.name for c in system.coordinates] == ["roll", "lift", "elbow", "shoulder"]
    assert system.input_map is not None
    force = system.input_map(jnp.zeros(4), jnp.zeros(4), jnp.ones(1), system.nominal())
    np.testing.assert_array_equal(force, [0, 0, 0, -2.5])


@pytest.mark.thorough
def test_friction_by_name_adds_to_that_of_every_joint():
    plain = tn.load_system(ROBOTS / "scara.urdf")
    rich = tn.load_robot(ROBOTS / "scara.urdf", friction=["load", "stribeck"])
    more = {"breakaway": 0.7, "stribeck_speed": 0.3, "load_friction": 0.1}
    values = {k: more.get(k.rpartition(".")[2], v) for k, v in rich.nominal().items()}
    names = [c.name for c in plain.coordinates]
    assert len(rich.parameters) == len(plain.parameters) + 3 * len(names)
    assert plain.dissipation is not None
    assert rich.dissipation is not None
    q, v = jnp.array([0.3, 0.2, -0.1, 0.4]), jnp.array([0.2, -0.4, 0.05, 1.0])
    extra = np.asarray(rich.dissipation(q, v, values) - plain.dissipation(q, v, values))
    widths = np.array([values[f"{name}.coulomb_speed"] for name in names])
    # gravity acts along the axis of the slide alone
    carried = values["spindle.mass"] + values["hand.mass"]
    weight = np.array([0.0, 0.0, 9.81 * carried, 0.0])
    level = 0.1 * weight + 0.7 * np.exp(-((np.asarray(v) / 0.3) ** 2))
    np.testing.assert_allclose(extra, level * np.tanh(np.asarray(v) / widths), rtol=1e-6, atol=1e-9)


@pytest.mark.thorough
def test_friction_by_a_recipe_is_that_of_the_robots_option():
    robot, names = ROBOTS / "scara.urdf", ("stribeck", "load", "curve")
    by_option, plain = tn.load_robot(robot, friction=names), tn.load_robot(robot)
    # both bring the same parameters
    new = tuple(p for p in by_option.parameters if p.name not in plain.nominal())
    by_recipe = with_forces(plain, names, new)
    assert {*by_recipe.added_parameters} == {p.name for p in new}
    generator = np.random.default_rng(0)
    values = by_option.nominal() | {p.name: generator.uniform(0.1, 1.0) for p in new}
    q, v = jnp.asarray(generator.normal(size=(2, 4)))
    assert by_option.dissipation is not None
    assert by_recipe.dissipation is not None
    found, expected = by_recipe.dissipation(q, v, values), by_option.dissipation(q, v, values)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    told = "'curve:shoulder' brings 'shoulder.curve_2', which the system 'scara' has already"
    with pytest.raises(InputError, match=told):
        with_forces(by_option, ("curve",), new)
    # behind an elastic gear the Coulomb friction is the motor's
    elastic = tn.load_robot(robot, elastic={"elbow": 100.0})
    with pytest.raises(InputError, match=r"elastic joint: tn\.load_robot\(friction=\.\.\.\)"):
        with_forces(elastic, ("stribeck:elbow",), ())


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("law", "encoder"),
    [
        *((law, "motor") for law in ("curve", "load", "spring", "maxwell", "lag")),
        # without a state and with one
        ("spring", "link"),
        ("maxwell", "link"),
    ],
)
def test_forces_are_added_to_robots_with_elastic_gears(law, encoder, hanging):
    """At what the encoder measures; internal states come behind those of the gear."""
    system = tn.load_robot(hanging, elastic={"hip": 100.0}, encoders={"hip": encoder})
    at_input = LAWS[law].is_at_input
    name = f"{law}:{system.inputs[0].name if at_input else 'hip'}"
    (force,) = parse_forces(system, [name])
    ends, drive = (-0.7, 0.8), 2.0
    motion = Motion(3.0, 0.5, 0.5, 1.0, ends, dt=0.005, longest=10.0, drive=drive)
    new = tuple(
        p.for_input(system.inputs[0], motion)
        if at_input
        else p.for_coordinate(system.coordinates[0], "N", motion)
        for p in force.brought.values()
    )
    more = with_forces(system, (name,), new)
    other = "link" if encoder == "motor" else "motor"
    has_state = law in ("maxwell", "lag")
    assert more.internal == (f"hip.{other}", f"hip.{other}_speed", name)[: 2 + has_state]
    values = {p.name: jnp.asarray(p.upper if p in new else p.nominal) for p in more.parameters}
    measured, u = jnp.array([0.4, 0.6]), jnp.ones(1)
    rates = []
    for one in (system, more):
        model = one.model({name: values[name] for name in one.nominal()})
        # where the lag has not reached what is asked for, and the spring is stretched
        rates.append(model.derivative(model.initial_state(measured, u) + 0.05, u)[1:4])
    assert np.abs(rates[1] - rates[0]).max() > 1e-3


def test_a_friction_of_another_name_is_refused():
    with pytest.raises(InputError, match="friction 'lugre'; expected one of str"):
        tn.load_robot(ROBOTS / "scara.urdf", friction=["lugre"])


HANGING = """<robot name="arm"><link name="base"/><link name="beam"><inertial>
  <origin xyz="0 0 -0.2"/><mass value="1.2"/>
  <inertia ixx="0.016" iyy="0.016" izz="0.0005" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hip" type="revolute"><parent link="base"/><child link="beam"/><axis xyz="0 1 0"/>
  <dynamics damping="0.05" friction="0.05"/><limit effort="5" velocity="10"/></joint></robot>"""


@pytest.fixture
def hanging(tmp_path) -> Path:
    """A beam that hangs, turned by a motor."""
    (file := tmp_path / "arm.urdf").write_text(HANGING)
    return file


def test_a_motor_behind_an_elastic_gear_moves_by_itself(hanging):
    """Against the equations of two masses, a spring with play between them."""
    system = tn.load_robot(hanging, elastic={"hip": 60.0}, backlash={"hip": 0.02})
    assert system.internal == ("hip.motor", "hip.motor_speed")
    p = system.nominal() | {"hip.armature": 0.01, "hip.gear_damping": 0.3}
    model = system.model({name: jnp.asarray(value) for name, value in p.items()})
    q, v, motor, speed, torque = 0.3, 0.5, 0.35, -0.8, 2.0
    _, a, rate, change = model.derivative(jnp.array([q, v, motor, speed]), jnp.array([torque]))
    gear = 60.0 * (motor - q - 0.01) + 0.3 * (speed - v)
    inertia = 0.016 + 1.2 * 0.2**2
    friction = 0.05 * speed + 0.05 * np.tanh(speed / p["hip.coulomb_speed"])
    assert float(rate) == pytest.approx(speed)
    assert float(change) == pytest.approx((torque - friction - gear) / 0.01, rel=1e-5)
    weight = 1.2 * 9.81 * 0.2 * np.sin(q)
    assert float(a) == pytest.approx((gear - weight) / inertia, rel=1e-5)
    # within the play nothing acts but the damping
    loose = model.derivative(jnp.array([q, v, q + 0.009, speed]), jnp.array([torque]))
    assert float(loose[1]) == pytest.approx((0.3 * (speed - v) - weight) / inertia, rel=1e-5)


@pytest.mark.thorough
def test_an_encoder_at_the_motor_changes_what_is_measured_alone(hanging):
    """The robot moves as with an encoder at the link; motor and link change their places."""
    load = partial(tn.load_robot, hanging, elastic={"hip": 60.0}, backlash={"hip": 0.02})
    by_link, by_motor = (load(encoders=x) for x in ("link", "motor"))
    assert by_motor.internal == ("hip.link", "hip.link_speed")
    assert load(encoders={"hip": "motor"}).internal == by_motor.internal
    nominal = {name: jnp.asarray(x) for name, x in by_link.nominal().items()}
    assert by_motor.nominal() == by_link.nominal()
    u, link, motor = jnp.array([2.0]), [0.3, 0.5], [0.35, -0.8]
    at_link = by_link.model(nominal).derivative(jnp.array([*link, *motor]), u)
    at_motor = by_motor.model(nominal).derivative(jnp.array([*motor, *link]), u)
    np.testing.assert_allclose(at_motor, at_link[jnp.array([2, 3, 0, 1])], rtol=1e-12)


def test_a_link_begins_where_the_load_twists_its_gear(hanging):
    """At rest that is gravity, whatever torque dry friction holds; else also its acceleration."""
    system = tn.load_robot(hanging, elastic={"hip": 60.0}, encoders="motor")
    values = system.nominal() | {"hip.armature": 0.01}
    model = system.model({name: jnp.asarray(x) for name, x in values.items()})
    weight = 1.2 * 9.81 * 0.2 * np.sin(0.4)
    for torque in (weight, weight + 0.04):  # its Coulomb friction is 0.05 N m
        begun = model.initial_internal(jnp.array([0.4, 0.0]), jnp.array([torque]))
        np.testing.assert_allclose(begun, [0.4 - weight / 60, 0.0], rtol=1e-6)
    inertia = 0.016 + 1.2 * 0.2**2
    acceleration = (2.0 - weight - 0.05 * 3.0 - 0.05) / (inertia + 0.01)
    begun = model.initial_internal(jnp.array([0.4, 3.0]), jnp.array([2.0]))
    twist = (weight + inertia * acceleration) / 60
    np.testing.assert_allclose(begun, [0.4 - twist, 3.0], rtol=1e-5)


@pytest.mark.parametrize(
    ("encoders", "message"),
    [
        ({"hip": "gear"}, "encoders of 'hip': 'gear'; expected 'motor' or 'link'"),
        (
            {"knee": "motor"},
            "encoders of 'knee': 'motor', and no elastic gear there; expected one of hip",
        ),
    ],
)
def test_encoders_are_checked(encoders, message, hanging):
    with pytest.raises(InputError, match=re.escape(message)):
        tn.load_robot(hanging, elastic={"hip": 60.0}, encoders=encoders)
    with pytest.raises(InputError, match="encoders: 'motor', and no elastic gear there; expected"):
        tn.load_robot(hanging, encoders="motor")


def test_the_stiffness_of_a_gear_is_identified(hanging):
    system = tn.load_robot(hanging, elastic={"hip": 60.0})
    true = system.nominal() | {"hip.gear_stiffness": 100.0, "hip.armature": 0.01}
    model = system.model({name: jnp.asarray(value) for name, value in true.items()})
    dt, count, rng = 0.002, 600, np.random.default_rng(0)
    step, t = (
        tn.compiled_step(tn.discretise(model, dt, 4, inputs=system.inputs)),
        dt * np.arange(count),
    )
    records = []
    for k in range(3):
        omega = 2 * np.pi * rng.uniform(0.3, 20, 12)
        torque = 0.35 * np.sin(omega * t[:, None] + rng.uniform(0, 6, 12)).sum(axis=1)
        states = [np.zeros(4)]
        for u in torque[:-1]:
            states.append(step(states[-1], np.array([u])))
        angle = np.round(np.array(states)[:, :1] / 1e-4) * 1e-4
        records.append(
            tn.from_arrays(
                angle,
                torque[:, None],
                dt=dt,
                name=f"run{k}",
                split="train" if k < 2 else "validation",
                coordinates=[tn.Coordinate("hip", "angular", 1e-4)],
                inputs=[tn.Input("hip_torque", "N m", "zero-order", is_delay_declared=True)],
            )
        )
    data = tn.DataSet("arm", tuple(records))
    result = tn.identify(data, system, "grey")  # along a flat valley
    for name in ("hip.gear_stiffness", "hip.armature", "hip.viscous", "hip.coulomb"):
        assert result.values[name] == pytest.approx(true[name], rel=0.05), name
    with pytest.raises(InputError, match="of a system with internal states"):
        tn.identify(data, system, "inverse-dynamics")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"locked": {"hip": np.nan}}, "locked: nan for 'hip'"),
        ({"motor_constants": {"hip": 0.0}}, "0.0 for 'hip'; expected a number other than 0"),
        ({"elastic": {"knee": 1.0}}, "elastic: the joint 'knee'"),
        ({"elastic": {"hip": -1.0}}, "elastic: -1.0 for 'hip'"),
        ({"backlash": {"hip": 0.1}}, "is elastic: give it a stiffness"),
        ({"default_density": 1e3}, "a shape and without an inertia"),
        ({"default_density": 0.0}, "0 kg/m^3; expected above 0"),
        ({"gravity": (9.81, 0.0)}, "(9.81, 0.0); expected three numbers [m/s^2]"),
        ({"gravity": (0.0, np.inf, 0.0)}, "expected three numbers [m/s^2] in the frame"),
    ],
)
def test_options_of_a_robot_are_checked(options, message, hanging):
    with pytest.raises(InputError, match=re.escape(message)):
        tn.load_robot(hanging, **options)


SHAPES = """<robot name="arm"><!-- as drawn --><link name="base"/>
  <link name="a"><collision><origin xyz="0.1 0 0" rpy="0.3 0.2 0.1"/><geometry>{}</geometry>
    </collision></link>
  <joint name="j" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
</robot>"""


@pytest.mark.parametrize(
    "shape",
    [
        '<box size="0.1 0.2 0.3"/>',
        '<sphere radius="0.1"/>',
        '<cylinder radius="0.1" length="0.3"/>',
        '<capsule radius="0.1" length="0.3"/>',
    ],
)
def test_a_link_without_inertia_gets_that_of_its_shape(shape, tmp_path):
    """As MuJoCo has it, which computes it from shapes as well."""
    (file := tmp_path / "arm.urdf").write_text(text := SHAPES.format(shape))
    system = tn.load_robot(file, default_density=1000.0)  # what MuJoCo takes by default
    compiled = mujoco.MjSpec.from_string(text).compile()
    nominal = system.nominal()
    assert nominal["a.mass"] == pytest.approx(compiled.body("a").mass[0])
    matrix, _ = terms_of(system, np.zeros((1, 2)))[0]
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    full = np.zeros((1, 1))
    mujoco.mj_fullM(compiled, data, full)
    np.testing.assert_allclose(matrix, full, rtol=1e-9)


def test_a_mass_of_zero_is_no_inertia_however_it_is_written(tmp_path):
    """A link that the reader takes for one without inertia is completed."""
    none = '<inertial><mass value="0.00"/><inertia/></inertial><collision>'
    (file := tmp_path / "arm.urdf").write_text(
        SHAPES.format('<sphere radius="0.1"/>').replace("<collision>", none)
    )
    mass = tn.load_robot(file, default_density=1000.0).nominal()["a.mass"]
    assert mass == pytest.approx(1000.0 * 4 / 3 * np.pi * 0.1**3)


def test_the_inertia_of_a_mesh_is_not_that_of_a_shape(tmp_path):
    (file := tmp_path / "arm.urdf").write_text(SHAPES.format('<mesh filename="a.stl"/>'))
    with pytest.raises(InputError, match="link 'a': no inertia, and the shape is a <mesh>"):
        tn.load_robot(file, default_density=1000.0)


def test_parameters_begin_at_the_files_values_within_ranges():
    system = tn.load_system(ROBOTS / "arm7.urdf")
    assert len(system.parameters) == 7 * 10 + 7 * 5
    p = system.nominal()
    assert p["shoulder.mass"] == 3.6
    assert (p["joint1.viscous"], p["joint1.coulomb"]) == (0.6, 1.2)
    assert p["flange.mass"] == pytest.approx(0.8), "the tool is fixed to it"
    assert all(x.prior is not None for x in system.parameters if not x.fixed)


def test_any_parameters_are_those_of_a_body():
    points = np.random.default_rng(0).normal(size=(5, 3))
    parts = [r @ r * np.eye(3) - np.outer(r, r) for r in points - points.mean(0)]
    tensor = np.sum(parts, axis=0)
    values = inertial_parameters(5.0, points.mean(0), tensor)
    assert min(values[name] for name in DIAGONAL) > 0
    rod = inertial_parameters(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.0]))
    assert min(rod[name] for name in DIAGONAL) == pytest.approx(1e-6)
    with pytest.raises(ValueError, match="larger than the sum"):
        inertial_parameters(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.3]))


@pytest.mark.parametrize("name", ["arm7.urdf", "scara.urdf", "gripper.urdf"])
def test_it_is_drawn_from_its_links(name):
    """Ends of links where the joints of the next ones are, with all joints at 0."""
    system = tn.load_system(ROBOTS / name)
    assert [link.coordinate for link in system.links] == [c.name for c in system.coordinates]
    ends: list[np.ndarray] = []
    for link, parent in zip(system.links, parent_indices(system.links), strict=True):
        begin = np.zeros(3) if parent is None else ends[parent]
        assert link.at is not None
        ends.append(begin + np.array(link.at))
    if name == "arm7.urdf":
        np.testing.assert_allclose(ends[-1], [0, 0, 1.24], atol=1e-9)


BALL = "<mass value='1'/><inertia ixx='1' iyy='1' izz='1'/>"
LINK = f"<link name='{{}}'><inertial>{BALL}</inertial></link>"
JOINT = "<joint name='{0}' type='{3}'><parent link='{1}'/><child link='{2}'/></joint>"
A, B, C = (LINK.format(name) for name in "abc")
AB, BC, CA = (JOINT.format(x + y, x, y, "revolute") for x, y in ("ab", "bc", "ca"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{A}{B}{C}{AB}{BC}{CA}", "a loop: the joints 'ab', 'bc', 'ca' carry one another"),
        (
            f"{A}{B}{C}{AB}{BC}{JOINT.format('ac', 'a', 'c', 'fixed')}",
            "'bc' and 'ac' both carry the link 'c'",
        ),
        (f"{A}{B}{C}{AB}", "links that no joint carries: 'a', 'c'"),
        (f"{A}<link name='b'><visual/></link>{AB}", "links that move have no masses"),
        (f"{A}<link name='b'/>{AB}", "links that move have no masses"),
        (
            f"{A}{B}{C}{AB}{JOINT.format('j', 'b', 'c', 'planar')}",
            "joint 'j': the type 'planar'; expected one of revolute",
        ),
        (
            f"{A}{B}{JOINT.format('j', 'a', 'd', 'fixed')}",
            "joint 'j': no link 'd'; expected one of a, b",
        ),
        (
            A + B + AB.replace("</joint>", "<axis xyz='0 0'/></joint>"),
            "<axis xyz> '0 0'; expected 3 numbers",
        ),
        (
            A + B + AB.replace("</joint>", "<mimic joint='ab'/></joint>"),
            "follows 'ab', which follows it",
        ),
        (A + B.replace("ixx='1'", "ixx='3'") + AB, "link 'b': an inertia that no body has"),
        (A + B.replace("value='1'", "value='-1'") + AB, "link 'b': a mass of -1 kg"),
        (f"{A}{A}", "two links 'a'"),
        (f"{A}{B}{JOINT.format('j', 'a', 'b', 'fixed')}", "no joint that moves"),
        (f"{A}{B}", "links that no joint carries"),
        ("<xacro:macro name='m'/>", "macros of xacro"),
    ],
)
def test_what_is_no_robot_is_refused_in_one_line(text, message, tmp_path):
    (file := tmp_path / "bad.urdf").write_text(f"<robot name='bad'>{text}</robot>")
    with pytest.raises(InputError) as error:
        tn.load_system(file)
    assert message in str(error.value)
    assert str(error.value).startswith(str(file))
    assert "\n" not in str(error.value)


TRANSMISSION = "<transmission name='t{0}'><joint name='{0}'/><actuator name='m'/></transmission>"
HEAVY = "a mass without an inertia, so a point"
MIMIC = "<mimic joint='cd'/></joint>"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (f"{A}{B}{AB}", ()),
        (
            f"{A}{B}{C}{AB}{BC.replace('revolute', 'fixed')}".replace("value='1'", "value='0'", 2),
            ("a, b: an inertia without a mass, which is 1e-12 kg to begin with",),
        ),
        (
            f"{A}{B}{C}{AB}{BC}".replace(BALL, "<mass value='1'/>", 2),
            (f"a, b: {HEAVY}",),
        ),
        (
            f"{A}{B}<link name='c'><visual/></link>{AB}{BC}",
            (
                "c: a shape without a mass, which a default density would give it",
                "bc: nothing with a mass moves by it: armature 0.001 to begin with",
            ),
        ),
        (
            f"{A}{B}{C}{AB.replace('revolute', 'floating')}{BC}",
            ("ab: does not move: the base stands",),
        ),
        (
            f"{A}{B}{AB.replace('</joint>', MIMIC)}",
            ("ab: moves by itself, as no joint moves that it is to follow",),
        ),
        (
            f"{A}{B}{C}{AB}{BC}" + "".join(map(TRANSMISSION.format, ("ab", "bc", "no"))),
            (
                "tbc: not one actuator at one joint, so an input at each joint",
                "tno: left out, as none of its joints is there",
            ),
        ),
        (
            f"{A}{B}{AB}<transmission name='t'><joint name='ab'/><actuator name='m'>"
            "<mechanicalReduction>50</mechanicalReduction></actuator></transmission>",
            ("t: its reduction does not count, as inputs are torques and forces at joints",),
        ),
        (
            A + B.replace("ixx='1'", "ixx='2.01'") + AB,
            (
                "b: its largest inertia is 0.5 % above the sum of the others, which become so much "
                "larger",
            ),
        ),
    ],
)
def test_files_as_they_are_in_the_world_are_read_and_it_is_told(text, told, tmp_path):
    (file := tmp_path / "arm.urdf").write_text(f"\n<robot name='arm'>{text}</robot>")
    source = tn.load_system(file).source
    assert source is not None
    assert source.remarks == tuple(f"arm.urdf, {sentence}" for sentence in told)


def test_what_is_told_has_its_meaning_in_the_equations(tmp_path):
    """Inputs of shared actuators, limits that are none, commas; the base of MuJoCo stands."""
    limits = "<limit lower='-1e16' upper='1e+16' effort='1e16' velocity='inf'/></joint>"
    differential = "<transmission name='t'><joint name='ab'/><joint name='bc'/></transmission>"
    turned = JOINT.format("x", "c", "d", "fixed").replace(
        "<parent", "<origin xyz='1, 2, 3'/><parent"
    )
    text = f"{A}{B}{C}{LINK.format('d')}{AB.replace('</joint>', limits)}{BC}{turned}{differential}"
    (file := tmp_path / "arm.urdf").write_text(f"<robot name='arm'>{text}</robot>")
    system = tn.load_system(file)
    assert [i.name for i in system.inputs] == ["ab_torque", "bc_torque"]
    assert (system.limits[0].position, system.limits[0].velocity) == (None, None)
    assert system.nominal()["c.center_z"] == pytest.approx(1.5)
    body = '<body name="base"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    text = f"<mujoco><worldbody>{body}{BODY.format('')}</body></worldbody></mujoco>"
    (file := tmp_path / "free.xml").write_text(text)
    source = (system := tn.load_system(file)).source
    assert [c.name for c in system.coordinates] == ["j"]
    assert source is not None
    told = "free.xml, base: stands where the file has it, and does not move freely"
    assert source.remarks == (told,)


@pytest.mark.parametrize("ending", ["urdf", "xml"])
def test_entities_and_broken_files_are_refused(ending, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("secret")
    root = "robot" if ending == "urdf" else "mujoco"
    file = tmp_path / f"bad.{ending}"
    for text, message in (
        (f'<!DOCTYPE r [<!ENTITY x SYSTEM "{secret}">]><{root}>&x;</{root}>', "a document type"),
        (f"<{root}><link></{root}>", "no well-formed XML"),
        ("", "no well-formed XML"),
        ("<html/>", "the root element <html>"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message) as error:
            tn.load_system(file)
        assert "\n" not in str(error.value)


BODY = (
    '<body name="b"><joint name="j"/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/>{}</body>'
)
NAMELESS = BODY.format("").replace(' name="j"', "")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '<worldbody><body name="b"><freejoint/><geom size="1"/></body></worldbody>',
            "no joint that moves",
        ),
        (
            '<worldbody><body name="b"><joint name="j" type="ball"/><geom size="1"/></body>'
            "</worldbody>",
            "a ball joint",
        ),
        (
            '<asset><mesh name="m" file="m.stl"/></asset><worldbody><body name="b">'
            '<joint name="j"/>'
            '<geom type="mesh" mesh="m"/></body></worldbody>',
            "body 'b': no <inertial>",
        ),
        (
            f'<worldbody>{BODY.format("")}</worldbody><equality><connect name="e" '
            'body1="b" body2="world" anchor="0 0 0"/></equality>',
            "a loop: the equality constraint 'e' (connect)",
        ),
        (
            f'<worldbody>{BODY.format("")}</worldbody><equality><weld body1="b"/></equality>',
            "a loop: the equality constraint number 1, without a name (weld)",
        ),
        (
            f'<worldbody>{BODY.format("")}</worldbody><tendon><fixed name="t"><joint joint="j" '
            'coef="1"/></fixed></tendon><equality><tendon name="e" tendon1="t"/></equality>',
            "bad.xml: the equality constraint 'e' (tendon); expected a tree",
        ),
        (
            f"<worldbody>{BODY.format('')}</worldbody><equality><connect "
            'body1="b" body2="world" anchor="0 0 0"/></equality>',
            "number 1, without a name (connect)",
        ),
        (
            '<worldbody><body name="b"><joint name="j"/></body></worldbody>',
            "body 'b': moves and has no inertia",
        ),
        (
            f'<worldbody>{BODY.format("")}</worldbody><actuator><general name="a" joint="j" '
            'dyntype="filter" dynprm="1"/></actuator>',
            "actuator 'a': states of its own",
        ),
        (f"<worldbody>{NAMELESS}</worldbody>", "a joint without a name"),
        ("<nonsense/>", "MuJoCo refuses it"),
    ],
)
def test_what_mujoco_has_and_equations_here_have_not_is_refused(text, message, tmp_path):
    (file := tmp_path / "bad.xml").write_text(f"<mujoco>{text}</mujoco>")
    with pytest.raises(InputError, match=r"bad\.xml") as error:
        tn.load_system(file)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_what_is_only_seen_or_read_by_other_programs_is_left_out(tmp_path):
    site = '<site name="s" material="red"/>'
    (file := tmp_path / "seen.xml").write_text(
        f'<mujoco><asset><material name="red"/></asset><worldbody>{BODY.format(site)}</worldbody>'
        "</mujoco>"
    )
    assert [c.name for c in tn.load_system(file).coordinates] == ["j"]
    limit = "<limit drake:acceleration='2' effort='1' velocity='1'/></joint>"
    (file := tmp_path / "prefixes.urdf").write_text(
        f"<robot name='r'>{A}{B}{AB.replace('</joint>', limit)}<drake:group name='g'/></robot>"
    )
    assert [c.name for c in tn.load_system(file).coordinates] == ["ab"]


def test_forces_that_a_file_switches_off_are_none(tmp_path):
    joint = '<joint name="j" damping="1" frictionloss="1" stiffness="1"/>'
    body = BODY.format("").replace('<joint name="j"/>', joint)
    flags = " ".join(f'{x}="disable"' for x in ("gravity", "spring", "damper", "frictionloss"))
    found = []
    for option in ("", f"<option><flag {flags}/></option>"):
        (file := tmp_path / "r.xml").write_text(
            f"<mujoco>{option}<worldbody>{body}</worldbody></mujoco>"
        )
        system = tn.load_system(file)
        model = system.model({name: jnp.asarray(x) for name, x in system.nominal().items()})
        found.append(model.derivative(jnp.array([1.0, 0.0]), jnp.zeros(len(system.inputs)))[1])
        assert system.nominal()["j.viscous"] == (0.0 if option else 1.0)
    assert abs(found[0]) > 0.1
    assert found[1] == 0.0


def test_files_are_included_once(tmp_path):
    body = f"<mujocoinclude>{BODY.format('')}</mujocoinclude>"
    (tmp_path / "body.xml").write_text(body)
    file = tmp_path / "scene.xml"
    file.write_text('<mujoco><worldbody><include file="body.xml"/></worldbody></mujoco>')
    assert [c.name for c in tn.load_system(file).coordinates] == ["j"]
    (tmp_path / "body.xml").write_text(body.replace("</body>", '</body><include file="body.xml"/>'))
    with pytest.raises(InputError, match=r"includes 'body.xml' twice"):
        tn.load_system(file)


def test_joints_and_columns_have_to_agree():
    system = tn.load_system(ROBOTS / "gripper.urdf")
    lift, turn, left = system.coordinates
    for coordinates, message in (
        (
            [lift, turn],
            r"no coordinate of the joint 'left' of gripper.urdf; .*locked=\{'left': 0.0\}",
        ),
        (
            [lift, turn, left, tn.Coordinate("right", "linear")],
            "'right': such a joint does not move by itself",
        ),
        (
            [lift, turn, left, tn.Coordinate("wrist", "angular")],
            "'wrist': such a joint is not there",
        ),
    ):
        with pytest.raises(InputError, match=message):
            system.for_channels(coordinates, system.inputs, "record 'one'")
    with pytest.raises(InputError, match="'thrust': no such actuator"):
        system.for_channels(system.coordinates, [tn.Input("thrust", "N")], "record 'one'")
    # a joint without an input is not driven
    passive = system.for_channels(system.coordinates, [tn.Input("tau_turn", "N m")], "record 'one'")
    assert [i.name for i in passive.inputs] == ["tau_turn"]


def test_limits_of_joints_are_those_of_a_urdf():
    limits = dict(
        zip(("lift", "turn", "left"), tn.load_system(ROBOTS / "gripper.urdf").limits, strict=True)
    )
    assert limits["lift"] == MotionLimits((0.0, 0.5), 0.5, force=200.0)
    assert limits["left"] == MotionLimits((0.0, 0.04), 0.1, force=40.0)
    scara = tn.load_system(ROBOTS / "scara.urdf")
    assert scara.limits[3] == MotionLimits(), "a continuous joint has none"
    reordered = scara.for_channels(scara.coordinates[::-1], scara.inputs[::-1], "records")
    assert reordered.limits == scara.limits[::-1]


def test_a_joint_that_follows_limits_the_one_that_it_follows(tmp_path):
    text = (ROBOTS / "gripper.urdf").read_text()
    text = text.replace('multiplier="1" offset="0"', 'multiplier="-2" offset="0.04"')
    (tmp_path / "gripper.urdf").write_text(text)
    left = tn.load_system(tmp_path / "gripper.urdf").limits[2]
    assert left.position == pytest.approx((0.0, 0.02))
    assert left.velocity == pytest.approx(0.05)


def test_limits_of_joints_are_those_of_a_file_of_mujoco(tmp_path):
    text = (ROBOTS / "cart_pole.xml").read_text()
    changes = {
        'type="slide" axis': 'type="slide" range="-0.4 0.6" axis',
        '<joint name="pole"': '<joint name="pole" actuatorfrcrange="-3 2"',
        'joint="slide"/>': 'joint="slide" gear="5" ctrlrange="-2 2" forcerange="-3 1.5"/>'
        '<motor name="torque" joint="pole" forcerange="-4 4"/>',
    }
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "robot.xml").write_text(text)
    slide, pole = tn.load_system(tmp_path / "robot.xml").limits
    assert slide == MotionLimits((-0.4, 0.6), force=7.5), "the smallest of both directions"
    assert pole == MotionLimits(force=2.0)


@pytest.mark.usefixtures("unchecked")
def test_values_by_name_are_needed_where_names_alone_are_given():
    """Of every option that is a mapping."""
    for option in ("locked", "motor_constants", "per", "elastic", "backlash", "encoders", "ranges"):
        named: dict[str, Any] = {option: ["elbow"]}
        with pytest.raises(InputError, match=r"\['elbow'\]; expected a value by name, as"):
            tn.load_robot(ROBOTS / "scara.urdf", **named)


CHAIN = """<robot name="arm"><link name="base"/><link name="a"><inertial><origin xyz="{}"/>
<mass value="1"/><inertia/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="{}" upper="{}" effort="1" velocity="1"/></joint>
{}</robot>"""
CARRIED = """<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
</link><joint name="ab" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""
MUJOCO = """<mujoco><compiler angle="radian"/><worldbody><body name="a">
<joint name="turn" range="{} {}"/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/>
<body name="b"><joint name="ab"/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/></body></body>
</worldbody></mujoco>"""


def test_exchanged_limits_and_joints_locked_outside_of_theirs_are_refused(tmp_path):
    urdf, mujoco = tmp_path / "arm.urdf", tmp_path / "arm.xml"
    for path, text in ((urdf, CHAIN.format("1 0 0", "{}", "{}", CARRIED)), (mujoco, MUJOCO)):
        path.write_text(text.format(1, -1))
        with pytest.raises(InputError, match="joint 'turn': position 1, limits 1 to -1; expected"):
            tn.load_robot(path)
        path.write_text(text.format(-1, 1))
        with pytest.raises(InputError, match=r"joint 'turn': position 1\.5, limits -1 to 1"):
            tn.load_robot(path, locked={"turn": 1.5})
        assert len(tn.load_robot(path, locked={"turn": 1.0}).coordinates) == 1
        path.write_text(text.format(0, 0))  # as files have it that know no limits
        assert len(tn.load_robot(path, locked={"turn": 1.5}).coordinates) == 1


def test_a_file_whose_inertias_are_all_0_is_refused(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(CHAIN.format("0 0 0", -1, 1, ""))
    with pytest.raises(InputError, match="all their inertias and centres are 0"):
        tn.load_robot(path)
    # a last link without an inertia is not rare: that of its motor is found
    for center, carried in (("0.1 0 0", ""), ("0 0 0", CARRIED)):
        path.write_text(CHAIN.format(center, -1, 1, carried))
        assert tn.load_robot(path).coordinates


# --- files that were made to do harm ---

BOMBS = {
    "shapes": '<worldbody><replicate count="3000" offset="0 0 1"><replicate count="3000" '
    'offset="0 1 0"><geom size=".1"/></replicate></replicate>{}</worldbody>',
    "bodies": '<worldbody><replicate count="100000000" offset="0 0 1">{}</replicate></worldbody>',
    "a field": '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'
    "<worldbody>{}</worldbody>",
}


@pytest.mark.parametrize("kind", BOMBS)
def test_a_small_file_that_takes_gigabytes_is_refused_by_a_line(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(mjcf, "_SECONDS", 3.0)
    monkeypatch.setattr(mjcf, "_MEMORY", 2**28)
    file = tmp_path / "bomb.xml"
    body = BOMBS[kind].format(BODY.format('name="j1"'))
    file.write_text(f"<mujoco>{body}</mujoco>")
    with pytest.raises(InputError, match=r"bomb\.xml: (the file crashes|MuJoCo refuses)"):
        tn.load_robot(file)


@pytest.mark.parametrize("where", ["outside.xml", "link.xml", "/etc/passwd"])
def test_nothing_is_included_from_outside_of_a_files_folder(where, tmp_path):
    folder = tmp_path / "robot"
    folder.mkdir()
    body = f"<mujocoinclude>{BODY.format('')}</mujocoinclude>"
    (tmp_path / "outside.xml").write_text(body)
    (folder / "link.xml").symlink_to(tmp_path / "outside.xml")
    name = where if where != "outside.xml" else "../outside.xml"
    text = f'<mujoco><worldbody><include file="{name}"/></worldbody></mujoco>'
    (folder / "robot.xml").write_text(text)
    with pytest.raises(InputError, match=f"includes '{re.escape(name)}', outside of its folder"):
        tn.load_robot(folder / "robot.xml")
    # nor by a text whose includes nobody has resolved, as that of a copy in a run's folder
    with pytest.raises(InputError, match="<include>, which stands for other files"):
        read_robot(text, folder / "system.xml")


@pytest.mark.parametrize("ending", ["urdf", "xml"])
def test_a_chain_of_a_thousand_joints_is_refused_by_a_line(ending, tmp_path):
    inertial = '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'
    if ending == "xml":
        body = "".join(f'<body><joint name="j{k}"/>{inertial}' for k in range(101))
        text = f"<mujoco><worldbody>{body}{'</body>' * 101}</worldbody></mujoco>"
    else:
        links = "".join(f'<link name="l{k}"/>' for k in range(1001))
        joints = "".join(
            f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
            "</joint>"
            for k in range(1000)
        )
        text = f'<robot name="r">{links}{joints}</robot>'
    file = tmp_path / f"long.{ending}"
    file.write_text(text)
    with pytest.raises(InputError, match=r"\d+ joints that move; expected at most 100"):
        tn.load_robot(file)
