"""The table [controller] of a data card: set points as inputs, and what is refused."""

from typing import Any

import numpy as np
import polars as pl
import pytest
from held_swings import KD, KP, LIMIT, card, held_swings, table

import tustinnet as tn
from tustinnet.channels import Channels
from tustinnet.check.check import check
from tustinnet.data.card import Card
from tustinnet.data.declaration import declare, read_declaration
from tustinnet.data.loading import from_frame, load_folder
from tustinnet.errors import InputError
from tustinnet.store.data_set_folder import write_data_set


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    return table(seconds=1.0)


def read(columns: dict[str, np.ndarray], card: dict[str, Any]) -> tn.Experiment:
    return from_frame(pl.DataFrame(columns), card)


def test_set_points_are_the_inputs_and_the_voltage_is_kept(columns):
    e = read(columns, card())
    assert [(i.name, i.unit, i.hold) for i in e.inputs] == [
        ("angle_setpoint", "rad", "zero-order"),
        ("angle_velocity_setpoint", "rad/s", "zero-order"),
        ("voltage_feedforward", "V", "zero-order"),
    ]
    np.testing.assert_array_equal(e.u[:, 0], columns["wanted"])
    assert e.outputs is not None
    assert e.channels.controller is not None
    np.testing.assert_array_equal(e.outputs[:, 0], columns["volts"])
    (loop,) = e.channels.controller.loops
    assert (loop.kp, loop.kd) == (KP, KD)
    alone = e.without_controller()
    assert [i.name for i in alone.inputs] == ["voltage"]
    np.testing.assert_array_equal(alone.u[:, 0], columns["volts"])
    # parts and resampled records keep both
    part, finer = e[10:20].outputs, e.resample(e.dt / 2).outputs
    assert part is not None
    assert finer is not None
    assert len(part) == 10
    assert finer.shape == (2 * len(e) - 1, 1)


def test_set_points_have_sign_zero_and_unit_of_the_coordinate(columns):
    other = card(position={"column": "wanted", "unit": "rad"})
    (angle,) = other["coordinates"]
    degrees = columns | {"read": 30 - np.degrees(columns["read"])}
    degrees["wanted"] = np.radians(30) - columns["wanted"]
    degrees["wanted_rate"] = -np.degrees(columns["wanted_rate"])
    angle |= {"unit": "deg", "sign": -1, "offset": 30.0}
    e, plain = read(degrees, other), read(columns, card())
    np.testing.assert_allclose(e.q, plain.q, atol=1e-12)
    np.testing.assert_allclose(e.u, plain.u, atol=1e-12)


def test_set_points_that_wrap_stay_beside_the_angle(columns):
    edge = np.median(columns["wanted"])
    wrapped = {
        name: (x - edge) % (2 * np.pi) if name in ("read", "wanted") else x
        for name, x in columns.items()
    }
    e, plain = read(wrapped, card()), read(columns, card())
    assert np.abs(np.diff(wrapped["wanted"])).max() > 6
    np.testing.assert_allclose(e.q[:, 0] - e.u[:, 0], plain.q[:, 0] - plain.u[:, 0], atol=1e-9)


def test_integral_filter_and_delay_are_read_and_written(columns, tmp_path):
    e = read(columns, card(kind="pid", ki=5.0, velocity_filter=0.02, delay=2))
    assert e.channels.controller is not None
    (loop,) = e.channels.controller.loops
    assert (loop.ki, loop.velocity_filter, loop.delay) == (5.0, 0.02, 2)
    assert loop.gains == ("kp", "kd", "ki")
    assert Channels.from_header(e.channels.as_header()) == e.channels
    for kind, ki in (("pid", None), ("pid", 0.0), ("pd", 0.0)):
        keys = {} if kind == "pd" else {"ki": ki}
        record = read(columns, card(kind=kind, **keys))
        path = write_data_set(tn.DataSet("one", (record,)), tmp_path, "One", overwrite=True)
        again = load_folder(tmp_path, read_declaration(path, Card))
        assert again.channels.controller is not None
        assert again.channels.controller.loops[0].ki == ki


def test_inputs_need_no_column_where_the_gains_are_known(columns):
    without = card()
    del without["inputs"][0]["column"]
    e = read(columns, without)
    assert e.outputs is None
    assert not e.without_controller().u.any()
    assert check([e]) == check([e])  # of the set points


def test_checks_see_the_system_alone():
    records = list(held_swings(2))
    findings = check(records)
    assert findings == check([e.without_controller() for e in records])


def test_channels_in_files_are_those_of_the_records(columns):
    e = read(columns, card(kd=None))
    assert Channels.from_header(e.channels.as_header()) == e.channels
    with pytest.raises(InputError, match="a controller in the loop; expected none, as in"):
        e.channels.plant.require_same(e.channels, "run", "the model")
    with pytest.raises(InputError, match=r"no controller in the loop; .*table \[controller\]"):
        e.channels.require_same(e.channels.plant, "run", "the model")


def test_records_of_two_controllers_are_no_data_set():
    first, second = held_swings(1)[0], held_swings(2, kp=2 * KP)[1]
    with pytest.raises(InputError, match="run1: another controller; expected that of run0"):
        tn.DataSet("two", (first, second))


def test_a_written_folder_reads_the_same(tmp_path):
    data = held_swings(2, kp=None)
    path = write_data_set(data, tmp_path, "Held")
    again = load_folder(tmp_path, read_declaration(path, Card))
    assert again.channels.controller is not None
    assert data.channels.controller is not None
    assert again.channels.controller.loops == data.channels.controller.loops
    assert again.channels.controller.inputs[0].limits == (-LIMIT, LIMIT)
    for e, other in zip(data, again, strict=True):
        assert e.outputs is not None
        assert other.outputs is not None
        np.testing.assert_allclose(other.u, e.u, rtol=1e-8)
        np.testing.assert_allclose(other.outputs, e.outputs, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("loop", "words"),
    [
        ({"coordinate": "elbow"}, r"no coordinate 'elbow'; expected one of angle"),
        ({"input": "torque"}, r"no input 'torque'; expected one of voltage"),
        ({"kp": -40.0}, r"loops\.0\.kp: Input should be greater than or equal to 0"),
        ({"kd": float("nan")}, r"loops\.0\.kd: Input should be a finite number"),
        ({"position": None}, r"loops\.0\.position: missing"),
        ({"stiffness": 1.0}, r"loops\.0\.stiffness: unknown key"),
        ({"velocity": {"column": "wanted_rate", "unit": "mm/s"}}, "mm/s"),
        (
            {"position": {"column": "wanted", "unit": "mm"}},
            "'mm' is not a unit of a quantity in rad",
        ),
    ],
)
def test_a_loop_that_is_wrong_is_refused_by_key(loop, words):
    with pytest.raises(InputError, match=words):
        declare(card(**loop), Card, "dataset.toml")


def test_a_controller_that_is_wrong_is_refused_by_key(columns):
    with pytest.raises(InputError, match=r"controller\.kind: Input should be 'pd' or 'pid'"):
        declare(card(kind="p"), Card, "dataset.toml")
    with pytest.raises(InputError, match=r'loops\.0\.ki: an integral is of kind = "pid"'):
        declare(card(ki=2.0), Card, "dataset.toml")
    with pytest.raises(InputError, match="`delay` of the loop of 'voltage', which computes all"):
        other = card(delay=1)
        other["inputs"][0]["hold"] = "first-order"
        declare(other, Card, "dataset.toml")
    with pytest.raises(InputError, match="no ki in the loop of 'voltage', and no column"):
        other = card(kind="pid")
        del other["inputs"][0]["column"]
        declare(other, Card, "dataset.toml")
    with pytest.raises(InputError, match="two loops of the input 'voltage'"):
        other = card()
        other["controller"]["loops"] *= 2
        declare(other, Card, "dataset.toml")
    with pytest.raises(InputError, match="`delay` of the input 'voltage'"):
        other = card()
        other["inputs"][0]["delay"] = 0.01
        declare(other, Card, "dataset.toml")
    with pytest.raises(InputError, match=r"inputs\.0\.column: missing; a column of"):
        other = card()
        del other["inputs"][0]["column"], other["controller"]
        declare(other, Card, "dataset.toml")
    with pytest.raises(InputError, match="no kd in the loop of 'voltage', and no column"):
        other = card(kd=None)
        del other["inputs"][0]["column"]
        declare(other, Card, "dataset.toml")
    with pytest.raises(InputError, match="no column 'target'"):
        read(columns, card(position="target"))
