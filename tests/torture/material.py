"""What is damaged, killed and loaded: small records, recipes, one model of every family."""

import shutil
import tomllib
from functools import cache
from pathlib import Path

import h5py
import jax
import numpy as np
import polars as pl
import scipy.io
from conftest import CARD, SMALL_RECIPE, record, write_folder

import tustinnet as tn
from tustinnet.data.catalog import QUBE_SERVO2
from tustinnet.families.linear import FAMILY, LinearHyper
from tustinnet.fits.request import FitRequest, PreparedFit, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.task import make_task
from tustinnet.models.contract import Model
from tustinnet.registry import FAMILIES

from .pendulum import SYSTEM

SYSTEM_FILE = Path(__file__).with_name("pendulum.py")
KINDS = {
    "tustin-net": "hidden = [8, 6]\nstem = 5",
    "gru": "hidden = 6\nwarm_up = 8",
    "neural-ode": "hidden = [8]",
    "hybrid": 'correction = { kind = "tustin-net", hidden = [8, 6] }',
}  # every family that trains, and what its table [model] says

SEARCH = """
name = "search"
[model]
kind = "euler-lagrange"
fixed = { gain = 2.0 }
begin = { gravity = 9.0 }
[search]
initial = "anchored"
tolerance = 1e-4
iterations = 10
"""

_NETWORK = """
name = "small"
[model]
hidden = [6]
[[stages]]
name = "only"
windows = { draw = "strided", length = 20, count = 60 }
rate = 1e-2
epochs = 8
batch = 16
"""
SELECTION = {
    "tustin-net-short.toml": _NETWORK,
    "linear-short.toml": 'name = "solved"\n[model]\nkind = "linear"\n',
    "plan.toml": """
name = "small"
folds = 3
keep = 1.0
start = "model-10"
[[candidates]]
name = "linear"
recipe = "linear-short.toml"
[[candidates]]
name = "network"
recipe = "tustin-net-short.toml"
""",
}  # recipes and a plan of a selection that takes seconds


def recipe(kind: str) -> str:
    """The two short stages of the tests' recipe, for a family."""
    name, stages = SMALL_RECIPE.split("[model]")[0], SMALL_RECIPE.partition("[[stages]]")[2]
    stages = stages.replace("frozen_layers = 1", "")
    return f'{name}[model]\nkind = "{kind}"\n{KINDS[kind]}\n[[stages]]{stages}'


@cache
def records() -> tn.DataSet:
    """The records that the tests' data card names, shorter."""
    return tn.DataSet(
        "pendulum",
        (
            record("fall1", 80, 1, "train"),
            record("fall2", 70, 2, "train"),
            record("noise1", 60, 3, "train", forced=True),
            record("fall3", 60, 4, "validation"),
            record("noise2", 50, 5, "validation", forced=True),
        ),
    )


def physics() -> Model:
    """The identified pendulum."""
    return tn.discretise(SYSTEM.model(SYSTEM.nominal()), 0.02, 2)


def model(kind: str) -> Model:
    """An untrained model of a family that trains."""
    of = physics() if kind == "hybrid" else None
    task = make_task(records(), tomllib.loads(recipe(kind)), physics=of)
    fold = task.folds[0]
    build = FAMILIES[kind].builder(task.recipe.model, fold.roles.train, "auto", fold.physics)
    return build(jax.random.key(7))


def card(*lists: str) -> str:
    """The tests' data card with other lists of files."""
    return "\n".join([CARD.partition("[splits]")[0] + "[splits]", *lists])


def write_logs(place: Path) -> None:
    """One record in every format that can be read."""
    e = records()[2]
    table = {"time": e.t, "angle": np.rad2deg(e.q[:, 0]), "torque": e.u[:, 0]}
    place.mkdir(parents=True)
    pl.DataFrame(table).write_csv(place / "log.csv")
    pl.DataFrame(table).write_parquet(place / "log.parquet")
    np.savez_compressed(place / "log.npz", allow_pickle=False, **table)
    scipy.io.savemat(place / "log.mat", table, do_compression=True)
    with h5py.File(place / "log73.mat", "w", userblock_size=512) as file:
        for name, column in table.items():
            file[name] = column[None, :]
    head = b"MATLAB 7.3 MAT-file".ljust(124) + (0x0200).to_bytes(2, "little") + b"IM"
    with (place / "log73.mat").open("r+b") as file:
        file.write(head)


def write_published(place: Path) -> None:
    """Short records that go by the names of the published ones."""
    generator, t = np.random.default_rng(0), 0.01 * np.arange(120)
    for file in QUBE_SERVO2.checksums():
        path = place / file
        path.parent.mkdir(parents=True, exist_ok=True)
        u = generator.uniform(-2, 2, len(t)) if "wN" in file else np.zeros(len(t))
        q = np.column_stack([0.3 * np.sin(3 * t), np.pi + np.exp(-t) * np.cos(8 * t)])
        v = np.gradient(q, 0.01, axis=0)
        v[:3] = v[-2:] = 0.0
        np.savetxt(path, np.column_stack([u, q, t, v]), delimiter=",")


def write_all(place: Path) -> None:
    """Everything that is damaged: logs, models, a finished run."""
    shutil.rmtree(place, ignore_errors=True)
    write_logs(place)
    for kind in KINDS:
        tn.save(model(kind), place / f"{kind}.safetensors")
    train = records().split("train")
    linear = FAMILY.one_step_model(LinearHyper(kind="linear", internal=1), [*train], "auto")
    tn.save(linear, place / "linear.safetensors")
    tn.save(physics(), place / "euler-lagrange.safetensors")
    (place / "recipe.toml").write_text(recipe("tustin-net"))
    (place / "search.toml").write_text(SEARCH)
    shutil.copy(SYSTEM_FILE, place)
    write_folder(records(), place / "logs")
    run_fit(fit_of(place), place / "run")


def fit_of(place: Path) -> PreparedFit:
    """The fit of the finished run."""
    return prepare(FitRequest(tn.load(place / "logs"), place / "recipe.toml"))
