"""`fit` of machines of every kind, in seconds: a model, or a line that says why there is none."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from any_machine import Machine, cover_pairs, write_logs
from small_selection import GREY, HYBRID, NETWORK
from test_verbs import tustinnet

LEVELS = {
    "inputs": (0, 1, 3),
    "coordinates": (1, 2, 4, 7),
    "kinds": ("linear", "angular", "mixed"),
    "has_validation": (False, True),
    "has_velocities": (False, True),
    "has_time": (False, True),
    "records": (1, 2, 5, 30),
    "samples": (60, 320, 2000),
    "hold": ("zero-order", "first-order", "band-limited", "unknown", "undeclared"),
    "is_delay_unknown": (False, True),
    "trait": ("plain", "stiff", "lightly damped", "unstable", "at rest", "still coordinate",
              "still input", "nan"),
}  # fmt: skip
_MOST = 14  # machines: more take more than a minute
MACHINES = cover_pairs(LEVELS, np.random.default_rng(1), _MOST)

_NETWORK = NETWORK.replace("epochs = 60", "epochs = 3").replace("count = 100", "count = 20")
PLAN = """
name = "tiny"
folds = 3
candidates = [
    { name = "linear", recipe = "linear.toml" },
    { name = "mechanism", recipe = "mechanism.toml" },
    { name = "network", recipe = "network.toml" },
    { name = "hybrid", recipe = "hybrid.toml", corrects = ["mechanism"] },
]
committees = [{ name = "best two", best = 2 }]
rounds = [{ folds = 1, keep = 1.0 }, { folds = 2, keep = 0.6 }, { folds = 3 }]
"""
RECIPES = {
    "linear": _NETWORK.replace("hidden = [6]", 'kind = "linear"'),
    "mechanism": GREY.replace("[search]", 'system = "mechanism"\n[search]'),
    "network": _NETWORK,
    "hybrid": HYBRID.replace("epochs = 60", "epochs = 3").replace("count = 100", "count = 20"),
}


def write_plan(folder: Path, text: str = PLAN) -> Path:
    """A plan file, and the recipes of its candidates beside it."""
    for name, recipe in RECIPES.items():
        (folder / f"{name}.toml").write_text(recipe)
    path = folder / "plan.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
def test_a_model_or_a_line(machine: Machine, tmp_path, capsys):
    logs, out = tmp_path / "logs", tmp_path / "out"
    write_logs(machine, logs)
    verb = ("fit", logs, "--plan", write_plan(tmp_path), "--out", out, "--no-report")
    code, printed, err = tustinnet(capsys, *verb, "--budget", "6s")
    print(code, printed, err)
    check_messages(err)
    if code == 0:
        assert (out / "model.safetensors").is_file()
        summary = json.loads((out / "summary.json").read_text())
        assert summary["best"] in {c["name"] for c in summary["candidates"] if "folds" in c}
    else:
        assert err.splitlines()[-1].startswith("error: ")
        assert not any((out / name).exists() for name in ("model.safetensors", "summary.json"))


def check_messages(err: str) -> None:
    """Raises if messages show an error of the program, or a sentence twice."""
    assert not re.search(r"Traceback|Warning|\w+Error:", err), err
    lines = [line for line in err.splitlines() if not re.search(r"fold \d|records: ", line)]
    assert len(set(lines)) == len(lines), err
