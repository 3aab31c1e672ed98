"""Memory and time of reading a large record: `python benchmarks/large_records.py [ROWS [OTHERS]]`.

Writes a CSV file of so many rows (10,000,000), with so many other columns (0), and a data card into
a temporary folder, reads it in a process of its own, and prints the peak of its memory. For many
columns: `python benchmarks/large_records.py 2 10000`.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

_DT = 1e-3
_CARD = f"""
name = "large"
dt = {_DT}
[time]
column = "time"
[[coordinates]]
name = "angle"
kind = "angular"
column = "angle"
unit = "deg"
[[inputs]]
name = "torque"
column = "torque"
unit = "N m"
"""
_READ = """
import sys
from pathlib import Path
import tustinnet
samples = len(tustinnet.load(sys.argv[1])[0])
(peak,) = (x.split()[1] for x in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in x)
print(samples, int(peak) // 1024)
"""


def write_record(folder: Path, rows: int, others: int) -> int:
    """Writes a record of an angle and a torque; its size in bytes."""
    t = np.arange(rows) * _DT
    noise = 0.01 * np.random.default_rng(0).normal(size=rows)
    columns = {"time": t, "angle": np.rad2deg(np.sin(3 * t)) + noise, "torque": np.sin(0.7 * t)}
    columns |= {f"other {k}": t for k in range(others)}
    file = folder / "log.csv"
    pl.DataFrame({name: np.round(x, 6) for name, x in columns.items()}).write_csv(file)
    (folder / "dataset.toml").write_text(_CARD)
    return file.stat().st_size


def main() -> None:
    """Prints one line."""
    rows = int(float(sys.argv[1])) if sys.argv[1:] else 10_000_000
    others = int(sys.argv[2]) if sys.argv[2:] else 0
    with tempfile.TemporaryDirectory() as place:
        size = write_record(Path(place), rows, others)
        begun = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-c", _READ, place], check=True, capture_output=True, text=True
        )
        samples, peak = map(int, done.stdout.split())
        seconds = time.monotonic() - begun
    print(f"{samples:,} samples, {size / 1e6:.0f} MB of CSV: {seconds:.0f} s, peak {peak} MiB")


if __name__ == "__main__":
    main()
