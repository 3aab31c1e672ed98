"""Files of columns."""

import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import polars as pl
import pytest
import scipy.io

from tustinnet.data.columns import Columns, frame_columns
from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError

ANGLE = np.array([0.5, -1.25, 3e-3])
VOLTAGE = np.array([1.0, 0.0, -2.0])
TABLE = {"angle": ANGLE, "voltage": VOLTAGE}


def text_file(folder: Path, content: str, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_text(content)
    return path


def mat73(path: Path, content: dict[str, np.ndarray]) -> Path:
    """Writes as MATLAB does: a header of 512 bytes, matrices transposed, structs as groups."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in content.items():
            file[name] = np.atleast_2d(value).T
        file["#refs#/a"] = np.zeros((3, 1))
        file["label"] = "no numbers"
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM"
    with path.open("r+b") as file:
        file.write(head)
    return path


def numbers(columns: Columns) -> dict[str, np.ndarray]:
    """All columns, turned into numbers."""
    return {name: columns[name] for name in columns.names}


def assert_columns(columns: Columns, expected: dict[str, Any]) -> None:
    found = numbers(columns)
    assert list(found) == list(expected)
    for name, column in expected.items():
        assert found[name].dtype == np.float64
        np.testing.assert_array_equal(found[name], column)


# --- text ---


@pytest.mark.parametrize(
    ("content", "name", "delimiter"),
    [
        ("angle,voltage\n0.5,1\n-1.25,0\n3e-3,-2\n", "log.csv", ","),
        ("angle;voltage\n0.5;1\n-1.25;0\n3e-3;-2\n", "log.txt", ";"),
        ("angle\tvoltage\n0.5\t1\n-1.25\t0\n3e-3\t-2\n", "log.TSV", "\t"),
        ('"angle","voltage"\r\n 0.5, 1\r\n-1.25, 0\r\n3e-3, -2', "log.dat", ","),
        ("\ufeffangle,voltage\n0.5,1\n-1.25,0\n3e-3,-2\n", "log.csv", ","),
        ("# a rig\nangle,voltage\n0.5,1\n# a pause\n-1.25,0\n3e-3,-2\n", "log.csv", ","),
    ],
)
def test_text_with_a_header_is_read(
    tmp_path: Path, content: str, name: str, delimiter: str
) -> None:
    path = text_file(tmp_path, content, name)
    assert_columns(read_columns(path, delimiter=delimiter), TABLE)


def test_text_without_a_header_is_numbered_from_1(tmp_path: Path) -> None:
    path = text_file(tmp_path, "0.5,1\n-1.25,0\n3e-3,-2\n")
    assert_columns(read_columns(path, header=False), {"column 1": ANGLE, "column 2": VOLTAGE})


@pytest.mark.parametrize("number", ["1", " -.5e-3", "+1.", "nan", "-Inf"])
def test_a_first_row_of_numbers_is_no_header(tmp_path: Path, number: str) -> None:
    path = text_file(tmp_path, f"# rig\n{number},,2\n3,,4\n")
    found = read_columns(path)
    assert found.names == ("column 1", "column 2", "column 3")
    assert found.notes == ("no header: the first row is a sample",)
    np.testing.assert_array_equal(found["column 3"], [2, 4])
    with pytest.raises(InputError, match=r"row 2: only numbers.*`header = false`"):
        read_columns(path, header=True)


def test_names_beside_numbers_must_be_told_from_a_sample(tmp_path: Path) -> None:
    path = text_file(tmp_path, "0.5,start\n0.6,\n0.7,stop\n")
    with pytest.raises(InputError, match=r"row 1: .*the number 0\.5.*`header = true`.*false"):
        read_columns(path)["0.5"]
    np.testing.assert_array_equal(read_columns(path, header=True)["0.5"], [0.6, 0.7])
    assert len(read_columns(path, header=False)["column 1"]) == 3


def test_columns_without_a_name_are_numbered(tmp_path: Path) -> None:
    found = read_columns(text_file(tmp_path, ",angle,,\n7,1,2,3\n8,4,5,6\n"))
    assert found.names == ("column 1", "angle", "column 3", "column 4")
    np.testing.assert_array_equal(found["column 4"], [3, 6])


def test_empty_lines_are_no_rows(tmp_path: Path) -> None:
    path = text_file(tmp_path, "angle,voltage\n0.5,1\n-1.25,0\n3e-3,-2\n\n")
    assert_columns(read_columns(path), TABLE)


@pytest.mark.parametrize("row", [",", ";", " , ", "\t"])
def test_rows_of_empty_cells_at_the_end_are_no_rows(row: str, tmp_path: Path) -> None:
    mark = row.strip(" ")
    lines = (f"angle{mark}voltage", f"0.5{mark}1", f"-1.25{mark}0", f"3e-3{mark}-2")
    path = text_file(tmp_path, "\n".join([*lines, *[row] * 200]) + "\n")
    assert_columns(read_columns(path), TABLE)


def test_numbers_are_those_of_python(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    numbers = generator.normal(size=3000) * 10.0 ** generator.integers(-300, 300, 3000)
    texts = [(repr(x), f"{x:.9g}", f"{x:.25e}")[i % 3] for i, x in enumerate(numbers.tolist())]
    path = text_file(tmp_path, "x,y\n" + "\n".join(f"{text},1" for text in texts))
    assert read_columns(path)["x"].tolist() == [float(text) for text in texts]


def test_numbers_that_are_not_finite_are_left_to_the_checks(tmp_path: Path) -> None:
    path = text_file(tmp_path, "a,b\nNaN,inf\nnan,-Inf\n")
    assert_columns(read_columns(path), {"a": [np.nan, np.nan], "b": [np.inf, -np.inf]})


# --- binary files ---


def test_a_text_column_of_parquet_does_not_hinder_the_others(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    table = {**TABLE, "count": np.arange(3), "note": ["a", "b", "c"]}
    pl.DataFrame(table).write_parquet(path)
    found = read_columns(path)
    assert found.names == ("angle", "voltage", "count", "note")
    np.testing.assert_array_equal(found["count"], [0, 1, 2])
    with pytest.raises(InputError, match=r"sample 0 .*note: 'a'; expected a number"):
        found["note"]


def test_a_text_column_of_a_csv_file_does_not_hinder_the_others(tmp_path: Path) -> None:
    found = read_columns(text_file(tmp_path, "a,note\n1,start\n2,stop\n"))
    np.testing.assert_array_equal(found["a"], [1, 2])
    with pytest.raises(InputError, match=r"row 2, note: the text 'start'"):
        found["note"]


def test_tabs_separate_the_columns_of_a_tsv_file_by_default(tmp_path: Path) -> None:
    path = text_file(tmp_path, "a\tb\n1\t2\n", "log.tsv")
    assert_columns(read_columns(path), {"a": [1], "b": [2]})


def test_an_empty_cell_of_parquet_is_not_a_number(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    pl.DataFrame({"a": [1, None, 3]}).write_parquet(path)
    assert_columns(read_columns(path), {"a": [1, np.nan, 3]})


def test_npz_vectors_and_matrices_are_columns(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    state = np.arange(6.0).reshape(3, 2)
    np.savez(
        path,
        angle=ANGLE.astype(np.float64),
        row=VOLTAGE[None, :],
        state=state,
        scalar=np.float64(3),
        label=np.array(["a", "b", "c"]),
        cube=np.zeros((2, 2, 2)),
    )
    expected = {"angle": ANGLE, "row": VOLTAGE, "state[1]": [0, 2, 4], "state[2]": [1, 3, 5]}
    assert_columns(read_columns(path), expected)


def test_mat_vectors_matrices_and_structs_are_columns(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    state = np.arange(6.0).reshape(3, 2)
    inner = {"u": VOLTAGE, "x": state}
    scipy.io.savemat(path, {"angle": ANGLE[:, None], "log": inner, "rate": 100.0, "who": "me"})
    expected = {"angle": ANGLE, "log.u": VOLTAGE, "log.x[1]": [0, 2, 4], "log.x[2]": [1, 3, 5]}
    assert_columns(read_columns(path), expected)


def test_mat_7_3_reads_like_mat_5(tmp_path: Path) -> None:
    state = np.arange(6.0).reshape(3, 2)
    content = {"angle": ANGLE, "log/u": VOLTAGE, "log/x": state}
    expected = {"angle": ANGLE, "log.u": VOLTAGE, "log.x[1]": [0, 2, 4], "log.x[2]": [1, 3, 5]}
    assert_columns(read_columns(mat73(tmp_path / "log.mat", content)), expected)


# --- what cannot be read ---

WAVE = np.sin(np.arange(60.0))


def noted(notes: dict[int, str]) -> str:
    """A log of 60 rows below its header with notes beside some of them."""
    rows = [f"{value},{notes.get(k, 'fine')}\n" for k, value in enumerate(WAVE)]
    return "angle,note\n" + "".join(rows)


def test_a_row_that_a_lost_power_left_is_a_damaged_row(tmp_path: Path) -> None:
    rows = [b"%d,%d" % (k, k * k) for k in range(99)]
    rows[40] = b"4,1\0\0\xff"
    (tmp_path / "log.csv").write_bytes(b"a,b\n" + b"\n".join(rows))
    with pytest.raises(InputError, match=r"row 42, b: the text"):
        numbers(read_columns(tmp_path / "log.csv"))


@pytest.mark.parametrize(
    ("content", "header", "message"),
    [
        ("a,b\n1,2\n3,off\n5,6\n", None, r"log\.csv row 3, b: the text 'off'"),
        ("a,b\n1,2\n,4\n", None, r"log\.csv row 3, a: an empty cell"),
        ("a,b\n1,2\n3,4\n5\n", None, r"log\.csv row 4, b: an empty cell"),
        ("a,b\n1,2\n3,'1,5'\n", None, "row 3 has 3 cells"),
        ("# rig\n# pause\na,b\n1,2\n3,off\n", None, r"log\.csv row 5, b: the text 'off'"),
        ("angle,voltage\n1,2\n", False, r"row 1, column 1: the text 'angle'.*`header = true`"),
        ("# rig\n1,2\n3,4\n5,6,7\n", True, r"log\.csv: row 4 has 3 cells, row 2 has 2"),
        ("# rig\n1,2\n3,4\n5,6,7\n", False, r"log\.csv: row 4 has 3 cells, row 2 has 2"),
        ("a,b\n", None, r"log\.csv: the file holds no samples"),
        ("\n\n", None, r"log\.csv: the file holds no samples"),
        ("# only a comment\n", None, r"log\.csv: the file holds no samples"),
        ("", None, "the file is empty"),
        (b"angle\n1\n\0\0\n", None, "not a text file in UTF-8"),
        ("angle\n1\n2\n".encode("utf-32"), None, "not a text file in UTF-8"),
        # a quote that is not closed swallows no rows
        (noted({9: '"'}), None, r'log\.csv: row 11 has a quote \("\) that'),
        (noted({9: '"lost', 30: 'found"'}), None, r'log\.csv: row 11 has a quote \("\) that'),
        (noted({30: '5"'}), None, r'log\.csv: row 32 has a quote \("\) that is not closed'),
        # lines end where files end them
        *(
            (
                end.join(["angle,note", f"1,a{other}b", "2,c", "x,d"]),
                None,
                "row 4, angle: the text 'x'",
            )
            for end in ("\n", "\r\n", "\r")
            for other in ("\x0b", "\x0c", "\x1c", "\x85", "\u2028")
        ),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_text_that_holds_no_table_of_numbers_is_refused_with_its_row(
    tmp_path: Path, content: str | bytes, header: bool | None, message: str
) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError, match=message):
        numbers(read_columns(path, header=header))


def test_later_columns_of_one_name_are_numbered(tmp_path):
    (tmp_path / "log.csv").write_text('a,b,a,"a #2"\n' + "1,2,3,4\n" * 3)
    with pytest.raises(InputError, match="two columns are called 'a #2'"):
        read_columns(tmp_path / "log.csv")
    (tmp_path / "log.csv").write_text("a,b,a,a\n" + "1,2,3,4\n" * 3)
    columns = read_columns(tmp_path / "log.csv")
    assert columns.names == ("a", "b", "a #2", "a #3")
    assert columns["a #2"].tolist() == [3.0] * 3
    assert "a later column of the same name: 'a #2'" in columns.notes


def duplicate_member(path: Path) -> None:
    np.savez_compressed(path, angle=ANGLE, time=ANGLE)
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("angle.npy", archive.read("time.npy"))


def duplicate_variable(path: Path) -> None:
    scipy.io.savemat(path, {"angle": WAVE, "bngle": WAVE})
    path.write_bytes(path.read_bytes().replace(b"bngle", b"angle"))


def duplicate_parquet(path: Path) -> None:
    pl.DataFrame({"angle": WAVE, "bngle": WAVE}).write_parquet(path)
    path.write_bytes(path.read_bytes().replace(b"bngle", b"angle"))


def external_numbers(path: Path) -> None:
    other = path.with_name("secret.txt")
    other.write_bytes(b"nobody's business")
    with h5py.File(path, "w") as file:
        file.create_dataset("angle", (16,), "u1", external=[(str(other), 0, 16)])


@pytest.mark.parametrize(
    ("name", "write", "message"),
    [
        ("absent.csv", lambda path: None, r"absent\.csv: no such file"),
        ("log.parquet", Path.touch, "the file is empty"),
        ("log.npz", Path.touch, "the file is empty"),
        ("log.mat", Path.touch, "the file is empty"),
        ("log.docx", lambda path: path.write_text("x"), r"ending '\.docx'; .*\.csv.*\.npz"),
        (
            "log.tsv",
            lambda path: path.write_text("a\tb\n1\t2\n\t\n3\t4\n"),
            "row 3, a: an empty cell",
        ),
        ("log.csv", Path.mkdir, r"log\.csv: a folder, pipe or device"),
        ("log.csv", os.mkfifo, r"log\.csv: a folder, pipe or device"),
        ("log.csv", lambda path: path.symlink_to("/dev/zero"), r"log\.csv: a folder, pipe"),
        ("log.npz", lambda path: np.savez(path, scalar=np.float64(3)), "holds no samples"),
        (
            "log.npz",
            lambda path: np.savez(path, a=np.array([{"x": 1}, None], dtype=object)),
            "holds no samples, only 'a': text or objects; expected columns",  # not unpickled
        ),
        (
            "log.npz",
            lambda path: np.savez(path, angle=np.zeros((2, 100_001), np.int8)),
            "100001 columns; expected at most 100000",
        ),
        ("log.npz", duplicate_member, "two columns are called 'angle'"),
        ("log.mat", duplicate_variable, "two columns are called 'angle'"),
        ("log.parquet", duplicate_parquet, r"log\.parquet"),
        ("log.mat", external_numbers, "the numbers of 'angle' are in another file"),
        (
            "log.mat",
            lambda path: scipy.io.savemat(path, {"angle": WAVE, "z": WAVE + 1j}),
            "z: numbers of type complex128; expected real",
        ),
    ],
)
def test_files_that_hold_no_columns_of_numbers_are_refused(
    tmp_path: Path, name: str, write: Callable[[Path], Any], message: str
) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError, match=message):
        numbers(read_columns(tmp_path / name))


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (pd.DataFrame([[1, 2]], columns=["a", "a"]), "bench: two columns are called 'a'"),
        (pl.DataFrame({"a": [[1], [2]]}), "bench, a: cannot be turned into numbers"),
        ({"a": [1.0]}, "bench: a dict; expected a pandas or polars data frame"),
    ],
    ids=["two", "lists", "dict"],
)
def test_data_frames_that_hold_no_columns_of_numbers_are_refused(frame: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        numbers(frame_columns(frame, "bench"))


@pytest.mark.parametrize("ending", ["parquet", "npz", "mat", "mat73"])
@pytest.mark.parametrize("damage", ["cut", "noise"])
def test_a_damaged_file_is_refused(tmp_path: Path, ending: str, damage: str) -> None:
    path = tmp_path / f"log.{ending[:7].removesuffix('73')}"
    long = np.random.default_rng(0).normal(size=2000)
    if ending == "parquet":
        pl.DataFrame({"a": long}).write_parquet(path)
    elif ending == "npz":
        np.savez_compressed(path, a=long)
    elif ending == "mat":
        scipy.io.savemat(path, {"a": long}, do_compression=True)
    else:
        mat73(path, {"a": long})
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if damage == "cut" else b"\x07noise" * 500)
    with pytest.raises(InputError, match=r"log\.(parquet|npz|mat)"):
        numbers(read_columns(path))


# --- MATLAB: cells, struct arrays, timeseries ---


def refer(file: h5py.File, name: str, parts: list[dict[str, np.ndarray]], *, cell: bool) -> None:
    """Writes a cell array of structs, or a struct array, as MATLAB 7.3 does: by references."""
    for k, part in enumerate(parts):
        for field, column in part.items():
            file[f"#refs#/{name}{k}/{field}"] = np.atleast_2d(column)  # a column in MATLAB
        file[f"#refs#/{name}{k}"].attrs["MATLAB_class"] = np.bytes_("struct")
    if cell:
        groups = [[file[f"#refs#/{name}{k}"].ref] for k in range(len(parts))]
        file.create_dataset(name, data=groups, dtype=h5py.ref_dtype)
        file[name].attrs["MATLAB_class"] = np.bytes_("cell")
        return
    for field in parts[0]:
        columns = [[file[f"#refs#/{name}{k}/{field}"].ref] for k in range(len(parts))]
        file.create_dataset(f"{name}/{field}", data=columns, dtype=h5py.ref_dtype)


def matlab_file(path: Path, parts: list[dict[str, np.ndarray]], *, v73: bool) -> Path:
    """A cell array `logs` and a struct array `runs` of the same parts, text, a timeseries."""
    series = np.arange(6.0).reshape(2, 1, 3)  # two channels by three samples
    if v73:
        with h5py.File(path, "w") as file:
            refer(file, "logs", parts, cell=True)
            refer(file, "runs", parts, cell=False)
            file["label"] = np.array([[104], [105]], np.uint16)
            file["label"].attrs["MATLAB_class"] = np.bytes_("char")
            file["ts"] = np.zeros((1, 6), np.uint32)
            file["ts"].attrs["MATLAB_class"] = np.bytes_("timeseries")
            file["ts"].attrs["MATLAB_object_decode"] = 3
            file["exported/Time"], file["exported/Data"] = np.zeros((1, 3)), series.T
            file["one"] = np.ones((1, 1))
        return path
    cell, array = np.empty((1, len(parts)), object), np.empty((1, len(parts)), object)
    cell[0], array[0] = parts, parts
    runs = np.zeros((1, len(parts)), [(field, object) for field in parts[0]])
    for k, part in enumerate(parts):
        runs[0, k] = tuple(part.values())
    exported = {"Time": np.zeros(3), "Data": series, "Name": "arm"}
    scipy.io.savemat(
        path, {"logs": cell, "runs": runs, "label": "hi", "exported": exported, "one": 1.0}
    )
    return path


@pytest.mark.parametrize("v73", [False, True])
def test_cells_struct_arrays_and_exported_timeseries_of_matlab_are_read(
    tmp_path: Path, v73: bool
) -> None:
    parts = [{"angle": ANGLE + k, "volts": VOLTAGE} for k in range(3)]
    found = read_columns(matlab_file(tmp_path / "log.mat", parts, v73=v73))
    assert found.elements == 3
    np.testing.assert_array_equal(found["logs{3}.angle"], ANGLE + 2)
    np.testing.assert_array_equal(found["runs(2).angle"], ANGLE + 1)
    second = found.element(2)
    np.testing.assert_array_equal(second["logs.angle"], ANGLE + 1)
    np.testing.assert_array_equal(second["runs.volts"], VOLTAGE)
    np.testing.assert_array_equal(found["exported.Data[2]"], [3, 4, 5])  # samples come first
    assert found.others["label"] == "text"
    assert found.others["one"] == "the number 1"
    if v73:
        assert found.others["ts"].startswith("a MATLAB object")


def test_a_cell_of_one_struct_and_a_matrix_in_a_cell(tmp_path: Path) -> None:
    one, matrices = np.empty((1, 1), object), np.empty((2, 1), object)
    one[0, 0] = TABLE
    matrices[:, 0] = [np.column_stack([ANGLE, VOLTAGE]), np.column_stack([VOLTAGE, ANGLE])]
    scipy.io.savemat(tmp_path / "log.mat", {"one": one, "many": matrices})
    found = read_columns(tmp_path / "log.mat")
    np.testing.assert_array_equal(found.element(1)["one.angle"], ANGLE)
    np.testing.assert_array_equal(found.element(2)["many[2]"], ANGLE)


def opaque(name: str) -> bytes:
    """An object of MATLAB as version 7 files have it: an element of class 17 without a size."""

    def element(kind: int, content: bytes) -> bytes:
        return np.array([kind, len(content)], "<u4").tobytes() + content + bytes(-len(content) % 8)

    texts = [element(1, text) for text in (name.encode(), b"MCOS", b"timeseries")]
    numbers = element(6, np.array([13, 0], "<u4").tobytes()) + element(5, bytes(8))
    inner = element(14, numbers + element(1, b"") + element(6, bytes(0)))
    flags = element(6, np.array([17, 0], "<u4").tobytes())
    return element(14, flags + b"".join(texts) + inner)


def test_an_object_of_matlab_is_told_as_such(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"x": ANGLE})
    with path.open("ab") as file:
        file.write(opaque("ts"))
    found = read_columns(path)
    assert found.names == ("x",)
    assert found.others["ts"].startswith("a MATLAB object")


def test_a_variable_that_is_cut_short_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"x": np.arange(50.0), "y": np.arange(50.0)})
    path.write_bytes(path.read_bytes()[:-100])
    found = read_columns(path)
    assert found["x"][-1] == 49
    with pytest.raises(InputError, match=r"log\.mat, y: the variable is cut short or damaged"):
        found["y"]
