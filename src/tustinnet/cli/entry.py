"""Entry point of the command; from the first moment on, signals end it with one line."""

import gc
import os
import sys

from tustinnet.cli import main
from tustinnet.cli.terminal import guard_streams, shorten_warnings, stoppable

# of libraries of linear algebra: threads take longer to wait for one another than small matrices
# take, thirty times as long where other programs use the cores
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_COLLECTED = 20_000  # new objects; by default 700, and a tenth of the time goes into what stays


def run() -> None:
    """Runs the command."""
    with stoppable(is_whole_process=True):
        guard_streams()
        shorten_warnings()
        for name in _THREADS:  # before NumPy is loaded
            os.environ.setdefault(name, "1")
        gc.set_threshold(_COLLECTED, *gc.get_threshold()[1:])
        try:
            main.run()  # which is loaded now, when signals and threads are set
        finally:
            gc.freeze()  # the process ends: what it leaves need not be searched for garbage
            try:  # nothing that was printed is lost to a late signal
                sys.stdout.flush()
            except (OSError, ValueError):  # Python would try once more, and print a traceback
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
