"""A single file that no card describes."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
import scipy.io

import tustinnet as tn
from tustinnet.data.file_inspection import inspect_file

N = 400
T = np.arange(N) * 0.01
ANGLE = np.sin(3 * T) + 0.3 * np.sin(11 * T)
COUNTS = np.round(ANGLE * 4096 / (2 * np.pi))
RATE = np.gradient(ANGLE, 0.01)
LEVELS = np.repeat(np.random.default_rng(0).choice([-2.0, 0.0, 2.0], N // 40), 40)
NOISE = np.random.default_rng(1).normal(size=N)


def log(path: Path) -> Path:
    pl.DataFrame(
        {
            "time [ms]": 1000 * T, "arm": COUNTS, "rate": RATE, "a": LEVELS, "b": NOISE,
            "gain": np.ones(N), "state": ["on"] * N,
        }
    ).write_csv(path)  # fmt: skip
    return path


def test_columns_are_told_apart(tmp_path: Path) -> None:
    found = inspect_file(log(tmp_path / "run 1.csv"))
    roles = {c.name: c.role for c in found.columns}
    assert roles == {
        "time [ms]": "time", "arm": "position", "rate": "velocity", "a": "input", "b": "input",
        "gain": "constant", "state": "no numbers",
    }  # fmt: skip
    assert (found.rows, found.time_unit) == (N, "ms")
    assert found.dt == pytest.approx(0.01)
    assert found.jitter == pytest.approx(0, abs=1e-9)
    by_name = {c.name: c for c in found.columns}
    assert by_name["arm"].count == pytest.approx(1)
    assert by_name["rate"].remark == "slope of 'arm'"
    assert (by_name["a"].remark, by_name["b"].remark) == ("held levels", "rough")


def test_the_draft_is_a_card_that_reads_the_file(tmp_path: Path) -> None:
    found = inspect_file(log(tmp_path / "run 1.csv"))
    (tmp_path / "dataset.toml").write_text(found.draft)
    (e,) = tn.load(tmp_path)
    assert (e.name, e.dt, [c.name for c in e.inputs]) == ("run 1", 0.01, ["a", "b"])
    np.testing.assert_allclose(e.q[:, 0], COUNTS * 2 * np.pi / 4096)
    assert e.v is not None


def test_files_without_header_clock_or_text_form_are_looked_at_too(tmp_path: Path) -> None:
    bare = tmp_path / "bare.dat"
    np.savetxt(bare, np.column_stack([ANGLE, LEVELS]), delimiter=",")
    found = inspect_file(bare)
    assert (found.dt, [c.role for c in found.columns]) == (None, ["position", "input"])
    (tmp_path / "dataset.toml").write_text(found.draft)
    assert tn.load(tmp_path)[0].dt == 0.01
    logs = np.empty(2, object)
    logs[:] = [{"t": T, "q": ANGLE}] * 2
    scipy.io.savemat(tmp_path / "logs.mat", {"logs": logs, "label": "x"})
    found = inspect_file(tmp_path / "logs.mat")
    roles = {c.name: c.role for c in found.columns}
    assert roles == {"logs.t": "time", "logs.q": "position", "label": "no numbers"}
    assert "2 cells" in found.notes[0]
    (tmp_path / "dataset.toml").write_text(found.draft)
    assert [e.name for e in tn.load(tmp_path)] == ["logs[1]", "logs[2]"]


def test_a_file_of_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("a,b\nx,y\nz,w\n")
    with pytest.raises(tn.InputError, match=r"log\.csv: no column of numbers"):
        inspect_file(tmp_path / "log.csv")
