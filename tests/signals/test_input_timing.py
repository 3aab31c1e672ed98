"""When inputs act, estimated from simulated records whose timing is known."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.signals.excitation import DeclaredHold, excitation
from tustinnet.signals.input_timing import DeclaredTiming, Response, estimate_input_timing

DT, FINE = 0.02, 20  # sampling period [s]; simulated steps a period


class Truth(NamedTuple):
    """How the input of simulated records acts; times in periods."""

    hold: DeclaredHold = "zero-order"
    delay: float = 0.0
    lag: float = 0.0


Feedback = Callable[[np.ndarray, np.ndarray], float]


def simulate(truth: Truth, seed: int, *, n: int = 400, feedback: Feedback | None = None):
    """Positions and inputs of a driven pendulum with friction, its angle read by an encoder."""
    random = np.random.default_rng(seed)
    noise = np.repeat(random.uniform(-3, 3, n // 4), 4) + random.normal(0, 0.5, n)
    u, q = np.empty(n), np.empty(n)
    angle, speed, reached, h = random.uniform(-0.5, 0.5), 0.0, 0.0, DT / FINE
    fine = np.zeros((n + 1) * FINE)  # what acts, were there neither delay nor lag
    if feedback is None:
        u = noise.copy()
        whole = excitation(u[:, None], [truth.hold], [0.0]).pieces
        part = (np.arange(FINE) + 0.5) / FINE
        powers = part[:, None] ** np.arange(whole.shape[1])
        fine[: (n - 1) * FINE] = (whole[..., 0] @ powers.T).ravel()
    late = round(truth.delay * FINE)
    for k in range(n):
        q[k] = np.round(angle / 1e-3) * 1e-3
        if feedback is not None:
            past = q[: k + 1]
            u[k] = feedback(past, noise[k])
            fine[k * FINE : (k + 1) * FINE] = u[k]
        for i in range(k * FINE, (k + 1) * FINE):
            now = fine[i - late] if i >= late else 0.0
            reached = now if not truth.lag else reached + h / (truth.lag * DT) * (now - reached)
            turning = -25 * np.sin(angle) - 0.8 * speed - 2 * np.tanh(speed / 0.05) + 12 * reached
            speed += h * turning
            angle += h * speed
    return q[:, None], u[:, None]


def estimate(truth: Truth, known: DeclaredTiming = DeclaredTiming(), **options):  # noqa: B008
    records = [simulate(truth, seed, **options) for seed in range(4)]
    positions, inputs = zip(*records, strict=True)
    (found,) = estimate_input_timing(positions, inputs, DT, np.array([True]), [known])
    return found


@pytest.mark.parametrize(
    "truth",
    [
        Truth(),
        Truth(delay=0.4),
        Truth(delay=2.0),
        Truth(lag=3.0),
        Truth(delay=2.0, lag=4.0),
        Truth("first-order"),
        Truth("first-order", delay=1.5),
    ],
)
def test_delays_and_lags_are_found_within_their_errors(truth):
    found = estimate(truth)
    both = truth.delay and truth.lag
    assert found.verdict == (
        "delay and lag" if both else "delay" if truth.delay else "lag" if truth.lag else "none"
    )
    assert truth.hold in (found.hold, *found.rivals)
    # a straight line is about what is held for a period, half a period before
    shift = -0.5 if truth.hold == "first-order" and found.hold == "zero-order" else 0.0
    if truth.delay:
        delay = (truth.delay + shift) * DT
        assert found.delay.value == pytest.approx(delay, abs=3 * found.delay.error)
        assert found.delay.error < 0.2 * DT
    if truth.lag:
        assert found.lag.value == pytest.approx(truth.lag * DT, rel=0.15)
    assert not found.is_hidden


def test_declared_timing_is_no_question():
    found = estimate(Truth(delay=1.5), DeclaredTiming("first-order", None))
    assert (found.hold, found.rivals) == ("first-order", ())
    assert found.delay.value == pytest.approx(2.0 * DT, abs=0.2 * DT)
    found = estimate(Truth("first-order"), DeclaredTiming(None, 0.0))
    assert (found.verdict, found.delay) == ("none", (0.0, 0.0))
    assert found.hold == "first-order"


def test_an_input_that_does_nothing_tells_nothing():
    records = [simulate(Truth(), seed) for seed in range(3)]
    others = [simulate(Truth(), seed + 10)[1] for seed in range(3)]
    (found,) = estimate_input_timing(
        [q for q, _ in records], others, DT, np.array([True]), [DeclaredTiming()]
    )
    assert found.verdict == "unclear"


def test_a_stiff_controller_hides_when_its_input_acts():
    """It computes from the encoder what the motion is then computed from."""

    def stiff(past: np.ndarray, noise: float) -> float:
        before = past[-2] if len(past) > 1 else past[-1]
        return float(40 * (0.3 * noise - past[-1]) - 1.5 * (past[-1] - before) / DT)

    found = estimate(Truth(), feedback=stiff)
    assert found.verdict in ("unclear", "none")


@pytest.mark.thorough
def test_two_inputs_are_told_apart():
    one = [simulate(Truth(delay=1.0), seed) for seed in range(4)]
    other = [simulate(Truth(), seed + 20) for seed in range(4)]
    q = [np.hstack([a[0], b[0]]) for a, b in zip(one, other, strict=True)]
    u = [np.hstack([a[1], b[1]]) for a, b in zip(one, other, strict=True)]
    first, second = estimate_input_timing(q, u, DT, np.array([True, True]), [DeclaredTiming()] * 2)
    assert (first.verdict, second.verdict) == ("delay", "none")
    assert first.delay.value == pytest.approx(DT, abs=0.15 * DT)


@pytest.mark.parametrize("hold", ["zero-order", "first-order", "band-limited"])
def test_weights_keep_the_gain_and_the_mean_delay(hold: DeclaredHold):
    lags = np.arange(-60, 200)
    for delay, lag in ((0.0, 0.0), (1.3, 0.0), (0.0, 2.0), (2.5, 4.0)):
        weights = Response(hold, delay, lag).weights(lags)
        assert weights.sum() == pytest.approx(1.0, abs=2e-3)
        half = 0.5 if hold == "zero-order" else 0.0  # samples that are held act half a period late
        if hold != "band-limited":  # of which the weights have no first moment
            assert weights @ lags == pytest.approx(delay + lag + half, abs=1e-5)


@pytest.mark.parametrize(
    ("angles", "message"),
    [
        (np.zeros((60, 1)), "samples to judge"),
        (np.zeros((900, 1)), "moves"),
        (np.zeros((900, 13)), "13 coordinates, 1 inputs; expected at most 12 of each"),
    ],
)
def test_records_that_say_nothing_are_refused(angles, message):
    u, angular = (
        np.random.default_rng(0).normal(size=(len(angles), 1)),
        np.full(angles.shape[1], True),
    )
    with pytest.raises(tn.InputError, match=message):
        estimate_input_timing([angles], [u], DT, angular, [DeclaredTiming()])


def shifted(records: Sequence[tn.Experiment], periods: int):
    """Positions and inputs, as if inputs had been logged so many periods too early."""
    q = [e.q[: len(e) - periods] for e in records]
    u = [e.u[periods:] for e in records]
    return q, u


@pytest.mark.real
def test_inputs_that_were_moved_in_measured_records_are_found_there(real_data):
    records = [e for e in tn.load(real_data) if e.split != "test"]
    for periods in range(3):
        q, u = shifted(records, periods)
        (found,) = estimate_input_timing(
            q, u, records[0].dt, np.array([True, True]), [DeclaredTiming()]
        )
        assert found.hold == "zero-order"
        assert found.verdict == ("delay" if periods else "none")
        assert found.delay.value / records[0].dt == pytest.approx(periods, abs=0.1)
