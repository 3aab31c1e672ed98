"""How many of the records that were used for nothing lie inside the bands of a model.

    python benchmarks/bands.py DATA [--recipe best-grey] [--system qube-servo2-rubbing]
    python benchmarks/bands.py DATA --run RUN --of hybrid,tustin-net

Each of five folds is left out. The others are dealt into three folds again: models of these give
the free runs that calibrate, a model of all others the bands that are tried on the fold left out.

With `--run`, the folder of a `fit` without a recipe, nothing is fitted: the models of some
candidates in each fold are put together as a committee, with equal shares for the candidates.
Bands of a fold are calibrated on the free runs of the other folds, each by its own models.
"""

import argparse
import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import tustinnet as tn
from tustinnet.data.dataset import DataSet
from tustinnet.evaluate.bands import Band, Prediction, calibrate_bands, make_band, predict
from tustinnet.evaluate.coverage import compute_coverage
from tustinnet.families.family import family_of
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Fold, Member, Task
from tustinnet.selection.folds import split_into_folds

INNER = 3  # folds of the others


def fitted(folds: list[Fold], recipe: Any, system: Any, seeds: int) -> list[FitResult]:
    """One model a fold, or a committee of several seeds."""
    members = tuple(Member(s, fold=f) for f in range(len(folds)) for s in range(seeds))
    return fit_task(Task(recipe, tuple(folds), members, system))


def guessed(result: FitResult, records: Any, start: str) -> list[Prediction]:
    """Free runs of records with the spread of the model's alternatives."""
    others = family_of(result.model).alternatives(result.model, result.as_header())
    return predict(result.model, others, records, start)


Tried = tuple[list[Prediction], list[tn.Experiment], list[Prediction], list[tn.Experiment]]


def by_fits(given: argparse.Namespace, data: DataSet) -> list[Tried]:
    """Per fold: free runs that calibrate, their records, free runs that are tried, theirs."""
    recipe, system = tn.read_recipe(given.recipe), tn.load_system(given.system)
    deals = split_into_folds(data)
    inner: list[tuple[int, Any]] = []
    folds: list[Fold] = []
    for k, deal in enumerate(deals):
        others = deal.roles.all
        inner.append((k, None))
        folds.append(Fold(Roles(tuple(others), ())))
        for d in split_into_folds(DataSet(data.name, tuple(others)), INNER):
            inner.append((k, d.scored))
            folds.append(Fold(Roles(tuple(d.roles.all), ())))
    results, found = fitted(folds, recipe, system, 1), []
    for k, deal in enumerate(deals):
        of_fold = [(r, s) for r, (f, s) in zip(results, inner, strict=True) if f == k]
        made, records = [], []
        for result, scored in of_fold:
            if scored is not None:
                made += guessed(result, scored, given.start)
                records += scored
        final = next(r for r, s in of_fold if s is None)
        found.append((made, records, guessed(final, deal.scored, given.start), list(deal.scored)))
    return found


def by_committees(given: argparse.Namespace, data: DataSet) -> list[Tried]:
    """The same of committees of a selection's candidates."""
    wanted = given.of.split(",")
    told = json.loads((given.run / "summary.json").read_text())["candidates"]
    files = {c["name"]: c["models"] for c in told if c["name"] in wanted}
    each: list[tuple[list[Prediction], list[tn.Experiment]]] = []
    for k, deal in enumerate(split_into_folds(data)):
        models, weights = [], []
        for name in wanted:
            there = [given.run / f for f in files[name] if re.search(rf"fold-{k}-seeds", f)]
            models += [tn.load_model(f) for f in there]
            weights += [1 / len(wanted) / len(there)] * len(there)
        together = tn.committee(models, weights)
        others = family_of(together).alternatives(together, {})
        each.append((predict(together, others, deal.scored, given.start), list(deal.scored)))
    found = []
    for k, (tried, scored) in enumerate(each):
        rest = [of for i, of in enumerate(each) if i != k]
        made, records = ([x for pair in rest for x in pair[j]] for j in (0, 1))
        found.append((made, records, tried, scored))
    return found


def main() -> None:
    """Reads the arguments, fits, prints."""
    asked = argparse.ArgumentParser()
    asked.add_argument("data")
    asked.add_argument("--recipe", default="best-grey")
    asked.add_argument("--system", default="qube-servo2-rubbing")
    asked.add_argument("--start", default="model-20")
    asked.add_argument("--run", type=Path)
    asked.add_argument("--of", default="hybrid,tustin-net")
    asked.add_argument("--out", type=Path, default=Path("results/bands.json"))
    given = asked.parse_args()
    data = tn.load(given.data)
    bands: dict[str, list[Band]] = {"time": [], "record": []}
    scored_all: list[tn.Experiment] = []
    for made, records, tried, scored in (by_committees if given.run else by_fits)(given, data):
        calibration, n = calibrate_bands(made, records, given.start), len(records)
        bands["time"] += [make_band(calibration, g, 0.9) for g in tried]
        bands["record"] += [make_band(calibration, g, n / (n + 1), "record") for g in tried]
        scored_all += scored
    rows = []
    for of, some in bands.items():
        shares = compute_coverage(scored_all, some)
        rows += [{"of": of, "level": some[0].level, **asdict(share)} for share in shares]
        for share in shares:
            low, high = share.interval
            print(
                f"{of:6} {some[0].level:.3f} {share.coordinate:6} {share.part:6} inside "
                f"{share.inside:.3f} ({low:.2f} to {high:.2f}), all of {share.whole} of "
                f"{share.records}, width {share.width:.4f} = {share.width / share.rmse:.2f} RMSE, "
                f"CRPS {share.crps:.4f}"
            )
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
