"""How a record was sampled, before anything was done to its time base."""

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.data.recording import describe_recording

DT = 0.01
COUNT = 1e-3


def log() -> tuple[np.ndarray, np.ndarray]:
    """Times with a gap of six periods, a quantised and a continuous position."""
    t = np.delete(np.arange(405) * DT, slice(100, 105))
    return t, np.stack([np.round(np.sin(3 * t) / COUNT) * COUNT, np.cos(3 * t)], axis=1)


def test_a_recording_tells_times_and_counts_as_logged() -> None:
    found = describe_recording(*log(), DT)
    assert found.samples == 400
    assert found.median_dt == pytest.approx(DT)
    assert found.jitter < 1e-12
    assert (found.worst_interval, found.worst_sample) == (pytest.approx(0.06), 100)
    assert found.gaps == (pytest.approx((0.99, 1.05)),)
    assert found.counts == (pytest.approx(COUNT, rel=1e-3), None)


def test_jitter_is_relative_to_a_nominal_period_close_to_the_median() -> None:
    t = np.arange(100) * 1.02 * DT
    assert describe_recording(t, t[:, None], DT).jitter == pytest.approx(0.02 * DT)


@pytest.mark.parametrize("dt", [DT / 4, 5 * DT])
def test_a_period_that_is_to_come_does_not_judge_the_log(dt: float) -> None:
    found = describe_recording(*log(), dt)
    assert found.jitter < 1e-12
    assert found.gaps == (pytest.approx((0.99, 1.05)),)


def test_a_resampled_record_remembers_its_first_recording() -> None:
    t, q = log()
    e = tn.from_arrays(q, t=t, dt=DT, coordinates={"a": "angular", "b": "angular"})
    assert e.recording is None
    once = e.resample(0.02)
    assert once.recording is not None
    assert once.recording.samples == 400
    assert once.resample(0.05).recording is once.recording
    assert once[10:50].recording is once.recording
