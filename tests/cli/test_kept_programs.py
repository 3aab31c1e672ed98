"""The compiled programs that the command keeps."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
from tustinnet.cli import devices
devices.prepare_jax("cpu")
import jax
jax.jit(lambda x: 3 * x + 1)(2.0).block_until_ready()
"""
LEAST = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"


def kept(place, **variables: str) -> list[str]:
    """The files below a folder after a small program was compiled in a process of its own."""
    names = ("JAX_COMPILATION_CACHE_DIR", LEAST, "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES")
    usual = {name: value for name, value in os.environ.items() if name not in names}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env=usual | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [path.name for path in place.rglob("*") if path.name.endswith("-cache")]


@pytest.mark.skipif(sys.platform != "linux", reason="the cache folder has another place")
def test_small_programs_are_kept_in_the_users_folder(tmp_path):
    assert kept(tmp_path, XDG_CACHE_HOME=str(tmp_path))


def test_small_programs_are_kept_in_a_folder_of_ones_own(tmp_path):
    assert kept(tmp_path, JAX_COMPILATION_CACHE_DIR=str(tmp_path))


@pytest.mark.thorough
def test_what_variables_say_of_small_programs_holds(tmp_path):
    assert not kept(tmp_path, **{"JAX_COMPILATION_CACHE_DIR": str(tmp_path), LEAST: "100"})
