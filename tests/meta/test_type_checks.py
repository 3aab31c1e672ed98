"""The checks of types and shapes that tests run with, see `remembered_checks`."""

import dataclasses

import jaxtyping
import numpy as np
import pytest
from beartype import beartype
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float
from remembered_checks import jaxtyped

Row = Float[np.ndarray, " n"]


@jaxtyped(typechecker=beartype)
def joined(a: Row, b: Row, *, is_short: bool = False) -> Row:
    return np.concatenate([a, b]) if is_short else a + b


@jaxtyped(typechecker=beartype)
def made(factory: type[np.ndarray], count: float) -> list[Row]:
    return [np.zeros(int(count), dtype=int if count > 1 else float)]


def test_arguments_and_results_are_checked_whether_others_were_right_or_not():
    one, two = np.ones(3), np.ones(4)
    for _ in range(2):
        assert joined(one, one).shape == (3,)
        assert joined(two, b=two).shape == (4,)
        for wrong in (two, np.ones(3, dtype=int), np.ones((3, 1)), [1.0, 1.0, 1.0]):
            with pytest.raises(BeartypeCallHintViolation):
                joined(one, wrong)
        with pytest.raises(BeartypeCallHintViolation):
            joined(one, one, is_short=True)
        assert made(np.ndarray, 1.0)
        with pytest.raises(BeartypeCallHintViolation):
            made(np.ndarray, 1)
        with pytest.raises(BeartypeCallHintViolation):
            made(np.ndarray, 2.0)


def test_functions_within_functions_and_dataclasses_are_checked(monkeypatch):
    def make(scale):
        @jaxtyped(typechecker=beartype)
        def scaled(a: Row) -> Row:
            return scale * a

        return scaled

    @jaxtyped(typechecker=beartype)
    @dataclasses.dataclass
    class Pair:
        row: Row
        number: float

    for factor in (2.0, 3.0):
        assert make(factor)(np.ones(2)).tolist() == [factor, factor]
    for _ in range(2):
        with pytest.raises(BeartypeCallHintViolation):
            make(np.ones((2, 2)))(np.ones(2))
        with pytest.raises(BeartypeCallHintViolation):
            make(2.0)(np.ones((2, 2)))
        Pair(np.ones(2), 1.0)
        with pytest.raises(BeartypeCallHintViolation):
            Pair(np.ones(2), "1")
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    assert Pair(np.ones(2), "1").number == "1"
