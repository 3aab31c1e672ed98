"""How many integration steps a period needs."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.simulate.substeps import PROBED_SECONDS, enough_substeps, fewest_substeps

DT = 0.05
SYSTEM = tn.LagrangianSystem(
    name="pendulum",
    coordinates=(tn.Coordinate("angle", "angular"),),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(tn.Parameter("gravity", "1/s^2", 60.0, 0.0, 100.0),),
    kinetic=lambda q, v, p: v[0] ** 2 / 2,
    potential=lambda q, p: -p["gravity"] * jnp.cos(q[0]),
    input_map=lambda q, v, u, p: u,
)
MODEL = tn.LagrangianModel(SYSTEM, {"gravity": jnp.asarray(60.0)})


@pytest.fixture(scope="module")
def swings() -> list[tn.Experiment]:
    """Two records, the second forced, with the velocities they start at."""
    generator = np.random.default_rng(0)
    result = []
    for name, u in (("free", np.zeros(60)), ("forced", generator.uniform(-20, 20, 50))):
        x = tn.rollout(tn.discretise(MODEL, DT, 64), np.array([2.0, 1.0]), u[:-1, None])
        result.append(
            tn.from_arrays(
                x[:, 0],
                u,
                v=x[:, 1],
                dt=DT,
                name=name,
                coordinates=SYSTEM.coordinates,
                inputs=SYSTEM.inputs,
            )
        )
    return result


@pytest.mark.thorough
def test_tighter_tolerances_take_more_substeps_and_are_kept(swings):
    tolerances = [1e-1, 1e-3, 1e-6]
    chosen = [tn.choose_substeps(MODEL, swings, tolerance) for tolerance in tolerances]
    assert chosen == sorted(set(chosen))
    probed = slice(0, round(PROBED_SECONDS / DT) + 1)
    exact = tn.free_run(tn.discretise(MODEL, DT, 64), swings, "file")
    for substeps, tolerance in zip(chosen, tolerances, strict=True):
        result = tn.free_run(tn.discretise(MODEL, DT, substeps), swings, "file")
        errors = [
            np.abs(a[probed, 0] - b[probed, 0]).max() for a, b in zip(result, exact, strict=True)
        ]
        assert max(errors) < tolerance


def test_a_short_record_does_not_hide_what_longer_ones_need(swings):
    alone, with_short = (
        tn.choose_substeps(MODEL, experiments, 1e-4)
        for experiments in (swings[:1], [swings[0], swings[1][:4]])
    )
    assert with_short >= alone > 1


def test_no_more_than_64_substeps_are_taken(swings):
    assert tn.choose_substeps(MODEL, swings, 1e-30) == 64


def test_a_simulation_that_leaves_the_numbers_is_never_enough():
    """Of a method whose error is n^-4, and that diverges below 8 substeps."""

    def positions(n: int) -> np.ndarray:
        return np.array([[1.0 + n**-4.0 if n >= 8 else np.nan]])

    assert enough_substeps(positions, 1.0) == 8
    assert enough_substeps(positions, 1e-5) == 32


def test_the_least_power_of_two_within_the_tolerance_is_chosen():
    for n in (1, 2, 4, 8, 16):
        error = 0.5 * n**-4.0
        assert enough_substeps(lambda m: np.array([0.5 * m**-4.0]), error * 1.01) == n
        assert enough_substeps(lambda m: np.array([0.5 * m**-4.0]), error * 0.99) == 2 * n


def test_the_less_a_model_fits_the_fewer_steps_it_needs(swings):
    fine = tn.discretise(MODEL, DT, 16)
    wrong = tn.discretise(tn.LagrangianModel(SYSTEM, {"gravity": jnp.asarray(45.0)}), DT, 16)
    exact = [
        replace(e, q=x[:, :1], v=x[:, 1:])
        for e, x in zip(swings, tn.free_run(fine, swings, "file"), strict=True)
    ]
    assert fewest_substeps(wrong, swings, 0.1) < fewest_substeps(fine, swings, 0.1)
    assert fewest_substeps(fine, exact, 0.1) == 16  # nothing is missed that could hide anything


@pytest.mark.parametrize("share", [0.3, 0.03, 0.003])
def test_steps_change_positions_by_less_than_the_share(swings, share):
    wrong = tn.discretise(tn.LagrangianModel(SYSTEM, {"gravity": jnp.asarray(55.0)}), DT, 16)
    few = fewest_substeps(wrong, swings, share)
    probed = [e[: round(PROBED_SECONDS / DT) + 1] for e in swings]
    coarse, fine = (
        np.concatenate([x[:, :1] for x in tn.free_run(m, probed, "file")])
        for m in (replace(wrong, substeps=few), wrong)
    )
    missed = fine - np.concatenate([e.q for e in probed])
    assert np.sqrt(np.mean((coarse - fine) ** 2)) <= share * np.sqrt(np.mean(missed**2))


def test_records_too_short_to_start_in_say_nothing_of_steps(swings):
    fine = tn.discretise(MODEL, DT, 16)
    assert fewest_substeps(fine, [e[:4] for e in swings], 0.1) == 16
