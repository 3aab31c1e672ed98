"""Do physics generalise? Models of gentle records, scored on wilder ones.

    python benchmarks/extrapolation.py DATA [--seeds 3] [--system qube-servo2-memory]

Three sets of training records of the measured pendulum:

* `gentle`: white noise up to 2.5 V and the lower half of the falls;
* `noise`: white noise of all amplitudes, no fall; a fall is three times as fast;
* `mixed`: two sets of as many records as `gentle`, of all kinds: what is scored was left out, but
  records like it were not.

Scored are 3.5 V and the higher falls, where a set does not have them. Training and validation
records alone are used, and every model trains on all records of its set: none chooses an epoch.
"""

import argparse
import json
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)

import numpy as np
from draws import Draw, DrawFitter, DrawResult
from rich.console import Console

import tustinnet as tn
from tustinnet.fitting.roles import records_without_test
from tustinnet.report.progress import FitProgress
from tustinnet.report.tables import Table, number
from tustinnet.selection.cross_validation import make_cross_validation_options

RECIPES = Path(__file__).parent / "recipes"
KINDS = {"noise 3.5 V": "wN_3_5V", "higher falls": "fall"}
REFERENCE = "mixed"


def sets_of(data: tn.DataSet) -> dict[str, list[list[tn.Experiment]]]:
    """The training records of each set; of `mixed` two lots."""
    known = records_without_test(data)
    noise = [e for e in known if not e.name.startswith("fall")]
    falls = sorted((e for e in known if e.name.startswith("fall")), key=lambda e: np.cos(e.q[0, 1]))
    low, high = falls[: len(falls) // 2], falls[len(falls) // 2 :]
    weak = [e for e in noise if np.abs(e.u).max() < 2.6]
    wild = [e for e in noise if e.name.startswith("wN_3_5V")]
    mixed = [[*low[k::2], *high[1 - k :: 2], *weak[:2], wild[k]] for k in (0, 1)]
    return {"gentle": [[*weak, *low]], "noise": [noise], REFERENCE: mixed}


def scored_of(data: tn.DataSet, used: Sequence[tn.Experiment]) -> list[tn.Experiment]:
    """The wilder records that were not used."""
    gentle = {e.name for e in sets_of(data)["gentle"][0]}
    wild = [e for e in records_without_test(data) if e.name.startswith(tuple(KINDS.values()))]
    return [e for e in wild if e.name not in gentle and e.name not in {of.name for of in used}]


def tables(found: Sequence[Mapping[str, object]]) -> Table:
    """RMSE by approach and set, median (range) over the seeds of the mean over records."""
    rows = []
    for approach in dict.fromkeys(of["approach"] for of in found):
        mine = [of for of in found if of["approach"] == approach]
        told = {
            (name, kind): [
                statistics.fmean(
                    x
                    for of in mine
                    if (of["set"], of["seed"]) == (name, seed)
                    for record, x in of["rmse"].items()
                    if record.startswith(start)
                )
                for seed in sorted({of["seed"] for of in mine})
            ]
            for name in dict.fromkeys(of["set"] for of in mine)
            for kind, start in KINDS.items()
            if any(r.startswith(start) for of in mine if of["set"] == name for r in of["rmse"])
        }
        for (name, kind), each in told.items():
            usual = statistics.median(told[REFERENCE, kind])
            middle = statistics.median(each)
            rows.append(
                [
                    str(approach),
                    str(name),
                    kind,
                    number(middle, scale=0.1),
                    f"{number(min(each), scale=0.1)}..{number(max(each), scale=0.1)}",
                    f"{middle / usual:.2f}",
                ]
            )
    columns = ["model", "trained on", "scored on", "RMSE [rad]", "seeds", "over `mixed`"]
    return Table(columns, rows)


def main() -> None:
    """Reads the arguments, fits, prints."""
    asked = argparse.ArgumentParser()
    asked.add_argument("data")
    asked.add_argument("--seeds", type=int, default=3)
    asked.add_argument("--system", default="qube-servo2-memory")
    asked.add_argument("--start", default="model-20")
    asked.add_argument("--network", default=str(RECIPES / "short-network.toml"))
    asked.add_argument("--hybrid", default=str(RECIPES / "short-hybrid.toml"))
    asked.add_argument("--epochs", type=int, nargs=2, default=(150, 30), help="network, hybrid")
    asked.add_argument("--out", type=Path, default=Path("results/extrapolation.json"))
    given = asked.parse_args()
    data = tn.load(given.data)
    lots = [(name, tuple(of)) for name, several in sets_of(data).items() for of in several]
    for name, of in lots:
        print(f"{name}: {', '.join(e.name for e in of)}")
    network_recipe, hybrid_recipe = (
        tn.read_recipe(name, [f"stages.*.epochs={epochs}"])
        for name, epochs in zip((given.network, given.hybrid), given.epochs, strict=True)
    )
    options = make_cross_validation_options(hybrid_recipe, system=given.system)
    assert options.physics is not None
    alone = [Draw(0, len(of), of, tuple(scored_of(data, of))) for _, of in lots]
    draws = [Draw(seed, d.size, d.records, d.scored) for seed in range(given.seeds) for d in alone]
    with FitProgress(Console(stderr=True, soft_wrap=True)) as progress:
        fitter = DrawFitter(data, given.start, progress.listener())
        physics = fitter.identify(alone, options.physics, options.system)
        models = [result.model for result in physics] * given.seeds
        network = fitter.train(draws, network_recipe)
        hybrid = fitter.train(draws, options.recipe, physics=models)
    results: dict[str, tuple[list[Draw], list[DrawResult]]] = {
        "network": (draws, network),
        "grey box": (alone, physics),
        "hybrid": (draws, hybrid),
    }
    found = []
    for approach, (at, fits) in results.items():
        for i, (draw, fit) in enumerate(zip(at, fits, strict=True)):
            assert fit.model is not None, fit.outcome
            found.append(
                {
                    "approach": approach,
                    "set": lots[i % len(lots)][0],
                    "seed": draw.number,
                    "rmse": fit.rmse,
                }
            )
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(json.dumps(found, indent=1))
    print(tables(found).markdown())


if __name__ == "__main__":
    main()
