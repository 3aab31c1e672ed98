"""Verbs on logs of a closed loop, whose card says what the controller was."""

import json
from pathlib import Path

import pytest
from held_swings import held_swings
from test_verbs import tustinnet

from tustinnet.store.data_set_folder import write_data_set

SYSTEM = """
import jax.numpy as jnp
import tustinnet as tn

SYSTEM = tn.LagrangianSystem(
    name="swing",
    coordinates=(tn.Coordinate("angle", "angular"),),
    inputs=(tn.Input("voltage", "V"),),
    parameters=(
        tn.Parameter("inertia", "kg m^2", 0.05, 0.01, 0.2, fixed=True),
        tn.Parameter("damping", "N m s", 0.04, 1e-3, 1.0),
        tn.Parameter("gravity", "N m", 1.0, 0.1, 10.0),
        tn.Parameter("gain", "N m/V", 0.1, 0.01, 1.0),
    ),
    kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2,
    potential=lambda q, p: -p["gravity"] * jnp.cos(q[0] - 0.4),
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=lambda q, v, u, p: p["gain"] * u,
)
"""


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("held")
    write_data_set(held_swings(3, kd=None), folder, "Held upright")
    (folder / "swing.py").write_text(SYSTEM)
    return folder


@pytest.mark.thorough
def test_fit_evaluate_and_simulate_in_the_loop(logs, tmp_path, capsys):
    run, system = tmp_path / "run", logs / "swing.py"
    code, out, err = tustinnet(
        capsys, "fit", logs, "--recipe", "grey", "--system", system, "--out", run, "--no-report"
    )
    assert code == 0, err
    assert "the controller of the data card is in the loop" in out
    summary = json.loads((run / "summary.json").read_text())
    assert "angle.kd" in {e["name"] for e in summary["identification"]["estimates"]}
    assert summary["identification"]["fixed"]["angle.kp"] == 40.0
    assert summary["horizon"] is None
    model = run / "model.safetensors"
    code, out, err = tustinnet(
        capsys, "evaluate", model, logs, "--split", "validation", "--system", system, "--json"
    )
    assert code == 0, err
    assert "whole" not in err
    code, out, err = tustinnet(
        capsys,
        "simulate",
        model,
        logs,
        "--split",
        "validation",
        "--system",
        system,
        "--out",
        tmp_path / "runs",
    )
    assert code == 0, err
    # a card without the controller is of another system
    plain = (logs / "dataset.toml").read_text().partition("[controller]")[0]
    card = tmp_path / "plain.toml"
    card.write_text(plain.replace("column = 6", "column = 1"))
    code, _, err = tustinnet(capsys, "evaluate", model, logs, "--card", card, "--system", system)
    assert code == 1
    assert err.strip().endswith("check the table [controller] of the data card")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ('kind = "pd"', 'kind = "lqr"'),
            "controller.kind: Input should be 'pd' or 'pid' (got 'lqr')",
        ),
        (('coordinate = "angle"', 'coordinate = "elbow"'), "no coordinate 'elbow'; expected one"),
        (("kp = 40.0", "kp = -40.0"), "controller.loops.0.kp: Input should be greater than"),
        (("kp = 40.0", "kp = nan"), "controller.loops.0.kp: Input should be a finite number"),
        (("position = 1", "position = 9"), "6 columns; expected a column 9 as in the card"),
    ],
)
def test_what_is_wrong_in_the_table_is_one_line(change, words, logs, tmp_path, capsys):
    text = (logs / "dataset.toml").read_text()
    assert change[0] in text
    card = tmp_path / "dataset.toml"
    card.write_text(text.replace(*change))
    code, _, err = tustinnet(capsys, "inspect", logs, "--card", card)
    assert code == 1
    lines = err.strip().splitlines()
    assert len(lines) == 1
    assert words in lines[0]


def test_kinds_of_models_without_use_for_it_are_named(logs, tmp_path, capsys):
    code, _, err = tustinnet(capsys, "fit", logs, "--recipe", "standard", "--out", tmp_path / "net")
    assert code == 1
    assert "[controller]: not applicable to models of kind 'tustin-net' (recipe 'standard')" in err
    # a selection without a system has nothing to try
    code, _, err = tustinnet(capsys, "fit", logs, "--out", tmp_path / "all")
    assert code == 1
    assert "left out, without the controller of the data card: " in err
    code, _, err = tustinnet(
        capsys, "cross-validate", logs, "--recipe", "linear", "--out", tmp_path / "folds"
    )
    assert code == 1
    assert "[controller]: not applicable to models of kind 'linear'" in err
