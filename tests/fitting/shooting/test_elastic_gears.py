"""Elastic gears of robots with encoders at the motors, identified from records in a loop."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import pytest
from robot_twins import record_in_loop, true_values

import tustinnet as tn

ARM = Path(__file__).parents[3] / "examples" / "robots" / "arm7.urdf"
LOCKED = {"joint1": 0.0, "joint3": 0.0, "joint5": 0.0, "joint6": 0.0, "joint7": 0.0}
TRUE = {
    "joint2.gear_stiffness": 4000.0,
    "joint4.gear_stiffness": 2000.0,
    "joint2.gear_damping": 4.0,
    "joint4.gear_damping": 2.0,
}
HORIZON = 0.25


@pytest.fixture(scope="module")
def system() -> tn.LagrangianSystem:
    """Shoulder and elbow of an arm; stiffnesses are a third off."""
    gears = {"joint2": 3000.0, "joint4": 2600.0}
    return tn.load_robot(ARM, locked=LOCKED, elastic=gears, encoders="motor")


@pytest.fixture(scope="module")
def truth(system) -> dict[str, float]:
    return true_values(system, 1) | TRUE


@pytest.fixture(scope="module")
def links(system, truth) -> dict[str, float]:
    """What the links are, which other tests identify: fixed, a fit takes a third of the time."""
    free = [p.name for p in system.parameters if not p.fixed and not p.name.startswith("joint")]
    return {name: truth[name] for name in free}


def with_values(model: tn.Model, system: tn.LagrangianSystem, values: dict[str, float]) -> tn.Model:
    """A model with other values."""
    arrays = {name: jnp.asarray(values[name]) for name in system.nominal()}
    # a model of equations of motion has the field, which its base class does not know
    return replace(model, continuous=system.model(arrays))  # pyright: ignore[reportCallIssue]


@pytest.mark.thorough
def test_stiffnesses_are_found_and_free_runs_are_as_good_as_with_the_truth(system, truth, links):
    data = record_in_loop(system, truth, 3, 2.5, 0.004, noise=0.0, substeps=8, begins_moving=True)
    recipe = {
        "name": "short",
        "model": {"kind": "euler-lagrange"},
        "search": {"horizon": 0.5, "initial": "anchored"},
    }
    result = tn.identify(data, system, recipe, fixed=links)
    gears = {e.name: e for e in result.estimates if e.name.endswith("gear_stiffness")}
    assert len(gears) == 2
    for name, estimate in gears.items():
        low, high = estimate.interval or (0.0, 0.0)
        assert low < TRUE[name] < high
        assert high - low < 0.02 * TRUE[name]
    held_out = list(data.split("validation"))
    own, true, rigid = (
        tn.mean_rmse(tn.evaluate(model, held_out, "model-20", horizon=HORIZON))
        for model in (
            result.model,
            with_values(result.model, system, truth),
            with_values(result.model, system, truth | dict.fromkeys(list(TRUE)[:2], 3e4)),
        )
    )
    assert own < 1.1 * true
    assert rigid > 2 * own


@pytest.mark.thorough
def test_records_in_the_loop_of_the_card_are_followed_as_a_whole(system, truth, links):
    """The controller reads the motors; upright the arm would fall without it."""
    data = record_in_loop(
        system, truth, 3, 3.0, 0.004, noise=0.0, substeps=8, knows_controller=True
    )
    begin = {name: value for name, value in truth.items() if name not in links}
    begin["joint2.gear_stiffness"] = 4400.0
    result = tn.identify(data, system, "grey", begin=begin, fixed=links)
    assert not result.horizons
    assert result.values["joint2.gear_stiffness"] == pytest.approx(4000.0, rel=0.01)
    assert result.validation_rmse is not None
    assert result.validation_rmse < 1e-4
