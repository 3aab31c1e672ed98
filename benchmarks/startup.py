"""Seconds of short commands, and how many times as long they take as loading NumPy and polars.

    python benchmarks/startup.py DATA MODEL [--source CHECKOUT/src ...] [--rounds 5]

Whole processes, medians of the rounds after one that fills the disk's cache. With several sources
each round runs those of all, one after the other, so that they can be compared on a busy machine.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import tustinnet

COMMAND = "from tustinnet.cli.entry import run; run()"
LIBRARIES = "import numpy, polars"


def seconds(program: str, *arguments: str, source: Path) -> float:
    """Seconds of a process with a source folder's package."""
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env={**os.environ, "PYTHONPATH": str(source)},
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return time.perf_counter() - begin


def measured(commands: dict[str, list[str]], source: Path) -> dict[str, float]:
    """Seconds of the libraries and of each command, one after the other."""
    found = {LIBRARIES: seconds(LIBRARIES, source=source)}
    for name, arguments in commands.items():
        found[name] = seconds(COMMAND, *arguments, source=source)
    return found


def main() -> None:
    """Reads the arguments, measures, prints."""
    parser = argparse.ArgumentParser()
    parser.add_argument("data")
    parser.add_argument("model")
    here = Path(tustinnet.__file__).parents[1]
    parser.add_argument("--source", type=Path, nargs="+", default=[here])
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    commands = {
        "--help": ["--help"],
        "inspect DATA": ["inspect", given.data],
        "show MODEL": ["show", given.model],
    }
    sources = [path.resolve() for path in given.source]
    rounds = [{of: measured(commands, of) for of in sources} for _ in range(given.rounds + 1)][1:]
    table = {}
    for of in sources:
        times = {name: median(r[of][name] for r in rounds) for name in rounds[0][of]}
        table[str(of)] = {
            name: {"s": round(t, 2), "ratio": round(t / times[LIBRARIES], 2)}
            for name, t in times.items()
        }
    print(json.dumps({"rounds": given.rounds, **table}, indent=1))


if __name__ == "__main__":
    main()
