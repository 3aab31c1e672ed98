"""Records cut end to end over a horizon."""

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.simulate.horizon import effective_horizon, horizon_samples, pieces
from tustinnet.simulate.starts import start_named


@pytest.mark.parametrize("start", ["file", "derived-6", "model-20", "warm-up-12"])
@pytest.mark.parametrize("samples", [20, 45, 60, 200, 1000])
def test_segments_leave_no_sample_out_and_share_none(pendulum, start, samples):
    e, rule = pendulum[0], start_named(start)
    cut = pieces(e, samples, rule)
    assert cut[0].t[0] == e.t[0]
    message = np.concatenate([piece.t[rule.first :] for piece in cut])
    np.testing.assert_array_equal(message, e.t[rule.first :])
    lengths = [len(piece) - rule.first for piece in cut]
    assert all(length == min(samples, len(e) - rule.first) for length in lengths[:-1])
    needed = max(2, rule.samples - rule.first)
    assert needed <= lengths[-1] < samples + needed


def test_a_record_is_whole_without_a_horizon(pendulum):
    assert pieces(pendulum[0], None, start_named("file")) == [pendulum[0]]
    assert effective_horizon(1e3, list(pendulum)) is None
    assert effective_horizon(1.0, list(pendulum)) == 1.0


@pytest.mark.parametrize(
    ("horizon", "start", "words"),
    [
        (0.02, "file", "at least two samples, 0.04 s"),
        (0.08, "derived-6", "what the start 'derived-6' needs, 0.12 s"),
        (0.3, "model-20", "what the start 'model-20' needs, 0.4 s"),
        (6.5, "file", "the longest record's 5.98 s"),
        (float("nan"), "file", "nan s"),
        (-1.0, "file", "more than 0"),
    ],
)
def test_a_horizon_that_no_free_run_has_is_refused(pendulum, horizon, start, words):
    with pytest.raises(tn.InputError, match=words) as error:
        horizon_samples(horizon, list(pendulum), start_named(start))
    assert str(error.value).startswith("horizon: ")
