"""Damaged files: every one ends in columns or in an `InputError`, never in less than it holds."""

import subprocess
import sys
import time
import zipfile
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pytest
import scipy.io

from tustinnet.data import binary_files, reading_process
from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError

WAVE = np.sin(np.arange(60.0))
TABLE = {"time": np.arange(60) * 0.01, "angle": WAVE, "torque": np.round(WAVE)}


def whole_file(place: Path, kind: str) -> Path:
    """A file of the table; `mat73` stands for MAT files of version 7.3."""
    path = place / f"log.{kind.removesuffix('73')}"
    if kind == "csv":
        pl.DataFrame({**TABLE, "note": ["a pause"] * 60}).write_csv(path)
    elif kind == "parquet":
        pl.DataFrame({**TABLE, "note": ["a pause"] * 60}).write_parquet(path)
    elif kind == "npz":
        np.savez_compressed(path, **TABLE)
    elif kind == "mat":
        scipy.io.savemat(path, {**TABLE, "log": TABLE})
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, column in TABLE.items():
                file[name] = column[:, None]
    return path


def read_all(path: Path) -> dict[str, np.ndarray]:
    columns = read_columns(path)
    used = [name for name in columns.names if name in TABLE]
    columns.fetch(used)
    return {name: columns[name] for name in used}


@pytest.mark.parametrize("kind", ["csv", "parquet", "npz", "mat", "mat73"])
def test_bytes_that_flip_and_ends_that_lack(
    tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = whole_file(tmp_path, kind)
    whole, generator = path.read_bytes(), np.random.default_rng(7)
    assert len(read_all(path)) == 3
    refused = 0
    for case in range(60):
        damaged = bytearray(whole)
        for place in generator.integers(0, len(whole), generator.integers(1, 4)):
            damaged[place] = generator.integers(0, 256)
        if case % 4 == 0:
            del damaged[generator.integers(1, len(whole)) :]
        path.write_bytes(damaged)
        message = ""
        try:
            read_all(path)
        except InputError as error:
            refused, message = refused + 1, str(error)
        assert len(message) < 300 + 2 * len(str(path))
    assert refused > 10
    assert capfd.readouterr() == ("", "")


# --- no row is lost ---


def test_quotes_that_are_closed_are_no_matter(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text('angle,note\n1,"a, b"\n2,"say ""off"""\n"3",c\n')
    np.testing.assert_array_equal(read_all(path)["angle"], [1, 2, 3])


# --- memory and time ---


def test_only_the_wanted_members_are_loaded(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, angle=WAVE)
    with zipfile.ZipFile(path, "a") as archive:
        head = np.lib.format.magic(1, 0)
        said = (
            b"{'descr': '<f8', 'fortran_order': False, 'shape': (900000000,), }".ljust(117) + b"\n"
        )
        archive.writestr("huge.npy", head + len(said).to_bytes(2, "little") + said)
    columns = read_columns(path)
    assert columns.names == ("angle", "huge")
    np.testing.assert_array_equal(columns["angle"], WAVE)
    with pytest.raises(InputError, match=r"take 6\.7 GiB; expected at most 1 GiB"):
        columns["huge"]


def test_a_file_that_crashes_its_reader_is_refused_and_the_next_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = whole_file(tmp_path, "npz")
    read_columns(path)
    child = reading_process._process
    assert child is not None
    child._child.kill()
    child._child.wait()
    assert len(read_all(path)) == 3  # one that died in between does no harm
    program = reading_process._PROGRAM.replace("serve()", "import os; os.abort()")
    monkeypatch.setattr(reading_process, "_PROGRAM", program)
    stop()
    with pytest.raises(InputError, match=r"process that reads \.npz files does not start"):
        read_columns(path)
    monkeypatch.undo()
    assert len(read_all(path)) == 3


@pytest.mark.parametrize(("does", "seconds"), [("os.abort()", 60.0), ("time.sleep(60)", 0.3)])
def test_a_reader_that_crashes_or_hangs_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, does: str, seconds: float
) -> None:
    path = whole_file(tmp_path, "npz")
    program = f"""
import os, time
import tustinnet.data.binary_files as files
files.list_columns = lambda *_: {does}
"""
    program = reading_process._PROGRAM.replace("from", program + "from", 1)
    monkeypatch.setattr(reading_process, "_PROGRAM", program)
    monkeypatch.setattr(reading_process, "_NAMES_S", seconds)
    stop()
    with pytest.raises(InputError, match=r"log\.npz: the file crashes its reader, or keeps it"):
        read_columns(path)
    monkeypatch.undo()
    assert len(read_all(path)) == 3


def test_a_process_that_read_much_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading_process, "_MUCH", 1000)
    path = whole_file(tmp_path, "npz")
    assert len(read_all(path)) == 3
    child = reading_process._process
    assert child is not None
    assert not child.is_usable
    columns = read_columns(path)
    path.unlink()
    with pytest.raises(InputError, match=r"log\.npz: cannot be looked at \(FileNotFoundError"):
        columns["angle"]


def stop() -> None:
    if reading_process._process is not None:
        reading_process._process.stop()


def test_relative_paths_follow_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole_file(tmp_path, "npz")
    monkeypatch.chdir(tmp_path)
    assert len(read_all(Path("log.npz"))) == 3
    Path("log.npz").write_bytes(b"damaged")
    with pytest.raises(InputError, match=r"^log\.npz: cannot be read as \.npz"):
        read_all(Path("log.npz"))


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_the_reader_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    path = whole_file(tmp_path, "npz")
    program = f"""
import os, pathlib
from tustinnet.data import reading_process
from tustinnet.data.readers import read_columns
read_columns(pathlib.Path({str(path)!r}))
print(reading_process._process._child.pid, flush=True)
os._exit(1)
"""
    run = [sys.executable, "-c", program]
    child = Path("/proc") / subprocess.run(run, capture_output=True, text=True).stdout.strip()
    assert child.name.isdigit()
    deadline = time.monotonic() + 10
    while child.exists() and "Z" not in (child / "stat").read_text().split()[2]:
        assert time.monotonic() < deadline
        time.sleep(0.02)


# --- what is no file ---


def test_a_file_that_may_not_be_read_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    path = whole_file(tmp_path, "csv")
    monkeypatch.setattr(Path, "read_bytes", forbidden)
    with pytest.raises(InputError, match=r"log\.csv: cannot be read as \.csv \(PermissionError"):
        read_columns(path)


def test_the_limits_leave_room_for_the_columns() -> None:
    assert 2 * binary_files.LARGEST < reading_process._MEMORY
