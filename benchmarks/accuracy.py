"""Where the error of a model is, and what a recipe reaches on records that it never saw.

    python benchmarks/accuracy.py split FOLDER MODEL [MODEL ...]
    python benchmarks/accuracy.py folds FOLDER RECIPE [--system NAME] [--memory S,S] [--plain]
    python benchmarks/accuracy.py variants FOLDER

`split` runs free over the validation records and tells the error by coordinate, by time and by
start; of a grey-box model also by cause: how much of it one parameter takes away that is chosen
anew for every record.

`folds` deals the records (train and validation) of each kind into 5 folds, like cards. Each fold
is scored once, by a model trained on three of the others; the fourth chooses its weights. With
--system the system is identified on all four, by `best-grey`, and alone for the recipe
`best-grey`.

`variants` does so for every piece of physics in `grey_variants.py`, and for the input shifted by
half a sample.
"""

import argparse
import itertools
import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)

import numpy as np
from grey_variants import SHIFTS, VARIANTS, shifted

import tustinnet as tn
from tustinnet.data.dataset import DataSet
from tustinnet.evaluation.free_run import Score
from tustinnet.identification.recipe import read_identification_recipe
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.report.tables import Table, number
from tustinnet.simulation.integrators import Discretised
from tustinnet.systems.registry import load_system
from tustinnet.training.fit import fit_many

FOLDS = 5
SEEDS = (0, 1, 2)
STARTS = ("file", "model-10", "model-20", "model-80")
TIMES = (0.0, 1.0, 3.0, 6.0, np.inf)  # s
FACTORS = (0.6, 0.8, 0.9, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1, 1.25, 1.6)


def kind(name: str) -> str:
    """The first letters of a record's name."""
    found = re.match("[a-z]+", name)
    return found.group() if found else ""


def dealt(data: DataSet) -> Iterator[DataSet]:
    """The folds: one to score as `test`, the next as `validation`, the others as `train`."""
    known = [e for e in data if e.split in (None, "train", "validation")]
    ordered = sorted(known, key=lambda e: (kind(e.name), str(e.split), e.name))
    for fold in range(FOLDS):
        place = {fold: "test", (fold + 1) % FOLDS: "validation"}
        yield DataSet(
            f"fold {fold}",
            tuple(replace(e, split=place.get(i % FOLDS, "train")) for i, e in enumerate(ordered)),
        )


def scored(models: Sequence[Any], fold: DataSet, start: str) -> dict[str, list[float]]:
    """RMSE of every record of the fold, one a model."""
    runs = [tn.evaluate(m, list(fold.split("test")), start) for m in models]
    return {of[0].experiment: [s.rmse for s in of] for of in zip(*runs, strict=True)}


def fold_models(fold: DataSet, args: argparse.Namespace) -> list[Any]:
    """The models of a fold, one a seed."""
    physics = None
    if args.system:
        known = [replace(e, split="train") for e in fold if e.split != "test"]
        settings = read_identification_recipe("best-grey").settings
        system = load_system(args.system) if isinstance(args.system, str) else args.system
        physics = tn.identify(DataSet(fold.name, tuple(known)), system, settings=settings).model
        if args.recipe == "best-grey":
            return [physics]
    recipe = tn.read_recipe(args.recipe)
    if args.memory:
        times = tuple(float(t) for t in args.memory.split(","))
        recipe = recipe.model_copy(
            update={"model": recipe.model.model_copy(update={"memory": times})}
        )
    if args.plain:
        stages = [s.model_copy(update={"mirror": False}) for s in recipe.stages]
        recipe = recipe.model_copy(update={"stages": stages})
    return [r.model for r in fit_many(fold, recipe, SEEDS, physics=physics)]


def folds(args: argparse.Namespace) -> None:
    """Mean and standard error over the records, each scored by models that never saw it."""
    found: dict[str, dict[str, list[float]]] = {start: {} for start in ("file", "model-20")}
    begun = time.perf_counter()
    for fold in dealt(shifted(tn.load(args.folder), args.shift)):
        models = fold_models(fold, args)
        for start, of in found.items():
            of |= (new := scored(models, fold, start))
            told = ", ".join(f"{name} {number(np.mean(x))}" for name, x in new.items())
            print(f"{fold.name}, {start}: {told}", flush=True)
        print(f"{time.perf_counter() - begun:.0f} s", flush=True)
    rows = []
    for start, of in found.items():
        errors = np.array(list(of.values()))
        mean = errors.mean(axis=1)
        kinds = {k: np.array([kind(name) == k for name in of]) for k in sorted(map(kind, of))}
        rows.append(
            [
                start, number(mean.mean()), number(mean.std(ddof=1) / len(mean) ** 0.5),
                " ".join(number(x) for x in errors.mean(axis=0)),
                ", ".join(f"{k} {number(mean[those].mean())}" for k, those in kinds.items()),
            ]
        )  # fmt: skip
    columns = ["start", "mean RMSE", "std. error", "each seed", "by kind of record"]
    title = f"{args.title or args.recipe}, {len(found['file'])} records"
    print(Table(columns, rows, title=title).markdown(), flush=True)


def variants(args: argparse.Namespace) -> None:
    """The same for further physics, and for inputs that come later or earlier."""
    args.recipe = "best-grey"
    for args.title, make in VARIANTS.items():
        args.system = make()
        folds(args)
    args.system = VARIANTS["as packaged"]()
    for args.shift in SHIFTS:
        args.title = f"input shifted by {args.shift:g} samples"
        folds(args)


def split(args: argparse.Namespace) -> None:
    """By coordinate, by time, by start, and of grey-box models by cause."""
    held = list(tn.load(args.folder).split("validation"))
    for path in args.models:
        model = tn.load_model(path)
        by_start = {start: tn.evaluate(model, held, start) for start in STARTS}
        names = [c.name for c in model.coordinates]
        spans = [f"{a:g}..{b:g} s" for a, b in itertools.pairwise(TIMES)]
        rows = []
        for i, e in enumerate(held):
            score = by_start["model-20"][i]
            rows.append(
                [
                    e.name, *[number(by_start[s][i].rmse) for s in STARTS],
                    *[number(x) for x in score.coordinate_rmse], *by_time(e, score),
                ]
            )  # fmt: skip
        print(Table(["record", *STARTS, *names, *spans], rows, title=str(path)).markdown())
        if isinstance(model, Discretised) and isinstance(model.continuous, LagrangianModel):
            print(by_cause(model, held).markdown())


def by_time(e: tn.Experiment, score: Score) -> list[str]:
    """RMSE within spans of time."""
    square = np.sum((score.simulated[:, : e.q.shape[1]] - e.q) ** 2, axis=1)
    since = e.t - e.t[0]
    within = [(since >= a) & (since < b) for a, b in itertools.pairwise(TIMES)]
    return [number(np.sqrt(square[w].mean())) if w.any() else "–" for w in within]


def by_cause(model: Discretised, held: Sequence[tn.Experiment]) -> Table:
    """RMSE with one parameter chosen anew for every record; all others as they are."""
    physics = model.continuous
    assert isinstance(physics, LagrangianModel)
    plain = [s.rmse for s in tn.evaluate(model, held, "model-20")]
    rows = [["as identified", *map(number, plain), number(float(np.mean(plain)))]]
    searched = [p.name for p in physics.system.parameters if not p.fixed]
    for name in [*searched, "torque_constant"]:
        tried = [_scaled(model, physics, name, f) for f in FACTORS]
        errors = np.array([[s.rmse for s in tn.evaluate(m, held, "model-20")] for m in tried])
        best = errors.min(axis=0)
        rows.append([name, *map(number, best), number(float(best.mean()))])
    rows[1:] = sorted(rows[1:], key=lambda row: float(row[-1]))
    return Table(["free in each record", *[e.name for e in held], "mean"], rows)


def _scaled(model: Discretised, physics: LagrangianModel, name: str, factor: float) -> Discretised:
    values = physics.values | {name: physics.values[name] * factor}
    return tn.discretise(LagrangianModel(physics.system, values), model.dt, model.substeps)


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    verbs = parser.add_subparsers(required=True)
    verb: Callable[[argparse.Namespace], None]
    for verb in (split, folds, variants):
        sub = verbs.add_parser(verb.__name__)
        sub.add_argument("folder", type=Path)
        sub.set_defaults(verb=verb, title="", shift=0.0)
        if verb is split:
            sub.add_argument("models", nargs="+", type=Path)
        elif verb is folds:
            sub.add_argument("recipe")
            sub.add_argument("--system")
            sub.add_argument("--memory")
            sub.add_argument("--plain", action="store_true", help="without mirrored windows")
    args = parser.parse_args()
    args.verb(args)


if __name__ == "__main__":
    main()
