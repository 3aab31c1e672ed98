"""Values of coordinates and inputs as people write them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tustinnet as tn
from tustinnet.channels import Channels, ColumnUnit, PDController, PDLoop
from tustinnet.data.quantities import ValueReader

UNITS = {"rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi, "mrad": 1e-3}
CHANNELS = Channels(
    (tn.Coordinate("elbow", "angular"), tn.Coordinate("cart", "linear")),
    (tn.Input("motor", "V"), tn.Input("brake", "Nm")),
)
COLUMNS = {"elbow": ColumnUnit("deg", UNITS["deg"]), "cart": ColumnUnit("counts", 2e-5)}


def read(name: str, text: str | float, count: int = 1) -> tuple[tuple[float, ...], str]:
    lines: list[str] = []
    values = ValueReader(CHANNELS, COLUMNS, lines.append).read("here", {name: text}, count)
    return values[name], lines[0]


@given(st.floats(-1e3, 1e3), st.sampled_from(sorted(UNITS)), st.sampled_from(["", " "]))
def test_a_unit_may_follow_and_a_number_alone_is_in_the_unit_of_the_column(number, unit, gap):
    assert read("elbow", f"{number!r}{gap}{unit}")[0] == pytest.approx([number * UNITS[unit]])
    assert read("elbow", number) == read("elbow", f"{number!r} deg")


@pytest.mark.parametrize(
    ("name", "text", "values", "line"),
    [
        ("elbow", "180", [np.pi], "here: elbow = 180 deg (3.142 rad)"),
        ("elbow", "0.5rad", [0.5], "here: elbow = 0.5 rad"),
        ("der_elbow", "60", [np.pi / 3], "here: der_elbow = 60 deg/s (1.047 rad/s)"),
        ("elbow_dot", "10rpm", [np.pi / 3], "here: elbow_dot = 10 rpm (1.047 rad/s)"),
        ("elbow_ddot", "180", [np.pi], "here: elbow_ddot = 180 deg/s^2 (3.142 rad/s^2)"),
        ("integral_elbow", "180", [np.pi], "here: integral_elbow = 180 deg*s (3.142 rad*s)"),
        ("cart", "1000", [0.02], "here: cart = 1000 counts (0.02 m)"),
        ("cart", "20 mm", [0.02], "here: cart = 20 mm (0.02 m)"),
        ("motor", "-10:10", [-10, 10], "here: motor = -10:10 V"),
        ("motor", "-9000:9e3 mV", [-9, 9], "here: motor = -9000:9000 mV (-9:9 V)"),
        ("motor", "-9V:9", [-9, 9], "here: motor = -9:9 V"),
        ("brake", "3Nm", [3], "here: brake = 3 Nm"),
        ("inner", "-.5", [-0.5], "here: inner = -0.5"),
    ],
)
def test_what_was_understood_is_said_in_both_units(name, text, values, line):
    found, said = read(name, text, len(values))
    assert found == pytest.approx(values)
    assert said == line


@pytest.mark.parametrize(
    ("name", "text", "count", "words"),
    [
        (
            "elbow",
            "fast",
            1,
            "not understood; expected a number; a number without a unit is in deg",
        ),
        ("elbow", "nan", 1, "not understood"),
        ("elbow", "1:2", 1, "not understood"),
        ("elbow", "1", 2, "not understood; expected LOW:HIGH"),
        ("elbow", "2:1", 2, "not understood; expected LOW:HIGH, the smaller number first"),
        ("elbow", "1rad:90deg", 2, "not understood"),
        ("elbow", "1 mile", 1, "'mile' is not a unit of a quantity in rad"),
        ("elbow", "1 nothing", 1, "unit 'nothing' is not known"),
        ("der_elbow", "5 deg", 1, "'deg' is not a unit of a quantity in rad/s"),
        ("motor", "5 A", 1, "'A' is not a unit of a quantity in V"),
        ("inner", "5 rad", 1, "unit '' is none"),
    ],
)
def test_what_is_no_value_is_refused_with_the_unit_of_a_number_alone(name, text, count, words):
    with pytest.raises(tn.InputError, match=f"here, {name}={text}: .*{words}"):
        read(name, text, count)


def test_set_points_are_written_as_what_they_set():
    loop = PDLoop("motor", "elbow", "wanted", "wanted_speed", kp=1.0, kd=0.1)
    controller = PDController(CHANNELS.inputs[:1], (loop,))
    points = (tn.Input("wanted", "rad"), tn.Input("wanted_speed", "rad/s"))
    channels = Channels(CHANNELS.coordinates, points, controller=controller)
    texts = {"wanted": "90", "wanted_speed": "180deg/s"}
    values = ValueReader(channels, COLUMNS, lambda _: None).read("here", texts)
    assert values == {
        "wanted": (pytest.approx(np.pi / 2),),
        "wanted_speed": (pytest.approx(np.pi),),
    }
