"""Files are written whole and inside, folders have one owner."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.store import files
from tustinnet.store.data_set_folder import write_data_set
from tustinnet.store.files import lock_folder, write_into


def test_a_file_is_written_below_its_folder(tmp_path):
    write_into(tmp_path, "deep/er/file.txt", "text")
    assert (tmp_path / "deep/er/file.txt").read_text() == "text"
    assert [p.name for p in tmp_path.rglob("*") if p.is_file()] == ["file.txt"]


@pytest.mark.parametrize("name", ["../outside.txt", "/tmp/outside.txt", "a/../../outside.txt"])
def test_nothing_is_written_outside(tmp_path, name):
    inside = tmp_path / "in"
    inside.mkdir()
    with pytest.raises(tn.InputError, match="outside of the output folder"):
        write_into(inside, name, "text")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["in"]


def test_a_link_that_leads_outside_is_not_followed(tmp_path):
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    (inside / "figures").symlink_to(outside)
    with pytest.raises(tn.InputError, match="outside of the output folder"):
        write_into(inside, "figures/a.png", b"")
    assert not list(outside.iterdir())


@pytest.mark.parametrize("planted", ["the file", "a part", "the last part"])
def test_a_planted_link_is_replaced_and_not_followed(tmp_path, monkeypatch, planted):
    """Also where somebody guesses the name that a file has while it is written."""
    inside, victim = tmp_path / "in", tmp_path / "victim"
    inside.mkdir()
    victim.write_text("precious")
    if planted == "the file":
        (inside / "f").symlink_to(victim)
    else:
        monkeypatch.setattr(files.secrets, "token_hex", lambda _: "0123abcd")
        random = "" if planted == "a part" else ".0123abcd"
        (inside / f".f.{os.getpid()}{random}.part").symlink_to(victim)
    if planted == "the last part":
        with pytest.raises(tn.InputError, match="cannot be written"):
            write_into(inside, "f", "text")
    else:
        write_into(inside, "f", "text")
        assert (inside / "f").read_text() == "text"
        assert not (inside / "f").is_symlink()
    assert victim.read_text() == "precious"


def test_a_folder_is_probed_without_following_links(tmp_path, monkeypatch):
    monkeypatch.setattr(files.secrets, "token_hex", lambda _: "0123abcd")
    victim = tmp_path / "victim"
    inside = tmp_path / "in"
    inside.mkdir()
    (inside / f".writable.{os.getpid()}.0123abcd.part").symlink_to(victim)
    with pytest.raises(tn.InputError, match="cannot be written"):
        files.require_writable_folder(inside)
    assert not victim.exists()


def test_a_file_that_does_not_fit_leaves_the_one_before(tmp_path):
    resource = pytest.importorskip("resource")
    program = (
        f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        f"from pathlib import Path; from tustinnet.store.files import write_into\n"
        f"write_into(Path({str(tmp_path)!r}), 'f', b'x' * 100)\n"
        f"write_into(Path({str(tmp_path)!r}), 'f', b'y' * 5000)\n"
    )
    assert resource
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "InputError" in ended.stderr.splitlines()[-1]
    assert "File too large" in ended.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["f"]
    assert (tmp_path / "f").read_bytes() == b"x" * 100


def test_a_folder_has_one_owner_at_a_time(tmp_path):
    pytest.importorskip("fcntl")
    taken = pytest.raises(tn.InputError, match="another run is writing there")
    with lock_folder(tmp_path / "run"), taken, lock_folder(tmp_path / "run"):
        pass
    with lock_folder(tmp_path / "run"):
        assert not list((tmp_path / "run").iterdir())


def test_what_a_killed_run_left_half_written_goes(tmp_path):
    for name in (".model.safetensors.77.part", "seed-0/.checkpoint.safetensors.77.part"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"half")
    (tmp_path / ".mine").write_text("stays")
    with lock_folder(tmp_path):
        assert sorted(p.name for p in tmp_path.rglob("*")) == [".mine", "seed-0"]


def test_what_a_killed_process_left_of_a_file_goes_when_the_file_is_written(tmp_path):
    """Of that file only, and of no process that may still be writing."""
    pytest.importorskip("fcntl")
    dead, running = 2**22 + 1, os.getppid()  # Linux counts processes to 2**22
    kept = [
        f".a[1].html.{running}.part",
        f".b.html.{dead}.part",
        f".a1.html.{dead}.part",
        ".a.part",
    ]
    for name in (*kept, f".a[1].html.{dead}.part"):
        (tmp_path / name).write_text("half")
    write_into(tmp_path, "a[1].html", "whole")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*kept, "a[1].html"])


def test_files_of_others_that_end_alike_are_left_alone(tmp_path):
    (tmp_path / ".video.part").write_text("a download")
    with lock_folder(tmp_path):
        pass
    assert (tmp_path / ".video.part").exists()


def test_a_folder_that_was_made_for_nothing_goes(tmp_path):
    with pytest.raises(ZeroDivisionError), lock_folder(tmp_path / "new"):
        raise ZeroDivisionError
    assert not (tmp_path / "new").exists()


def test_a_written_data_set_keeps_the_groups_of_its_records(tmp_path: Path):
    e = tn.from_arrays(
        np.sin(np.arange(50.0)),
        dt=0.01,
        coordinates={"a": "linear"},
        name="heavy",
        split="train",
        groups={"payload": "2kg"},
    )
    write_data_set(tn.DataSet("d", (e,)), tmp_path / "d", "")
    assert tn.load(tmp_path / "d")["heavy"].groups == (("payload", "2kg"),)
