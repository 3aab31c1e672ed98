"""Deadlines, and which trainings stop for them."""

import time

from tustinnet.fits.deadline import NEVER, Deadline, StopCheck
from tustinnet.fitting.gradient.state import Progress


def ran(epochs: int, stage: int = 0) -> list[Progress]:
    return [Progress(stage=stage, epochs=(0,) * stage + (epochs,))]


class Time:
    """A clock that a test sets."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now)


def test_what_can_end_in_time_goes_on(monkeypatch):
    clock, stops = Time(monkeypatch), StopCheck(Deadline(100.0))
    clock.now = 40.0  # the first call compiled
    assert not stops(ran(5))
    clock.now = 45.0  # a second an epoch: 20 are left
    assert not stops(ran(10))


def test_a_training_goes_on_until_the_next_call_would_end_too_late(monkeypatch):
    clock, stops = Time(monkeypatch), StopCheck(Deadline(60.0))
    clock.now = 40.0
    assert not stops(ran(5))
    clock.now = 45.0
    assert not stops(ran(10))
    clock.now = 52.0
    assert not stops(ran(5, stage=1))
    clock.now = 57.0
    assert stops(ran(10, stage=1))


def test_the_first_call_may_have_taken_all_the_time(monkeypatch):
    clock, stops = Time(monkeypatch), StopCheck(Deadline(30.0))
    clock.now = 40.0
    assert stops(ran(5))


def test_the_first_call_of_a_stage_says_nothing_but_the_end_is_the_end(monkeypatch):
    clock, stops = Time(monkeypatch), StopCheck(Deadline(60.0))
    clock.now = 30.0
    assert not stops(ran(10))
    clock.now = 59.0
    assert not stops(ran(5, stage=1))
    clock.now = 61.0
    assert stops(ran(5, stage=1))


def test_an_identification_ends_at_the_end(monkeypatch):
    clock, deadline = Time(monkeypatch), Deadline(10.0)
    assert not deadline.has_passed()
    clock.now = 11.0
    assert deadline.has_passed()
    assert not NEVER.has_passed()
