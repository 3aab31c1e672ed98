"""What the pages tell users of C and FMUs to type does what they say."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from documented import blocks
from every_family import example

import tustinnet as tn
from tustinnet.cli.main import run

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


def typed(lines: str, folder: Path) -> str:
    """What commands print, typed one after the other; ours in this process, which has JAX."""
    told = ""
    for line in lines.splitlines():
        program, *arguments = line.split()
        if program == "cd":
            folder = folder / arguments[0]
        elif program == "tustinnet":
            with pytest.raises(SystemExit) as ended:
                run(arguments)
            assert not ended.value.code
        else:
            told += subprocess.run(
                [program, *arguments], cwd=folder, capture_output=True, text=True, check=True
            ).stdout
    return told


@pytest.fixture
def place(tmp_path, monkeypatch):
    tn.save(example("linear"), tmp_path / "pendulum.safetensors")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_page_on_c(place):
    (commands,) = blocks("C", "sh")
    assert "estimate" in typed(commands, place)
    (controller,) = blocks("C", "c")
    (place / "pendulum-c/controller.c").write_text(controller)
    typed("cd pendulum-c\ngcc -std=c99 -Wall -Wextra -Werror -c controller.c", place)


@pytest.mark.thorough
def test_the_page_on_fmus(place, capsys):
    export, build = blocks("FMU", "sh")
    # the command of fmpy is where Python's are, which need not be in the path
    typed(export.splitlines()[0], place)
    capsys.readouterr()
    (program,) = blocks("FMU", "python")
    exec(program, {})
    shown = float(capsys.readouterr().out)
    model = example("linear")
    x0 = np.zeros(model.state_size)
    x0[0] = 0.3
    expected = np.asarray(tn.rollout(model, x0, np.zeros((100, 1))))[-1, 0]
    assert shown == pytest.approx(expected, rel=1e-9)
    if shutil.which("unzip"):
        typed(build, place)
        assert (place / "fmu/sources/model.so").is_file()
