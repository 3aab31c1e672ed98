"""How many of the records that were used for nothing lie inside the bands of a model.

    python benchmarks/bands.py DATA [--recipe best-grey] [--system qube-servo2-rubbing]

Each of five folds is left out. The others are dealt into folds again: models of these give the free
runs that calibrate, a model of all others the bands that are tried on the fold left out.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
import scoringrules

import tustinnet as tn
from tustinnet.data.dataset import DataSet
from tustinnet.evaluate.bands import Calibration, Guess, calibrated, guesses
from tustinnet.evaluate.folds import dealt
from tustinnet.families.family import family_of
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Fold, Member, Task

LEVELS = np.arange(0.05, 0.96, 0.05)


def fitted(folds: list[Fold], recipe: Any, system: Any, seeds: int) -> list[FitResult]:
    """One model a fold, or a committee of several seeds."""
    members = tuple(Member(s, fold=f) for f in range(len(folds)) for s in range(seeds))
    return fit_task(Task(recipe, tuple(folds), members, system, brief=True))


def guessed(result: FitResult, records: Any, start: str) -> list[Guess]:
    """Free runs of records with the spread of the model's alternatives."""
    others = family_of(result.model).alternatives(result.model, result.as_header())
    return guesses(result.model, others, records, start)


def told(of: Calibration, made: Guess, e: tn.Experiment, name: str) -> list[dict[str, Any]]:
    """How a record lies in its bands, by coordinate, moving and at rest."""
    rows = []
    low, high = of.band(made, 0.9)
    n = len(of.records)
    whole = of.band(made, n / (n + 1), "record")
    for j, c in enumerate(e.coordinates):
        for part, where in (("moving", made.moving), ("rest", ~made.moving)):
            where = where & (np.arange(len(e)) >= made.first)
            if not where.any():
                continue
            q, error = e.q[where, j], (made.simulated - e.q)[where, j]
            quantiles = np.stack(
                [of.band(made, abs(2 * p - 1) or 1e-3)[int(p > 0.5)][where, j] for p in LEVELS], -1
            )
            rows.append({
                "record": e.name, "fold": name, "coordinate": c.name, "part": part,
                "samples": int(where.sum()),
                "inside": float(np.mean((low[where, j] <= q) & (q <= high[where, j]))),
                "all": bool(((whole[0][where, j] <= q) & (q <= whole[1][where, j])).all()),
                "width": float(np.mean((high - low)[where, j])),
                "rmse": float(np.sqrt(np.mean(error**2))),
                "crps": float(np.mean(scoringrules.crps_quantile(q, quantiles, LEVELS))),
            })  # fmt: skip
    return rows


def main() -> None:
    """Reads the arguments, fits, prints."""
    asked = argparse.ArgumentParser()
    asked.add_argument("data")
    asked.add_argument("--recipe", default="best-grey")
    asked.add_argument("--system", default="qube-servo2-rubbing")
    asked.add_argument("--start", default="model-20")
    asked.add_argument("--out", type=Path, default=Path("results/bands.json"))
    given = asked.parse_args()
    data, recipe = tn.load(given.data), tn.read_recipe(given.recipe)
    system = tn.load_system(given.system)
    deals, rows = dealt(data), []
    inner: list[tuple[int, Any]] = []
    folds: list[Fold] = []
    for k, deal in enumerate(deals):
        others = deal.roles.all
        folds.append(Fold(Roles(tuple(others), ())))
        inner.append((k, None))
        for d in dealt(DataSet(data.name, tuple(others))):
            folds.append(Fold(Roles(tuple(d.roles.all), ())))
            inner.append((k, d.scored))
    results = fitted(folds, recipe, system, 1)
    for k, deal in enumerate(deals):
        of_fold = [(r, s) for r, (f, s) in zip(results, inner, strict=True) if f == k]
        made, records = [], []
        for result, scored in of_fold:
            if scored is not None:
                made += guessed(result, scored, given.start)
                records += scored
        calibration = calibrated(made, records, given.start)
        final = next(r for r, s in of_fold if s is None)
        for guess, e in zip(guessed(final, deal.scored, given.start), deal.scored, strict=True):
            rows += told(calibration, guess, e, str(k))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(json.dumps(rows, indent=1))
    for coordinate in [c.name for c in data.channels.coordinates]:
        for part in ("moving", "rest"):
            some = [r for r in rows if r["coordinate"] == coordinate and r["part"] == part]
            if some:
                mean = {k: np.mean([r[k] for r in some])
                        for k in ("inside", "all", "width", "rmse", "crps")}  # fmt: skip
                print(coordinate, part, len(some), {k: round(float(x), 4) for k, x in mean.items()},
                      "width/rmse", round(float(mean["width"] / mean["rmse"]), 2))  # fmt: skip


if __name__ == "__main__":
    main()
