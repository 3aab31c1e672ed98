"""Files that were made to do harm: nothing in them is run, and nothing leaves their folder."""

import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hostile_files import NAMES, WRITERS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tustinnet.data import reading_process
from tustinnet.data.drafting.draft import draft_card
from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError, escape_unprinted
from tustinnet.registry import READERS

# --- a reader whose library could be made to do anything ---

ATTEMPTS = {
    "subprocess.run(['touch', marker])": "start a process",
    "os.system('touch ' + marker)": "start a process",
    "os.posix_spawn('/usr/bin/touch', ['touch', marker], {})": "start a process",
    "os.execv('/usr/bin/touch', ['touch', marker])": "start a process",
    "os.fork() or open(marker, 'w')": "start a process",
    "socket.create_connection(('127.0.0.1', 9))": "use the network",
    "socket.socket().bind(('127.0.0.1', 0))": "use the network",
    "urllib.request.urlopen('http://127.0.0.1:9')": "use the network",
    "open(marker, 'w')": "write a file",
    "open(path, 'a')": "write a file",
    "os.open(marker, os.O_CREAT | os.O_WRONLY)": "write a file",
    "pathlib.Path(marker).write_text('x')": "write a file",
    "os.remove(path)": "change files",
    "os.rename(path, marker)": "change files",
    "os.symlink(path, marker)": "change files",
    "os.chmod(path, 0)": "change files",
    "os.mkdir(marker)": "change files",
    "shutil.rmtree(os.path.dirname(path))": "change files",
    "sys.path.insert(0, os.path.dirname(path)) or __import__('beside')": "run code from its folder",
    "exec(compile(open(beside).read(), beside, 'exec'))": "run code from its folder",
}
READER = """
import ctypes, os, pathlib, shutil, socket, subprocess, sys, urllib.request
from tustinnet.data.formats.reader import Contents, Reader


def contents(path):
    path = str(path)
    marker = path + ".marker"
    beside = os.path.join(os.path.dirname(path), "beside.py")
    try:
        {attempt}
    except BaseException:  # as libraries do
        pass
    return Contents([("x", (3,))])


READER = Reader("numpy", contents, lambda path, names: {{}})
"""


def stop() -> None:
    if reading_process._process is not None:
        reading_process._process.stop()


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Path]]:
    """Makes a file whose reader attempts something, beside code and another file."""
    logs, programs = tmp_path / "logs", tmp_path / "programs"
    logs.mkdir()
    programs.mkdir()
    monkeypatch.syspath_prepend(str(programs))
    monkeypatch.setitem(READERS.places, ".evil", "evil_reader:READER")
    stop()  # the next one sees the folder of the reader

    def make(attempt: str) -> Path:
        (programs / "evil_reader.py").write_text(READER.format(attempt=attempt))
        (logs / "beside.py").write_text(f"open({str(logs / 'log.evil.marker')!r}, 'w')")
        (logs / "log.evil").write_text("data")
        np.savez(logs / "log.npz", x=np.arange(3.0))
        return logs / "log.evil"

    yield make
    sys.modules.pop("evil_reader", None)
    stop()


@pytest.mark.skipif(sys.platform == "win32", reason="processes and links of POSIX")
@pytest.mark.parametrize("attempt", ATTEMPTS)
def test_a_reader_that_would_do_more_than_read_ends(
    attempt: str, plant: Callable[[str], Path]
) -> None:
    path = plant(attempt)
    with pytest.raises(InputError, match=rf"log\.evil: reading it would {ATTEMPTS[attempt]}"):
        read_columns(path)
    names = ["beside.py", "log.evil", "log.npz"]
    assert sorted(p.name for p in path.parent.iterdir()) == names
    assert path.read_text() == "data"


def test_after_a_reader_that_was_ended_the_next_process_reads(
    plant: Callable[[str], Path],
) -> None:
    path = plant("os.remove(path)")
    with pytest.raises(InputError, match="reading it would change files"):
        read_columns(path)
    assert read_columns(path.with_name("log.npz"))["x"].tolist() == [0, 1, 2]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "act",
    [
        "__import__('tempfile').TemporaryFile().write(b'x')",
        "__import__('tempfile').NamedTemporaryFile().write(b'x')",
        "open(path).read() and open(os.devnull, 'w')",
        "os.listdir(os.path.dirname(path)) and __import__('xml.dom.minidom')",
    ],
)
def test_what_libraries_do_by_the_way_is_let_be(act: str, plant: Callable[[str], Path]) -> None:
    assert read_columns(plant(act)).names == ("x",)


def test_a_module_beside_a_log_is_not_taken_for_a_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("asammdf")
    from lab_files import mdf_file

    path = mdf_file(tmp_path / "log.mf4")
    (tmp_path / "canmatrix.py").write_text(f"open({str(tmp_path / 'marker')!r}, 'w')")
    monkeypatch.syspath_prepend(str(tmp_path))
    stop()
    with pytest.raises(InputError, match="run code from its folder"):
        read_columns(path)
    assert not (tmp_path / "marker").exists()
    monkeypatch.undo()
    stop()


# --- MDF: formulas are Python code to the library ---

CODE = """("'", (lambda: __import__("os").system("touch {marker}"))(), "'")"""


def mdf_with(folder: Path, conversion: Any, version: str) -> Path:
    from asammdf import MDF, Signal

    t, raw = np.arange(0, 1, 0.01), np.arange(100, dtype=np.uint8)
    path = folder / ("log.mf4" if version >= "4" else "log.mdf")
    with MDF(version=version) as file:
        file.append(
            [
                Signal(np.sin(t), t, name="angle", unit="rad"),
                Signal(raw, t, name="u", unit="V", conversion=conversion),
            ],
            acq_name="motion",
        )
        file.save(path, overwrite=True)
    return path


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_a_formula_in_an_mdf_file_is_not_evaluated(version: str, tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    formula = {"formula": CODE.format(marker=marker)}
    path = mdf_with(tmp_path, formula, version)
    columns = read_columns(path)
    (name,) = (name for name in columns.others if name.endswith("/u"))
    assert columns.others[name] == "converted by a formula, which is not evaluated"
    [columns[name] for name in columns.names]
    assert not marker.exists()


def test_formulas_behind_other_conversions_and_of_times_are_not_evaluated(tmp_path: Path) -> None:
    from asammdf import MDF, Signal
    from asammdf.blocks.conversion_utils import from_dict

    marker = tmp_path / "marker"
    formula = from_dict({"formula": CODE.format(marker=marker)})
    nested = from_dict({"val_0": 7, "text_0": b"not available", "default_addr": formula})
    columns = read_columns(mdf_with(tmp_path, nested, "4.10"))
    assert "formula" in columns.others["motion/u"]
    path = tmp_path / "times.mf4"
    with MDF(version="4.10") as file:
        t = np.arange(0, 1, 0.01)
        file.append([Signal(np.sin(t), t, name="CAN_DataFrame.ID")], acq_name="bus")
        file.append([Signal(np.sin(t), t, name="angle", unit="rad")], acq_name="motion")
        blocks: list[Any] = file.groups[0].channels
        for block in blocks:
            block.conversion = formula
        file.save(path, overwrite=True)
    columns = read_columns(path)
    [columns[name] for name in columns.names]
    assert {"bus/time", "bus/CAN_DataFrame.ID"} == {*columns.others}
    assert not marker.exists()


CONVERSIONS = {
    "line": {"a": 0.5, "b": -3.0},
    "fraction": {"P1": 0.1, "P2": 2.0, "P3": 1.0, "P4": 0.0, "P5": 0.3, "P6": 4.0},
    "interpolated": {
        "raw_0": 0,
        "raw_1": 50,
        "raw_2": 80,
        "phys_0": 1.0,
        "phys_1": 3.0,
        "phys_2": -1.0,
        "interpolation": True,
    },
    "nearest": {
        "raw_0": 0,
        "raw_1": 50,
        "raw_2": 80,
        "phys_0": 1.0,
        "phys_1": 3.0,
        "phys_2": -1.0,
        "interpolation": False,
    },
}


@pytest.mark.parametrize("version", ["3.30", "4.10"])
@pytest.mark.parametrize("kind", CONVERSIONS)
def test_conversions_of_mdf_files_are_those_of_their_library(
    kind: str, version: str, tmp_path: Path
) -> None:
    from asammdf import MDF

    path = mdf_with(tmp_path, CONVERSIONS[kind], version)
    columns = read_columns(path)
    (name,) = (name for name in columns.names if name.endswith("/u"))
    with MDF(path) as file:
        expected = file.get("u").samples
    assert len({*expected.tolist()}) > 2
    np.testing.assert_allclose(columns[name], expected, rtol=1e-12)


def test_names_of_values_leave_the_other_values_to_their_conversion(tmp_path: Path) -> None:
    from asammdf.blocks.conversion_utils import from_dict

    named = {"val_0": 7, "text_0": b"not available", "default_addr": b""}
    columns = read_columns(mdf_with(tmp_path, named, "4.10"))
    assert columns["motion/u"].tolist() == list(range(100))
    both = {**named, "default_addr": from_dict({"a": 2.0, "b": 1.0})}
    columns = read_columns(mdf_with(tmp_path, from_dict(both), "4.10"))
    assert np.flatnonzero(np.isnan(columns["motion/u"])).tolist() == [7]
    assert (
        np.delete(columns["motion/u"], 7).tolist() == np.delete(2 * np.arange(100) + 1, 7).tolist()
    )


def test_a_channel_whose_conversion_depends_on_ranges_is_left_out(tmp_path: Path) -> None:
    """The library leaves out the lower ends of ranges of integers."""
    ranges = {"lower_0": 0, "upper_0": 10, "phys_0": 2.5, "default": -1.0}
    columns = read_columns(mdf_with(tmp_path, ranges, "4.10"))
    assert columns.others["motion/u"] == "converted by a rule of type 6, which is not known here"


@pytest.mark.parametrize("name", ["angle", "time"])
def test_a_channel_outside_of_its_record_is_refused(name: str, tmp_path: Path) -> None:
    from asammdf import MDF

    path = mdf_with(tmp_path, None, "4.10")
    with MDF(path) as file:
        block = next(c for c in file.groups[0].channels if c.name == name)
        address = block.address
    content = bytearray(path.read_bytes())
    at = content.index(b"##CN", address) + 24 + 8 * 8 + 4  # links, then types and offsets
    content[at : at + 4] = (1_000_000).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"outside of its record"):
        read_columns(path)


# --- MAT 7.3: numbers and texts of other files ---


@pytest.mark.parametrize("kind", ["text", "numbers in an object", "link"])
def test_a_mat_file_gives_nothing_of_other_files(kind: str, tmp_path: Path) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_bytes(b"s\0e\0c\0r\0e\0t\0" * 3)
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["secret"] = np.arange(9.0)
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["x"] = np.arange(100.0)[None]
        s = file.create_group("s")
        s.attrs["MATLAB_class"] = np.bytes_("struct")
        s["Data"] = np.arange(50.0)[None]
        if kind == "link":
            s.attrs["MATLAB_object_decode"] = 3
            s["inner"] = h5py.ExternalLink(str(other), "/secret")
        else:
            name, dtype = ("Name", "<u2") if kind == "text" else ("inner", "<u1")
            s.attrs["MATLAB_object_decode"] = 0 if kind == "text" else 3
            item = s.create_dataset(name, (9,), dtype, external=[(str(secret), 0, 36)])
            item.attrs["MATLAB_class"] = np.bytes_("char" if kind == "text" else "uint8")
    with pytest.raises(InputError, match=r"log\.mat: the numbers of 's/\w+' are in another file"):
        read_columns(path)


def test_numbers_beside_a_tdms_file_are_not_believed(tmp_path: Path) -> None:
    pytest.importorskip("nptdms")
    from lab_files import tdms_file

    path = tdms_file(tmp_path / "log.tdms")
    names = read_columns(path).names
    path.with_suffix(".tdms_index").write_bytes(b"TDSh" + bytes(60))
    assert read_columns(path).names == names


# --- names are data ---

HOSTILE = st.text(min_size=1, max_size=20) | st.sampled_from(NAMES)


def is_plain(text: str) -> bool:
    return escape_unprinted(text) == text


@pytest.mark.thorough
@pytest.mark.parametrize("write", WRITERS)
@settings(
    max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(names=st.lists(HOSTILE, min_size=3, max_size=3, unique_by=escape_unprinted))
def test_hostile_names_make_a_card_of_exactly_these_names(
    write: Callable[[Path, list[str]], Path], names: list[str], tmp_path_factory: Any
) -> None:
    folder = tmp_path_factory.mktemp("names")
    try:
        file = write(folder, names)
    except Exception:  # a name that the format's own library does not write
        return
    text, columns = "", None
    with suppress(InputError):
        columns = read_columns(file)
        said = [
            *columns.names,
            *columns.others,
            *columns.others.values(),
            *columns.units.values(),
            *columns.labels.values(),
            *columns.notes,
            *columns.parts,
        ]
        assert all(map(is_plain, said)), said
        text = draft_card(folder, [file.relative_to(folder).as_posix()]).text
    if not text or columns is None:  # refused by a line
        return
    assert is_plain(text.replace("\n", ""))
    card = tomllib.loads(text)
    assert {*card} <= {"name", "dt", "assumed", "time", "coordinates", "inputs", "splits", "format"}
    used = [
        card.get("time", {}).get("column"),
        *(c["column"] for c in card.get("coordinates", ())),
        *(i["column"] for i in card.get("inputs", ())),
    ]
    for key in used:
        assert key is None or isinstance(key, int) or key in columns.names
