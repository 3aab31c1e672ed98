"""Compiled programs are forgotten before a process has no room for more."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from tustinnet.simulate import programs

PROGRAM = """
import jax
from tustinnet.simulate import programs

twice = jax.jit(lambda x: 2 * x)
twice(1.0)
for share in (1.0, 0.0):
    programs.make_room(share)
    print(twice._cache_size())
print(twice(1.0))
"""


def test_programs_are_forgotten_only_where_there_is_little_room():
    # in a process of its own: the programs of this one serve other tests
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1", "0", "2.0"]


def test_systems_without_such_a_limit_keep_their_programs(
    tmp_path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(programs, "_LIMIT", tmp_path / "absent")
    twice = jax.jit(lambda x: 2 * x)
    twice(jnp.ones(3))
    programs.make_room(0.0)
    assert twice._cache_size() == 1  # pyright: ignore[reportAttributeAccessIssue]
