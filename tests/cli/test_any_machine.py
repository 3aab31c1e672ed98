"""`fit` of machines of every kind, in seconds: a model, or a line that says why there is none."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from any_machine import Machine, cover_pairs, write_logs
from small_selection import GREY, HYBRID, NETWORK
from test_verbs import tustinnet

from tustinnet.store.run_folder import MODEL

LEVELS = {
    "inputs": (0, 1, 3),
    "coordinates": (1, 2, 4, 5),
    "kinds": ("linear", "angular", "mixed"),
    "has_validation": (False, True),
    "has_velocities": (False, True),
    "has_time": (False, True),
    "records": (1, 2, 5, 30),
    "hold": ("zero-order", "first-order", "band-limited", "unknown", "undeclared"),
    "is_delay_unknown": (False, True),
    "trait": (
        "plain",
        "stiff",
        "lightly damped",
        "unstable",
        "at rest",
        "still coordinate",
        "still input",
    ),
}
_SAMPLES = {1: 700, 2: 400, 5: 200, 30: 60}  # by the number of records: all take as long
_MOST = 2  # machines, which take a quarter of a minute each
_BUDGET = "15s"
_GENERATOR = np.random.default_rng(1)
MACHINES = [
    replace(machine, samples=_SAMPLES[machine.records])
    for machine in cover_pairs(LEVELS, _GENERATOR, _MOST)
]
REFUSED = {
    "a record that is too short": (Machine(records=1, samples=60), "60 samples, too few to be cut"),
    "a record that is not a number": (Machine(trait="nan"), "nan (1 such)"),
    "nothing that moves": (Machine(trait="still coordinate"), "nothing moves"),
    "no record to fit to": (Machine(records=1, has_validation=True, samples=60), "60 samples"),
}

_SHORT = (("epochs = 15", "epochs = 2"), ("count = 100", "count = 20"))


def _shortened(recipe: str) -> str:
    for before, after in _SHORT:
        assert before in recipe
        recipe = recipe.replace(before, after)
    return recipe


PLAN = """
name = "tiny"
folds = 3
scored = 1
candidates = [
    { name = "linear", recipe = "linear.toml" },
    { name = "mechanism", recipe = "mechanism.toml" },
    { name = "network", recipe = "network.toml" },
    { name = "hybrid", recipe = "hybrid.toml", corrects = ["mechanism"] },
]
"""
RECIPES = {
    "linear": 'name = "solved"\n[model]\nkind = "linear"\n',
    "mechanism": GREY.replace("[search]", 'system = "mechanism"\n[search]\niterations = 3'),
    "network": _shortened(NETWORK),
    "hybrid": _shortened(HYBRID),
}


def write_plan(folder: Path, text: str = PLAN) -> Path:
    """A plan file, and the recipes of its candidates beside it."""
    for name, recipe in RECIPES.items():
        (folder / f"{name}.toml").write_text(recipe)
    path = folder / "plan.toml"
    path.write_text(text)
    return path


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """The folder of a run."""
    return tmp_path / "out"


@pytest.mark.thorough
@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
def test_a_machine_has_a_model_or_a_line_says_why(machine: Machine, tmp_path, out, capsys):
    write_logs(machine, tmp_path / "logs")
    verb = ("fit", tmp_path / "logs", "--plan", write_plan(tmp_path), "--out", out)
    code, printed, err = tustinnet(capsys, *verb, "--no-report", "--budget", _BUDGET)
    require_words(err)
    require_words(printed)
    if code:  # on a busy processor time may be up before anything was fitted
        assert err.splitlines()[-1].startswith("error: selection: no candidate could be fitted (")
        assert "time" in err.splitlines()[-1]
        assert not (out / MODEL).exists()
        return
    assert (out / MODEL).is_file()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["best"] in {c["name"] for c in summary["candidates"] if "folds" in c}
    assert all("folds" in c or c["why"] for c in summary["candidates"])
    assert machine.inputs or "holds and delays" not in err


@pytest.mark.parametrize(("machine", "words"), REFUSED.values(), ids=list(REFUSED))
def test_records_that_cannot_be_used_are_refused_in_a_line(machine, words, tmp_path, out, capsys):
    write_logs(machine, tmp_path / "logs")
    code, printed, err = tustinnet(capsys, "fit", tmp_path / "logs", "--out", out)
    assert (code, printed) == (1, "")
    require_words(err)
    assert "searched for" not in err  # no time is spent before
    assert err.splitlines()[-1].startswith("error: ")
    assert words in err.splitlines()[-1]
    assert not (out / MODEL).exists()


def require_words(text: str) -> None:
    """Raises if output shows an error of the program, or a sentence twice."""
    assert not re.search(r"Traceback|Warning|\w+Error:", text), text
    lines = [line for line in text.splitlines() if line.strip() and not re.search(r"fold \d", line)]
    assert len(set(lines)) == len(lines), text


# --- plans and systems that do not fit ---

ONE = """
name = "one"
folds = 3
scored = 1
candidates = [{ name = "only", recipe = "NAME" }]
"""
SYSTEM = """
import jax.numpy as jnp
import tustinnet as tn

SYSTEM = tn.LagrangianSystem(
    name="spring",
    coordinates=(tn.Coordinate("q0", "linear"),),
    inputs=(tn.Input("u0", "V", hold="zero-order"),),
    parameters=(
        tn.Parameter("stiffness", "1/s^2", 20.0, 1.0, 100.0),
        tn.Parameter("damping", "1/s", 1.0, 0.01, 10.0),
        tn.Parameter("gain", "m/s^2/V", 10.0, 1.0, 50.0),
    ),
    kinetic=lambda q, v, p: 0.5 * v[0] ** 2,
    potential=lambda q, p: 0.5 * p["stiffness"] * q[0] ** 2,
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=lambda q, v, u, p: p["gain"] * u,
)
"""


def test_a_plan_in_which_nobody_can_take_part_is_refused(tmp_path, out, capsys):
    write_logs(Machine(), tmp_path / "logs")
    plan = write_plan(tmp_path, ONE.replace("NAME", "best-grey"))
    code, _, err = tustinnet(capsys, "fit", tmp_path / "logs", "--plan", plan, "--out", out)
    assert code == 1
    assert err == (
        "error: plan 'one': left out, requires a system (--system): only; "
        "expected a candidate that can take part\n"
    )
    assert not (out / MODEL).exists()


@pytest.mark.thorough
def test_where_every_candidate_fails_each_is_told_and_nothing_is_saved(tmp_path, out, capsys):
    write_logs(Machine(coordinates=7), tmp_path / "logs")
    two = ONE.replace('"NAME" }', '"mechanism.toml" }, { name = "other", recipe = "mechanism" }')
    plan = write_plan(tmp_path, two)
    code, printed, err = tustinnet(capsys, "fit", tmp_path / "logs", "--plan", plan, "--out", out)
    assert (code, printed) == (1, "")
    require_words(err)
    assert err.startswith("error: plan 'one': left out, system 'mechanism': 7 coordinates; ")
    assert "only, other" in err
    assert "--budget" not in err  # more time would not help
    assert not list(out.rglob(MODEL))
    assert not (out / "summary.json").exists()


@pytest.mark.thorough
def test_a_horizon_longer_than_every_record_is_whole_records(tmp_path, out, capsys):
    write_logs(Machine(samples=200), tmp_path / "logs")
    plan = write_plan(tmp_path, "horizon = 1000.0\n" + ONE.replace("NAME", "linear.toml"))
    verb = ("fit", tmp_path / "logs", "--plan", plan, "--out", out, "--no-report")
    code, printed, err = tustinnet(capsys, *verb)
    assert code == 0, err
    require_words(err)
    assert "chosen: only" in printed
    assert "no record is longer than the plan's horizon of 1000 s: judged over whole records" in err


@pytest.mark.thorough
def test_the_hold_of_the_card_counts_and_that_of_the_system_is_told(tmp_path, out, capsys):
    write_logs(Machine(hold="first-order", samples=200), tmp_path / "logs")
    system = tmp_path / "spring.py"
    system.write_text(SYSTEM)
    plan = write_plan(tmp_path, ONE.replace('"NAME"', '"best-grey"'))
    verb = ("fit", tmp_path / "logs", "--plan", plan, "--system", system, "--out", out)
    code, printed, err = tustinnet(capsys, *verb, "--no-report")
    assert code == 0, err
    require_words(err)
    told = "hold of 'u0': first-order as in the data card, not zero-order as in the system"
    assert err.count(told) == 1
    assert "chosen: only" in printed
    code, printed, err = tustinnet(capsys, "show", out / MODEL)
    assert code == 0, err
    assert "first-order" in printed
    code, _, err = tustinnet(capsys, "evaluate", out / MODEL, tmp_path / "logs", "--json")
    assert code == 0, err
