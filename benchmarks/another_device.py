"""How many records of another device does a fitted model need, and how many a new one?

    python benchmarks/another_device.py network [--devices 3] [--sizes 1,2,4,15] [--figure FILE]
    python benchmarks/another_device.py physics ...

Twins of the rotary pendulum whose masses, cable and frictions are each 20 % more or less than those
of the first: the signs are drawn, for every device anew. Models of the first device, fitted to 21
records, go on with few records of the other (as `fit --from` does), beside models that begin
anew. All are scored on the 6 validation records of the other device, which nothing is fitted to.
"""

import argparse
import json
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)

import numpy as np
from draws import Draw, DrawFitter, DrawResult, make_points
from rich.console import Console

import tustinnet as tn
from tustinnet.report.drawing import write_figure
from tustinnet.report.learning import learning_figure, learning_table
from tustinnet.report.progress import FitProgress
from tustinnet.selection.cross_validation import (
    CrossValidationOptions,
    make_cross_validation_options,
)
from tustinnet.selection.learning import ENOUGH, LearningCurve
from tustinnet.systems.qube_servo2_twin import TWIN_VALUES, twin

Results = dict[str, list[DrawResult]]

RECIPES = Path(__file__).parent / "recipes"
OFF = 0.2
GENTLE = ["stages.*.rate=3e-4"]  # the first rate spoils what the network has learnt
PARTS = {
    "mass": ("arm_mass", "pendulum_mass"),
    "cable": ("cable_stiffness", "cable_quadratic", "cable_cubic", "cable_memory"),
    "friction": ("arm_damping", "pendulum_damping", "arm_friction"),
}


def another(device: int) -> tn.DataSet:
    """The records of a device that differs."""
    signs = np.random.default_rng(device).choice([-1, 1], len(PARTS))
    values = dict(TWIN_VALUES)
    for sign, names in zip(signs, PARTS.values(), strict=True):
        values |= {name: (1 + OFF * sign) * values[name] for name in names}
    told = ", ".join(f"{part} {100 * OFF * s:+.0f} %" for part, s in zip(PARTS, signs, strict=True))
    print(f"device {device}: {told}")
    return twin(100 + device, values=values)


def draw_records(devices: int, sizes: tuple[int, ...]) -> list[Draw]:
    """Every device with every number of its records."""
    draws = []
    for device in range(devices):
        data = another(device)
        records = data.split("train")
        order = np.random.default_rng(device).permutation(len(records))
        mixed, left = tuple(records[int(i)] for i in order), tuple(data.split("validation"))
        draws += [Draw(device, n, mixed[:n], left) for n in sizes]
    return draws


def first_device() -> Draw:
    """All records of the first device but those of its test split."""
    known = [e for e in twin(0) if e.split != "test"]
    return Draw(0, len(known), tuple(known), ())


def model_of(result: DrawResult) -> tn.Model:
    """The model of a fit that succeeded."""
    assert result.model is not None, result.outcome
    return result.model


def score(draws: list[Draw], model: tn.Model, start: str) -> list[DrawResult]:
    """A model as it is, scored on the records that each draw leaves out."""
    by_draw = [tn.evaluate(model, draw.scored, start) for draw in draws]
    rmse = [{s.experiment: s.rmse for s in scores} for scores in by_draw]
    return [DrawResult(model, "finished", of_draw) for of_draw in rmse]


def networks(draws: list[Draw], network: tn.Recipe, gentle: tn.Recipe, start: str) -> Results:
    """Results of networks, a fit a draw: anew, gone on with, and as the first device had it."""
    with FitProgress(Console(stderr=True, soft_wrap=True)) as progress:
        fitter = DrawFitter(twin(0), start, progress.listener())
        first = model_of(fitter.train([first_device()], network)[0])
        return {
            "network, anew": fitter.train(draws, network),
            "network, from": fitter.train(draws, gentle, origins=[first] * len(draws)),
            "network of the first device": score(draws, first, start),
        }


def with_physics(draws: list[Draw], options: CrossValidationOptions, start: str) -> Results:
    """Results of grey boxes and hybrids, a fit a draw."""
    first, n, recipe, system = [first_device()], len(draws), options.physics, options.system
    assert recipe is not None
    with FitProgress(Console(stderr=True, soft_wrap=True)) as progress:
        fitter = DrawFitter(twin(0), start, progress.listener())
        ours = model_of(fitter.identify(first, recipe, system)[0])
        hybrid = model_of(fitter.train(first, options.recipe, physics=[ours])[0])
        anew = fitter.identify(draws, recipe, system)
        theirs = [result.model for result in anew]
        from_ours = recipe.from_model(ours, system)
        return {
            "grey box, anew": anew,
            "grey box, from": fitter.identify(draws, from_ours, system),
            "hybrid, anew": fitter.train(draws, options.recipe, physics=theirs),
            "hybrid, from": fitter.train(
                draws, options.recipe, physics=[ours] * n, origins=[hybrid] * n
            ),
            "hybrid, from, physics anew": fitter.train(
                draws, options.recipe, physics=theirs, origins=[hybrid] * n
            ),
        }


def told(curve: LearningCurve, before: str, after: str) -> str:
    """From how many records on a model that goes on is as good as one anew with all."""
    enough = []
    for device in range(len(curve.scored)):
        goal = ENOUGH * curve.by_draw(before, curve.sizes[-1])[device]
        reached = [n for n in curve.sizes if curve.by_draw(after, n)[device] <= goal]
        enough.append(str(reached[0]) if reached else "never")
    most = curve.sizes[-1]
    return f"{after}: within 10 % of {before} with {most} from {', '.join(enough)} records on"


def main() -> None:
    """Reads the arguments, fits, prints."""
    asked = argparse.ArgumentParser()
    asked.add_argument("what", choices=("network", "physics"))
    asked.add_argument("--devices", type=int, default=3)
    asked.add_argument("--sizes", default="1,2,4,15")
    asked.add_argument("--system", default="qube-servo2")
    asked.add_argument("--start", default="model-20")
    asked.add_argument("--network", default=str(RECIPES / "long-network.toml"))
    asked.add_argument("--hybrid", default="hybrid")
    asked.add_argument("--out", type=Path, default=Path("results/another_device.json"))
    asked.add_argument("--figure", type=Path, default=Path("results/another_device.png"))
    given = asked.parse_args()
    sizes = tuple(map(int, given.sizes.split(",")))
    draws = draw_records(given.devices, sizes)
    if given.what == "network":
        anew, gentle = (tn.read_recipe(given.network, changes) for changes in ((), GENTLE))
        found = networks(draws, anew, gentle, given.start)
    else:
        options = make_cross_validation_options(given.hybrid, system=given.system)
        found = with_physics(draws, options, given.start)
    points = [p for name, of in found.items() for p in make_points(name, draws, of)]
    left_out = tuple(len(d.scored) for d in draws if d.size == sizes[0])
    curve = LearningCurve("rad", given.start, sizes, tuple(points), left_out)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(json.dumps(curve.as_plain(), indent=1))
    write_figure(learning_figure(curve), given.figure.parent, given.figure.name)
    print(learning_table(curve).markdown())
    for kind in ("network", "grey box", "hybrid"):
        if f"{kind}, from" in found:
            print(f"* {told(curve, f'{kind}, anew', f'{kind}, from')}")


if __name__ == "__main__":
    main()
