"""Load: long records, many records, many coordinates, within a bound of memory."""

import shutil
import time
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from . import oracle
from .command import finish, start
from .report import Part

_MOST = 4096  # MiB
_LONGEST = 900.0  # seconds a command
# records, samples of each, coordinates
_SIZES = {
    "a record of 1,000,000 samples": (1, 1_000_000, 1),
    "2,000 records of 1,000 samples": (2000, 1000, 1),
    "50 coordinates": (4, 2000, 50),
}
_RECIPE = """
name = "load"
[model]
hidden = [8]
[[stages]]
name = "one"
windows = { draw = "random", length = 20, count = 200 }
rate = 1e-3
epochs = 2
batch = 32
"""


def write_records(place: Path, records: int, samples: int, coordinates: int) -> None:
    """Noise-driven oscillations as Parquet files, one more for validation, with a card."""
    place.mkdir(parents=True)
    names = [f"q{j}" for j in range(coordinates)]
    generator, t = np.random.default_rng(0), 0.01 * np.arange(samples)
    for k in range(records + 1):
        n = samples if k < records else min(samples, 2000)
        phases = generator.uniform(0, 6, (coordinates, 1))
        speeds = generator.uniform(2, 9, (coordinates, 1))
        q = np.sin(speeds * t[:n] + phases)
        table = {"time": t[:n], "u": generator.normal(size=n), **dict(zip(names, q, strict=True))}
        pl.DataFrame(table).write_parquet(place / f"r{k:04d}.parquet")
    channels = "".join(
        f'[[coordinates]]\nname = "{name}"\nkind = "linear"\ncolumn = "{name}"\n' for name in names
    )
    (place / "dataset.toml").write_text(
        f'name = "load"\ndt = 0.01\n[time]\ncolumn = "time"\n{channels}'
        '[[inputs]]\nname = "u"\ncolumn = "u"\nunit = "N"\n[splits]\n'
        f"train = {[f'r{k:04d}.parquet' for k in range(records)]}\n"
        f'validation = ["r{records:04d}.parquet"]\n'
    )


class Load:
    """Every size once: inspect, fit, evaluate."""

    def __init__(self, place: Path) -> None:
        self.box, self.part = place / "load", Part("load")

    def run(self, scale: int = 1) -> Part:
        """All sizes, or a fraction of them."""
        for name, (records, samples, coordinates) in _SIZES.items():
            shutil.rmtree(self.box, ignore_errors=True)
            write_records(
                self.box / "logs",
                max(1, records // scale),
                max(1000, samples // scale),
                max(1, coordinates // scale),
            )
            (self.box / "load.toml").write_text(_RECIPE)
            logs, out = str(self.box / "logs"), str(self.box / "run")
            model = str(self.box / "run" / "model.safetensors")
            for command in (
                ("inspect", logs),
                ("fit", logs, "--recipe", str(self.box / "load.toml"), "--out", out, "--quiet"),
                ("evaluate", model, logs, "--split", "validation"),
            ):
                outcome, told = oracle.judged(partial(self._one, name, command))
                self.part.count(outcome, f"{name}, {command[0]}: {told}", "--parts load")
        shutil.rmtree(self.box)
        return self.part

    def _one(self, name: str, command: tuple[str, ...]) -> None:
        begun = time.monotonic()
        ended = finish(start(command, {}), _LONGEST)
        seconds = time.monotonic() - begun
        self.part.notes.append(f"{name}, {command[0]}: {seconds:.0f} s, {ended.peak} MiB")
        ended.require_told()
        oracle.require(ended.code == 0, f"failed: {ended.last_line}")
        oracle.require(ended.peak < _MOST, f"more than {_MOST} MiB")
