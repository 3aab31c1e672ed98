"""Ctrl-C, SIGTERM and SIGHUP: a checkpoint, one line, the usual exit code."""

import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tustinnet.cli import terminal
from tustinnet.cli.automatic_report import after_model
from tustinnet.cli.main import run
from tustinnet.data import loading
from tustinnet.store.sealed import read_sealed

COMMAND = [sys.executable, "-c", "from tustinnet.cli.entry import run; run()"]


def start(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "JAX_PLATFORMS": "cpu"},
    )


def wait_for(log: Path, size: int) -> None:
    deadline = time.monotonic() + 90
    while time.monotonic() < deadline and (not log.is_file() or log.stat().st_size < size):
        time.sleep(0.01)


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGHUP", 129), ("SIGINT", 130)])
def test_a_signal_is_one_line_and_the_usual_exit_code(capsys, name, code):
    number = getattr(signal, name, None)
    if number is None:
        pytest.skip(f"no {name} here")
    before = signal.signal(number, signal.default_int_handler)  # if it is ignored
    try:
        with (
            pytest.raises(SystemExit) as ended,
            terminal.stoppable(),
            terminal.interruptible("go on with --resume"),
        ):
            os.kill(os.getpid(), number)
            time.sleep(5)
        assert ended.value.code == code
        assert capsys.readouterr().err == "interrupted; go on with --resume\n"
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_while_the_process_ends_is_one_line(name, code):
    late = (
        "import atexit, signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # if it is ignored
        f"atexit.register(signal.raise_signal, signal.{name})\n"
    )
    command = [sys.executable, "-c", late + COMMAND[-1], "--version"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (code, "interrupted\n")
    assert ended.stdout.startswith("tustinnet ")  # all that was printed arrives


class Callback:
    """What is collected while a signal arrives: Python drops what `__del__` raises."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)


def test_a_signal_that_arrives_where_exceptions_are_dropped_is_not_lost(capsys):
    with pytest.raises(SystemExit) as ended, terminal.stoppable(), terminal.interruptible():
        Callback()
        time.sleep(5)
    assert ended.value.code == 143
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("ended_by", [1, 0])
def test_a_library_that_turns_a_signal_into_an_error_does_not_change_the_exit_code(
    ended_by, folder, tmp_path, monkeypatch
):
    def stopped(*_: object) -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except KeyboardInterrupt:
            raise SystemExit(ended_by) from None

    importlib.import_module("tustinnet.data.catalog")  # else it would keep the name that follows
    monkeypatch.setattr(loading, "load_folder", lambda *_, **__: stopped())
    with pytest.raises(SystemExit) as ended, terminal.stoppable():
        run(["inspect", str(folder)])
    assert ended.value.code == (143 if ended_by else 0)
    with pytest.raises(SystemExit) as ended:  # a later verb in this process is its own
        run(["inspect", str(tmp_path / "none")])
    assert ended.value.code == 1


def test_after_the_model_is_written_an_interruption_says_that_it_is_there(capsys, tmp_path):
    model = tmp_path / "model.safetensors"
    with pytest.raises(SystemExit) as ended, terminal.stoppable(), after_model(model):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)
    assert ended.value.code == 143
    assert capsys.readouterr().err.startswith(f"interrupted; the model is complete: {model}")


def test_a_signal_that_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with terminal.stoppable(), terminal.interruptible():
            os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.thorough
def test_a_training_that_is_terminated_leaves_a_checkpoint(folder, small_recipe, tmp_path):
    small_recipe.write_text(small_recipe.read_text().replace("epochs = 5", "epochs = 100000"))
    process = start("fit", folder, "--recipe", small_recipe, "--out", tmp_path / "run", "--quiet")
    log = tmp_path / "run" / "seed-0" / "log.jsonl"
    wait_for(log, 3000)
    process.send_signal(signal.SIGTERM)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 143
    assert told == "interrupted; --resume continues from the checkpoint\n"
    assert not list((tmp_path / "run").rglob("*.part"))
    header, _ = read_sealed(log.parent / "checkpoint.safetensors", ["checkpoint"])
    # what was done since the last checkpoint of every 5 s is in it
    assert header["progress"][0]["reported"] >= len(log.read_text().splitlines()) - 5


@pytest.mark.thorough
def test_ctrl_c_while_modules_load_is_one_line(tmp_path):
    process = start("evaluate", tmp_path / "none.safetensors", tmp_path)
    time.sleep(0.5)  # it takes longer to load JAX
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    # the last lines are what was asked for, should the machine be that fast
    assert told in (
        "interrupted\n",
        f"error: {tmp_path}/none.safetensors: no such file; expected a model file (.safetensors)\n",
    )
    assert process.returncode in (130, 1)
