"""Where the error of a model is, and what a recipe reaches on records that it never saw.

    python benchmarks/accuracy.py split FOLDER MODEL [MODEL ...]
    python benchmarks/accuracy.py starts FOLDER RUN CANDIDATE
    python benchmarks/accuracy.py variants FOLDER [--start START ...]

`split` runs free over the validation records and tells the error by coordinate, by time and by
start; of a grey-box model also by cause: how much of it one parameter takes away that is chosen
anew for every record.

`starts` tells what the start `file` alone costs. RUN is a finished selection (`tustinnet fit FOLDER
--out RUN`). Each record is simulated by a model that never saw it: from `file`, and from a state
fitted to 40 samples. Were that state and that model right, the distance between both free runs
would be the error from `file`.

`variants` cross-validates `best-grey` with every piece of physics in `grey_variants.py`, and with
the input shifted by half a sample. Recipes are cross-validated by `tustinnet cross-validate`.
"""

import argparse
import itertools
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)

import numpy as np
from grey_variants import SHIFTS, VARIANTS, shifted

import tustinnet as tn
from tustinnet.evaluate.scores import Score
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.report.fits import folds_table
from tustinnet.report.tables import Table, number
from tustinnet.selection.cross_validation import make_cross_validation_options
from tustinnet.store.run_folder import SCORES

STARTS = ("file", "model-10", "model-20", "model-80")
TIMES = (0.0, 1.0, 3.0, 6.0, np.inf)  # s
FACTORS = (0.6, 0.8, 0.9, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1, 1.25, 1.6)


def variants(args: argparse.Namespace) -> None:
    """Folds of `best-grey` with further physics, and with inputs that come later or earlier."""
    data = tn.load(args.folder)
    tried = {title: (data, make()) for title, make in VARIANTS.items()}
    usual = VARIANTS["as packaged"]()
    tried |= {f"input shifted by {by:g} samples": (shifted(data, by), usual) for by in SHIFTS}
    for title, (records, system) in tried.items():
        found = tn.cross_validate(
            records, make_cross_validation_options("best-grey", system=system, starts=args.start)
        )
        print(f"{title}\n\n{folds_table(found).markdown()}", flush=True)


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
                    e.name,
                    *[number(by_start[s][i].rmse) for s in STARTS],
                    *[number(x) for x in score.coordinate_rmse],
                    *by_time(e, score),
                ]
            )
        print(Table(["record", *STARTS, *names, *spans], rows, title=str(path)).markdown())
        if isinstance(model, Discretised) and isinstance(model.continuous, LagrangianModel):
            print(by_cause(model, held).markdown())


def starts(args: argparse.Namespace) -> None:
    """What a model without errors would miss, begun at what is stored."""
    records = {e.name: e for e in tn.load(args.folder)}
    found: dict[str, list[list[float]]] = {}
    for job in sorted((args.run / "candidates" / args.candidate).glob(f"*/{SCORES}")):
        for scored in json.loads(job.read_text())["result"]["scores"]:
            model = tn.load_model(args.run / scored["model"])
            held = [records[name] for name in next(iter(scored["rmse"].values()))]
            stored, fitted = (tn.evaluate(model, held, start) for start in ("file", "model-40"))
            for e, a, b in zip(held, stored, fitted, strict=True):
                far = (a.simulated - b.simulated)[:, : e.q.shape[1]]
                apart = float(np.sqrt(np.mean(np.sum(far**2, axis=1))))
                row = [a.rmse, b.rmse, apart, np.hypot(b.rmse, apart)]
                found.setdefault(e.name, []).append(row)
    means = {name: np.mean(rows, axis=0) for name, rows in sorted(found.items())}
    means["mean"] = np.mean(list(means.values()), axis=0)
    rows = [[name, *map(number, values)] for name, values in means.items()]
    columns = ["record", "file", "model-40", "start file alone", "both, as independent errors"]
    print(Table(columns, rows, title=args.candidate).markdown())


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
    for verb in (split, starts, variants):
        sub = verbs.add_parser(verb.__name__)
        sub.add_argument("folder", type=Path)
        sub.set_defaults(verb=verb)
        if verb is split:
            sub.add_argument("models", nargs="+", type=Path)
        if verb is starts:
            sub.add_argument("run", type=Path)
            sub.add_argument("candidate")
        if verb is variants:
            sub.add_argument("--start", action="append", default=[])
    args = parser.parse_args()
    args.verb(args)


if __name__ == "__main__":
    main()
