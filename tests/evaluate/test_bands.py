"""Bands around free runs hold what they promise, and refuse what they cannot."""

from typing import Any

import numpy as np
import pytest
import scipy.stats
from swinging import SWING, records

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.evaluate.bands import Calibration, Prediction, calibrate_bands, make_band, predict
from tustinnet.evaluate.coverage import compute_coverage
from tustinnet.families.family import family_of

N = 400
TOLD = tn.Coordinate("a", "linear")


def made(seed: int, scale: float = 0.02, n_rest: int = 100) -> tuple[Prediction, tn.Experiment]:
    """A made-up free run whose errors grow, its alternatives a tenth as far apart as its errors."""
    generator = np.random.default_rng(seed)
    t = np.arange(N)
    size = scale * (0.2 + t / N) * np.exp(0.5 * generator.normal())
    phase = generator.uniform(0, 6, 3)
    wander = sum(np.sin(t / (11 + 7 * i) + phase[i]) for i in range(3))
    truth = np.cos(t / 20)
    e = tn.from_arrays(truth[:, None], dt=0.01, coordinates=[TOLD], name=f"r{seed}")
    moving = t < N - n_rest
    prediction = Prediction(
        e.name, (truth + size * wander)[:, None], 0.1 * size[:, None], moving, 0
    )
    return prediction, e


def some(seeds: range) -> tuple[list[Prediction], list[tn.Experiment]]:
    pairs = [made(seed) for seed in seeds]
    return [g for g, _ in pairs], [e for _, e in pairs]


def test_bands_hold_their_share_of_records_that_were_used_for_nothing():
    calibration = calibrate_bands(*some(range(30)), "file")
    held, whole = [], []
    for prediction, e in zip(*some(range(100, 400)), strict=True):
        held.append(make_band(calibration, prediction, 0.9).contains(e.q).mean())
        whole.append(make_band(calibration, prediction, 0.9, "record").contains(e.q).all())
    assert 0.88 < np.mean(held) < 0.94
    assert 0.85 < np.mean(whole) <= 1.0


def test_higher_levels_are_wider_and_whole_records_widest():
    calibration = calibrate_bands(*some(range(12)), "file")
    prediction, _ = made(50)
    widths = [
        *(np.mean(calibration.half_width(prediction, level)) for level in (0.5, 0.8, 0.9)),
        np.mean(calibration.half_width(prediction, 0.9, "record")),
    ]
    assert widths == sorted(widths)


def test_few_records_promise_little_and_say_how_many_are_needed():
    calibration = calibrate_bands(*some(range(6)), "file")
    prediction, _ = made(50)
    make_band(calibration, prediction, 6 / 7, "record")
    with pytest.raises(InputError, match=r"more than 85.7 %; expected 9 records or more"):
        make_band(calibration, prediction, 0.9)
    with pytest.raises(InputError, match="at least 2"):
        calibrate_bands(*some(range(1)), "file")


def test_a_header_brings_back_the_same_bands():
    calibration = calibrate_bands(*some(range(9)), "file", 1.5)
    again = Calibration.from_header({"bands": calibration.as_header()}, "model")
    prediction, _ = made(50)
    np.testing.assert_array_equal(
        calibration.half_width(prediction, 0.7), again.half_width(prediction, 0.7)
    )
    with pytest.raises(InputError, match="was calibrated"):
        again.require(0.7, "model-20", 1.5)
    with pytest.raises(InputError, match="without bands"):
        Calibration.from_header({}, "model")


def test_coverage_is_told_with_its_interval_and_score():
    calibration = calibrate_bands(*some(range(30)), "file")
    tried, known = some(range(100, 120))
    bands = [make_band(calibration, prediction, 0.9) for prediction in tried]
    moving, rest = compute_coverage(known, bands)
    assert (moving.part, rest.part, moving.records) == ("moving", "rest", 20)
    k = 20 * moving.inside
    assert moving.interval[0] == pytest.approx(scipy.stats.beta.ppf(0.025, k, 21 - k))
    assert moving.interval[0] < moving.inside < moving.interval[1]
    errors = np.abs(
        np.concatenate([g.simulated[g.moving] for g in tried])
        - np.concatenate([e.q[g.moving] for g, e in zip(tried, known, strict=True)])
    )
    assert 0 < moving.crps < errors.mean()  # a band says more than its middle alone


@pytest.mark.thorough
def test_alternatives_of_an_identified_system_are_drawn_from_its_errors():
    known = records()
    result = tn.fit(tn.DataSet("swing", tuple(known)), "grey", system=SWING)
    others = family_of(result.model).alternatives(result.model, result.as_header())
    assert len(others) == 12
    assert result.identification is not None
    for e in result.identification.estimates:
        drawn: list[Any] = list(others)
        values = [float(of.continuous.values[e.name]) for of in drawn]
        if e.error:
            assert 0.4 * e.error < np.std(values) < 1.8 * e.error
    made_ = predict(result.model, others, known[:2], "model-20")
    assert all((g.spread[g.first :] >= 0).all() for g in made_)
    assert any(g.spread.max() > 0 for g in made_)


def test_a_free_run_that_is_not_finite_is_refused():
    prediction, e = made(1)
    bad = Prediction(
        prediction.record, prediction.simulated * np.inf, prediction.spread, prediction.moving, 0
    )
    with pytest.raises(InputError, match="calibrate over a horizon"):
        calibrate_bands([bad, prediction], [e, e], "file")


def test_rest_has_a_band_of_its_own_where_only_some_records_come_to_rest():
    def of(seeds: range) -> tuple[list[Prediction], list[tn.Experiment]]:
        pairs = [made(seed, n_rest=200 if seed % 2 else 0) for seed in seeds]
        for prediction, _ in pairs:  # a tenth of the error is left at rest, the alternatives agree
            prediction.simulated[~prediction.moving] = (
                0.0 * prediction.simulated[~prediction.moving]
            )
            prediction.spread[~prediction.moving] = 0.0
        still = [
            tn.from_arrays(
                np.where(g.moving[:, None], e.q, 1e-4 * np.sin(np.arange(N)[:, None])),
                dt=0.01,
                coordinates=[TOLD],
                name=e.name,
            )
            for g, e in pairs
        ]
        return [g for g, _ in pairs], still

    calibration = calibrate_bands(*of(range(30)), "file")
    (moving,), (resting,) = calibration.moving, calibration.resting
    assert resting.has_level(0.9)
    assert not resting.has_level(0.95)  # 15 records come to rest
    assert moving.has_level(0.95)
    tried, known = of(range(101, 121, 2))
    bands = [make_band(calibration, prediction, 0.9) for prediction in tried]
    _, rest = compute_coverage(known, bands)
    assert 0.85 < rest.inside < 0.97
    assert rest.width < 5 * rest.rmse
    # at a level that they cannot promise, what holds for motion holds for them
    half = calibration.half_width(tried[0], 0.96)[~tried[0].moving, 0]
    np.testing.assert_allclose(half, moving.factor(0.96, "time") * moving.floor)


def test_a_width_follows_the_root_of_the_spread():
    calibration = calibrate_bands(*some(range(30)), "file")
    (moving,) = calibration.moving
    assert moving.unit is not None
    assert moving.floor == pytest.approx(0.2 * moving.unit)
    widths = moving.width(np.array([0.0, moving.unit, 100 * moving.unit]))
    np.testing.assert_allclose(widths / moving.unit, [0.2, 1.04**0.5, 100.04**0.5])
