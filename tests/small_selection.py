"""Records, recipes and a plan for selections that take seconds."""

from pathlib import Path

from swinging import falls, noises, read_by_encoder, simulated, voltage

import tustinnet as tn

NETWORK = """
name = "small"
[model]
hidden = [6]
[[stages]]
name = "only"
windows = { draw = "strided", length = 20, count = 100 }
rate = 1e-2
epochs = 15
batch = 16
"""
HYBRID = NETWORK.replace("hidden = [6]", 'kind = "hybrid"\ncorrection = { hidden = [4] }')
GREY = """
name = "short-grey"
[model]
kind = "euler-lagrange"
[search]
initial = "anchored"
substeps = 1
"""
PLAN = """
name = "small"
folds = 3
keep = 1.0
start = "model-10"

[[candidates]]
name = "grey"
recipe = "grey.toml"

[[candidates]]
name = "network"
recipe = "small.toml"

[[candidates]]
name = "hybrid"
recipe = "hybrid.toml"
corrects = ["grey"]
"""
NETWORK_ONLY = """
name = "network only"
folds = 3
start = "model-10"
candidates = [{ name = "network", recipe = "small.toml" }]
"""


def swings() -> tn.DataSet:
    """Five records of the swing as an encoder reads them."""
    fifth = simulated("noise3", [-0.4, 0.5], voltage(180, 3))
    made = [read_by_encoder(e) for e in (*falls(), *noises(), fifth)]
    return tn.DataSet("swing", tuple(made))


def plan_in(folder: Path, text: str = PLAN) -> Path:
    """A plan file, and the recipes of its candidates beside it."""
    for name, recipe in (("small", NETWORK), ("hybrid", HYBRID), ("grey", GREY)):
        (folder / f"{name}.toml").write_text(recipe)
    path = folder / "plan.toml"
    path.write_text(text)
    return path
