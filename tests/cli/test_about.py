"""What the command says of itself, and what a shell completes."""

import os
import re
import subprocess
import sys
from importlib import metadata

import jax
import pytest
import typer
from test_verbs import tustinnet

from tustinnet.cli.main import app

_COMMAND = "import sys; sys.argv = ['tustinnet']; from tustinnet.cli.entry import run; run()"


def test_the_command_alone_prints_the_steps_of_a_typical_use(capsys):
    code, out, err = tustinnet(capsys)
    assert (code, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines() if re.match("  [0-9]", line)] == [*"12345"]
    verbs = typer.main.get_group(app).commands
    named = re.findall(r"tustinnet ([a-z-]+) (.*)", out)
    assert {verb for verb, _ in named} >= {"inspect", "fit", "report", "export", "demo"}
    for verb, rest in named:
        known = {name for p in verbs[verb].params for name in p.opts} | {"--help"}
        line = rest.split("     ")[0]
        assert set(re.findall(r"--[a-z-]+", line)) - {"--install-completion"} <= known, verb


def test_versions_for_a_bug_report(capsys):
    code, out, _ = tustinnet(capsys, "--version", "--verbose")
    assert code == 0
    assert f"jax {jax.__version__}" in out
    assert f"jaxlib {metadata.version('jaxlib')}" in out
    assert "extra 'casadi'" in out
    assert f"device 0: {jax.devices()[0].platform}" in out
    assert re.search(r"XLA_FLAGS|nothing of ours", out)


def test_verbose_alone_is_refused(capsys):
    code, out, err = tustinnet(capsys, "--verbose")
    assert (code, out) == (1, "")
    assert "--version --verbose" in err


def test_the_package_runs_as_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "tustinnet", "fitt"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "Usage: tustinnet [OPTIONS]" in done.stderr
    assert "No such command 'fitt'" in done.stderr


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("tustinnet cr", "cross-validate"),
        ("tustinnet fit LOGS --recipe best-h", "best-hybrid"),
        ("tustinnet fit LOGS --plan q", "quick"),
        ("tustinnet fit LOGS --system me", "mechanism"),
        ("tustinnet export m --to on", "onnx"),
        ("tustinnet evaluate m LOGS --split va", "validation"),
        ("tustinnet evaluate m LOGS --start mo", "model-20"),
        ("tustinnet evaluate m LOGS --hor", "--horizon"),
    ],
)
def test_a_shell_completes(typed, completed):
    asked = {"COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    done = subprocess.run(
        [sys.executable, "-c", _COMMAND],
        env=os.environ | asked | {"_TUSTINNET_COMPLETE": "complete_bash"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == [completed], done.stderr
