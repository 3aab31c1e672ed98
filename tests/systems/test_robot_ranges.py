"""Ranges of a robot's parameters, the line that loads it, links that are fixed to others."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.fitting.report import Estimate
from tustinnet.fitting.shooting.findings import describe_bounds
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.systems.robot_reading import read_robot_text
from tustinnet.systems.robots import RobotFile

# a light hand behind a geared motor, of whose joint nothing says what it can do
WRIST = """<robot name="wrist"><link name="base"/>
  <link name="hand"><inertial><origin xyz="0.05 0 0"/><mass value="0.5"/>
    <inertia ixx="5e-4" iyy="6e-4" izz="6e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tool"><inertial><origin xyz="0.02 0 0"/><mass value="0.2"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tag"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="hand"/>
    <axis xyz="0 1 0"/>{limit}</joint>
  <joint name="mount" type="fixed"><parent link="hand"/><child link="tool"/></joint>
  <joint name="sticker" type="fixed"><parent link="base"/><child link="tag"/></joint>
</robot>"""


SERVO = """<mujoco><compiler angle="radian"/><worldbody><body name="arm">
  <joint name="servo" axis="0 1 0" damping="0.01"/>
  <inertial pos="0 0 -0.12" mass="0.175" diaginertia="7e-4 7e-4 2e-5"/></body></worldbody>
  <actuator><position name="servo" joint="servo" kp="2.5" forcerange="-1.4 1.4"/></actuator>
</mujoco>"""


@pytest.fixture
def wrist(tmp_path: Path) -> Path:
    (file := tmp_path / "wrist.urdf").write_text(WRIST.format(limit=""))
    return file


def records_of(system: LagrangianSystem, torque: float, omega: float) -> tn.Experiment:
    """A record whose angle and torque are sines of given sizes."""
    t = np.arange(0, 4, 0.004)
    return tn.from_arrays(
        np.sin(omega * t)[:, None],
        torque * np.cos(omega * t)[:, None],
        dt=0.004,
        coordinates=system.coordinates,
        inputs=system.inputs,
    )


def test_friction_of_a_joint_without_limits_has_a_range_by_the_records(wrist: Path) -> None:
    system = tn.load_system(wrist)
    record = records_of(system, torque=3.2, omega=3.0)
    seen = system.for_records([record], "record 'one'")
    before, after = system.parameter("turn.viscous"), seen.parameter("turn.viscous")
    assert after.upper == pytest.approx(5.0 / 2.0), "3.2 N m up, 3 rad/s down"
    assert after.upper > 5 * before.upper
    assert "the largest force in the records" in after.basis
    assert seen.parameter("turn.coulomb").upper == pytest.approx(5.0)
    assert seen.nominal() == system.nominal()
    # a part of the records makes one system
    part = system.for_records([record[:700]], "record 'one'")
    assert part.parameters == seen.parameters


def test_limits_of_the_file_decide_where_it_has_some(tmp_path: Path) -> None:
    limit = '<limit lower="-1" upper="1" effort="8" velocity="4"/>'
    (file := tmp_path / "wrist.urdf").write_text(WRIST.format(limit=limit))
    system = tn.load_system(file)
    assert system.inputs[0].limits == (-8.0, 8.0)
    seen = system.for_records([records_of(system, 30.0, 20.0)], "record 'one'")
    assert seen.parameters == system.parameters
    assert seen.parameter("turn.viscous").upper == pytest.approx(2.0)


def test_a_servo_has_the_force_of_its_file_and_else_that_of_its_gains(tmp_path: Path) -> None:
    """A goal is no force: it says one by the gains, and no more than the file has."""
    (file := tmp_path / "servo.xml").write_text(SERVO)
    system = tn.load_system(file)
    seen = system.for_records([records_of(system, 0.8, 3.0)], "record 'one'")
    viscous, coulomb = (seen.parameter(f"servo.{name}") for name in ("viscous", "coulomb"))
    assert (viscous.upper, coulomb.upper) == pytest.approx((1.4 / 2.0, 1.4))
    assert viscous.basis == (
        "1.4 by 2, the largest force of the joint in the file, and the largest speed in the "
        "records, in round numbers"
    )
    file.write_text(SERVO.replace('forcerange="-1.4 1.4"', ""))
    seen = tn.load_system(file).for_records([records_of(system, 0.8, 3.0)], "record 'one'")
    # 2.5 N m/rad times 1.28 rad
    assert seen.parameter("servo.coulomb").upper == pytest.approx(5.0)
    assert (
        "in the records, as the file has none, by its gains" in seen.parameter("servo.offset").basis
    )


def test_a_range_can_be_given(wrist: Path) -> None:
    system = tn.load_robot(wrist, ranges={"turn.viscous": (0.0, 7.0)})
    parameter = system.parameter("turn.viscous")
    assert (parameter.lower, parameter.upper) == (0.0, 7.0)
    seen = system.for_records([records_of(system, 3.0, 3.0)], "record 'one'")
    assert seen.parameter("turn.viscous").upper == 7.0, "that counts, and not the records"


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        (
            {"turn.vicous": (0.0, 7.0)},
            "no parameter 'turn.vicous'; expected a parameter that is "
            "searched for, as turn.viscous",
        ),
        ({"turn.coulomb_speed": (0.0, 7.0)}, "the parameter 'turn.coulomb_speed' is fixed"),
        ({"turn.viscous": (7.0, 0.0)}, "(7.0, 0.0) for 'turn.viscous'; expected two numbers"),
        ({"turn.viscous": (0.0, np.nan)}, "ranges: (0.0, nan) for 'turn.viscous'"),
        ({"hand.mass": (0.0, 3.0)}, "'hand.mass' from 0 on; expected a range above 0"),
        ({"hand.mass": (2.0, 3.0)}, "nominal value 0.7 kg; expected a value within 2..3"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(ranges, message: str, wrist: Path) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        tn.load_robot(wrist, ranges=ranges)


@pytest.mark.parametrize(
    ("link", "message"),
    [
        (
            "tool",
            "'tool' is fixed to 'hand', and both are one body; expected a link that moves and "
            "has a mass: hand; name the link that moves: per={'hand': 'payload'}",
        ),
        ("tag", "per: the link 'tag' is fixed to the base, which does not move"),
        ("thumb", "per: no link 'thumb'; expected a link that moves and has a mass: hand"),
    ],
)
def test_a_link_that_another_one_carries_is_named(link: str, message: str, wrist: Path) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        tn.load_robot(wrist, per={link: "payload"})


def test_advice_keeps_what_the_user_gave(tmp_path: Path) -> None:
    inertial = re.findall(r"<inertial>.*?</inertial>", WRIST, re.DOTALL)[1]
    shape = '<visual><geometry><sphere radius="0.02"/></geometry></visual>'
    text = WRIST.replace(inertial, shape)
    (file := tmp_path / "wrist.urdf").write_text(text.format(limit=""))
    system = tn.load_robot(file, default_density=2700.0, per={"hand": "payload"})
    with pytest.raises(InputError) as caught:
        system.for_channels([], system.inputs, "the card")
    line = re.search(r"SYSTEM = tn.*\)", str(caught.value))
    assert line is not None
    assert line[0] == (
        "SYSTEM = tn.load_robot('wrist.urdf', locked={'turn': 0.0}, per={'hand': 'payload'}, "
        "default_density=2700.0)"
    )
    assert isinstance(source := system.source, RobotFile)
    assert "friction=['curve']" in source.call(friction=["curve"])
    assert "Ellipsis" not in str(caught.value)


def test_everything_that_does_not_agree_is_said_at_once(wrist: Path) -> None:
    system = tn.load_system(wrist)
    coordinates = [tn.Coordinate("Turn", "angular")]
    inputs = [tn.Input("turn_torque", "A"), tn.Input("fan", "V")]
    with pytest.raises(InputError) as caught:
        system.for_channels(coordinates, inputs, "dataset.toml")
    message = str(caught.value)
    assert "\n" not in message
    for part in (
        "no coordinate of the joint 'turn' of wrist.urdf",
        "rename the coordinate 'Turn' to 'turn'",
        "input 'turn_torque' in A",
        "motor_constants={'turn': ...}",
        "input 'fan': no such actuator",
    ):
        assert part in message
    # a name that another input has is no advice
    inputs = [tn.Input("turn_torque", "N m"), tn.Input("trn_torque", "N m")]
    with pytest.raises(InputError, match="input 'trn_torque': no such actuator") as caught:
        system.for_channels(system.coordinates, inputs, "dataset.toml")
    assert "rename" not in str(caught.value)
    wrong_kind = [replace(system.coordinates[0], kind="linear", unit="m")]
    with pytest.raises(InputError, match="'turn' is linear, and the joint turns"):
        system.for_channels(wrong_kind, system.inputs, "dataset.toml")


def test_a_bound_says_where_it_is_from_and_how_to_move_it(wrist: Path) -> None:
    system = tn.load_robot(wrist, default_density=None, per={"hand": "payload"})
    parameter = system.parameter("turn.viscous")
    estimates = [
        Estimate(
            "turn.viscous",
            "N m s/rad",
            parameter.upper,
            None,
            None,
            None,
            0.0,
            parameter.upper,
            "upper",
        ),
        Estimate("hand.mass[1kg]", "kg", 0.14, None, None, None, 0.14, 3.5, "lower"),
        Estimate("turn.coulomb", "N m", 0.0, None, None, None, 0.0, 1.0, "lower"),
    ]
    first, second, third, advice = map(str, describe_bounds(estimates, None, system))
    assert "range: 10 times the inertia that it moves by the file" in first
    assert "range: 1/5 to 5 times the value in the file" in second
    assert "nothing of the machine as long as the model misses more" in third
    assert "'+ constant'" in third
    followed = [f.text for f in describe_bounds(estimates, 1.0, system)]
    assert "'turn.coulomb' is 0, its lower bound: the records show nothing of it" in followed
    assert "tn.load_robot('wrist.urdf', per={'hand': 'payload'}, ranges={'turn.viscous'" in advice
    assert "'hand.mass': (0.014, 3.5)" in advice
    wider = re.search(r"'turn.viscous': \((.*?)\)", advice)
    assert wider is not None
    lower, upper = map(float, wider[1].split(","))
    assert (lower, upper > 2 * parameter.upper) == (0.0, True)


def test_formats_that_are_mixed_up_are_said(tmp_path: Path) -> None:
    (urdf := tmp_path / "a.urdf").write_text('<mujoco model="a"/>')
    (mjcf := tmp_path / "b.xml").write_text('<robot name="b"/>')
    with pytest.raises(InputError, match=r"<mujoco>.*has the ending \.xml"):
        tn.load_system(urdf)
    with pytest.raises(InputError, match=r"<robot>.*has the ending \.urdf"):
        tn.load_system(mjcf)
    assert read_robot_text(urdf).startswith("<mujoco")
    with pytest.raises(InputError, match="run xacro"):
        tn.load_system(tmp_path / "arm.urdf.xacro")
