"""Bands around free runs hold what they promise, and refuse what they cannot."""

from typing import Any

import numpy as np
import pytest
import scipy.stats
from swinging import SWING, records

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.evaluate.bands import Calibration, Guess, band_of, calibrated, guesses
from tustinnet.evaluate.coverage import covered
from tustinnet.families.family import family_of

N = 400
TOLD = tn.Coordinate("a", "linear")


def made(seed: int, scale: float = 0.02, n_rest: int = 100) -> tuple[Guess, tn.Experiment]:
    """A made-up free run whose errors grow, its alternatives a tenth as far apart as its errors."""
    generator = np.random.default_rng(seed)
    t = np.arange(N)
    size = scale * (0.2 + t / N) * np.exp(0.5 * generator.normal())
    phase = generator.uniform(0, 6, 3)
    wander = sum(np.sin(t / (11 + 7 * i) + phase[i]) for i in range(3))
    truth = np.cos(t / 20)
    e = tn.from_arrays(truth[:, None], dt=0.01, coordinates=[TOLD], name=f"r{seed}")
    moving = t < N - n_rest
    guess = Guess(e.name, (truth + size * wander)[:, None], 0.1 * size[:, None], moving, 0)
    return guess, e


def some(seeds: range) -> tuple[list[Guess], list[tn.Experiment]]:
    pairs = [made(seed) for seed in seeds]
    return [g for g, _ in pairs], [e for _, e in pairs]


def test_bands_hold_their_share_of_records_that_were_used_for_nothing():
    calibration = calibrated(*some(range(30)), "file")
    held, whole = [], []
    for guess, e in zip(*some(range(100, 400)), strict=True):
        held.append(band_of(calibration, guess, 0.9).holds(e.q).mean())
        whole.append(band_of(calibration, guess, 0.9, "record").holds(e.q).all())
    assert 0.88 < np.mean(held) < 0.94
    assert 0.85 < np.mean(whole) <= 1.0


def test_higher_levels_are_wider_and_whole_records_widest():
    calibration = calibrated(*some(range(12)), "file")
    guess, _ = made(50)
    widths = [
        *(np.mean(calibration.half(guess, level)) for level in (0.5, 0.8, 0.9)),
        np.mean(calibration.half(guess, 0.9, "record")),
    ]
    assert widths == sorted(widths)


def test_few_records_promise_little_and_say_how_many_are_needed():
    calibration = calibrated(*some(range(6)), "file")
    guess, _ = made(50)
    band_of(calibration, guess, 6 / 7, "record")
    with pytest.raises(InputError, match=r"more than 85.7 %; expected 9 records or more"):
        band_of(calibration, guess, 0.9)
    with pytest.raises(InputError, match="at least 2"):
        calibrated(*some(range(1)), "file")


def test_a_header_brings_back_the_same_bands():
    calibration = calibrated(*some(range(9)), "file", 1.5)
    again = Calibration.from_header({"bands": calibration.as_header()}, "model")
    guess, _ = made(50)
    np.testing.assert_array_equal(calibration.half(guess, 0.7), again.half(guess, 0.7))
    with pytest.raises(InputError, match="was calibrated"):
        again.require(0.7, "model-20", 1.5)
    with pytest.raises(InputError, match="without bands"):
        Calibration.from_header({}, "model")


def test_coverage_is_told_with_its_interval_and_score():
    calibration = calibrated(*some(range(30)), "file")
    tried, known = some(range(100, 120))
    bands = [band_of(calibration, guess, 0.9) for guess in tried]
    moving, rest = covered(known, bands)
    assert (moving.part, rest.part, moving.records) == ("moving", "rest", 20)
    k = 20 * moving.inside
    assert moving.interval[0] == pytest.approx(scipy.stats.beta.ppf(0.025, k, 21 - k))
    assert moving.interval[0] < moving.inside < moving.interval[1]
    errors = np.abs(
        np.concatenate([g.simulated[g.moving] for g in tried])
        - np.concatenate([e.q[g.moving] for g, e in zip(tried, known, strict=True)])
    )
    assert 0 < moving.crps < errors.mean()  # a band says more than its middle alone


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
    made_ = guesses(result.model, others, known[:2], "model-20")
    assert all((g.spread[g.first :] >= 0).all() for g in made_)
    assert any(g.spread.max() > 0 for g in made_)


def test_a_free_run_that_is_not_finite_is_refused():
    guess, e = made(1)
    bad = Guess(guess.record, guess.simulated * np.inf, guess.spread, guess.moving, 0)
    with pytest.raises(InputError, match="calibrate over a horizon"):
        calibrated([bad, guess], [e, e], "file")
