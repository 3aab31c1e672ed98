"""Searches that are stopped at a time limit: what they return, and what they say."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import pytest
from swinging import FAR, SWING, data_set, read_by_encoder, records
from test_refit import SYSTEM, creeping, recipe

import tustinnet as tn
from tustinnet.fitting.identify import UnfinishedSearchError, identify_task
from tustinnet.fitting.listener import Iteration, Listener, SearchProgress, StageResult
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.shooting import refit
from tustinnet.fitting.shooting.levenberg_marquardt import DampingRule, iterate
from tustinnet.fitting.task import Member, Task, make_task


@dataclass
class Search:
    """A search of a task that is stopped as soon as a condition holds; what it reported."""

    task: Task
    is_over: Callable[["Search"], bool] = lambda search: False
    stages: list[StageResult] = field(default_factory=list)
    progress: list[SearchProgress] = field(default_factory=list)

    def run(self) -> FitResult:
        listener = Listener(
            on_stage=self.stages.append,
            on_progress=self.progress.append,
            should_stop=lambda seconds: self.is_over(self),
        )
        return identify_task(self.task, Member(), listener)


def swing_task(*, validation: bool = False) -> Task:
    experiments = records()
    if validation:
        splits = ["validation", *["train"] * (len(experiments) - 1)]
        experiments = [replace(e, split=s) for e, s in zip(experiments, splits, strict=True)]
    far = [f"model.begin.{name}={x}" for name, x in FAR.items()]
    return make_task(data_set(experiments), tn.read_recipe("grey", far), system=SWING)


def in_stage(number: int, iterations: int) -> Callable[[Search], bool]:
    """After some iterations of a stage."""

    def is_over(search: Search) -> bool:
        if not search.progress:
            return False
        last = search.progress[-1]
        return last.number == number and last.iteration >= iterations

    return is_over


def test_a_stopped_search_has_the_model_of_its_last_finished_stage():
    whole = Search(swing_task())
    whole.run()
    count = whole.progress[-1].stages
    assert [s.why for s in whole.stages[1:]] == ["converged"] * count
    stopped = Search(swing_task(), in_stage(3, 1))
    result = stopped.run()
    assert stopped.stages[:3] == whole.stages[:3]  # estimate, two stages
    assert [s.why for s in stopped.stages[3:]] == ["stopped"]
    identification = result.identification
    assert identification is not None
    assert identification.values == stopped.stages[2].parameters
    assert result.outcome == (
        f"out of time: stopped at its time limit after stage 2 of {count} "
        f"({stopped.stages[2].stage})"
    )
    assert result.is_out_of_time
    assert not result.sound
    assert not identification.converged
    assert not any("nothing is missing" in f.text for f in result.findings)
    assert tn.mean_rmse(tn.evaluate(result.model, records(), "file")) < 0.1


def test_a_limit_that_is_never_reached_changes_nothing():
    free, limited = Search(swing_task()), Search(swing_task(), lambda search: False)
    assert free.run().details == limited.run().details
    assert free.stages == limited.stages


def test_identify_takes_a_condition_to_stop():
    iterations: list[Iteration] = []
    result = tn.identify(
        data_set(records()),
        SWING,
        begin=FAR,
        listener=Listener(
            on_iteration=iterations.append,
            should_stop=lambda _: bool(iterations) and iterations[-1].stage.startswith("whole"),
        ),
    )
    assert result.outcome.startswith("out of time: stopped at its time limit after stage ")
    assert not result.sound


@pytest.mark.parametrize("is_over", [lambda search: True, in_stage(1, 0)])
def test_without_a_finished_stage_there_is_no_model_and_it_says_so(is_over):
    with pytest.raises(UnfinishedSearchError, match=r"before a stage was finished; .*allow more"):
        Search(swing_task(), is_over).run()


def test_a_search_that_is_stopped_while_it_compares_initial_states_keeps_the_anchored_ones():
    whole = Search(swing_task(validation=True))
    whole.run()
    count = whole.progress[-1].stages
    result = Search(swing_task(validation=True), in_stage(count - 1, 0)).run()
    assert f"after stage {count - 2} of {count} (whole records, anchored start)" in result.outcome
    assert result.identification is not None
    assert result.identification.initial == "anchored"
    assert result.validation_rmse == pytest.approx(0.0, abs=0.01)


def test_every_simulation_is_reported_with_its_stage():
    search = Search(swing_task())
    result = search.run()
    assert search.progress[0] == SearchProgress(
        "equation-error estimate", 0, 0, 1, search.stages[0].cost
    )
    counted = search.progress[1:]
    numbers = [p.number for p in counted]
    assert numbers == sorted(numbers)
    assert set(numbers) == set(range(1, counted[-1].stages + 1))
    for before, after in pairwise(counted):
        if before.number == after.number:
            assert after.iteration in (before.iteration, before.iteration + 1)
            assert after.cost <= before.cost
    assert result.identification is not None
    assert counted[-1].iteration == result.identification.iterations


def test_a_refit_that_is_stopped_leaves_the_identified_values(monkeypatch):
    monkeypatch.setattr(refit, "_WORTH", 0.0)
    task = make_task(data_set(creeping()), recipe(), system=SYSTEM)
    whole = Search(task)
    before = whole.run().identification
    count = whole.progress[-1].stages
    result = Search(task, in_stage(count, 1)).run()
    assert before is not None
    assert before.refit is not None
    assert result.identification is not None
    assert result.identification.refit is None
    assert result.identification.estimates == before.estimates
    assert f"after stage {count - 1} of {count} (whole records, " in result.outcome
    assert "no refit to free runs: stopped at its time limit" in [f.text for f in result.findings]


def test_terms_that_were_not_tested_stay_where_the_limit_comes_among_them():
    data = data_set([read_by_encoder(e) for e in records()])
    task = make_task(data, "mechanism", system="mechanism")
    with pytest.raises(UnfinishedSearchError):
        Search(task, lambda search: len(search.progress) > 2).run()
    result = Search(task, lambda search: len(search.stages) == 2).run()
    assert "among the optional terms; the values are those of a fit to segments" in result.outcome
    [remark] = [f.text for f in result.findings if f.text.startswith("optional terms: ")]
    assert "are left; the time limit ended the search" in remark


@dataclass(frozen=True)
class Point:
    """A point of a parabola."""

    x: float

    @property
    def cost(self) -> float:
        return self.x**2


def test_an_iteration_asks_before_every_step_and_returns_the_best_point():
    rule = DampingRule(1.0, 1e9, 2.0, lambda damping, gain: 1.0, 0.0)
    asked, trials = [], []

    def should_stop() -> bool:
        asked.append(len(asked))
        return len(asked) == 4

    def propose(point: Point, damping: float) -> tuple[Point, float]:
        return Point(point.x / 2 if damping > 1 else -9.0), 1.0

    def stricter(point: Point, cost: float) -> bool:
        return False

    result = iterate(
        Point(8.0),
        propose,
        stricter,
        rule,
        100,
        lambda iterations, point, _, is_accepted: trials.append((iterations, point.x, is_accepted)),
        should_stop,
    )
    assert (result.status, result.iterations, result.point) == ("stopped", 1, Point(4.0))
    assert trials == [(0, 8.0, False), (1, 4.0, True), (1, 4.0, False)]
