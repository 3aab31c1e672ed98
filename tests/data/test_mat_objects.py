"""Objects of MATLAB and exports of Simulink in MAT files."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
from lab_files import CARD

import tustinnet as tn
from tustinnet.data import reading_process
from tustinnet.data.file_inspection import inspect_file
from tustinnet.data.formats import mat
from tustinnet.data.readers import read_columns

T = np.arange(200) * 0.01
ANGLE = np.sin(3 * T)
COMMAND_T = np.arange(41) * 0.05
COMMAND = np.random.default_rng(0).choice([-1.0, 0.0, 2.0], 41)


def timeseries(t: np.ndarray | None, data: np.ndarray) -> Any:
    """A timeseries object; without times it has only their beginning, step and number."""
    with warnings.catch_warnings(action="ignore"):
        from matio.utils import MatlabOpaque

    info = {"Start_": 0.0, "Increment_": 0.01, "Length": float(len(data)), "Units": "seconds"}
    properties = {
        "Data_": data[:, None], "Time_": np.zeros((0, 0)) if t is None else t[:, None],
        "TimeInfo": MatlabOpaque(properties=info, classname="tsdata.timemetadata"), "Name": "arm",
    }  # fmt: skip
    return MatlabOpaque(properties=properties, classname="timeseries")


def objects_file(path: Path, version: str) -> Path:
    with warnings.catch_warnings(action="ignore"):
        import matio

    index = pd.Index(pd.to_timedelta(T, unit="s").astype("timedelta64[us]"), name="Time")
    table = pd.DataFrame({"q": ANGLE, "u": 2 * ANGLE}, index=index)
    content = {
        "plain": ANGLE[:, None], "even": timeseries(None, ANGLE),
        "uneven": timeseries(COMMAND_T, COMMAND), "log": {"inner": timeseries(T, ANGLE)},
        "tt": table,
    }  # fmt: skip
    with warnings.catch_warnings(action="ignore"):
        matio.save_to_mat(str(path), content, version=version)
    return path


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_timeseries_and_timetables_are_columns_with_times(tmp_path: Path, version: str) -> None:
    columns = read_columns(objects_file(tmp_path / "log.mat", version))
    expected = {
        "plain": ANGLE, "even.Time": T, "even.Data": ANGLE, "uneven.Time": COMMAND_T,
        "uneven.Data": COMMAND, "log.inner.Time": T, "log.inner.Data": ANGLE, "tt.Time": T,
        "tt.q": ANGLE, "tt.u": 2 * ANGLE,
    }  # fmt: skip
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
    found = inspect_file(tmp_path / "log.mat")
    (tmp_path / "dataset.toml").write_text(found.draft)
    assert len(tn.load(tmp_path)) == 1
