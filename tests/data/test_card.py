"""Data cards."""

from typing import Any

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.data.card import Card, CoordinateCard, InputCard, TimeCard, VelocityCard
from tustinnet.data.declaration import declare

ANGLE = {"name": "angle", "kind": "angular", "column": "a"}
CART = {"name": "cart", "kind": "linear", "column": "x"}
CARD = {"name": "toy", "dt": 0.01, "coordinates": [ANGLE]}


def read(**changes: Any) -> Card:
    return declare({**CARD, **changes}, Card, "dataset.toml")


def angle(**keys: Any) -> CoordinateCard:
    return CoordinateCard(name="angle", kind="angular", column="a", **keys)


def cart(**keys: Any) -> CoordinateCard:
    return CoordinateCard(name="cart", kind="linear", column="x", **keys)


@pytest.mark.parametrize(
    ("changes", "key", "hint"),
    [
        ({"input": []}, "input", "did you mean 'inputs'"),
        (
            {"coordinates": [{**ANGLE, "resoluton": 1}]},
            "coordinates.0.resoluton",
            "did you mean 'resolution'",
        ),
        (
            {"time": {"column": "t", "tolerence": 0.1}},
            "time.tolerence",
            "did you mean 'tolerance'",
        ),
        (
            {"splits": {"train": ["a.csv", {"file": "b.csv", "row": [0, 9]}]}},
            "splits.train.1.row",
            "did you mean 'rows'",
        ),
        (
            {"coordinates": [{**ANGLE, "velocity": {"column": "v", "mesured": True}}]},
            "coordinates.0.velocity.mesured",
            "did you mean 'measured'",
        ),
        ({"format": {"delimeter": ";"}}, "format.delimeter", "did you mean 'delimiter'"),
        (
            {"splits": {"train": ["a.csv"], "valid": ["b.csv"]}},
            "splits.valid",
            "did you mean 'validation'",
        ),
        ({"splits": {"trian": ["a.csv"]}}, "splits.trian", "did you mean 'train'"),
        # keys that are required
        (
            {"coordinates": [{"name": "angle", "kind": "angular", "colunm": "a"}]},
            "coordinates.0.colunm",
            "did you mean 'column'",
        ),
        ({"splits": {"train": [{"flie": "b.csv"}]}}, "splits.train.0.flie", "did you mean 'file'"),
        # far from all
        ({"time": {"column": "t", "zzz": 1}}, "time.zzz", "known keys: assumed, column, irregular"),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest_known_one(
    changes: dict[str, Any], key: str, hint: str
) -> None:
    with pytest.raises(tn.InputError, match=rf"dataset.toml, {key}: unknown key; {hint}"):
        read(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coordinates": [{**ANGLE, "unit": "mm"}]}, "unit 'mm' of an? angular coordinate"),
        ({"coordinates": [{**CART, "unit": "arcmin"}]}, "unit 'arcmin' of a linear coordinate"),
        ({"coordinates": [{**CART, "unit": "mVolz"}]}, "'cart': unit 'mVolz' is not known"),
        ({"coordinates": [{**CART, "unit": "degC"}]}, "unit 'degC' has a zero .*delta_degC"),
        ({"coordinates": [{**CART, "unit": "9**9**9**9"}]}, r"unit '9\*\*9\*\*9\*\*9' is none"),
        (
            {"coordinates": [{**CART, "unit": "mV", "velocity": {"column": "v", "unit": "mm/s"}}]},
            "'mm/s' is not a unit of a quantity in V/s",
        ),
        ({"coordinates": [{**ANGLE, "unit": "counts"}]}, "'counts' needs `resolution`"),
        (
            {"coordinates": [{**ANGLE, "kind": "linear", "counts_per_revolution": 4}]},
            "of a linear coordinate; give `resolution`",
        ),
        (
            {"coordinates": [{**ANGLE, "velocity": {"column": "v", "unit": "mm/s"}}]},
            "coordinates.0 'angle': 'mm/s' is not a unit of a quantity in rad/s",
        ),
        (
            {"coordinates": [{**ANGLE, "unit": "counts", "resolution": 1e-3, "scale": 2.0}]},
            "`scale` of counts; scale `resolution`",
        ),
        ({"coordinates": [{**ANGLE, "sine": "s", "unit": "deg"}]}, "`sine` of a position"),
        ({"coordinates": [{**CART, "sine": "s"}]}, "`sine` of a position"),
        ({"coordinates": [{**ANGLE, "scale": -1.0}]}, "scale: .*greater than or equal"),
        (
            {"coordinates": [{**ANGLE, "assumed": ["counts_per_revolution"]}]},
            "`assumed` names 'counts_per_revolution', which this table lacks",
        ),
        ({"coordinates": [{**ANGLE, "assumed": ["column"]}]}, "assumed.0: .*'kind', 'unit'"),
        ({"coordinates": [{**ANGLE, "resolution": 0}]}, "resolution: .*greater than or equal"),
        ({"coordinates": [{**ANGLE, "sign": 2}]}, "sign: .*1 or -1"),
        ({"coordinates": [ANGLE, ANGLE]}, "two channels are called 'angle'"),
        (
            {"inputs": [{"name": "angle", "column": "u", "unit": "V"}]},
            "two channels are called 'angle'",
        ),
        ({"coordinates": []}, "coordinates: .*at least 1"),
        ({"dt": "fast"}, r"dt: .*\(got 'fast'\)"),
        ({"dt": 0}, "dt: .*greater than or equal"),
        ({"dt": 1e-320}, "dt: .*greater than or equal"),
        ({"dt": 1e300}, "dt: .*less than or equal"),
        ({"dt": float("nan")}, "dt: .*finite"),
        ({"name": "a\nb"}, "name: .*holds the character"),
        ({"coordinates": [{**ANGLE, "name": "a/b"}]}, r"coordinates\.0\.name: .*the name 'a/b'"),
        ({"coordinates": [{**ANGLE, "column": 0}]}, r"0\.column: columns count from 1"),
        ({"coordinates": [{**ANGLE, "column": 10**9}]}, r"0\.column: columns count from 1"),
        ({"coordinates": [{**ANGLE, "offset": float("inf")}]}, r"0\.offset: "),
        ({"coordinates": [{**ANGLE, "counts_per_revolution": 1e300}]}, "counts_per_revolution: "),
        ({"inputs": [{"name": "u", "column": 1, "unit": "V", "scale": 1e200}]}, "scale: .*less"),
        ({"inputs": [{"name": "u", "column": 1, "unit": "V", "scale": 1e-300}]}, "scale: a factor"),
        ({"inputs": [{"name": "u", "column": 1, "unit": "V", "scale": 0}]}, "scale: a factor"),
        (
            {"inputs": [{"name": "u", "column": 1, "unit": "V", "limits": [2, -2]}]},
            "limits: .*first",
        ),
        (
            {"inputs": [{"name": "u", "column": 1, "unit": "V", "limits": [0, 1, 2]}]},
            "limits: 3 values, expected at most 2 items",
        ),
        ({"dt": 0}, "dt: "),
        ({"dt": -0.01}, "dt: "),
        (
            {"inputs": [{"name": "u", "column": 1, "unit": "V", "limits": [0, float("inf")]}]},
            r"limits\.1: ",
        ),
        ({"time": {"column": "t", "tolerance": float("inf")}}, "tolerance: "),
        ({"format": {"columns": 10**9}}, r"format\.columns: .*less"),
        ({"format": {"delimiter": "ab"}}, r"format\.delimiter: one mark"),
        ({"format": {"delimiter": '"'}}, r"format\.delimiter: one mark"),
        ({"splits": {"train": [{"file": "a.csv", "rows": [9, 9]}]}}, "rows: the first row, then"),
        ({"splits": {"train": [{"file": "a.csv", "rows": [-1, 9]}]}}, r"rows\.0: .*greater"),
        ({"splits": {"train": [{"file": "a.csv", "k_bar": 10**15}]}}, "k_bar: .*less"),
        ({"splits": {"train": [{"file": "a.csv", "name": "../a"}]}}, r"name: .*the name '\.\./a'"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_key(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(tn.InputError, match=f"dataset.toml, .*{message}"):
        read(**changes)


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("/etc/passwd", "a path below the card's folder"),
        ("../other/log.csv", "a path below the card's folder"),
        ("a/../../log.csv", "a path below the card's folder"),
        ("C:\\logs\\log.csv", "a path below the card's folder"),
        ("..\\log.csv", "a path below the card's folder"),
        ("", "a path below the card's folder"),
        ("**/*.csv", r"a pattern without '\*\*'"),
        (f"a/{'ä' * 128}", "a file name of more than 255 bytes"),
    ],
)
def test_files_lie_below_the_cards_folder(file: str, message: str) -> None:
    with pytest.raises(tn.InputError, match=rf"splits\.train\.0\.file: {message}"):
        read(splits={"train": [file]})


def test_a_time_column_stands_in_for_the_period() -> None:
    assert read(dt=None, time={"column": "t"}).dt is None


def test_a_path_is_short_for_a_file_entry() -> None:
    card = read(splits={"train": ["a.csv", {"file": "b.csv", "name": "b", "k_bar": 3}]})
    assert [(f.file, f.name, f.k_bar) for f in card.splits["train"]] == [
        ("a.csv", None, None),
        ("b.csv", "b", 3),
    ]


@pytest.mark.parametrize(
    ("coordinate", "factor"),
    [
        (angle(), 1.0),
        (angle(unit="deg"), np.pi / 180),
        (angle(unit="rev"), 2 * np.pi),
        (angle(unit="rev", scale=0.2), 0.4 * np.pi),
        (cart(scale=0.5), 0.5),
        (angle(unit="counts", counts_per_revolution=4096), 2 * np.pi / 4096),
        (cart(), 1.0),
        (cart(unit="mm"), 1e-3),
        (cart(unit="in"), 0.0254),
        (cart(unit="counts", resolution=2.3e-5), 2.3e-5),
    ],
)
def test_positions_are_converted_to_si(coordinate: CoordinateCard, factor: float) -> None:
    assert coordinate.factor() == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("coordinate", "unit", "factor"),
    [
        (angle, "rad/s", 1.0),
        (angle, "deg/s", np.pi / 180),
        (angle, "rpm", 2 * np.pi / 60),
        (angle, "deg/ms", 1000 * np.pi / 180),
        (cart, "mm/s", 1e-3),
        (cart, "m/s", 1.0),
    ],
)
def test_velocities_are_converted_to_si(coordinate: Any, unit: str, factor: float) -> None:
    card = coordinate(velocity=VelocityCard(column="v", unit=unit))
    assert card.velocity_factor() == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "factor", "name"),
    [
        ("mV", 1e-3, "V"),
        ("V", 1.0, "V"),
        ("mA", 1e-3, "A"),
        ("K", 1.0, "K"),
        ("1", 1.0, "1"),
        ("%", 1e-2, "1"),
        ("inch", 0.0254, "m"),
        ("km", 1e3, "m"),
        ("psi", 6894.757, "Pa"),
        ("mN*m", 1e-3, "m*N"),
        ("mm/s", 1e-3, "m/s"),
        ("delta_degC", 1.0, "K"),
    ],
)
def test_a_linear_coordinate_in_any_unit_is_in_si(unit: str, factor: float, name: str) -> None:
    card = cart(unit=unit, velocity=VelocityCard(column="v"))
    assert card.factor() == pytest.approx(factor)
    assert card.velocity_factor() == card.factor()
    assert card.coordinate().unit == name
    assert cart(unit=name).factor() == 1  # as a card is written from records


def test_any_angle_and_any_velocity_of_a_unit_are_converted() -> None:
    of = angle(unit="arcmin", velocity=VelocityCard(column="v", unit="turn/min"))
    assert (of.factor(), of.velocity_factor(), of.coordinate().unit) == (
        pytest.approx(np.pi / 180 / 60),
        pytest.approx(2 * np.pi / 60),
        "rad",
    )
    km = cart(velocity=VelocityCard(column="v", unit="km/h"))
    assert km.velocity_factor() == pytest.approx(1 / 3.6)
    volts = cart(unit="mV", velocity=VelocityCard(column="v", unit="mV/ms"))
    assert volts.velocity_factor() == pytest.approx(1.0)


def test_channels_tell_units_apart_and_leave_out_the_usual_ones() -> None:
    volts = tn.Channels((tn.Coordinate("x", "linear", unit="V"), tn.Coordinate("a", "angular")))
    assert volts.unit == "V and rad"
    told = volts.as_header()
    assert [c.get("unit") for c in told["coordinates"]] == ["V", None]
    assert tn.Channels.from_header(told) == volts
    metres = tn.Channels((tn.Coordinate("x", "linear"), tn.Coordinate("a", "angular")))
    with pytest.raises(tn.InputError, match=r"x \(linear\), a .*x \(linear, V\), a .*units"):
        volts.require_same(metres, "log", "the model")
    with pytest.raises(tn.InputError, match="coordinate 'x': unit 'deg'; expected rad"):
        tn.Coordinate("x", "angular", unit="deg")
    with pytest.raises(tn.InputError, match="coordinate 'x': unit 'rad'; expected m"):
        tn.Coordinate("x", "linear", unit="rad")


def test_a_velocity_without_unit_is_in_the_positions_unit_per_second() -> None:
    card = angle(unit="deg", velocity=VelocityCard(column="v"))
    assert card.velocity_factor() == card.factor()


def test_counts_per_second_are_a_velocity_unit_of_an_encoder() -> None:
    card = angle(resolution=1e-3, velocity=VelocityCard(column="v", unit="counts/s"))
    assert card.velocity_factor() == pytest.approx(1e-3)


def test_the_count_is_the_resolution_or_a_share_of_a_turn() -> None:
    assert angle().count is None
    assert angle(resolution=2e-3).count == 2e-3
    assert angle(counts_per_revolution=2000).count == pytest.approx(np.pi / 1000)
    assert angle(resolution=2e-3).coordinate() == tn.Coordinate("angle", "angular", 2e-3)


def test_an_input_says_what_the_records_will_say() -> None:
    card = InputCard(name="force", column=1, unit="N", hold="first-order", limits=(-2, 2))
    assert card.input() == tn.Input("force", "N", "first-order", (-2.0, 2.0))


@pytest.mark.parametrize(("unit", "factor"), [("s", 1), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_times_are_converted_to_seconds(unit: Any, factor: float) -> None:
    assert TimeCard(column="t", unit=unit).factor() == factor


def test_sign_scale_and_offset_apply_in_the_columns_unit() -> None:
    card = {
        **CARD,
        "coordinates": [
            {
                **ANGLE,
                "unit": "deg",
                "sign": -1,
                "offset": 90.0,
                "velocity": {"column": "v", "unit": "rpm"},
            },
            {
                "name": "cart",
                "kind": "linear",
                "column": "x",
                "unit": "counts",
                "resolution": 1e-4,
                "offset": 500.0,
                "velocity": {"column": "w", "unit": "mm/s"},
            },
        ],
        "inputs": [
            {"name": "u", "column": "u", "unit": "V", "scale": 0.5, "sign": -1, "offset": 2.0}
        ],
    }
    import pandas as pd

    frame = pd.DataFrame(
        {
            "a": [90.0, 0, 180],
            "v": [60.0, 0, -30],
            "x": [500, 600, 0],
            "w": [1000.0, 0, 1],
            "u": [2.0, 4.0, 0.0],
        }
    )
    e = tn.from_frame(frame, card)
    np.testing.assert_allclose(e.q, [[0, 0], [np.pi / 2, 0.01], [-np.pi / 2, -0.05]], atol=1e-12)
    assert e.v is not None
    np.testing.assert_allclose(e.v, [[-2 * np.pi, 1], [0, 0], [np.pi, 1e-3]], atol=1e-12)
    np.testing.assert_allclose(e.u[:, 0], [0, -1, 1])
