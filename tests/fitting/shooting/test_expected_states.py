"""Internal states that a system expects where a record begins, while it is identified."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from swinging import DT, LAGGING, TURNED, data_set, read_by_encoder, simulated, swing_model, voltage

import tustinnet as tn
from tustinnet.fitting.recipe import SearchRecipe
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.normal import NormalProducts, compute_products
from tustinnet.fitting.shooting.problem import Problem, SearchState, make_cost_function
from tustinnet.fitting.shooting.segments import CutOptions, cut_records
from tustinnet.fitting.shooting.space import make_search_space
from tustinnet.models.parameters import Parameter
from tustinnet.models.sensors import with_sensor_errors

SPACE = make_search_space(TURNED, {}, {})
VECTOR = SPACE.to_vector(TURNED.nominal() | {"damping": 0.03, "gravity": 1.3, "turned": 0.6})
POSITION = Residual((False,), (1.0,))
KEPT = 0.8  # of the first angle is not relaxed where the records below begin


def records() -> list[tn.Experiment]:
    """Two falls and a record under noise, begun with a part of the angle remembered."""
    starts = ([2.0, 0.0], [-1.5, 1.0], [1.0, -0.5])
    drives = (np.zeros(200), np.zeros(200), voltage(160, 2))
    return [
        simulated(f"turned{i}", [*x0, KEPT * x0[0]], u, system=TURNED)
        for i, (x0, u) in enumerate(zip(starts, drives, strict=True))
    ]


def segments(length: int | None = None):
    model = tn.discretise(swing_model(system=TURNED), DT)
    return cut_records(records(), model, CutOptions(POSITION, length))


def products(vector: np.ndarray, x0: np.ndarray, pieces) -> NormalProducts:
    return compute_products(TURNED, POSITION, SPACE, vector, x0, pieces, 2)


def test_they_are_expected_where_records_begin_and_searched_for_elsewhere():
    pieces = segments(50)
    begins = np.isin(np.arange(len(pieces.steps)), pieces.first_of_records)
    np.testing.assert_array_equal(pieces.adds_expected, begins)
    np.testing.assert_array_equal(pieces.is_free[:, 2], ~begins)
    assert len(pieces.for_records([1]).adds_expected) == 4


def test_the_derivatives_are_those_of_finite_differences():
    pieces = segments()
    result, h = products(VECTOR, pieces.x0, pieces), 1e-6

    def cost(vector: np.ndarray, x0: np.ndarray) -> float:
        return products(vector, x0, pieces).cost.sum()

    by_parameter = [
        (cost(VECTOR + d, pieces.x0) - cost(VECTOR - d, pieces.x0)) / (2 * h)
        for d in h * np.eye(len(VECTOR))
    ]
    np.testing.assert_allclose(2 * result.gp.sum(axis=0), by_parameter, rtol=1e-5, atol=1e-6)
    turned = SPACE.names.index("turned")
    assert abs(by_parameter[turned]) > 0.1
    for i in range(2):  # angle and speed of the first record: the first also moves what is expected
        d = np.zeros_like(pieces.x0)
        d[0, i] = h
        by_state = (cost(VECTOR, pieces.x0 + d) - cost(VECTOR, pieces.x0 - d)) / (2 * h)
        assert 2 * result.gx[0, i] == pytest.approx(by_state, rel=1e-5)


@pytest.mark.thorough
@pytest.mark.parametrize("initial", ["anchored", "derived-6"])
def test_what_is_remembered_is_identified(initial):
    changes = [f"search.initial={initial}"]
    result = tn.identify(data_set(records()), TURNED, tn.read_recipe("grey", changes))
    values = {e.name: e.value for e in result.estimates}
    loose = initial == "derived-6"  # a parabola misses the velocity, which is not searched for
    assert values["turned"] == pytest.approx(KEPT, rel=0.2 if loose else 0.02)
    for x in result.initial_states.values():
        assert x[2] == pytest.approx(values["turned"] * x[0], rel=1e-3, abs=0.1)


def test_a_state_that_is_given_is_not_added_to():
    """A start that fits the state has the internal ones in it."""
    experiments = [read_by_encoder(e) for e in records()]
    problem = Problem(TURNED, tuple(experiments), (), SearchRecipe())
    state = SearchState(SPACE, VECTOR, substeps=2)
    pieces = problem.segments(None, "anchored", {}).without_velocities(TURNED.channels)
    whole = np.array([[2.0, 0.0, 0.4], [-1.5, 1.0, 0.1], [1.0, -0.5, 0.0]])
    fixed = pieces.with_fixed_states(whole)
    added = replace(pieces, x0=whole - [0, 0, 1] * (0.6 * whole[:, :1]), is_free=fixed.is_free)
    cost = make_cost_function(problem, state, fixed, 2)
    same = problem.products(SPACE, VECTOR, added, 2).cost
    np.testing.assert_allclose(cost.products(VECTOR, whole).cost, same, rtol=1e-9)


# --- internal states that follow inputs ---

LATE = with_sensor_errors(
    replace(LAGGING, inputs=(replace(LAGGING.inputs[0], hold="first-order"),)),
    (Parameter("voltage.delay", "s", 0.01, 0.0, 0.04),),
)
LAGS = {"lag": 0.12, "share": 0.4}


def driven(system=LAGGING) -> list[tn.Experiment]:
    """Records under noise that begin with a part of the motor's lag over."""
    return [
        simulated(f"lagging{i}", [*x0, 0.4 * u[0]], u, LAGS, system)
        for i, (x0, u) in enumerate([([0.5, 0.0], voltage(200, 3)), ([-0.2, 1.0], voltage(160, 4))])
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("length", [None, 50])
def test_derivatives_by_parameters_and_delays_hold_where_states_follow_inputs(length):
    space = make_search_space(LATE, {}, {})
    vector = space.to_vector(LATE.nominal() | {"damping": 0.03, "gravity": 1.3, "share": 0.6})
    model = tn.discretise(swing_model(system=LATE), DT)
    options = CutOptions(POSITION, length, has_delays=True)
    pieces, h = cut_records(driven(), model, options), 1e-6

    def products_at(vector: np.ndarray, x0: np.ndarray) -> NormalProducts:
        return compute_products(LATE, POSITION, space, vector, x0, pieces, 2)

    result = products_at(vector, pieces.x0)
    by_parameter = [
        (products_at(vector + d, pieces.x0).cost - products_at(vector - d, pieces.x0).cost).sum()
        / (2 * h)
        for d in h * np.eye(len(vector))
    ]
    np.testing.assert_allclose(2 * result.gp.sum(axis=0), by_parameter, rtol=1e-4, atol=1e-6)
    share = by_parameter[space.names.index("share")]
    assert abs(share) > 1e-3
    # inside a record the search begins where the inputs say
    assert pieces.adds_expected.all()
    assert not pieces.x0[:, 2].any()


@pytest.mark.thorough
def test_a_lag_is_identified_with_the_state_that_records_begin_with():
    result = tn.identify(data_set(driven()), LAGGING, tn.read_recipe("grey", []))
    values = {e.name: e.value for e in result.estimates}
    assert values["lag"] == pytest.approx(LAGS["lag"], rel=0.01)
    assert values["share"] == pytest.approx(LAGS["share"], abs=0.02)
    for e in driven():
        assert result.initial_states[e.name][2] == pytest.approx(0.4 * e.u[0, 0], abs=0.1)


@pytest.mark.thorough
@pytest.mark.parametrize("start", ["derived-6", "model-20"])
def test_a_refit_begins_with_the_states_that_inputs_say(start):
    changes = [f"search.refine={start}", "search.initial=anchored"]
    result = tn.identify(data_set(driven()), LAGGING, tn.read_recipe("grey", changes))
    continuous: Any = result.model.continuous
    assert float(continuous.values["lag"]) == pytest.approx(LAGS["lag"], rel=0.05)


def test_a_reversed_input_is_found_behind_a_lag():
    steps = np.repeat(voltage(10, 5), 20)
    made = [
        simulated(f"steps{i}", [q, 0.0, 0.0], steps, LAGS, LAGGING) for i, q in enumerate((0.5, 0))
    ]
    reversed_records = [replace(e, u=-e.u) for e in made]
    result = tn.identify(data_set(reversed_records), LAGGING, tn.read_recipe("grey", []))
    assert any("'voltage'" in f.text and "reversed" in f.text for f in result.findings)
