"""Identification, measured: time, starts, recovery and coverage.

python benchmarks/identification.py time FOLDER   seconds on measured records, first and later
python benchmarks/identification.py starts        20 starts on the twin, within a factor of 3
python benchmarks/identification.py recovery      noise-free twin: relative errors
python benchmarks/identification.py coverage      20 noisy twins: truth inside the 95 % interval
"""

import statistics
import sys
import time
from dataclasses import replace

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np

import tustinnet as tn
from tustinnet.systems import qube_servo2, qube_servo2_twin
from tustinnet.systems.twin import Logger

SYSTEM, TRUTH = qube_servo2.WITH_MEMORY, qube_servo2_twin.TWIN_VALUES
FREE = [p for p in SYSTEM.parameters if not p.fixed]
EXACT = Logger(jitter=0.0, counts=False, substeps=2)
SETTINGS = tn.Settings(initial="anchored")
EXACT_SETTINGS = tn.Settings(initial="anchored", substeps=EXACT.substeps)


def training_records(seed: int, *, exact: bool) -> tn.DataSet:
    """The twin's training records, through encoders or exactly as simulated."""
    data = qube_servo2_twin.twin(seed, EXACT if exact else Logger())
    records = tuple(data.split("train"))
    if exact:
        records = tuple(replace(e, coordinates=SYSTEM.coordinates) for e in records)
    return tn.DataSet(data.name, records)


def errors(result: tn.Identification) -> dict[str, float]:
    """Relative error of every parameter."""
    return {e.name: e.value / TRUTH[e.name] - 1 for e in result.estimates}


def measure_time(folder: str) -> None:
    """The paper's structure on measured training records; the first run compiles."""
    data = tn.load(folder)
    train = tn.DataSet(data.name, tuple(data.split("train")))
    for label, records in (("with the choice by validation", data), ("training only", train)):
        jax.clear_caches()
        seconds = []
        for _ in range(6):
            begun = time.perf_counter()
            result = tn.identify(records, qube_servo2.SYSTEM)
            seconds.append(time.perf_counter() - begun)
        later = statistics.median(seconds[1:])
        print(
            f"{label}: first {seconds[0]:.1f} s, later {later:.2f} s (median of 5, "
            f"{min(seconds[1:]):.2f}..{max(seconds[1:]):.2f}); {result.outcome}"
        )


def starts(count: int = 20) -> None:
    """Starts log-uniform within a factor of 3 either way."""
    data = training_records(0, exact=True)
    generator = np.random.default_rng(0)
    reached = 0
    for k in range(count):
        begin = {
            p.name: float(np.clip(TRUTH[p.name] * 3 ** generator.uniform(-1, 1), p.lower, p.upper))
            for p in FREE
        }
        result = tn.identify(data, SYSTEM, start_values=begin, settings=EXACT_SETTINGS)
        worst = max(abs(e) for e in errors(result).values())
        reached += worst < 1e-4
        print(f"start {k}: largest relative error {worst:.1e}, {result.outcome}", flush=True)
    print(f"{reached} of {count} reached the truth within 1e-4")


def recovery() -> None:
    """The generator's own integration steps, no encoders, no jitter."""
    result = tn.identify(training_records(0, exact=True), SYSTEM, settings=EXACT_SETTINGS)
    for name, error in errors(result).items():
        print(f"{name:<18}{error:+.1e}")


def coverage(count: int = 20) -> None:
    """Fresh initial states, inputs, jitter and encoder phases for every seed."""
    inside: dict[str, list[bool]] = {}
    naive: dict[str, list[bool]] = {}
    for seed in range(100, 100 + count):
        result = tn.identify(training_records(seed, exact=False), SYSTEM, settings=SETTINGS)
        for e in result.estimates:
            low, high = e.interval or (np.nan, np.nan)
            inside.setdefault(e.name, []).append(bool(low <= TRUTH[e.name] <= high))
            half = 1.96 * (e.naive_error or np.nan)
            naive.setdefault(e.name, []).append(bool(abs(e.value - TRUTH[e.name]) <= half))
        print(f"seed {seed}: {result.outcome}, {result.seconds:.1f} s", flush=True)
    print(f"{'parameter':<18}{'records':>9}{'J-J':>7}")
    for name in inside:
        print(f"{name:<18}{np.mean(inside[name]):>9.2f}{np.mean(naive[name]):>7.2f}")
    pooled = [np.mean(list(table.values())) for table in (inside, naive)]
    print(f"{'pooled':<18}{pooled[0]:>9.3f}{pooled[1]:>7.3f}")


if __name__ == "__main__":
    verbs = {"starts": starts, "recovery": recovery, "coverage": coverage}
    if len(sys.argv) == 3 and sys.argv[1] == "time":
        measure_time(sys.argv[2])
    elif len(sys.argv) == 2 and sys.argv[1] in verbs:
        verbs[sys.argv[1]]()
    else:
        sys.exit(__doc__)
