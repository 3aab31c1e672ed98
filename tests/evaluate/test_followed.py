"""The trivial predictors that any model has to beat."""

from dataclasses import replace

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.evaluate.horizons import (
    describe_followed,
    errors_over_horizons,
    seconds_followed,
)
from tustinnet.evaluate.reference import Persistence, find_reference


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


def test_a_reference_needs_no_timing_of_inputs():
    late = tn.Input("u", "V", "unknown", delay=None)
    q, inputs = np.linspace(0, 1, 50), [late]
    e = tn.from_arrays(q, np.zeros(50), dt=0.01, coordinates={"x": "linear"}, inputs=inputs)
    assert find_reference([e], None).mean == pytest.approx(0.0, abs=1e-9)


def test_every_score_stands_beside_its_reference():
    t = 0.01 * np.arange(400)
    records = [record(0.3 * np.sin(3 * t)), record(0.2 * np.cos(2 * t), "b")]
    still = Persistence(records[0].channels, False)
    (one, other) = tn.evaluate(still, records, "derived-6", horizon=2.0)
    assert [one.reference, other.reference] == list(find_reference(records, 2.0).rmse.values())
    assert one.reference == one.rmse
    (short,) = tn.evaluate(still, [record(t[:4])], "derived-3")
    assert short.reference is None
    with pytest.raises(tn.InputError, match="mean_rmse: no scores"):
        tn.mean_rmse([])


def test_nothing_follows_the_noise_of_a_record_at_rest():
    noise = 1e-3 * np.random.default_rng(0).normal(size=400)
    (score,) = tn.evaluate(Persistence(record(noise).channels, False), [record(noise)])
    assert seconds_followed([record(noise)], [score]) == [pytest.approx(3.99)]
    drift = noise + np.linspace(0, 0.1, 400)
    (score,) = tn.evaluate(Persistence(record(drift).channels, False), [record(drift)])
    assert seconds_followed([record(drift)], [score])[0] < 2


def test_a_record_is_followed_until_a_coordinate_is_far_off():
    t = 0.01 * np.arange(401)
    records = [record(np.sin(3 * t)), record(np.sin(3 * t), "b")]
    whole = list(find_reference(records, None).scores)
    rms = np.sqrt(np.cumsum(np.sin(3 * t) ** 2) / np.arange(1, 402))  # of one that stands still
    off = rms > 0.3 * np.std(np.sin(3 * t))
    assert whole[0].simulated[:, 0] == pytest.approx(0.0, abs=1e-3)
    expected = [0.01 * (np.argmax(off) - 1)] * 2
    assert seconds_followed(records, whole) == pytest.approx(expected)
    assert describe_followed(records, whole).text.startswith(
        "follows whole records without a restart: 0 of 2 to the end, the others for 0.12 s in the "
    )
    true = [
        replace(s, simulated=np.hstack([e.q, e.q])) for e, s in zip(records, whole, strict=True)
    ]
    assert seconds_followed(records, true) == pytest.approx([4.0, 4.0])
    assert describe_followed(records, true).text.startswith("follows 2 whole records to the end")
    # a start that is off for a moment does not count for more than its part of the record
    for score in true:
        score.simulated[:20, 0] += 0.5
    assert seconds_followed(records, true) == pytest.approx([4.0, 4.0])


def test_how_long_a_record_is_followed_depends_on_no_other_record():
    t = 0.01 * np.arange(401)
    small, large = record(0.2 * np.sin(3 * t)), record(5 * np.sin(3 * t), "b")
    whole = list(find_reference([small, large], None).scores)
    alone = seconds_followed([small], whole[:1])
    assert seconds_followed([small, large], whole)[0] == alone[0] < 1.0


def test_errors_grow_with_the_horizon_beside_the_reference():
    t = 0.01 * np.arange(401)
    records = [record(np.sin(3 * t))]
    model = Persistence(records[0].channels, True)
    whole = tn.evaluate(model, records, "derived-6")
    errors = errors_over_horizons(model, records, "derived-6", whole)
    assert [e.horizon for e in errors] == [0.3, 1.0, 3.0, None]
    assert errors[-1].rmse == {"m": whole[0].rmse}
    assert errors[0].rmse["m"] == pytest.approx(errors[0].reference.mean)
    assert errors[-1].reference.label == "standing still"
    assert errors[0].rmse["m"] < errors[1].rmse["m"] < errors[2].rmse["m"]
