"""Objects of MATLAB and exports of Simulink in MAT files."""

import warnings
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
from lab_files import CARD

import tustinnet as tn
from tustinnet.data import reading_process
from tustinnet.data.drafting.draft import draft_file
from tustinnet.data.formats import mat
from tustinnet.data.readers import read_columns

T = np.arange(200) * 0.01
ANGLE = np.sin(3 * T)
COMMAND_T = np.arange(41) * 0.05
COMMAND = np.random.default_rng(0).choice([-1.0, 0.0, 2.0], 41)


def timeseries(t: np.ndarray | None, data: np.ndarray, name: str = "arm", unit: Any = None) -> Any:
    """A timeseries object; without times it has only their beginning, step and number."""
    with warnings.catch_warnings(action="ignore"):
        from matio.utils import MatlabOpaque

    info = {"Start_": 0.0, "Increment_": 0.01, "Length": float(len(data)), "Units": "seconds"}
    properties = {
        "Data_": data[:, None],
        "Time_": np.zeros((0, 0)) if t is None else t[:, None],
        "TimeInfo": MatlabOpaque(properties=info, classname="tsdata.timemetadata"),
        "Name": name,
    }
    if unit is not None:
        about = MatlabOpaque(properties={"Units": unit}, classname="tsdata.datametadata")
        properties["DataInfo"] = about
    return MatlabOpaque(properties=properties, classname="timeseries")


def objects_file(path: Path, version: str) -> Path:
    with warnings.catch_warnings(action="ignore"):
        import matio

    index = pd.Index(pd.to_timedelta(T, unit="s").astype("timedelta64[us]"), name="Time")
    table = pd.DataFrame({"q": ANGLE, "u": 2 * ANGLE}, index=index)
    content = {
        "plain": ANGLE[:, None],
        "even": timeseries(None, ANGLE),
        "uneven": timeseries(COMMAND_T, COMMAND),
        "log": {"inner": timeseries(T, ANGLE)},
        "tt": table,
    }
    with warnings.catch_warnings(action="ignore"):
        matio.save_to_mat(str(path), content, version=version)
    return path


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_timeseries_and_timetables_are_columns_with_times(tmp_path: Path, version: str) -> None:
    columns = read_columns(objects_file(tmp_path / "log.mat", version))
    expected = {
        "plain": ANGLE,
        "even.Time": T,
        "even.Data": ANGLE,
        "uneven.Time": COMMAND_T,
        "uneven.Data": COMMAND,
        "log.inner.Time": T,
        "log.inner.Data": ANGLE,
        "tt.Time": T,
        "tt.q": ANGLE,
        "tt.u": 2 * ANGLE,
    }
    assert {*columns.names} == {*expected}
    for name, column in expected.items():
        np.testing.assert_allclose(columns[name], column, atol=1e-12, err_msg=name)
    assert columns.clocks["uneven.Data"] == "uneven.Time"
    assert columns.clocks["tt.u"] == "tt.Time"
    assert "plain" not in columns.clocks


def test_timeseries_of_two_rates_make_a_record(tmp_path: Path) -> None:
    objects_file(tmp_path / "log.mat", "v7")
    (tmp_path / "dataset.toml").write_text(
        CARD.format(time="even.Time", position="even.Data", command="uneven.Data")
    )
    (record,) = tn.load(tmp_path)
    np.testing.assert_allclose(record.q[:, 0], ANGLE)
    np.testing.assert_allclose(record.u[:, 0], np.repeat(COMMAND, 5)[:200], atol=1e-9)


def test_without_the_package_objects_are_named_with_its_pip_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    objects_file(tmp_path / "log.mat", "v7")
    program = "import importlib.util as u\nfind = u.find_spec\n"
    program += "u.find_spec = lambda name, *a: None if name == 'matio' else find(name, *a)\n"
    monkeypatch.setattr(reading_process, "_PROGRAM", program + reading_process._PROGRAM)
    monkeypatch.setattr(mat, "can_read_objects", lambda: False)
    if reading_process._process is not None:
        reading_process._process.stop()
    columns = read_columns(tmp_path / "log.mat")
    assert columns.others[""].startswith("a MATLAB object")
    (tmp_path / "dataset.toml").write_text(
        'name = "arm"\ndt = 0.01\n[[coordinates]]\nname = "a"\nkind = "linear"\n'
        'column = "even.Data"\n'
    )
    with pytest.raises(
        tn.InputError, match=r"'even\.Data', but a MATLAB object.*tustinnet\[matlab\]"
    ):
        tn.load(tmp_path)
    assert reading_process._process is not None
    reading_process._process.stop()  # the next one finds the package


@pytest.mark.parametrize("count", [1, 2])
def test_the_signals_of_a_simulink_export_are_channels(tmp_path: Path, count: int) -> None:
    signals = np.zeros((1, count), [("values", object), ("label", object)])
    for k in range(count):
        signals[0, k] = ((k + 1) * ANGLE[:, None], f"signal {k}")
    scipy.io.savemat(tmp_path / "log.mat", {"out": {"time": T[:, None], "signals": signals}})
    columns = read_columns(tmp_path / "log.mat")
    names = ["out.signals.values"] if count == 1 else [f"out.signals({k}).values" for k in (1, 2)]
    assert columns.names == ("out.time", *names)
    assert columns.elements == 0
    found = draft_file(tmp_path / "log.mat")
    (tmp_path / "dataset.toml").write_text(found.text)
    assert len(tn.load(tmp_path)) == 1


# --- names and units in texts beside the numbers ---


def write_text(group: h5py.Group, name: str, text: str) -> h5py.Dataset:
    """A char row as MATLAB 7.3 writes it; an empty one is stored as its size."""
    codes = np.array([[ord(c)] for c in text], np.uint16) if text else np.zeros(2, np.uint64)
    item = group.create_dataset(name, data=codes)
    item.attrs["MATLAB_class"] = np.bytes_("char")
    if not text:
        item.attrs["MATLAB_empty"] = np.uint8(1)
    return item


def write_struct_array(group: h5py.Group, name: str, elements: list[dict[str, Any]]) -> None:
    """A struct array as MATLAB 7.3 writes it: a data set of references for each field."""
    array = group.create_group(name)
    array.attrs["MATLAB_class"] = np.bytes_("struct")
    store = group.file.require_group("#refs#")
    for field in elements[0]:
        references = []
        for value in (element[field] for element in elements):
            label = f"r{len(store)}"
            if isinstance(value, str):
                write_text(store, label, value)
            else:
                store[label] = value[None]
            references.append([store[label].ref])
        array.create_dataset(field, data=references, dtype=h5py.ref_dtype)


def exported_file(path: Path) -> Path:
    """Exports of dSPACE and Simulink and a timeseries that was made a struct, version 7.3."""
    with h5py.File(path, "w", userblock_size=512) as file:
        file["exp1/X/Data"] = T[None]
        write_text(file, "exp1/X/Unit", "s")
        write_text(file, "exp1/X/Name", "")
        signals = [
            {"Name": "Winkel \u03c6", "Unit": "rad", "Data": ANGLE},
            {"Name": "u_cmd", "Unit": "V", "Data": 2 * ANGLE},
        ]
        write_struct_array(file.require_group("exp1"), "Y", signals)
        file["ts/Data"], file["ts/Time"] = ANGLE[None], T[None]
        write_text(file, "ts/Name", "theta")
        write_text(file, "ts/DataInfo/Units", "deg")
        file["out/time"] = T[None]
        scope = [{"values": ANGLE, "label": "q"}, {"values": 2 * ANGLE, "label": ""}]
        write_struct_array(file.require_group("out"), "signals", scope)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM"
    with path.open("r+b") as stream:
        stream.write(head)
    return path


def test_texts_of_structs_in_7_3_are_names_and_units(tmp_path: Path) -> None:
    columns = read_columns(exported_file(tmp_path / "log.mat"))
    assert columns.labels == {
        "exp1.Y(1).Data": "Winkel \u03c6",
        "exp1.Y(2).Data": "u_cmd",
        "ts.Data": "theta",
        "out.signals(1).values": "q",
    }
    assert columns.units == {
        "exp1.X.Data": "s",
        "exp1.Y(1).Data": "rad",
        "exp1.Y(2).Data": "V",
        "ts.Data": "deg",
    }


def test_elements_of_a_cell_array_keep_names_and_units(tmp_path: Path) -> None:
    cell = np.empty((1, 2), object)
    for k in range(2):
        cell[0, k] = {"angle": {"Data": ANGLE, "Name": "theta", "Unit": "deg"}, "t": T}
    scipy.io.savemat(tmp_path / "log.mat", {"runs": cell})
    first = read_columns(tmp_path / "log.mat").element(1)
    assert first.labels == {"runs.angle.Data": "theta"}
    assert first.units == {"runs.angle.Data": "deg"}


def logged(name: str, values: Any) -> Any:
    """A signal of a Simulink data set."""
    with warnings.catch_warnings(action="ignore"):
        from matio.utils import MatlabOpaque
    return MatlabOpaque(
        properties={"Name": name, "Values": values}, classname="Simulink.SimulationData.Signal"
    )


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_names_and_units_of_objects_and_strings(tmp_path: Path, version: str) -> None:
    with warnings.catch_warnings(action="ignore"):
        import matio
        from matio.utils import MatlabOpaque

    elements = np.empty((1, 2), object)
    # since 2016 the unit of a logged signal is an object with a name
    volt = MatlabOpaque(properties={"Name": "V"}, classname="Simulink.SimulationData.Unit")
    elements[0, 0] = logged("angle", timeseries(T, ANGLE, "angle", "rad"))
    elements[0, 1] = logged("motor", timeseries(T, 2 * ANGLE, "", volt))
    storage = MatlabOpaque(
        properties={"Elements": elements},
        classname="Simulink.SimulationData.Storage.RamDatasetStorage",
    )
    data_set = MatlabOpaque(
        properties={"Name": "logsout", "Storage_": storage},
        classname="Simulink.SimulationData.Dataset",
    )
    strings = {
        key: np.array([[text]], np.dtypes.StringDType())
        for key, text in (("Name", "elbow"), ("Unit", "deg"))
    }
    content = {"logsout": data_set, "arm": {"Data": ANGLE[:, None], **strings}}
    path = tmp_path / "log.mat"
    with warnings.catch_warnings(action="ignore"):
        matio.save_to_mat(str(path), content, version=version)
    columns = read_columns(path)
    signal = "logsout.Storage.Elements{{{}}}.Values.Data"
    expected = {
        signal.format(1): ("angle", "rad"),
        signal.format(2): ("motor", "V"),
        "arm.Data": ("elbow", "deg"),
    }
    assert {n: (columns.labels[n], columns.units[n]) for n in columns.labels} == expected
    np.testing.assert_allclose(columns[signal.format(2)], 2 * ANGLE)


def test_texts_belong_to_variables_of_their_case_and_columns_of_a_matrix_are_numbered(
    tmp_path: Path,
) -> None:
    two = np.stack([ANGLE, 2 * ANGLE], axis=1)
    scipy.io.savemat(
        tmp_path / "log.mat",
        {
            "U": {"Data": ANGLE, "Name": "voltage"},
            "u": {"Data": 2 * ANGLE, "Name": "unnamed"},
            "arm": {"Data": two, "Name": "joints", "Units": "deg"},
        },
    )
    columns = read_columns(tmp_path / "log.mat")
    assert columns.labels == {
        "U.Data": "voltage",
        "arm.Data[1]": "joints[1]",
        "arm.Data[2]": "joints[2]",
    }
    assert columns.units == {"arm.Data[1]": "deg", "arm.Data[2]": "deg"}
