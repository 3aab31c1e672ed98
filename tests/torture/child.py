"""The command in a process of its own, made easier to catch: run as a script with its arguments.

TORTURE holds JSON: `slow`, seconds that every write takes longer; `jump`, seconds by which the
clock on the wall jumps to and fro; `largest`, bytes that a file may have.
"""

import json
import os
import random
import resource
import signal
import sys
import time
from pathlib import Path


def slow_writes(seconds: float) -> None:
    """Lengthens the moments in which a file is written but not yet in place.

    From the first file on there is a checkpoint at every call.
    """
    sync, replace = os.fsync, Path.replace

    def fsync(descriptor: int) -> None:
        time.sleep(seconds)
        sync(descriptor)

    def slow_replace(self: Path, target: Path) -> Path:
        # nothing of the package is imported here: signals while it is are its own business
        if "tustinnet.store.checkpoint" in sys.modules:
            vars(sys.modules["tustinnet.store.checkpoint"])["_INTERVAL"] = -1e9
        time.sleep(seconds)
        return replace(self, target)

    os.fsync = fsync
    Path.replace = slow_replace  # pyright: ignore[reportAttributeAccessIssue]


def jumping_clock(seconds: float) -> None:
    """A clock on the wall that goes back as often as it goes on.

    `monotonic` and `perf_counter` do not on any system; Python's own locks rely on it.
    """
    read = time.time
    time.time = lambda: read() + random.uniform(-seconds, seconds)


def main() -> None:
    """Runs the command."""
    # until the command has its own handlers, a signal is Python's business
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    asked = json.loads(os.environ.get("TORTURE", "{}"))
    if "jump" in asked:
        jumping_clock(asked["jump"])
    if "largest" in asked:
        resource.setrlimit(resource.RLIMIT_FSIZE, (asked["largest"], asked["largest"]))
    slow_writes(asked.get("slow", 0.0))
    try:
        from tustinnet.cli.entry import run

        run()
    finally:
        # not by `getrusage`, which begins with what the parent used
        status = Path("/proc/self/status").read_text().splitlines()
        used = next(line.split()[1] for line in status if line.startswith("VmHWM"))
        sys.stderr.write(f"\npeak {int(used) // 1024} MiB\n")


if __name__ == "__main__":
    main()
