"""Steps per second of a model as an environment, one at a time and many at once.

python benchmarks/gym_env.py [RUNS]   medians of 5 runs
"""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import gymnasium
import numpy as np
from every_family import example

ID = "tustinnet.gym:TustinNet-v0"
MODELS = {
    "network 7-100-100-2": "qube network",
    "grey box, 1 substep": "qube",
    "grey box with memory, 30 substeps": "qube memory",
}
COUNTS = (1, 16, 256, 4096)
SECONDS = 0.5  # of a run
_LIMIT, _SPEED, _VOLTAGE = 30.0, 300.0, 5.0  # wide, so that what is timed are steps


def rate(step: Callable[[], object], steps: int) -> float:
    """Steps per second, of so many in a call."""
    calls, begun = 0, time.perf_counter()
    while (spent := time.perf_counter() - begun) < SECONDS:
        step()
        calls += 1
    return calls * steps / spent


def rates(name: str, runs: int) -> dict[str, float]:
    """Median steps per second of a model: one environment, then many at once."""
    model = example(name)
    ends = [[-_LIMIT, _LIMIT]] * 2 + [[-_SPEED, _SPEED]] * 2
    ends += [[-_LIMIT, _LIMIT]] * len(model.internal)
    known = {"states": ends, "inputs": [[-_VOLTAGE, _VOLTAGE]]}
    asked = {"model": model, "range": known, "reward": "swing-up", "start": [0.0, 3.1, 0.0, 0.0]}
    one = gymnasium.make(ID, **asked)
    one.reset(seed=0)
    action = np.zeros(1)
    found = {"one": statistics.median(rate(lambda: one.step(action), 1) for _ in range(runs))}
    for count in COUNTS:
        many = gymnasium.make_vec(ID, count, **asked)
        many.reset(seed=0)
        actions = np.zeros((count, 1))
        of = [rate(lambda: many.step(actions), count) for _ in range(runs)]  # noqa: B023
        found[f"{count} at once"] = statistics.median(of)
    return found


def main(runs: int = 5) -> None:
    """The table: a row a model."""
    print(f"steps per second, medians of {runs} runs of {SECONDS:g} s")
    for told, name in MODELS.items():
        print(f"{told}: " + ", ".join(f"{k} {v:,.0f}" for k, v in rates(name, runs).items()))


if __name__ == "__main__":
    if len(sys.argv) > 2 or "--help" in sys.argv:
        sys.exit(__doc__)
    main(*map(int, sys.argv[1:]))
