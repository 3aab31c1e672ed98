"""Data sets and records from arrays."""

from typing import Any

import numpy as np
import pytest

import tustinnet as tn


def record(
    name: str, samples: int = 20, *, dt: float = 0.01, split: str | None = None
) -> tn.Experiment:
    q = np.sin(np.arange(samples))
    return tn.from_arrays(
        q,
        0 * q,
        dt=dt,
        coordinates={"angle": "angular"},
        inputs={"voltage": "V"},
        name=name,
        split=split,
    )


@pytest.fixture
def three() -> tn.DataSet:
    return tn.DataSet(
        "three",
        (
            record("a", split="train"),
            record("b", 35, split="train"),
            record("c", 50, split="validation"),
        ),
    )


def names(data: tn.DataSet) -> list[str]:
    return [e.name for e in data]


def test_records_may_have_any_lengths(three: tn.DataSet) -> None:
    assert [len(e) for e in three] == [20, 35, 50]
    assert len(three) == 3


def test_what_the_records_share_is_the_data_sets(three: tn.DataSet) -> None:
    assert three.dt == 0.01
    assert three.coordinates == (tn.Coordinate("angle", "angular"),)
    assert three.inputs == (tn.Input("voltage", "V"),)
    assert three.splits == ("train", "validation")
    assert repr(three) == "DataSet('three', 3 experiments)"


def test_records_are_found_by_number_name_and_slice(three: tn.DataSet) -> None:
    assert three[-1].name == "c"
    assert three["b"] is three[1]
    assert names(three[1:]) == ["b", "c"]
    with pytest.raises(tn.InputError, match="no experiment 'd'; expected one of a, b, c"):
        three["d"]


def test_a_split_is_a_data_set(three: tn.DataSet) -> None:
    assert names(three.split("train")) == ["a", "b"]
    with pytest.raises(tn.InputError, match="no split 'test'; expected one of: train, validation"):
        three.split("test")


def test_records_that_are_not_split_say_so() -> None:
    with pytest.raises(tn.InputError, match="not split"):
        tn.DataSet("plain", (record("a"),)).split("train")


def test_trimming_trims_every_record(three: tn.DataSet) -> None:
    assert [len(e) for e in three.trim(0.05, 0.15)] == [11, 11, 11]


def test_excluding_by_name(three: tn.DataSet) -> None:
    assert names(three.exclude("b")) == ["a", "c"]
    with pytest.raises(tn.InputError, match="no experiment 'x'"):
        three.exclude("x")
    with pytest.raises(tn.InputError, match="no experiments"):
        three.exclude("a", "b", "c")


def test_merging_takes_data_sets_and_records(three: tn.DataSet) -> None:
    other = tn.DataSet("other", (record("d"),))
    merged = three.merge(other, [record("e")])
    assert names(merged) == ["a", "b", "c", "d", "e"]
    assert merged.name == "three"


def test_two_records_of_one_name_are_refused(three: tn.DataSet) -> None:
    with pytest.raises(tn.InputError, match="two experiments named 'a'"):
        three.merge([record("a")])


def test_another_period_is_refused_and_rounding_is_not(three: tn.DataSet) -> None:
    with pytest.raises(tn.InputError, match=r"d: sampling period 0\.02 s; .* 0\.01 s as in a"):
        three.merge([record("d", dt=0.02)])
    assert len(three.merge([record("d", dt=0.01 * (1 + 1e-9))])) == 4


ANGLE = (tn.Coordinate("angle", "angular"),)
BETA = (tn.Coordinate("beta", "angular"),)
VOLTAGE = (tn.Input("voltage", "V"),)


@pytest.mark.parametrize(
    ("coordinates", "inputs", "message"),
    [
        (BETA, VOLTAGE, r"coordinates beta \(angular\); expected angle \(angular\)"),
        ((tn.Coordinate("angle", "linear"),), VOLTAGE, r"angle \(linear\)"),
        (ANGLE, (tn.Input("torque", "V"),), r"inputs torque \(V, zero-order\); expected voltage"),
        (ANGLE, (tn.Input("voltage", "mV"),), r"voltage \(mV, zero-order\)"),
        (ANGLE, (tn.Input("voltage", "V", "first-order"),), r"voltage \(V, first-order\)"),
    ],
)
def test_another_system_is_refused(
    three: tn.DataSet,
    coordinates: tuple[tn.Coordinate, ...],
    inputs: tuple[tn.Input, ...],
    message: str,
) -> None:
    q = np.arange(5.0)
    other = tn.from_arrays(q, q, dt=0.01, coordinates=coordinates, inputs=inputs, name="other")
    with pytest.raises(tn.InputError, match=f"other: .*{message}"):
        three.merge([other])


def test_the_order_of_coordinates_matters() -> None:
    q = np.arange(10.0).reshape(5, 2)
    one = tn.from_arrays(q, dt=0.1, coordinates={"a": "angular", "b": "angular"}, name="one")
    two = tn.from_arrays(q, dt=0.1, coordinates={"b": "angular", "a": "angular"}, name="two")
    with pytest.raises(tn.InputError, match="order must agree"):
        tn.DataSet("mixed", (one, two))


def declaring(name: str, count: float | None, limits: tuple[float, float] | None) -> tn.Experiment:
    """A record with an encoder count and limits of its voltage, or without."""
    coordinates = (tn.Coordinate("angle", "angular", count),)
    inputs = (tn.Input("voltage", "V", limits=limits),)
    return tn.from_arrays(
        np.arange(5.0), np.zeros(5), dt=0.01, coordinates=coordinates, inputs=inputs, name=name
    )


def test_records_may_differ_in_what_does_not_change_the_system() -> None:
    data = tn.DataSet(
        "arm", (declaring("a", 1e-3, (-5.0, 5.0)), declaring("b", 2e-3, (-10.0, 10.0)))
    )
    assert [e.inputs[0].limits for e in data] == [(-5.0, 5.0), (-10.0, 10.0)]
    assert [e.coordinates[0].resolution for e in data] == [1e-3, 2e-3]


def test_what_only_some_records_declare_holds_for_all_and_is_told_once() -> None:
    records = [
        declaring("a", None, None),
        declaring("b", 1e-3, None),
        declaring("c", None, (-5.0, 5.0)),
    ]
    told = "arm: no encoder count of angle, limits of voltage in 'a' and 2 more: taken from"
    with pytest.warns(UserWarning, match=told):
        data = tn.DataSet("arm", tuple(records))
    for e in data:
        assert e.channels == data.channels
        assert (e.coordinates[0].resolution, e.inputs[0].limits) == (1e-3, (-5.0, 5.0))
    assert len(data[1:]) == len(data.exclude("a")) == 2
    with pytest.warns(UserWarning, match="no limits of voltage in 'd': taken from"):
        assert data.merge([declaring("d", 1e-3, None)]).channels == data.channels


def test_no_records_are_refused() -> None:
    with pytest.raises(tn.InputError, match="no experiments; expected at least one"):
        tn.DataSet("empty", ())


# --- from_arrays ---


def test_vectors_become_columns() -> None:
    e = tn.from_arrays(
        [0.0, 1, 2], [3.0, 4, 5], dt=0.5, coordinates={"a": "angular"}, inputs={"u": "V"}
    )
    np.testing.assert_array_equal(e.q, [[0], [1], [2]])
    np.testing.assert_array_equal(e.u, [[3], [4], [5]])
    np.testing.assert_array_equal(e.t, [0, 0.5, 1])
    assert e.v is None
    assert not e.v_measured


def test_a_record_needs_no_input() -> None:
    e = tn.from_arrays(np.zeros((6, 2)), dt=0.5, coordinates={"a": "angular", "b": "linear"})
    assert e.u.shape == (6, 0)
    assert e.held_inputs.shape == (5, 0)
    assert [c.kind for c in e.coordinates] == ["angular", "linear"]


def test_wrapped_angles_are_unwrapped_and_lengths_are_not() -> None:
    q = np.array([[3.0, 3.0], [-3.0, -3.0], [-2.0, 3.0]])
    e = tn.from_arrays(q, dt=0.1, coordinates={"angle": "angular", "slide": "linear"})
    np.testing.assert_allclose(e.q[:, 0], [3.0, 2 * np.pi - 3.0, 2 * np.pi - 2.0])
    np.testing.assert_array_equal(e.q[:, 1], q[:, 1])
    assert e.notes == ("angle: unwrapped (1 jump)",)


def test_a_wrapped_angle_of_arrays_begins_near_zero() -> None:
    q = np.array([6.2, 6.27, 0.05, 6.25])
    e = tn.from_arrays(q, dt=0.1, coordinates={"angle": "angular"})
    np.testing.assert_allclose(e.q[:, 0], [*(q[:2] - 2 * np.pi), q[2], q[3] - 2 * np.pi])
    assert e.notes == ("angle: unwrapped (2 jumps)", "angle: moved by -1 turn")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "channels", [{"coordinates": ["a"]}, {"coordinates": {"a": "angular"}, "inputs": ["u"]}]
)
def test_kinds_and_units_are_declared_never_guessed(
    channels: dict[str, Any],
) -> None:
    with pytest.raises(tn.InputError, match="without a"):
        tn.from_arrays(np.arange(5.0), np.arange(5.0), dt=0.1, **channels)


def test_times_in_another_unit_are_refused() -> None:
    with pytest.raises(tn.InputError, match=r"samples 10 s apart; expected dt = 0\.01 s"):
        tn.from_arrays(np.arange(5.0), dt=0.01, t=np.arange(5) * 10.0, coordinates=ANGLE)


def test_given_times_and_velocities_are_taken() -> None:
    t, v = np.array([1.0, 1.4, 2.1]), np.array([7.0, 8, 9])
    e = tn.from_arrays(np.zeros(3), t=t, v=v, dt=0.5, coordinates={"a": "angular"})
    np.testing.assert_array_equal(e.t, t)
    assert e.v is not None
    np.testing.assert_array_equal(e.v[:, 0], v)
    assert e.v_measured


def test_too_few_names_for_the_columns_are_refused() -> None:
    with pytest.raises(tn.InputError, match=r"q has shape \(5, 2\); expected \(5, 1\)"):
        tn.from_arrays(np.zeros((5, 2)), dt=0.1, coordinates={"a": "angular"})


def test_groups_stay_with_a_record_and_are_checked():
    made = {"payload": "1kg", "day": "monday"}
    e = tn.from_arrays(np.sin(np.arange(50.0)), dt=0.01, coordinates={"a": "linear"}, groups=made)
    assert e.groups == (("day", "monday"), ("payload", "1kg"))
    for part in (e[5:20], e.resample(0.02), e.trim(0.1), *e.exclude(10, 20)):
        assert part.groups == e.groups
    assert (e.group("payload"), e.group("tool")) == ("1kg", None)
    with pytest.raises(tn.InputError, match="the name 'a/b'"):
        tn.from_arrays(
            np.sin(np.arange(50.0)), dt=0.01, coordinates={"a": "linear"}, groups={"x": "a/b"}
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"split": "trian"}, "a split 'trian'; expected train, validation, test or None"),
        ({"groups": "x"}, "groups of 'x'"),
    ],
)
def test_fields_of_a_record_that_cannot_be_are_refused(changes, message):
    with pytest.raises(tn.InputError, match=message):
        tn.from_arrays(np.zeros(9), dt=0.1, coordinates={"x": "linear"}, **changes)


def test_positions_that_are_complex_are_refused():
    with pytest.raises(tn.InputError, match="not numbers"):
        tn.from_arrays(np.zeros(9) + 1j, dt=0.1, coordinates={"x": "linear"})


def test_irregular_times_of_arrays_are_noted():
    t = np.cumsum(np.random.default_rng(0).uniform(0.06, 0.14, 50))
    record = tn.from_arrays(np.zeros(50), t=t, dt=0.1, coordinates={"x": "linear"})
    assert "irregular times kept as recorded" in record.notes[-1]
    assert tn.from_arrays(np.zeros(9), dt=0.1, coordinates={"x": "linear"}).notes == ()
