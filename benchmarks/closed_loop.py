"""Identification of an arm that balances a pendulum, from records under its own controller.

python benchmarks/closed_loop.py [SECONDS [RECORDS [SEEDS]]]   20 s, 10 records, seeds 0 to 2
"""

import sys
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import balancing
from balancing import SYSTEM, TRUTH, balanced

import tustinnet as tn


def measure(seconds: float, records: int, seed: int) -> dict[str, float]:
    """Relative errors of the parameters."""
    experiments = balanced(records, seconds, seed)
    start_time = time.perf_counter()
    result = tn.identify(tn.DataSet("balanced", tuple(experiments)), SYSTEM)
    print(f"seed {seed}: {result.outcome}; {time.perf_counter() - start_time:.0f} s")
    print(*(f"  {finding}" for finding in result.findings), sep="\n", flush=True)
    held_out = balanced(2, seconds, seed + 1000)
    scores = tn.evaluate(result.model, held_out, result.start, horizon=result.horizon)
    print(f"  two new records, {result.horizon:.2g} s at once: {tn.mean_rmse(scores):.2g} rad")
    inside = [
        e.interval is not None and e.interval[0] <= TRUTH[e.name] <= e.interval[1]
        for e in result.estimates
    ]
    print(f"  {sum(inside)} of {len(inside)} intervals hold the truth")
    return {e.name: e.value / TRUTH[e.name] - 1 for e in result.estimates}


def main(seconds: float = 20.0, records: int = 10, seeds: int = 3) -> None:
    """The table: a row a parameter, a column a seed."""
    print(f"{records} records of {seconds:g} s, sampled at {balancing.DT:g} s")
    errors = [measure(seconds, records, seed) for seed in range(seeds)]
    print(f"{'error of':<20}" + "".join(f"{f'seed {i}':>10}" for i in range(seeds)))
    for name in errors[0]:
        print(f"{name:<20}" + "".join(f"{100 * e[name]:>8.2f} %" for e in errors))


if __name__ == "__main__":
    if len(sys.argv) > 4 or "--help" in sys.argv:
        sys.exit(__doc__)
    given = sys.argv[1:]
    main(*(kind(x) for kind, x in zip((float, int, int), given, strict=False)))
