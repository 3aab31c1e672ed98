"""The cores that this process may use, and what other programs take of them."""

import os
import time
from pathlib import Path

_LARGEST_SHARE = 0.9  # share of others: a system gives every program something
_IDLE = (3, 4)  # columns of /proc/stat in which nothing is computed


def count_cores() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class OtherPrograms:
    """The computing time of other programs from now on."""

    def __init__(self) -> None:
        self._began, self._others = time.monotonic(), _seconds_of_others()

    @property
    def share(self) -> float:
        """Their share of the machine's processors; 0 where the system does not say it."""
        now, available = _seconds_of_others(), time.monotonic() - self._began
        if now is None or self._others is None or available <= 0:
            return 0.0
        share = (now - self._others) / (available * (os.cpu_count() or 1))
        return min(max(share, 0.0), _LARGEST_SHARE)


def _seconds_of_others() -> float | None:
    """Processor time of all programs but this one and its children; None where it is not known."""
    try:
        line = Path("/proc/stat").read_text(encoding="ascii").partition("\n")[0]
        ticks = [int(x) for x in line.split()[1:9]]
    except (OSError, ValueError):
        return None
    busy = sum(x for i, x in enumerate(ticks) if i not in _IDLE) / os.sysconf("SC_CLK_TCK")
    return busy - sum(os.times()[:4])
