"""The trivial predictors that any model has to beat."""

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.evaluate.reference import find_reference


def record(q: np.ndarray, name: str = "a") -> tn.Experiment:
    return tn.from_arrays(q, dt=0.01, coordinates={"x": "linear"}, name=name)


def test_the_better_of_both_predictors_is_the_reference():
    t = 0.01 * np.arange(400)
    swinging = record(0.3 * np.sin(3 * t))
    whole = find_reference([swinging], None)
    assert whole.label == "standing still"
    expected = np.sqrt(np.mean((swinging.q - swinging.q[0]) ** 2))
    assert whole.mean == pytest.approx(expected, rel=1e-3)
    short = find_reference([swinging], 0.1)
    assert short.label == "constant speed"
    assert short.mean < 0.1 * whole.mean
    rising = find_reference([record(0.2 + 0.5 * t), record(0.1 - 0.5 * t, "b")], None)
    assert rising.label == "constant speed"
    assert rising.mean == pytest.approx(0.0, abs=1e-9)
    assert list(rising.rmse) == ["a", "b"]
    assert rising.mean_by_unit == {"m": pytest.approx(0.0, abs=1e-9)}
