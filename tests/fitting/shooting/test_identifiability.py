"""Parameters that records cannot tell apart."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import SWING, changed, falls, records

import tustinnet as tn
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.identifiability import (
    ConfoundedParameters,
    describe_confounded,
    find_confounded,
    has_diverged,
)
from tustinnet.fitting.shooting.normal import compute_products
from tustinnet.fitting.shooting.segments import CutOptions, cut_records
from tustinnet.fitting.shooting.space import SearchSpace, make_search_space
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.systems import qube_servo2, qube_servo2_twin


def plain(**ranges: tuple[float, float]) -> SearchSpace:
    """Parameters of the given ranges."""
    searched = tuple(Parameter(name, "", sum(r) / 2, *r) for name, r in ranges.items())
    return SearchSpace(searched, {})


ABC = plain(a=(1.0, 5.0), b=(1.0, 2.0), c=(1.0, 9.0))
CENTRE = ABC.to_vector({"a": 3.0, "b": 1.5, "c": 5.0})


def confounded_by(
    jacobian: np.ndarray, space: SearchSpace = ABC
) -> tuple[ConfoundedParameters, ...]:
    return find_confounded(space, CENTRE, jacobian.T @ jacobian)


def columns(count: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(100, count))


def test_parameters_that_act_each_in_their_own_way_are_told_apart():
    assert confounded_by(columns(3)) == ()
    assert confounded_by(columns(3) * [1.0, 1e-4, 1e4]) == ()


def test_a_common_factor_is_told_as_ratios_with_the_narrowest_range_to_fix():
    a, b = columns(2).T
    (confounded,) = confounded_by(np.stack([a, b, -a - b], axis=1))
    assert confounded.shares == pytest.approx({"a": 1.0, "b": 1.0, "c": 1.0})
    assert confounded.suggestion == "b"
    assert "only ratios of a, b and c can be identified" in confounded.finding.text
    assert "'b', which is known best, was fixed" in confounded.finding.text


def test_few_sets_have_a_sentence_each_and_of_many_the_fixed_parameters_are_listed():
    sets = [ConfoundedParameters({f"a{i}": 1.0, f"b{i}": -0.5}, f"a{i}") for i in range(20)]
    few = [f.text for f in describe_confounded(sets[:2], 60)]
    assert len(few) == 2
    assert few[1].startswith("a1 and b1 are not identifiable separately, as changed together (rel")
    assert few[1].endswith("'a1', which is known best, was fixed at its first value")
    (many,) = (f.text for f in describe_confounded(sets, 60))
    assert many.startswith("20 combinations of the 60 parameters have no effect on these records")
    assert many.endswith(
        "fixed at its first value: " + ", ".join(f"a{i}" for i in range(12)) + " and 8 more"
    )


def test_a_sum_is_told_with_how_its_parts_change_together():
    a, b = columns(2).T
    (confounded,) = confounded_by(np.stack([3.0 * a, b, 5.0 * a], axis=1))
    assert confounded.shares == pytest.approx({"a": 1.0, "c": -0.6})
    assert confounded.spread == pytest.approx({"c": 0.6 * np.log(5) / 2}), "half the range of a"
    assert confounded.suggestion == "a"
    assert confounded.finding.text.startswith("a and c are not identifiable separately")


def test_what_is_known_beforehand_is_fixed():
    """Of a sum the part with the narrowest prior, whatever its range."""
    a = columns(1)[:, 0]
    known = tuple(replace(p, prior=0.1 if p.name == "c" else None) for p in ABC.free_parameters)
    (first, second) = confounded_by(np.stack([a, 2 * a, 3 * a], axis=1), SearchSpace(known, {}))
    assert {first.suggestion, second.suggestion} == {"b", "c"}


def test_a_parameter_without_effect_is_told_alone():
    (confounded,) = confounded_by(columns(3) * [1.0, 0.0, 1.0])
    assert confounded.shares == {"b": 1.0}
    assert "'b' has no effect on these records" in confounded.finding.text


def test_several_directions_name_a_parameter_each_that_no_other_has():
    a = columns(1)[:, 0]
    confounded = confounded_by(np.stack([a, 2 * a, 3 * a], axis=1))
    names = {f.suggestion for f in confounded}
    assert names == {"a", "b"}
    for f in confounded:
        assert names & set(f.shares) == {f.suggestion}


def test_where_nothing_has_an_effect_every_parameter_is_told_alone():
    confounded = confounded_by(np.zeros((5, 3)))
    assert sorted(f.suggestion for f in confounded) == ["a", "b", "c"]
    assert all(len(f.shares) == 1 for f in confounded)


# --- derivatives of simulations ---


def products(
    system: LagrangianSystem, experiments: list[tn.Experiment], length: int, space: SearchSpace
) -> np.ndarray:
    vector = space.to_vector(system.nominal())
    values = {name: jnp.asarray(x) for name, x in space.to_values(vector).items()}
    model = tn.discretise(system.model(values), experiments[0].dt)
    n_q = len(system.coordinates)
    residual = Residual((False,) * n_q, (1.0,) * n_q)
    pieces = cut_records(experiments, model, CutOptions(residual, length, timestamps=False))
    x0 = pieces.x0
    return compute_products(system, residual, space, vector, x0, pieces, 1).pp.sum(axis=0)


def directions(
    system: LagrangianSystem, experiments: list[tn.Experiment], space: SearchSpace
) -> tuple[ConfoundedParameters, ...]:
    vector = space.to_vector(system.nominal())
    return find_confounded(space, vector, products(system, experiments, 60, space))


def test_only_ratios_of_a_pendulums_inertia_and_forces_are_identifiable():
    loose = changed("inertia", fixed=False)
    (confounded,) = directions(loose, records(), make_search_space(loose, {}, {}))
    assert set(confounded.shares) == {"inertia", "damping", "gravity", "gain"}
    assert confounded.suggestion == "inertia"
    assert "only ratios" in confounded.finding.text


def test_free_swings_say_nothing_of_the_input():
    (confounded,) = directions(SWING, list(falls()), make_search_space(SWING, {}, {}))
    assert confounded.shares == {"gain": 1.0}
    assert directions(SWING, records(), make_search_space(SWING, {}, {})) == ()


@pytest.fixture(scope="module")
def rotary() -> list[tn.Experiment]:
    """Two falls and two records under noise of the twin, 3 s of each."""
    names = ("twin_fall1", "twin_fall2", "twin_noise1", "twin_noise2")
    data = qube_servo2_twin.twin()
    return [data[name][:300] for name in names]


LOOSE = replace(
    qube_servo2.SYSTEM,
    parameters=tuple(replace(p, fixed=False) for p in qube_servo2.SYSTEM.parameters),
)
LOOSE_SPACE = make_search_space(LOOSE, {}, {})


def base_parameters(vector: jax.Array) -> jax.Array:
    """Logarithms of all that the rotary pendulum's motion depends on, over one of them.

    The equations hold three inertias, two dampings, two stiffnesses, the gain of the voltage and
    the pendulum's weight, which all others are divided by.
    """
    p = {
        q.name: jnp.exp(x) if q.positive else x * (q.upper - q.lower)
        for q, x in zip(LOOSE_SPACE.free_parameters, vector, strict=True)
    }
    arm = p["rotor_inertia"] + p["hub_mass"] * p["hub_radius"] ** 2 / 2
    base = jnp.stack(
        [
            arm + (p["arm_mass"] / 3 + p["pendulum_mass"]) * p["arm_length"] ** 2,
            p["pendulum_mass"] * p["pendulum_centre"] ** 2 + p["pendulum_inertia"],
            p["pendulum_mass"] * p["arm_length"] * p["pendulum_centre"],
            p["arm_damping"] + p["torque_constant"] * p["back_emf"] / p["resistance"],
            p["pendulum_damping"],
            p["cable_stiffness"],
            p["cable_quadratic"],
            p["torque_constant"] / p["resistance"],
        ]
    )
    return jnp.log(base / (p["pendulum_mass"] * p["pendulum_centre"]))


@pytest.mark.thorough
def test_the_rotary_pendulums_null_space_is_that_of_its_base_parameters(rotary):
    confounded = directions(LOOSE, rotary, LOOSE_SPACE)
    vector = LOOSE_SPACE.to_vector(LOOSE.nominal())
    slopes = np.asarray(jax.jit(jax.jacfwd(base_parameters))(jnp.asarray(vector)))
    assert np.linalg.matrix_rank(slopes) == 8
    assert len(confounded) == len(vector) - 8
    for direction in confounded:
        along = np.array([direction.shares.get(name, 0.0) for name in LOOSE_SPACE.names])
        moved = np.abs(slopes @ along).max() / np.abs(slopes * along).max()
        assert moved < 5e-3, str(direction)


@pytest.mark.parametrize(
    "change",
    [
        {"back_emf": 1.0, "arm_damping": -0.7},  # kt kv / R over the arm's damping
        {"hub_radius": 1.0, "hub_mass": -2.0},
        {"resistance": 1.0, "torque_constant": 1.0},
        {
            "torque_constant": 1.0,
            "rotor_inertia": 1.0,
            "hub_mass": 1.0,
            "arm_mass": 1.0,
            "pendulum_mass": 1.0,
            "pendulum_inertia": 1.0,
            "arm_damping": 1.0,
            "pendulum_damping": 1.0,
            "cable_stiffness": 1.0,
            "cable_quadratic": 0.025,
        },
    ],
    ids=["back-emf", "hub", "gain", "scale"],
)
def test_the_rotary_pendulums_known_ambiguities_are_among_those_found(rotary, change):
    confounded = directions(LOOSE, rotary, LOOSE_SPACE)
    basis = np.array([[f.shares.get(n, 0.0) for n in LOOSE_SPACE.names] for f in confounded]).T
    along = np.array([change.get(n, 0.0) for n in LOOSE_SPACE.names])
    rest = along - basis @ np.linalg.lstsq(basis, along)[0]
    assert np.abs(rest).max() < 5e-3


def test_the_rotary_pendulums_best_known_parameters_are_named(rotary):
    shares = {f.suggestion: set(f.shares) for f in directions(LOOSE, rotary, LOOSE_SPACE)}
    assert {"resistance", "torque_constant", "hub_mass", "hub_radius"} < set(shares)
    assert shares["back_emf"] == {"back_emf", "arm_damping"}


def test_with_the_named_parameters_fixed_the_others_are_identifiable(rotary):
    named = {f.suggestion for f in directions(LOOSE, rotary, LOOSE_SPACE)}
    kept = np.array([name not in named for name in LOOSE_SPACE.names])
    whole = products(LOOSE, rotary, 60, LOOSE_SPACE)[np.ix_(kept, kept)]
    unit = np.sqrt(np.diag(whole))
    assert np.linalg.cond(whole / np.outer(unit, unit)) < 1e8


def test_falls_alone_leave_the_voltages_gain_open_too(rotary):
    confounded = directions(LOOSE, rotary[:2], LOOSE_SPACE)
    assert len(confounded) == 8


@pytest.mark.parametrize(("largest", "diverged"), [(1e119, True), (np.inf, True), (1e9, False)])
def test_derivatives_of_simulations_that_nearly_diverge_say_nothing(largest, diverged):
    assert has_diverged(np.diag([1.0, largest, 1e3])) == diverged
