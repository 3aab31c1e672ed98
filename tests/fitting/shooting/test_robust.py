"""Robust identification: spoilt samples weigh little, and it is said which."""

from dataclasses import replace

import numpy as np
import pytest
from swinging import DT, TRUTH, changed, data_set, read_by_encoder, records

import tustinnet as tn
from tustinnet.fitting.residual import robust_weights

BIAS, INPUT_GAIN, SPIKE = np.deg2rad(2.0), 1.1, 0.2
KNOWN_GAIN = changed("gain", nominal=TRUTH["gain"], fixed=True)


def spoilt(e: tn.Experiment, seed: int) -> tuple[tn.Experiment, np.ndarray]:
    """An encoder with its zero off, a torque off by 10 %, one sample in a hundred spoilt."""
    generator = np.random.default_rng(seed)
    at = generator.choice(np.arange(10, len(e) - 1), len(e) // 100, replace=False)
    q = e.q + BIAS
    q[at] += SPIKE * generator.choice([-1, 1], (len(at), 1))
    off = read_by_encoder(replace(e, q=q, u=e.u / INPUT_GAIN, v=None, v_measured=False))
    return off, np.sort(at)


SPOILT = [spoilt(e, i) for i, e in enumerate(records())]


def identified(robust: str) -> tn.Identification:
    free = 'model.free=["angle.bias", "voltage.gain"]'
    recipe = tn.read_recipe("grey", [free, f"search.robust={robust}"])
    return tn.identify(data_set([e for e, _ in SPOILT]), KNOWN_GAIN, recipe)


@pytest.fixture(scope="module")
def student() -> tn.Identification:
    return identified("student")


TRUE = TRUTH | {"angle.bias": BIAS, "voltage.gain": INPUT_GAIN}


@pytest.mark.thorough
def test_zero_and_gain_are_found_within_their_intervals_despite_spikes(student):
    for e in student.estimates:
        assert e.interval is not None
        if e.name in ("angle.bias", "voltage.gain"):
            assert e.interval[0] <= TRUE[e.name] <= e.interval[1], str(e)
        assert e.value == pytest.approx(TRUE[e.name], rel=0.05), e.name


def test_without_it_the_estimates_are_worse(student):
    plain = identified("none")
    for name in ("angle.bias", "gravity"):
        off = [abs(f.values[name] - TRUE[name]) for f in (student, plain)]
        assert off[0] < off[1] / 3
    assert plain.downweighted == ()


def test_the_spikes_are_the_stretches_that_are_told(student):
    for e, at in SPOILT:
        stretches = [s for s in student.downweighted if s.record == e.name]
        told = {round(t / DT) for s in stretches for t in (s.begin, s.end) if s.weight < 0.05}
        assert told == set(at.tolist())
    assert any("weigh less than half" in f.text for f in student.findings)
    assert student.as_plain()["downweighted"][0]["record"] in {e.name for e, _ in SPOILT}


def test_weights_are_one_for_small_residuals_and_fall_with_size():
    errors = np.concatenate([np.linspace(-1, 1, 101), [10.0, 100.0]])[:, None]
    unknown = np.zeros(1)
    scale = 1.4826 * np.median(np.abs(errors - np.median(errors)))
    huber, student = (robust_weights(k, errors, unknown)[:, 0] for k in ("huber", "student"))
    assert np.all(huber[:101] == 1.0)
    assert huber[-1] == pytest.approx(1.345 * scale / 100)
    assert student[-1] == pytest.approx(1 / (1 + (100 / scale) ** 2 / 4))
    assert robust_weights("none", errors, unknown).all()


def test_the_scale_is_never_below_what_rounding_to_counts_makes():
    errors = np.concatenate([np.zeros(99), [0.5]])[:, None]
    weight = robust_weights("huber", errors, np.array([1.0]))[-1, 0]
    assert weight == pytest.approx(1.345 / (0.5 * np.sqrt(12)))
