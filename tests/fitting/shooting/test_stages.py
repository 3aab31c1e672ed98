"""Searches whose simulations diverge along long segments."""

from dataclasses import replace

import numpy as np
import pytest
from swinging import SWING, data_set, records

import tustinnet as tn
from tustinnet.fitting.shooting import stages
from tustinnet.fitting.shooting.problem import Problem, SearchState


@pytest.fixture
def diverging(monkeypatch):
    """Makes simulations of segments with more steps than a limit diverge."""

    def with_limit(limit: int) -> list[int]:
        run, lengths = stages.run_stage, []

        def run_stage(problem: Problem, state: SearchState, stage: stages.SearchStage):
            after = run(problem, state, stage)
            result = after.last_result
            lengths.append(int(result.segments.steps.max()))
            if lengths[-1] <= limit:
                return after
            diverged = replace(result, vector=state.vector, status="diverged", cost=np.inf)
            return replace(after, vector=state.vector, result=diverged)

        monkeypatch.setattr(stages, "run_stage", run_stage)
        return lengths

    return with_limit


def test_the_longest_segments_that_stay_finite_are_kept_and_the_model_has_their_horizon(diverging):
    lengths = diverging(130)
    result = tn.identify(data_set(records()), SWING, "grey")
    assert result.converged
    assert lengths[-1] <= 130 < max(lengths)
    assert lengths[-1] > 65, "not far below what stays finite"
    assert result.horizon is not None
    assert result.horizon <= 130 * records()[0].dt
    assert any("simulations of longer segments diverge" in f.text for f in result.findings)
    values = {e.name: e.value for e in result.estimates}
    assert values["gravity"] == pytest.approx(1.5, rel=0.02)


def test_a_search_that_diverges_along_the_shortest_segments_says_so(diverging):
    diverging(1)
    result = tn.identify(data_set(records()), SWING, "grey")
    assert not result.converged
    assert result.outcome.startswith("diverged")
    assert result.horizon is None


def test_values_of_shorter_segments_may_let_longer_ones_stay_finite(monkeypatch):
    run, has_failed = stages.run_stage, []

    def run_stage(problem: Problem, state: SearchState, stage: stages.SearchStage):
        after = run(problem, state, stage)
        if has_failed:
            return after
        has_failed.append(stage)
        diverged = replace(after.last_result, vector=state.vector, status="diverged", cost=np.inf)
        return replace(after, vector=state.vector, result=diverged)

    monkeypatch.setattr(stages, "run_stage", run_stage)
    result = tn.identify(data_set(records()), SWING, "grey")
    assert result.converged
    assert result.horizon is None
