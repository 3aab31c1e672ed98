"""When time is up."""

import time
from types import SimpleNamespace
from typing import Any

import pytest

from tustinnet.fitting.gradient.state import Progress
from tustinnet.fitting.listener import Iteration, Listener
from tustinnet.selection.clock import Clock, OutOfTime, Watch


def plan(*stages: tuple[int, int | None]) -> Any:
    """Stages of so many epochs, with so much patience; windows alike."""
    windows = SimpleNamespace(rows=SimpleNamespace(shape=(1, 10)), length=5)
    return SimpleNamespace(
        stages=[
            SimpleNamespace(recipe=SimpleNamespace(epochs=n, patience=p), windows=windows)
            for n, p in stages
        ]
    )


def ran(epochs: int, stage: int = 0) -> list[Progress]:
    return [Progress(stage=stage, epochs=(0,) * stage + (epochs,))]


class Time:
    """A clock that a test sets."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now)


def test_what_can_end_in_time_goes_on(monkeypatch):
    clock, watch = Time(monkeypatch), Watch(Clock(100.0), plan((10, None), (20, None)))
    clock.now = 40.0  # the first call compiled
    watch(ran(5))
    clock.now = 45.0  # a second an epoch: 20 are left
    watch(ran(10))


@pytest.mark.parametrize("end", [60.0, 30.0])  # the second is up in the first call already
def test_what_cannot_is_given_up_and_says_how_long_it_would_have_taken(monkeypatch, end):
    clock, watch = Time(monkeypatch), Watch(Clock(end), plan((10, None), (20, None)))
    clock.now = 40.0
    watch(ran(5))
    clock.now = 45.0
    with pytest.raises(OutOfTime) as stop:
        watch(ran(10))
    assert stop.value.left == pytest.approx(20.0)


def test_a_stage_with_patience_is_expected_to_end_early(monkeypatch):
    clock, watch = Time(monkeypatch), Watch(Clock(60.0), plan((10, None), (20, 5)))
    clock.now = 40.0
    watch(ran(5))
    clock.now = 45.0
    watch(ran(10))  # 10 s more, of 15


def test_the_first_call_of_a_stage_says_nothing_but_the_end_is_the_end(monkeypatch):
    clock, watch = Time(monkeypatch), Watch(Clock(60.0), plan((10, None), (20, None)))
    clock.now = 30.0
    watch(ran(10))
    clock.now = 59.0
    watch(ran(5, stage=1))
    clock.now = 61.0
    with pytest.raises(OutOfTime):
        watch(ran(5, stage=1))


def test_an_identification_ends_at_the_end(monkeypatch):
    clock, heard = Time(monkeypatch), []
    follow = Clock(10.0).within(lambda prepared: Listener(on_iteration=heard.append))
    told = follow(SimpleNamespace())  # pyright: ignore[reportArgumentType]
    step = Iteration("whole records", 1, 0.5, 1e-3)
    told.on_iteration(step)
    clock.now = 11.0
    with pytest.raises(OutOfTime):
        told.on_iteration(step)
    assert heard == [step, step]


def test_without_an_end_listeners_stay_as_they_are():
    def tell(prepared: Any) -> Listener:
        return Listener()

    assert Clock().within(tell) is tell
