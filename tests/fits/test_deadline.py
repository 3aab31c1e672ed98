"""Deadlines, and which trainings stop for them."""

import time

from tustinnet.fits.deadline import NEVER, Deadline, Stopwatch


def test_what_would_end_too_late_is_not_begun(monkeypatch):
    monkeypatch.setattr(time, "monotonic", lambda: 55.0)
    deadline = Deadline(60.0)
    assert not deadline.comes_within(4.0)
    assert deadline.comes_within(6.0)
    assert not deadline.has_passed()
    assert not NEVER.comes_within(1e9)


def test_a_deadline_that_has_passed_ends_what_takes_no_time(monkeypatch):
    monkeypatch.setattr(time, "monotonic", lambda: 61.0)
    assert Deadline(60.0).comes_within(0.0)
    assert Deadline(60.0).has_passed()
    assert not NEVER.has_passed()


def test_a_stopwatch_has_the_time_since_the_last_part_for_each(monkeypatch):
    watch = Stopwatch(10.0)
    for now, part in ((13.0, "reading"), (14.0, "fitting"), (19.0, "reading")):
        monkeypatch.setattr(time, "monotonic", lambda now=now: now)
        watch.end(part)
    assert watch.seconds == {"reading": 8.0, "fitting": 1.0}
