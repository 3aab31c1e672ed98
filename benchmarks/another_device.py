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
from typing import Any

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)

import numpy as np
from rich.console import Console

import tustinnet as tn
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.task import Origin
from tustinnet.report.figures import write_figure
from tustinnet.report.learning import learning_figure, learning_table
from tustinnet.report.progress import FitProgress
from tustinnet.selection.cross_validation import Question, make_cross_validation_options
from tustinnet.selection.learning import (
    ENOUGH,
    LearningCurve,
    Maybe,
    Place,
    identified,
    scored,
    trained,
)
from tustinnet.systems.qube_servo2_twin import TWIN_VALUES, twin

Found = dict[str, list[Maybe]]

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


def networks(places: list[Place], network: tn.Recipe, gentle: tn.Recipe) -> Found:
    """What networks came to, a fit a place: anew, gone on with, and as the first device had it."""
    with FitProgress(Console(stderr=True, soft_wrap=True)) as progress:
        tell: Any = progress.follow
        first = trained([first_device()], network, tell=tell)[0]
        origins = [Origin(model_of(first))] * len(places)
        return {
            "network, anew": trained(places, network, tell=tell),
            "network, from": trained(places, gentle, origins=origins, tell=tell),
            "network of the first device": [first] * len(places),
        }


def with_physics(places: list[Place], question: Question) -> Found:
    """What grey boxes and hybrids came to, a fit a place."""
    first, n = [first_device()], len(places)
    with FitProgress(Console(stderr=True, soft_wrap=True)) as progress:
        tell: Any = progress.follow
        ours = model_of(identified(first, question, tell)[0])
        both = trained(first, question.recipe, physics=[ours], tell=tell)
        hybrid = Origin(model_of(both[0]))
        anew = identified(places, question, tell)
        theirs = [model_of(of) if isinstance(of, FitResult) else None for of in anew]
        return {
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
    places = places_of(given.devices, sizes)
    if given.what == "network":
        recipes = (tn.read_recipe(given.network, changes) for changes in ((), GENTLE))
        found = networks(places, *recipes)
    else:
        found = with_physics(
            places, make_cross_validation_options(given.hybrid, system=given.system)
        )
    points = [p for name, of in found.items() for p in scored(name, places, of, given.start)]
    left_out = tuple(len(p.scored) for p in places if p.size == sizes[0])
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
