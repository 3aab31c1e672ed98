"""Combinations of parameters that change forces, and the parameters in which forces are linear."""

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.fitting.shooting.base_parameters import (
    LinearCoordinates,
    find_combinations,
    order_of,
)
from tustinnet.fitting.shooting.space import make_search_space
from tustinnet.models.chains import INERTIAL, STANDARD, standard_inertia

BODY = np.array([2.0, 0.3, -0.1, 0.2, 0.15, 0.1, 0.08, 0.02, -0.03, 0.01])


def test_dependent_parameters_are_terms_of_those_before_them():
    rng = np.random.default_rng(0)
    a, b, c = rng.normal(size=(3, 50))
    nothing = np.zeros(50)
    slopes = np.stack([a, nothing, b, a + 0.5 * b, c, 1e-3 * c], axis=1)
    spread = np.array([1.0, 1.0, 2.0, 1.0, 1.0, 1e-3])
    combinations = find_combinations(slopes, spread, range(6))
    assert combinations.pivots == (0, 2, 4)
    expected = [[1, 0, 0, 1, 0, 0], [0, 0, 1, 0.5, 0, 0], [0, 0, 0, 0, 1, 1e-3]]
    np.testing.assert_allclose(combinations.factors, expected, atol=1e-9)
    assert combinations.terms(0, spread) == combinations.terms(1, spread) == [3]
    # a thousandth of what is known of a small parameter is too little to be shown
    assert combinations.terms(2, spread) == []
    other = find_combinations(slopes, spread, [3, *range(6)])
    assert other.pivots == (3, 0, 4)


def test_standard_parameters_have_these_derivatives():
    (standard,), (derivatives,) = standard_inertia(BODY[None])
    assert dict(zip(STANDARD, standard, strict=True))["mass*center_x"] == pytest.approx(0.6)
    upper = np.array([[0.15, 0.02, -0.03], [0, 0.1, 0.01], [0, 0, 0.08]])
    center, mass = BODY[1:4], BODY[0]
    second = mass * (upper @ upper.T + np.outer(center, center))
    tensor = np.trace(second) * np.eye(3) - second
    np.testing.assert_allclose(standard[4:7], np.diag(tensor))
    np.testing.assert_allclose(standard[7:], [tensor[0, 1], tensor[0, 2], tensor[1, 2]])
    for i, step in enumerate(1e-6 * np.eye(10)):
        above, below = (standard_inertia((BODY + sign * step)[None])[0][0] for sign in (1, -1))
        change = (above - below) / 2e-6
        np.testing.assert_allclose(derivatives[:, i], change, atol=1e-8)


def test_only_bodies_with_all_their_parameters_have_others_in_their_place():
    system = tn.load_system("2-link-chain")
    plain = make_search_space(system, {}, {})
    values = {p.name: p.nominal for p in system.parameters}
    same = LinearCoordinates(plain, values)
    assert same.names == list(plain.names)
    np.testing.assert_array_equal(same.derivatives, np.eye(len(plain.names)))


def test_masses_name_combinations_last():
    names = ["a.mass", "a.mass*center_x", "a.inertia_zz[1kg]", "joint.armature", "b.mass[1kg]"]
    assert [names[i] for i in order_of(names)] == [
        "a.mass*center_x",
        "a.inertia_zz[1kg]",
        "joint.armature",
        "a.mass",
        "b.mass[1kg]",
    ]
    assert len(INERTIAL) == len(STANDARD)
