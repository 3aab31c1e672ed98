"""The command on records without inputs, as of a free pendulum."""

import json

import numpy as np
from free_swings import free_swings
from small_selection import plan_in
from test_verbs import tustinnet

SYSTEM = """
import jax.numpy as jnp
import tustinnet as tn
SYSTEM = tn.LagrangianSystem(
    name="free pendulum",
    coordinates=(tn.Coordinate("angle", "angular"),),
    inputs=(),
    parameters=(
        tn.Parameter("gravity", "1/s^2", 20.0, 1.0, 200.0),
        tn.Parameter("damping", "1/s", 0.3, 0.01, 5.0),
    ),
    kinetic=lambda q, v, p: v[0] ** 2 / 2,
    potential=lambda q, p: -p["gravity"] * jnp.cos(q[0]),
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=None,
)
"""
CARD = """
name = "free"
dt = 0.02
[[coordinates]]
name = "angle"
kind = "angular"
column = "angle"
unit = "rad"
counts_per_revolution = 6283
[splits]
"""


PLAN = """
name = "two"
folds = 3
scored = 1
start = "model-10"
candidates = [
  { name = "grey", recipe = "grey.toml" },
  { name = "network", recipe = "small.toml" },
]
"""


def test_the_command_chooses_and_judges_on_them(tmp_path, capsys):
    logs, out = tmp_path / "logs", tmp_path / "run"
    logs.mkdir()
    for e in free_swings((None,) * 4):
        np.savetxt(logs / f"{e.name}.csv", e.q, header="angle", comments="", fmt="%.6f")
    (logs / "dataset.toml").write_text(CARD + 'train = ["*.csv"]\n')
    (tmp_path / "free.py").write_text(SYSTEM)
    plan, system = plan_in(tmp_path, PLAN), tmp_path / "free.py"
    verb = ("fit", logs, "--plan", plan, "--budget", "5min", "--out", out, "--system", system)
    verb += ("--no-report",)
    code, printed, err = tustinnet(capsys, *verb)
    assert code == 0, err
    assert "* chosen: " in printed
    found = json.loads((out / "summary.json").read_text())["candidates"]
    assert {c["name"] for c in found} == {"grey", "network"}
    assert all(len(c["folds"]) == 1 for c in found), err
    model = out / "model.safetensors"
    for more in (
        ("evaluate", model, logs, "--ahead", "3", "--residuals"),
        ("evaluate", model, model, logs),
        ("show", model),
        ("simulate", model, logs, "--out", tmp_path / "simulated"),
        ("report", model, logs, "--out", tmp_path / "page.html"),
    ):
        code, _, err = tustinnet(capsys, *more)
        assert code == 0, (more, err)
