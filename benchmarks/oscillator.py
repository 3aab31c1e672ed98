"""A fast oscillator whose input moves between samples: a grey box, and networks alone.

python benchmarks/oscillator.py [DATA_SEED [SEEDS]]   the twin of seed 12, networks of seeds 0 to 2

The grey box is not told what the input does between the samples. Networks are chosen by the
validation records; each model runs once over the test record, after everything is fitted.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)

import numpy as np

import tustinnet as tn
from tustinnet.report.tables import Table, number

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from duffing_twin import COUNT, SYSTEM, TWIN_VALUES, duffing_twin

START = "model-20"  # a fit through the model: parabolas are wrong at 9 samples a period


def undeclared(data: tn.DataSet) -> tn.DataSet:
    """The same records by somebody who does not know what the inputs do between the samples."""
    inputs = [replace(i, hold="unknown") for i in data[0].inputs]
    channels = replace(data[0].channels, inputs=tuple(inputs))
    return tn.DataSet(data.name, tuple(replace(e, channels=channels) for e in data))


def grey_box(data: tn.DataSet) -> tn.Model:
    """Equations of motion with the parameters and the hold that the records say."""
    begun = time.perf_counter()
    found = tn.identify(data, SYSTEM)
    print(f"grey box: {found.outcome}; {time.perf_counter() - begun:.0f} s")
    print(*(f"  {finding}" for finding in found.findings), sep="\n")
    errors = {e.name: e.value / TWIN_VALUES[e.name] - 1 for e in found.estimates}
    print("  " + ", ".join(f"{name} {100 * e:+.3f} %" for name, e in errors.items()), flush=True)
    return found.model


def networks(data: tn.DataSet, seeds: int) -> list[tn.Model]:
    """Tustin-Nets of the packaged recipe."""
    begun = time.perf_counter()
    found = tn.fit_many(data, "oscillator", seeds=range(seeds))
    print(f"networks: {seeds} seeds together, {time.perf_counter() - begun:.0f} s")
    for seed, result in enumerate(found):
        print(f"  seed {seed}: {result.outcome}", *result.findings, sep="; ", flush=True)
    return [result.model for result in found]


def simulation_errors(model: tn.Model, data: tn.DataSet) -> tuple[float, float]:
    """Of the validation records and of the test record, in mm."""
    chosen, test = (
        1e3 * tn.mean_rmse(tn.evaluate(model, list(data.split(split)), START))
        for split in ("validation", "test")
    )
    return chosen, test


def main(data_seed: int = 12, seeds: int = 3) -> None:
    """The table: a row a model, simulation errors in mm."""
    data = duffing_twin(data_seed)
    fitted = tn.DataSet(data.name, tuple(e for e in data if e.split != "test"))
    models = {"grey box": grey_box(undeclared(fitted))}
    models |= {f"network, seed {i}": m for i, m in enumerate(networks(fitted, seeds))}
    print(f"rounding to counts leaves {number(1e3 * COUNT / 12**0.5)} mm")
    errors = {name: simulation_errors(model, data) for name, model in models.items()}
    rows = [[name, *map(number, of)] for name, of in errors.items()]
    print(Table(["model", "validation, mm", "growing noise, mm"], rows).markdown())
    (_, grey), *of_networks = errors.values()
    middle, chosen = np.median([test for _, test in of_networks]), min(of_networks)[1]
    print(f"over the grey box: median of the networks {middle / grey:.2f}, ", end="")
    print(f"the best by validation {chosen / grey:.2f}")


if __name__ == "__main__":
    if len(sys.argv) > 3 or "--help" in sys.argv:
        sys.exit(__doc__)
    main(*map(int, sys.argv[1:]))
