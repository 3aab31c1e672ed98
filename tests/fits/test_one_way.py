"""The one way to fit: the command and Python return the same from the same card and recipe."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import CARD, COUNT, DT

import tustinnet as tn
from tustinnet.cli.main import run

SAMPLES, STEPS = 160, 10
QUICK = ("search.refine=none", "search.horizon=1.0")


def write_random_machine(folder: Path, seed: int, *, first_order: bool, declared: str) -> float:
    """Writes records of a random pendulum; returns its gravity by its inertia [1/s^2].

    The torque between two samples is held or a straight line; the card says so or says nothing.
    """
    rng = np.random.default_rng(seed)
    gravity, damping, gain = rng.uniform(10, 30), rng.uniform(0.3, 1.0), rng.uniform(2, 5)
    folder.mkdir()
    for name in ("fall1", "fall2", "noise1", "fall3", "noise2"):
        u = np.repeat(rng.uniform(-3, 3, SAMPLES // 4), 4)
        x, rows, h = np.array([rng.uniform(-0.5, 0.5), 0.0]), [], DT / STEPS
        for k in range(SAMPLES):
            rows.append((k * DT, np.rad2deg(np.round(x[0] / COUNT) * COUNT), u[k]))
            ahead = u[min(k + 1, SAMPLES - 1)] if first_order else u[k]
            for i in range(STEPS):
                torque = u[k] + (ahead - u[k]) * (i + 0.5) / STEPS

                def rate(x: np.ndarray, torque: float = torque) -> np.ndarray:
                    return np.array(
                        [x[1], -gravity * np.sin(x[0]) - damping * x[1] + gain * torque]
                    )

                x = x + h * rate(x + h / 2 * rate(x))
        text = "time,angle,torque\n" + "\n".join(f"{t:.3f},{q:.17g},{v:.17g}" for t, q, v in rows)
        (folder / f"{name}.csv").write_text(text + "\n")
    timing = 'hold = "zero-order"\ndelay = 0.0\n'
    (folder / "dataset.toml").write_text(CARD.replace(timing, declared))
    return gravity


@pytest.mark.parametrize(
    ("seed", "first_order", "declared"),
    [(1, True, ""), (2, False, 'hold = "unknown"\ndelay = 0.0\n')],
)
def test_the_command_and_python_identify_the_same_bits(
    seed, first_order, declared, tmp_path, system
):
    folder = tmp_path / "logs"
    gravity = write_random_machine(folder, seed, first_order=first_order, declared=declared)
    recipe = tn.read_recipe("grey", QUICK)
    by_python = tn.identify(tn.load(folder), system, recipe)
    options = ["--recipe", "grey", "--system", system, "--out", tmp_path / "out", "--quiet"]
    options += ["--no-report", *(part for change in QUICK for part in ("--set", change))]
    with pytest.raises(SystemExit) as ended:
        run([str(a) for a in ("fit", folder, *options)])
    assert not ended.value.code
    header = tn.read_header(tmp_path / "out" / "model.safetensors")
    by_command = {e["name"]: e["value"] for e in header["identification"]["estimates"]}
    values = {e.name: e.value for e in by_python.estimates}
    assert by_command == json.loads(json.dumps(values))
    assert values["gravity"] == pytest.approx(gravity, rel=0.01)
    if not declared:  # what is declared is the same for both functions
        by_fit = tn.fit(tn.load(folder), recipe, system=system).identification
        assert by_fit is not None
        assert {e.name: e.value for e in by_fit.estimates} == values


def test_the_command_and_python_train_the_same_bits(tmp_path, tiny_recipe):
    folder = tmp_path / "logs"
    write_random_machine(folder, 5, first_order=False, declared="")
    by_python = tn.fit(tn.load(folder), tiny_recipe)
    options = ["--recipe", tiny_recipe, "--out", tmp_path / "out", "--quiet", "--no-report"]
    with pytest.raises(SystemExit) as ended:
        run([str(a) for a in ("fit", folder, *options)])
    assert not ended.value.code
    tn.save(by_python, tmp_path / "python.safetensors")
    paths = (tmp_path / "python.safetensors", tmp_path / "out" / "model.safetensors")
    by_file = [
        tn.free_run(tn.load_model(path), tn.load(folder)["fall3"], "derived-6") for path in paths
    ]
    assert np.array_equal(by_file[0], by_file[1])
    mine, of_command = (tn.read_header(path) for path in paths)
    assert mine.keys() == of_command.keys()
    for key in ("scores", "findings", "range", "data"):
        assert mine[key] == of_command[key]
    assert any("delay" in finding["text"] for finding in mine["findings"])
