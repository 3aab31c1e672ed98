"""How many records of another device does a fitted model need, and how many a new one?

    python benchmarks/another_device.py [--devices 3] [--sizes 1,2,4,8,15] [--figure FILE]

Twins of the rotary pendulum whose masses, cable and frictions are each 20 % more or less than those
of the first: the signs are drawn, for every device anew. Models of the first device, fitted to 21
records, go on with few records of the other (as `fit --from` does), beside models that begin
anew. All are scored on the 6 validation records of the other device, which nothing is fitted to.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)

import numpy as np
from rich.console import Console

import tustinnet as tn
from tustinnet.evaluate.folds import Question, make_question
from tustinnet.evaluate.learning import (
    ENOUGH,
    LearningCurve,
    Maybe,
    Place,
    identified,
    scored,
    trained,
)
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.task import Origin
from tustinnet.report.figures import write_figure
from tustinnet.report.learning import learning_figure, learning_table
from tustinnet.report.progress import FitProgress
from tustinnet.systems.qube_servo2_twin import TWIN_VALUES, twin

RECIPES = Path(__file__).parent / "recipes"
OFF = 0.2
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


def places_of(devices: int, sizes: tuple[int, ...]) -> list[Place]:
    """Every device with every number of its records."""
    found = []
    for device in range(devices):
        data = another(device)
        records = data.split("train")
        order = np.random.default_rng(device).permutation(len(records))
        mixed, left = tuple(records[int(i)] for i in order), tuple(data.split("validation"))
        found += [Place(device, n, mixed[:n], left) for n in sizes]
    return found


def first_device() -> Place:
    """All records of the first device but those of its test split."""
    known = [e for e in twin(0) if e.split != "test"]
    return Place(0, len(known), tuple(known), ())


def begun(question: Question, origin: tn.Model) -> Question:
    """The same identification, beginning at the values of another."""
    assert question.physics is not None
    family, table = question.physics.family, question.physics.model
    there = family.beginning(table, origin, question.system)
    return Question(question.recipe, question.physics.model_copy(update={"model": there}),
                    question.system)  # fmt: skip


def model_of(of: Maybe) -> tn.Model:
    """The model that came out."""
    assert isinstance(of, FitResult), of
    return of.model


def fits(places: list[Place], network: tn.Recipe, question: Question) -> dict[str, list[Maybe]]:
    """What every way to a model came to, a fit a place."""
    first, n = [first_device()], len(places)
    with FitProgress(Console(stderr=True, soft_wrap=True)) as progress:
        tell: Any = progress.follow
        ours = model_of(identified(first, question, tell)[0])
        net = Origin(model_of(trained(first, network, tell=tell)[0]))
        both = trained(first, question.recipe, physics=[ours], tell=tell)
        hybrid = Origin(model_of(both[0]))
        anew = identified(places, question, tell)
        theirs = [model_of(of) if isinstance(of, FitResult) else None for of in anew]
        return {
            "network, anew": trained(places, network, tell=tell),
            "network, from": trained(places, network, origins=[net] * n, tell=tell),
            "grey box, anew": anew,
            "grey box, from": identified(places, begun(question, ours), tell),
            "hybrid, anew": trained(places, question.recipe, physics=theirs, tell=tell),
            "hybrid, from": trained(
                places, question.recipe, physics=[ours] * n, origins=[hybrid] * n, tell=tell
            ),
            "hybrid, from, physics anew": trained(
                places, question.recipe, physics=theirs, origins=[hybrid] * n, tell=tell
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
    asked.add_argument("--devices", type=int, default=3)
    asked.add_argument("--sizes", default="1,2,4,8,15")
    asked.add_argument("--system", default="qube-servo2")
    asked.add_argument("--start", default="model-20")
    asked.add_argument("--network", default=str(RECIPES / "short-network.toml"))
    asked.add_argument("--hybrid", default=str(RECIPES / "short-hybrid.toml"))
    asked.add_argument("--out", type=Path, default=Path("results/another_device.json"))
    asked.add_argument("--figure", type=Path, default=Path("results/another_device.png"))
    given = asked.parse_args()
    sizes = tuple(map(int, given.sizes.split(",")))
    places = places_of(given.devices, sizes)
    question = make_question(given.hybrid, system=given.system)
    found = fits(places, tn.read_recipe(given.network), question)
    points = [p for name, of in found.items() for p in scored(name, places, of, given.start)]
    left_out = tuple(len(p.scored) for p in places if p.size == sizes[0])
    curve = LearningCurve("rad", given.start, sizes, tuple(points), left_out)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(json.dumps(curve.as_plain(), indent=1))
    write_figure(learning_figure(curve), given.figure.parent, given.figure.name)
    print(learning_table(curve).markdown())
    for kind in ("network", "grey box", "hybrid"):
        print(f"* {told(curve, f'{kind}, anew', f'{kind}, from')}")
    print(f"* {told(curve, 'hybrid, anew', 'hybrid, from, physics anew')}")


if __name__ == "__main__":
    main()
