"""Output that cannot be written: one line and an exit code, never a traceback."""

import os
import subprocess
import sys

import pytest

VERBS = [("show",), ("evaluate",), ("--help",)]


def run(arguments, shell_tail="", **variables):
    command = " ".join([sys.executable, "-m", "tustinnet", *map(str, arguments), shell_tail])
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        capture_output=True,
        check=False,
        env={**os.environ, **variables},
    )


@pytest.fixture
def arguments(request, identified, folder):
    more: dict[str, tuple] = {"show": (identified / "model.safetensors",)}
    more["evaluate"] = (*more["show"], folder)
    return (*request.param, *(more.get(request.param[0], ()) if len(request.param) == 1 else ()))


@pytest.mark.parametrize(
    ("arguments", "unbuffered"),
    [*((verb, "") for verb in VERBS), (VERBS[0], "1"), (("--version",), "1")],
    indirect=["arguments"],
)
@pytest.mark.parametrize("tail", [">&-", ">/dev/full"])
def test_output_that_cannot_be_written_is_one_line(arguments, tail, unbuffered):
    ended = run(arguments, tail, PYTHONUNBUFFERED=unbuffered)
    errors = [line for line in ended.stderr.decode().splitlines() if not line.startswith("note")]
    assert ended.returncode == 1
    assert len(errors) == 1
    assert errors[0].startswith("error: standard output: c")


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_ends_ends_the_command_without_a_line(identified, unbuffered):
    tail = "| true"
    ended = run(("show", identified / "model.safetensors"), tail, PYTHONUNBUFFERED=unbuffered)
    assert ended.returncode == 141
    assert not ended.stderr


@pytest.mark.parametrize("arguments", [*VERBS, ("inspect",)], indirect=True)
def test_characters_that_an_encoding_lacks_are_written_as_escapes(arguments, folder):
    if arguments == ("inspect",):
        arguments = ("inspect", folder)
    ended = run(arguments, PYTHONIOENCODING="ascii")
    assert ended.returncode == 0, ended.stderr
    assert b"Traceback" not in ended.stderr
    if arguments[0] == "inspect":
        assert b"\\u2013" in ended.stdout


def test_without_any_stream_the_exit_code_still_says_it():
    assert run(("--version",), ">/dev/full 2>&-").returncode == 1
    assert run(("--version",), ">/dev/null 2>&-").returncode == 0
    assert run(("show", "nothing"), "2>&-").returncode == 1
