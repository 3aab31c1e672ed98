"""Compiled programs are forgotten before a process has no room for more."""

import jax
import jax.numpy as jnp
import pytest

from tustinnet.simulate import programs


def test_programs_are_forgotten_only_where_there_is_little_room():
    twice = jax.jit(lambda x: 2 * x)
    twice(jnp.ones(3))
    programs.make_room(1.0)
    kept = twice._cache_size()  # pyright: ignore[reportAttributeAccessIssue]
    programs.make_room(0.0)
    remaining = twice._cache_size()  # pyright: ignore[reportAttributeAccessIssue]
    assert (kept, remaining) == (1, 0)
    assert twice(jnp.ones(3)).tolist() == [2.0, 2.0, 2.0]


def test_systems_without_such_a_limit_keep_their_programs(
    tmp_path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(programs, "_LIMIT", tmp_path / "absent")
    twice = jax.jit(lambda x: 2 * x)
    twice(jnp.ones(3))
    programs.make_room(0.0)
    assert twice._cache_size() == 1  # pyright: ignore[reportAttributeAccessIssue]
