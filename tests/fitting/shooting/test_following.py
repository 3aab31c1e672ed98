"""Initial states that follow from the parameters."""

from dataclasses import replace

import numpy as np
import pytest
from swinging import (
    CREEPING,
    TRUTH,
    changed,
    data_set,
    falls,
    noises,
    read_by_encoder,
    records,
    simulated,
    swing_model,
    voltage,
)

import tustinnet as tn
from tustinnet.fitting.recipe import IdentificationRecipe
from tustinnet.fitting.shooting.following import Following, following
from tustinnet.fitting.shooting.least_squares import Cost
from tustinnet.fitting.shooting.problem import Problem, State, prior
from tustinnet.fitting.shooting.space import make_space

FOLLOWS = ("search.initial=model-20", "search.loss=position")
START = "model-20"


def recipe(*changes: str) -> IdentificationRecipe:
    found = tn.read_recipe("grey", [*FOLLOWS, *changes])
    assert isinstance(found, IdentificationRecipe)
    return found


def cost_of(
    experiments: list[tn.Experiment], *, horizons: dict[str, int] | None = None
) -> tuple[Following, np.ndarray]:
    search = recipe().search
    problem = Problem(CREEPING, tuple(experiments), (), search)
    space = make_space(CREEPING, {}, {})
    vector = space.vector(CREEPING.nominal() | {"damping": 0.03, "gravity": 1.3})
    state = State(space, vector, substeps=2)
    segments = problem.segments(None, START, horizons or {})
    cost = Cost(problem.shape(space), space, segments, prior(problem, state), state.substeps)
    assert search.follows is not None
    return following(problem, cost, search.follows), vector


def read() -> list[tn.Experiment]:
    return [read_by_encoder(e) for e in records()]


@pytest.mark.parametrize("horizons", [{}, {"fall1": 90, "noise1": 60}])
def test_the_gradient_is_that_of_finite_differences(horizons):
    cost, vector = cost_of(read(), horizons=horizons)
    nothing = cost.segments.x0

    def value(at: np.ndarray) -> float:
        return cost.value(cost.products(at, nothing), at)

    gradient = 2 * cost.products(vector, nothing).gp.sum(axis=0)
    h = 1e-5
    expected = [(value(vector + d) - value(vector - d)) / (2 * h) for d in h * np.eye(len(vector))]
    np.testing.assert_allclose(gradient, expected, rtol=2e-3, atol=1e-3 * np.abs(expected).max())


def test_nothing_is_searched_for_in_the_states():
    cost, vector = cost_of(read())
    found = cost.products(vector, cost.segments.x0)
    assert not found.px.any()
    assert not found.xx.any()
    assert not found.gx.any()


def test_initial_states_are_those_of_the_start():
    experiments = read()
    found = tn.identify(data_set(experiments), CREEPING, recipe())
    assert found.initial == START
    states = tn.start_states(found.model, experiments, START)
    for e, x0 in zip(experiments, states, strict=True):
        np.testing.assert_allclose(found.initial_states[e.name], x0, atol=1e-6)


def test_the_truth_is_found_from_encoders():
    found = tn.identify(data_set(read()), swing_model().system, recipe())
    for e in found.estimates:
        assert e.value == pytest.approx(TRUTH[e.name], rel=0.01), e.name


def test_where_physics_is_missing_free_runs_are_better_than_from_searched_states():
    """The records creep, the model does not."""
    values = {"offset": 0.0, "stiffness": 0.9, "relaxation": 6.0}
    experiments = [
        read_by_encoder(
            simulated(e.name, [float(e.q[0, 0]), float(e.velocities("file")[0, 0]), 0.0],
                      e.u[:, 0], values, CREEPING)
        )
        for e in (*falls(), *noises())
    ]  # fmt: skip
    system = swing_model().system
    ours, usual = (
        tn.identify(data_set(experiments), system, tn.read_recipe("grey", changes)).model
        for changes in (FOLLOWS, ("search.initial=anchored", "search.loss=position"))
    )
    scores = [tn.mean_rmse(tn.evaluate(m, experiments, START)) for m in (ours, usual)]
    assert scores[0] < scores[1]


def test_parameters_per_group_have_their_own_states():
    per = changed("gravity", per="place")
    experiments = [
        replace(
            read_by_encoder(simulated(f"r{i}", [1.0, 0.0], voltage(120, i), {"gravity": g})),
            groups=(("place", place),),
        )
        for i, (place, g) in enumerate([("here", 1.5), ("there", 1.2)] * 2)
    ]
    found = tn.identify(data_set(experiments), per, recipe())
    known = {e.name: e.value for e in found.estimates}
    assert known["gravity[here]"] == pytest.approx(1.5, rel=0.01)
    assert known["gravity[there]"] == pytest.approx(1.2, rel=0.01)


def test_a_delay_that_is_searched_for_is_refused():
    with pytest.raises(
        tn.InputError, match=r"search\.initial: 'model-20', and 'voltage.delay' is free"
    ):
        tn.identify(data_set(read()), swing_model().system, recipe('model.free=["voltage.delay"]'))


def test_records_shorter_than_the_start_are_refused():
    short = [read_by_encoder(e[:8]) for e in records()]
    with pytest.raises(tn.InputError, match=r"start 'model-20'"):
        tn.identify(data_set(short), swing_model().system, recipe())
