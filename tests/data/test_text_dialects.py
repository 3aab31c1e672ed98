"""Text files as programs of all countries write them, and Excel workbooks."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from lab_files import workbook

import tustinnet as tn
from tustinnet.data.drafting.draft import draft_card, draft_file
from tustinnet.data.readers import read_columns
from tustinnet.data.text_rate import find_period
from tustinnet.errors import InputError

TIME = [0.0, 0.01, 0.02, 0.03]
ANGLE = [0.5, -1.25, 3e-3, 1234.5]


def read(folder: Path, content: str | bytes, name: str = "log.csv", **options: Any) -> Any:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_columns(path, **options)


def rows(delimiter: str, *, comma: bool = False, names: str = "t{}angle", end: str = "\n") -> str:
    lines = [names.format(delimiter)]
    for t, x in zip(TIME, ANGLE, strict=True):
        cells = [f"{value:g}".replace(".", "," if comma else ".") for value in (t, x)]
        lines.append(delimiter.join(cells))
    return end.join(lines) + end


@pytest.mark.parametrize("name", ["log.csv", "log.txt", "log.tsv", "log.dat"])
@pytest.mark.parametrize(
    ("delimiter", "comma"),
    [(",", False), *((d, c) for d in (";", "\t", "|", " ", "    ") for c in (False, True))],
)
def test_the_mark_between_columns_is_found(
    tmp_path: Path, name: str, delimiter: str, comma: bool
) -> None:
    columns = read(tmp_path, rows(delimiter, comma=comma), name)
    assert columns.names == ("t", "angle")
    np.testing.assert_array_equal(columns["t"], TIME)
    np.testing.assert_array_equal(columns["angle"], ANGLE)
    assert ("decimal comma" in " ".join(columns.notes)) == comma or name == "log.tsv"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        # marks between thousands
        ('a,b\n"1,234.5",1\n"12,000.25",2\n', [1234.5, 12000.25]),
        ("a;b\n1.234,5;1\n12.000,25;2\n", [1234.5, 12000.25]),
        ("a;b\n1'234.5;1\n12'000.25;2\n", [1234.5, 12000.25]),
        ("a;b\n1 234,5;1\n12\u202f000,25;2\n".replace(" ", "\u202f"), [1234.5, 12000.25]),
        ("a;b\n1,234,567;1.5\n2,000;2.5\n", [1234567, 2000]),
        ("a;b\n1.234.567;1,5\n2.000;2,5\n", [1234567, 2000]),
        ('a,b\n"1,5",1\n"-2,25",2\n', [1.5, -2.25]),
        # three digits after a comma are decimals where nothing else says so
        ("a;b\n1,234;1\n2,345;2\n", [1.234, 2.345]),
        # exponents of Fortran, and a minus of typography
        ("a b\n1.0D-3 1\n-2.5d+02 2\n", [1e-3, -250]),
        ("a;b\n1,0D-3;1\n2,5E2;2\n", [1e-3, 250]),
        ("a,b\n\u22121.5,1\n2,2\n", [-1.5, 2]),
        # notes and texts beside numbers
        ("a;note\n1,5;so, so\n2,5;a pause, long\n", [1.5, 2.5]),
        ("a,when\n1.5,2026-01-01 10:00:00\n2.5,2026-01-01 10:00:01\n", [1.5, 2.5]),
    ],
)
def test_numbers_of_all_countries_are_read(
    tmp_path: Path, content: str, expected: list[float]
) -> None:
    np.testing.assert_array_equal(read(tmp_path, content)["a"], expected)


@pytest.mark.parametrize(
    ("content", "names", "units"),
    [
        ("t,q\ns,rad\n0,1\n1,2\n", ["t", "q"], {"t": "s", "q": "rad"}),
        ("t;q\n[s];[deg/s]\n0;1,5\n1;2,5\n", ["t", "q"], {"t": "s", "q": "deg/s"}),
        ("t,q,n\n(ms),-,\n0,1,2\n1,2,3\n", ["t", "q", "n"], {"t": "ms"}),
        (
            "t,motor,,arm\n,pos,vel,pos\n0,1,2,3\n1,2,3,4\n",
            ["t", "motor/pos", "motor/vel", "arm/pos"],
            {},
        ),
        (
            "t,motor,\n,pos,vel\ns,rad,rad/s\n0,1,2\n1,2,3\n",
            ["t", "motor/pos", "motor/vel"],
            {"t": "s", "motor/pos": "rad", "motor/vel": "rad/s"},
        ),
        ("# a rig\n# t, q\n0,1\n1,2\n", ["t", "q"], {}),
        ("# 1: t [s]\n# 2: q [rad]\n0 1\n1 2\n", ["t [s]", "q [rad]"], {}),
        ("# column 0 = t\n# 1-2 of 2026\n# column 1 = q\n0,1\n1,2\n", ["t", "q"], {}),
        (
            "%% a rig\n% 1 t\n% 2 3 u left, right\n0 1 2\n1 2 3\n",
            ["t", "u left, right 2", "u left, right 3"],
            {},
        ),
        ("# 1 of 3 runs\n0 1 2\n1 2 3\n", ["column 1", "column 2", "column 3"], {}),
        ("% a rig\n\n// made by hand\nt,q\n0,1\n% pause\n1,2\n", ["t", "q"], {}),
        ("Rig 7\nmade on a Monday, by hand\n\nt;q\n0;1\n1;2\n2;3\n3;4\n4;5\n", ["t", "q"], {}),
        ("%time,q\n0,1\n1,2\n", ["%time", "q"], {}),  # as rostopic writes it
        ("time [s]  angle [deg]\n0 1\n1 2\n".replace(" [", "["), ["time[s]", "angle[deg]"], {}),
    ],
    ids=lambda value: repr(value)[:40],
)
def test_rows_of_names_units_and_comments(
    tmp_path: Path, content: str, names: list[str], units: dict[str, str]
) -> None:
    columns = read(tmp_path, content)
    assert [*columns.names] == names
    assert columns.units == units
    assert columns[names[0]][:2].tolist() == [0, 1]


@pytest.mark.parametrize(
    ("encoding", "bom"),
    [
        ("utf-8", "\ufeff"),
        ("utf-8", ""),
        ("utf-16", ""),
        ("utf-16-le", ""),
        ("utf-16-be", "\ufeff"),
        ("latin-1", ""),
        ("cp1252", ""),
    ],
)
def test_texts_in_several_encodings(tmp_path: Path, encoding: str, bom: str) -> None:
    content = bom + "zeit,winkel [\u00b0]\n0,1.5\n1,2.5\n2,3.5\n"
    columns = read(tmp_path, content.encode(encoding))
    assert columns.names == ("zeit", "winkel [\u00b0]")
    np.testing.assert_array_equal(columns["winkel [\u00b0]"], [1.5, 2.5, 3.5])
    if encoding == "latin-1":
        assert columns.notes == ("not in UTF-8, read as Latin-1",)


def test_a_card_decides_where_a_file_does_not(tmp_path: Path) -> None:
    content = "a;b\n1,234;1.234\n2,345;2.345\n"
    with pytest.raises(InputError, match=r"do not say which mark is decimal.*`decimal"):
        read(tmp_path, content)
    assert read(tmp_path, content, decimal=".")["a"].tolist() == [1234, 2345]
    assert read(tmp_path, content, decimal=",")["b"].tolist() == [1234, 2345]
    greek = "\u03c6,t\n1,0\n2,1\n".encode("cp1253")
    assert read(tmp_path, greek, encoding="cp1253").names == ("\u03c6", "t")
    with pytest.raises(InputError, match="not a text file in utf-8"):
        read(tmp_path, greek, encoding="utf-8")
    late = "Rig,7\nrate,100\nt,q\n0,1\n1,2\n"
    assert read(tmp_path, late, header=3).names == ("t", "q")
    (tmp_path / "dataset.toml").write_text(
        'name = "a"\ndt = 0.01\n[format]\nheader = 3\ndecimal = "."\nencoding = "utf-8"\n'
        '[[coordinates]]\nname = "q"\nkind = "linear"\ncolumn = "q"\n'
    )
    assert tn.load(tmp_path)[0].q[:, 0].tolist() == [1, 2]


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("encoding = 'klingon'", "no encoding 'klingon'"),
        ("decimal = ';'", "decimal"),
        ("header = 0", "header"),
        ("header = 'yes'", "header"),
    ],
)
def test_keys_of_the_format_are_checked(tmp_path: Path, key: str, message: str) -> None:
    (tmp_path / "dataset.toml").write_text(
        f'name = "a"\ndt = 0.01\n[format]\n{key}\n'
        '[[coordinates]]\nname = "q"\nkind = "linear"\ncolumn = "q"\n'
    )
    with pytest.raises(InputError, match=message):
        tn.load(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a;b\n1.234,5;1\n12.00,25;2\n", r"row 3, a: the text '12\.00,25'"),
        ("a;b\n1,5;1\n1.5;2\n2,5;3\n", r"row 3, a: the text '1\.5'|do not say"),
        ("a b\n1.0D-3 1\n1.0D 2\n", r"row 3, a: the text '1\.0D'"),
        ("a b\n1 2\n3\n4 5 6\n", r"row 3 has 1 cells, row 1 has 2; expected .*separated by ' '"),
        ("a;b\n1;2\n;3\n", "row 3, a: an empty cell"),
    ],
)
def test_numbers_that_are_none_are_refused_with_their_row(
    tmp_path: Path, content: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, content)["a"]


def test_units_of_the_file_are_in_the_draft(tmp_path: Path) -> None:
    t = np.arange(300) * 0.01
    lines = ["t;x;u", "s;deg;V"]
    lines += [f"{a:.2f};{40 * np.sin(3 * a):.6f};{2 * (a % 0.5 > 0.2)}" for a in t]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines).replace(".", ","))
    report = draft_file(path)
    assert {c.name: c.unit for c in report.columns} == {"t": "s", "x": "deg", "u": "V"}
    assert report.notes == ("separated by ';', decimal comma", "names and units in 2 rows")
    (tmp_path / "dataset.toml").write_text(report.text)
    (record,) = tn.load(tmp_path)
    np.testing.assert_allclose(record.q[:, 0], np.radians(40 * np.sin(3 * t)), atol=1e-6)


# --- Excel ---


MOTION = [
    ["time", "elbow", "note"],
    ["s", "rad", None],
    *([t, x, "fine"] for t, x in zip(TIME, ANGLE, strict=True)),
]


def test_a_sheet_of_excel_is_a_table(tmp_path: Path) -> None:
    titled = [["Measurements of the rig"], [], *MOTION]
    columns = read_columns(workbook(tmp_path / "log.xlsx", {"Sheet1": titled, "Empty": []}))
    assert columns.names == ("time", "elbow")
    np.testing.assert_array_equal(columns["elbow"], ANGLE)
    assert columns.units == {"time": "s", "elbow": "rad"}
    assert columns.others == {"note": "text"}


def test_several_sheets_have_their_names_before_those_of_columns(tmp_path: Path) -> None:
    numbers = [[1.5, 2.0], [0.0625, 3.0]]
    path = workbook(tmp_path / "log.xlsx", {"motion": MOTION, "raw": numbers})
    columns = read_columns(path)
    assert columns.names == ("motion/time", "motion/elbow", "raw/column 1", "raw/column 2")
    np.testing.assert_array_equal(columns["raw/column 1"], [1.5, 0.0625])
    path = workbook(tmp_path / "gap.xlsx", {"a": [["x", "y"], [1, 2], [None, 3], ["off", 4]]})
    with pytest.raises(InputError, match=r"gap\.xlsx, sample 2 .*, x: 'off'; expected a number"):
        read_columns(path)["x"]
    assert read_columns(path)["y"].tolist() == [2, 3, 4]


# --- exports of measuring programs ---

LVM = """LabVIEW Measurement\t
Separator\tTab
Date\t2024/03/01
***End_of_Header***\t
\t
Channels\t2\t\t
Date\t2024/03/01\t2024/03/01\t
Y_Unit_Label\tdeg\tVolts\t
Delta_X\t0,01\t0,01\t
***End_of_Header***\t\t\t
X_Value\tWinkel\tMotor\tComment
"""
SCOPE = """Name;YT Scope Project
Name;position;Name;torque
Data-Type;REAL64;Data-Type;REAL64
SampleTime[ms];10;SampleTime[ms];20
Unit;mm;Unit;N m

0;0,5;0;1,0
10;1,5;20;2,0
20;2,5;;
30;3,5;;
"""


def test_settings_above_a_table_are_skipped_and_its_units_taken(tmp_path: Path) -> None:
    samples = "".join(f"0,{k:02}\t{k},5\t1,0\t\n" for k in range(40))
    columns = read(tmp_path, LVM + samples, "log.lvm")
    assert columns.names == ("X_Value", "Winkel", "Motor", "Comment")
    assert columns["Winkel"][:2].tolist() == [0.5, 1.5]
    assert columns.units == {"Winkel": "deg", "Motor": "Volts"}
    without_comments = samples.replace("\t\n", "\n")
    assert read(tmp_path, LVM + without_comments, "log.lvm").names == ("X_Value", "Winkel", "Motor")
    titled = "Test 3;;;;\nBy: me;;;;\nt;x;v;u;i\n" + 5 * "0;1,5;0;0;0\n"
    assert read(tmp_path, titled).names == ("t", "x", "v", "u", "i")


def test_columns_in_pairs_have_times_of_their_own(tmp_path: Path) -> None:
    columns = read(tmp_path, SCOPE)
    assert columns.names == ("position/time", "position", "torque/time", "torque")
    np.testing.assert_allclose(columns["position/time"], [0.0, 0.01, 0.02, 0.03])
    np.testing.assert_allclose(columns["torque/time"], [0.0, 0.02])
    assert columns["torque"].tolist() == [1.0, 2.0]
    assert columns.clocks["torque"] == "torque/time"
    assert columns.units == {
        "position/time": "s",
        "position": "mm",
        "torque/time": "s",
        "torque": "N m",
    }


def test_channels_that_end_before_others_lack_their_last_cells(tmp_path: Path) -> None:
    settings = "Name\tangle\tName\ttemp\nSymbolComment\tdeg\tSymbolComment\tin the motor\n"
    settings += "SampleTime[ms]\t2\tSampleTime[ms]\t10\n\n"
    rows = [f"{2 * k}\t{k},5" + (f"\t{10 * k}\t39,5" if k < 8 else "") for k in range(40)]
    (tmp_path / "scope.csv").write_text(settings + "\n".join(rows) + "\nEOF\n")
    columns = read_columns(tmp_path / "scope.csv")
    np.testing.assert_array_equal(columns["angle"], np.arange(40) + 0.5)
    np.testing.assert_allclose(columns["temp/time"], 0.01 * np.arange(8))
    assert columns.units["angle"] == "deg"
    assert "temp" not in columns.units


def test_names_of_several_words_stand_far_apart(tmp_path: Path) -> None:
    table = "0.0  1.5\n0.1  2.5\n"
    assert read(tmp_path, f"% time (s)   arm angle (rad)\n{table}").names == (
        "time (s)",
        "arm angle (rad)",
    )
    assert read(tmp_path, f"time (s)   arm angle (rad)\n{table}").names == (
        "time_(s)",
        "arm_angle_(rad)",
    )


def test_damaged_rows_are_refused_or_skipped_as_the_card_says(tmp_path: Path) -> None:
    rows = [f"{10 * k},{np.sin(0.1 * k):.5f},{k % 9}" for k in range(300)]
    rows[100], rows[200] = "1000,0.5", "millis,angle,u"
    (tmp_path / "log.csv").write_text("boot\nready\nmillis,angle,u\n" + "\n".join(rows) + "\n")
    with pytest.raises(InputError, match="row 104, u: an empty cell"):
        read_columns(tmp_path / "log.csv")["u"]
    draft = draft_card(tmp_path, ["log.csv"])
    assert 'damaged_rows = "skip"' in draft.text
    assert "log.csv: 2 damaged rows left out" in draft.notes
    (tmp_path / "dataset.toml").write_text(draft.text)
    assert sum(len(record) for record in tn.load(tmp_path)) == 300  # on a grid, without gaps
    (tmp_path / "dataset.toml").write_text(draft.text.replace('"skip"', '"mend"'))
    with pytest.raises(InputError, match="damaged_rows"):
        tn.load(tmp_path)


def test_names_above_units_may_be_numbers_of_channels(tmp_path: Path) -> None:
    rows = "".join(f"{0.01 * k:+.4E},{np.sin(k):+.4E},{k % 5:+.4E}\n" for k in range(60))
    (tmp_path / "scope.csv").write_text("x-axis,1,2\nsecond,Volt,Volt\n" + rows)
    columns = read_columns(tmp_path / "scope.csv")
    assert columns.names == ("x-axis", "1", "2")
    assert columns.units == {"x-axis": "second", "1": "Volt", "2": "Volt"}
    np.testing.assert_allclose(columns["2"], np.arange(60) % 5)


@pytest.mark.parametrize("slower", [1, 3])
def test_a_long_table_is_columns_by_signal(slower: int, tmp_path: Path) -> None:
    t = 0.01 * np.arange(90)
    lines = ["t_ms,signal,value"]
    for k in range(90):
        lines.append(f"{1e3 * t[k]:.1f},angle,{np.sin(t[k]):.6f}")
        if k % slower == 0:
            lines.append(f"{1e3 * t[k]:.1f},motor,{np.cos(t[k]):.6f}")
    if slower > 1:  # a log of more signals, of which most are slow
        lines += [f"{1e3 * x:.1f},{name},{x}" for name in "abc" for x in t[::2]]
    (tmp_path / "can.csv").write_text("\n".join(lines))
    columns = read_columns(tmp_path / "can.csv")
    np.testing.assert_allclose(columns["angle"], np.sin(t), atol=1e-6)
    np.testing.assert_allclose(columns["motor"], np.cos(t[::slower]), atol=1e-6)
    if slower == 1:
        assert columns.names == ("t_ms", "angle", "motor")
        np.testing.assert_allclose(columns["t_ms"], 1e3 * t)
    else:
        assert columns.clocks["motor"] == "motor/t_ms"
        np.testing.assert_allclose(columns["motor/t_ms"], 1e3 * t[::slower])
        assert draft_card(tmp_path, ["can.csv"]).dt == pytest.approx(0.01)


@pytest.mark.parametrize(("label", "motors"), [("motor_id", ("1", "2")), ("joint", ("a", "b"))])
def test_rows_of_several_motors_in_turn_are_columns_of_each(
    label: str, motors: tuple[str, str], tmp_path: Path
) -> None:
    t = 0.02 * np.arange(90)
    lines = [
        f"{x + 4e-4 * k:.4f},{motor},{np.sin(x + k):.6f},{k}"
        for x in t
        for k, motor in enumerate(motors)
    ]
    (tmp_path / "log.csv").write_text(f"t_s,{label},position_rot,duty\n" + "\n".join(lines))
    columns = read_columns(tmp_path / "log.csv")
    position = f"{motors[1]}/position_rot"
    np.testing.assert_allclose(columns[position], np.sin(t + 1), atol=1e-6)
    np.testing.assert_allclose(columns[columns.clocks[position]], t + 4e-4)
    assert draft_card(tmp_path, ["log.csv"]).dt == pytest.approx(0.02)


def test_the_times_of_a_long_table_may_stand_anywhere_and_other_words_beside_them(
    tmp_path: Path,
) -> None:
    lines = [
        f"{'rise' if k < 20 else 'hold'},{joint},{np.sin(0.1 * k):.6f},{0.1 * k:.1f}"
        for k in range(40)
        for joint in ("hip", "knee")
    ]
    (tmp_path / "log.csv").write_text("phase,joint,angle_rad,stamp\n" + "\n".join(lines))
    columns = read_columns(tmp_path / "log.csv")
    assert columns.names == ("stamp", "hip", "knee")
    assert columns.others == {"phase": "texts"}
    np.testing.assert_allclose(columns["stamp"], 0.1 * np.arange(40))


def test_a_table_with_a_state_in_words_stays_as_it_is(tmp_path: Path) -> None:
    lines = [f"{k},{'up' if k % 40 < 20 else 'down'},{k * k}" for k in range(200)]
    (tmp_path / "log.csv").write_text("t,state,x\n" + "\n".join(lines))
    assert read_columns(tmp_path / "log.csv").names == ("t", "state", "x")


def test_hexadecimal_numbers_are_read_and_may_be_names(tmp_path: Path) -> None:
    rows = "".join(f"{10 * k},0x{k * 7:03X},{k % 5}\n" for k in range(60))
    (tmp_path / "serial.csv").write_text("ms,0x101,pwm\n" + rows)
    columns = read_columns(tmp_path / "serial.csv")
    np.testing.assert_array_equal(columns["0x101"], 7 * np.arange(60))
    np.testing.assert_array_equal(columns["pwm"], np.arange(60) % 5)


RATES = {
    "Abtastrate: 1000 Hz": 1e-3,
    "Sampled at 0.5 kHz": 2e-3,
    "FREQUENCY\t200": 5e-3,
    "# sampling interval = 5 ms": 5e-3,
    "SampleTime[ms];2 ms": 2e-3,
    "dt = 0.01 s": 0.01,
    "fs = 250": 4e-3,
    "Frame rate: 29,97 fps": 1 / 29.97,
    "Position of motor 3": None,
    "Operator: Sam, 12.03.2024": None,
    "t,angle,u": None,
    "Samples: 3000": None,
    "# SAMPLE_TIME = 0.0002000": 2e-4,
    "Sampling time: 0.02 sec": 0.02,
    "X,CH1,Start,Increment\nSequence,Volt,-0.24,2e-3": 2e-3,
}


@pytest.mark.parametrize("line", RATES)
def test_the_sampling_rate_above_a_table_is_found(line: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(f"Rig 7\n{line}\nangle_deg,u_V\n1,2\n3,4\n")
    assert find_period(tmp_path / "log.csv") == RATES[line]


@pytest.mark.parametrize(("name", "value"), [("Ts", 0.02), ("fs", 50), ("config/rate_hz", 50)])
def test_a_number_beside_the_columns_may_say_the_period(
    name: str, value: float, tmp_path: Path
) -> None:
    t = 0.02 * np.arange(400)
    columns = {"theta": np.sin(3 * t), "u": np.repeat(np.random.default_rng(0).normal(size=20), 20)}
    scipy.io.savemat(tmp_path / "a.mat", columns | {name.rpartition("/")[2]: value})
    assert draft_card(tmp_path, ["a.mat"]).dt == pytest.approx(0.02)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for key, column in (columns | {name: value}).items():
            file[key] = column
    assert draft_card(tmp_path, ["a.h5"]).dt == pytest.approx(0.02)
    document = {key: column.tolist() for key, column in columns.items()} | {name: value}
    (tmp_path / "a.json").write_text(json.dumps(document))
    assert draft_card(tmp_path, ["a.json"]).dt == pytest.approx(0.02)


def test_a_single_column_has_its_name(tmp_path: Path) -> None:
    assert read(tmp_path, "angle\n" + "".join(f"{k / 8}\n" for k in range(50))).names == ("angle",)


def test_rows_may_end_in_a_mark_that_the_names_have_not(tmp_path: Path) -> None:
    columns = read(tmp_path, "step 9 V\nt,x,u\n0.0,1.0,2.0,\n0.1,1.5,2.0,\n0.2,1.7,0.0,\n")
    assert columns.names == ("t", "x", "u")
    assert columns["u"].tolist() == [2, 2, 0]


def test_rows_above_a_table_may_describe_its_columns(tmp_path: Path) -> None:
    settings = "Name\tActPos\tActTorque\nData-Type\tREAL64\tINT16\nSampleTime[ms]\t2\t2\n"
    rows = "Unit\tmm\t(None)\nUnit Offset\t0\t0\n\n0\t50,0\t0\n2\t50,5\t-1\n4\t51,5\t-3\n"
    columns = read(tmp_path, settings + rows)
    assert columns.names == ("time", "ActPos", "ActTorque")
    assert columns.units == {"time": "ms", "ActPos": "mm", "ActTorque": "(None)"}
    np.testing.assert_array_equal(columns["ActPos"], [50, 50.5, 51.5])


def test_messages_between_labelled_numbers_and_a_bare_one_before_them(tmp_path: Path) -> None:
    rows = [f"{k}\tAngle:{k / 4}\tpwm:{k % 5}\n" for k in range(60)]
    text = "Starting.\n" + "".join(rows[:40]) + "LIMIT\n" + "".join(rows[40:]) + "DONE\n"
    (tmp_path / "serial.txt").write_text(text)
    columns = read_columns(tmp_path / "serial.txt", skips_damaged=True)
    assert columns.names == ("column 1", "Angle", "pwm")
    np.testing.assert_array_equal(columns["Angle"], np.arange(60) / 4)


def test_sections_of_a_trace_of_codesys_are_columns(tmp_path: Path) -> None:
    rows = {name: "".join(f"; {20 * k + 2}; {f(k)}\n" for k in range(40)) for name, f in SIGNALS}
    sections = "".join(
        f"{k}.Variable; {name}\n{k}.Class; 14\n{k}.Data; \n{text}"
        for k, (name, text) in enumerate(rows.items())
    )
    columns = read(tmp_path, f"[key]; [value]\nVersion; 0x03050000\n{sections}")
    assert columns.names == ("time", "Axis.fActPosition", "Axis.fActTorque")
    np.testing.assert_allclose(columns["Axis.fActTorque"], np.arange(40) % 7)


SIGNALS = [("Axis.fActPosition", lambda k: k / 8), ("Axis.fActTorque", lambda k: k % 7)]


def test_labelled_numbers_of_a_serial_plotter_are_columns(tmp_path: Path) -> None:
    rows = "".join(f"pot:{k * 3}\tpwm: {k % 5}\n" for k in range(60))
    (tmp_path / "serial.txt").write_text("Ready.\n" + rows)
    columns = read_columns(tmp_path / "serial.txt")
    assert columns.names == ("pot", "pwm")
    np.testing.assert_array_equal(columns["pot"], 3 * np.arange(60))
    rows = rows.replace("pot:9\t", "pot:9")  # a line that broke
    (tmp_path / "serial.txt").write_text(rows)
    with pytest.raises(InputError, match="row 4"):
        read_columns(tmp_path / "serial.txt")["pot"]
    skipping = read_columns(tmp_path / "serial.txt", skips_damaged=True)
    assert len(skipping["pot"]) == 59


def test_a_line_of_json_above_a_table_is_a_comment(tmp_path: Path) -> None:
    text = '{"rig": "sled", "operator": "mk", "fs_hz": 100}\nt,x,u\n0,1,2\n1,2,3\n'
    (tmp_path / "rec.csv").write_text(text)
    assert read_columns(tmp_path / "rec.csv").names == ("t", "x", "u")


def test_rows_with_texts_without_a_header_are_samples(tmp_path: Path) -> None:
    rows = "".join(f"$ENC,{10 * k},{3 * k},*{k % 256:02X}\n" for k in range(40))
    (tmp_path / "uart.txt").write_text(rows)
    columns = read_columns(tmp_path / "uart.txt")
    assert columns.names[1:3] == ("column 2", "column 3")
    np.testing.assert_array_equal(columns["column 3"], 3 * np.arange(40))
    (tmp_path / "named.txt").write_text("kind,ms,count,crc\n" + rows)
    assert read_columns(tmp_path / "named.txt").names == ("kind", "ms", "count", "crc")


def test_names_before_the_first_cell_are_left_out_where_times_rise_so(tmp_path: Path) -> None:
    rows = "".join(f"{20 * k + 5979},{k % 7},12.9,\n" for k in range(60))
    (tmp_path / "auton.csv").write_text("v=1,t_ms,x(in),batt_V,mark\n" + rows)
    columns = read_columns(tmp_path / "auton.csv")
    assert columns.names == ("t_ms", "x(in)", "batt_V", "mark")
    assert columns["t_ms"][0] == 5979
    assert columns.notes == ("more names than cells in a row: 'v=1' left out",)


def test_a_number_among_the_names_is_no_name(tmp_path: Path) -> None:
    rows = "".join(f"{1748261904 + k / 1000},{k},{k % 5}\n" for k in range(40))
    (tmp_path / "log.csv").write_text("1748261904.2213,POSITION_FB,SPEED_FB\n" + rows)
    assert read_columns(tmp_path / "log.csv").names == ("column 1", "POSITION_FB", "SPEED_FB")
