"""Systems of the library, identified from their twins: errors, and what the intervals contain.

    python benchmarks/library.py [SEEDS] [FIRST_SEED] [SYSTEM ...]      (default: 20 0, all)

Each twin has four records for training and one for validation. Prints a line for each system: in
how many twins all values are within 2 % of the true ones, the largest error among these, how many
true values are within their 95 % intervals (of all twins), and the parameters whose values were
outside most often.
"""

import jax

jax.config.update("jax_enable_x64", True)

import sys
from collections import Counter
from collections.abc import Iterator
from importlib import import_module

import tustinnet as tn
from tustinnet.registry import SYSTEMS
from tustinnet.systems.twin import Twin

PACKAGE = "tustinnet.systems.library."
CLOSE = 0.02  # relative error of a value that counts as found


def library_twins() -> Iterator[Twin]:
    """The twin of each file of the library."""
    places = [place for place in SYSTEMS.places.values() if isinstance(place, str)]
    modules = dict.fromkeys(p.partition(":")[0] for p in places if p.startswith(PACKAGE))
    for module in modules:
        yield import_module(module).TWIN


def identify_twin(twin: Twin, seed: int) -> dict[str, tuple[float, bool]]:
    """By parameter: the relative error of its value, and whether its interval has the true one."""
    result = tn.identify(twin.records(seed, test=0), twin.system)
    found = {}
    for e in result.estimates:
        true = twin.true_values()[e.name]
        is_inside = e.interval is not None and e.interval[0] <= true <= e.interval[1]
        found[e.name] = (abs(e.value / true - 1), is_inside)
    return found


def main() -> None:
    """Prints a line for each system."""
    numbers = [int(x) for x in sys.argv[1:] if x.isdigit()]
    names = [x for x in sys.argv[1:] if not x.isdigit()]
    count, first = (*numbers, *(20, 0)[len(numbers) :])
    for twin in library_twins():
        name = twin.system.name
        if names and name not in names:
            continue
        twins = [identify_twin(twin, seed) for seed in range(first, first + count)]
        worst = [max(error for error, _ in found.values()) for found in twins]
        inside = [is_inside for found in twins for _, is_inside in found.values()]
        pairs = [pair for found in twins for pair in found.items()]
        missed = Counter(parameter for parameter, (_, is_inside) in pairs if not is_inside)
        listed = ", ".join(f"{parameter} {n}" for parameter, n in missed.most_common())
        print(
            f"{name}: found in {sum(x < CLOSE for x in worst)} of {count} twins, "
            f"largest error {max((x for x in worst if x < CLOSE), default=float('nan')):.2%}; "
            f"{sum(inside)} of {len(inside)} values within their intervals",
            f"; outside: {listed}" if missed else "",
            sep="",
            flush=True,
        )


if __name__ == "__main__":
    main()
