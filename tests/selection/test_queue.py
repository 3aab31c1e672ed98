"""The queue of a selection, with jobs that only pretend."""

import math
import re
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from small_selection import swings

from tustinnet.evaluate.reference import find_reference
from tustinnet.evaluate.scores import Score
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.fitting.recipe import IdentificationRecipe
from tustinnet.selection import runner
from tustinnet.selection.final_models import SelectionResults, compare_whole_records
from tustinnet.selection.jobs import FitScore, Job, JobResult, RunContext
from tustinnet.selection.plan import SelectionPlan
from tustinnet.selection.queue import CandidateQueue
from tustinnet.selection.ranking import CandidateResult
from tustinnet.selection.runner import Workplace, run_jobs
from tustinnet.selection.scoring import Scorer

PLAN = {
    "name": "pretended",
    "candidates": [
        {"name": "linear", "recipe": "linear"},
        {"name": "grey", "recipe": "best-grey"},
        {"name": "network", "recipe": "best-tustin"},
        {"name": "hybrid", "recipe": "best-hybrid", "corrects": ["grey"]},
    ],
}
QUALITY = {"linear": 0.09, "grey": 0.03, "better grey": 0.025, "network": 0.02, "hybrid": 0.01}


class Pretended(ThreadPoolExecutor):
    """Pretends to do jobs, several at once."""

    def __init__(self, places: int = 1, of: Callable[[Job], JobResult | None] = lambda job: None):
        super().__init__(places)
        self.done: list[Job] = []
        self._of, self._lock = of, threading.Lock()

    def submit(self, fn, /, *args, **named) -> Future:  # pyright: ignore[reportIncompatibleMethodOverride]
        return super().submit(self._pretend, args[1])

    def _pretend(self, job: Job) -> JobResult:
        with self._lock:
            self.done.append(job)
            other = self._of(job)
        return other or scored(job, QUALITY[job.candidate])


def scored(job: Job, error: float, seconds: float = 1.0, **more) -> JobResult:
    """The result of a job that is done, on two records."""
    rmse = {f"r{job.fold}{i}": error + 0.001 * i for i in range(2)}
    models = tuple(
        FitScore(seed, "finished", f"{job.folder}/{seed}", None, {"model-20": rmse}, **more)
        for seed in job.seeds
    )
    return JobResult(job.candidate, job.fold, seconds, "done", models)


@dataclass
class Tried:
    """A queue, and what it says while its jobs are done."""

    queue: CandidateQueue
    said: list[str] = field(default_factory=list)

    def run(self, executor: Pretended) -> list[CandidateResult]:
        with executor:
            run_jobs(
                self.queue.choose, self.queue.add, lambda: self.queue.context, Workplace(executor)
            )
        return self.queue.remaining()


@pytest.fixture(autouse=True)
def _without_files(monkeypatch):
    monkeypatch.setattr(runner, "_take_result", lambda future, job, context: future.result())
    monkeypatch.setattr(RunContext, "load_model", lambda self, name: name)
    scores = {"model-20": {"r": 0.1}}
    monkeypatch.setattr(RunContext, "score", lambda self, model, horizon, fold: scores)


def tried(
    plan: dict | None = None, deadline: Deadline = NEVER, start: str = "model-20", **more
) -> Tried:
    made, said = SelectionPlan.model_validate(plan or PLAN), []
    context = RunContext(swings(), Scorer(3, start), Path("nowhere"), **more)
    queue = CandidateQueue(made, made.candidates, context, said.append, deadline)
    return Tried(queue, said)


def names(executor: Pretended, fold: int | None = None) -> list[str]:
    """The candidates of the jobs that were done, in order."""
    return [job.candidate for job in executor.done if fold is None or job.fold == fold]


@pytest.mark.parametrize("places", [1, 3])
def test_the_best_kinds_go_on_to_all_folds(places, monkeypatch):
    still = {f"r{fold}{i}": 0.1 for fold in range(3) for i in range(2)}
    reference = SimpleNamespace(rmse=still, mean=0.1, label="standing still")
    monkeypatch.setattr(RunContext, "reference", reference)
    executor, found = Pretended(places), tried()
    left = found.run(executor)
    assert [r.name for r in left] == ["hybrid", "network", "grey", "linear"]
    jobs = {(j.candidate, j.fold) for j in executor.done}
    assert jobs >= {
        ("linear", 0),
        *((name, fold) for name in ("grey", "network", "hybrid") for fold in range(3)),
    }
    assert len(executor.done) == len(jobs)
    assert re.match(
        r"best so far: \w+, off by 0.0\d+ rad \([0-9.]+ % of standing still\)", found.said[0]
    )
    assert found.said[0].endswith(" on 2 records, 1 of 3 folds")
    line = "best so far: hybrid, off by 0.0105 rad (10 % of standing still)"
    assert any(said.startswith(line) for said in found.said)


def test_what_takes_least_of_first_fits_and_further_ones_of_the_best_is_next():
    def of(job: Job) -> JobResult:
        seconds = {"linear": 0.5, "grey": 3.0, "network": 30.0, "hybrid": 20.0}[job.candidate]
        return scored(job, QUALITY[job.candidate], seconds)

    executor, found = Pretended(of=of), tried()
    found.run(executor)
    assert names(executor)[:5] == ["linear", "grey", "grey", "grey", "network"]
    assert names(executor).count("linear") == 1  # a loser goes no further


@pytest.mark.parametrize("places", [1, 4])
def test_a_network_that_corrects_waits_for_the_physics_of_its_fold(places):
    executor, found = Pretended(places), tried()
    found.run(executor)
    done: set[str] = set()
    for job in executor.done:
        if job.candidate == "hybrid":
            physics = f"candidates/grey/fold-{job.fold}-seeds-0"
            assert job.physics == f"{physics}/0"
            assert physics in done
        done.add(job.folder)


def test_of_several_that_could_be_corrected_the_best_goes_on_with_it():
    other = {"name": "better grey", "recipe": "best-grey"}
    hybrid = {**PLAN["candidates"][3], "corrects": ["grey", "better grey"]}
    candidates = [*PLAN["candidates"][:2], other, hybrid]
    quality = QUALITY | {"linear": 0.02, "hybrid": 0.022}  # the others of a kind are tried, too
    executor = Pretended(
        of=lambda job: scored(
            job, quality[job.candidate], 20.0 if job.candidate == "hybrid" else 5.0
        )
    )
    found = tried({**PLAN, "candidates": candidates, "keep": 0.1})
    found.run(executor)
    used = [j.physics for j in executor.done if j.candidate == "hybrid"]
    physics = ["better grey"] * 3  # which takes less than a hybrid
    assert used == [f"candidates/{name}/fold-{f}-seeds-0/0" for f, name in enumerate(physics)]


def test_what_corrects_waits_for_equations_that_come_after_it():
    grey = {**PLAN["candidates"][1], "last": True}
    found = tried({**PLAN, "candidates": [grey, PLAN["candidates"][3]]})
    executor = Pretended(of=lambda job: scored(job, QUALITY[job.candidate], 100.0))
    assert [r.name for r in found.run(executor)] == ["hybrid", "grey"]
    assert names(executor, 0)[:2] == ["grey", "hybrid"]
    assert not any("left out" in line for line in found.said)


BY_FORCES = {"name": "forces", "recipe": "inverse-dynamics", "when": "fully-actuated"}


def with_forces(*begins_with: str) -> dict:
    """The plan with a candidate by forces, second, with which the grey one begins."""
    grey = {**PLAN["candidates"][1], "begins_with": begins_with}
    return {**PLAN, "candidates": [PLAN["candidates"][0], BY_FORCES, grey, *PLAN["candidates"][2:]]}


@pytest.mark.parametrize("places", [1, 3])
def test_a_search_begins_with_what_forces_say_in_its_fold(places, monkeypatch):
    monkeypatch.setitem(QUALITY, "forces", 0.05)
    executor, found = Pretended(places), tried(with_forces("forces"))
    found.run(executor)
    done: list[tuple[str, int]] = []
    for job in executor.done:
        if job.candidate == "grey":
            assert job.origin == f"candidates/forces/fold-{job.fold}-seeds-0/0"
            assert ("forces", job.fold) in done
        else:
            assert job.origin is None
        done.append((job.candidate, job.fold))


def test_a_search_begins_at_the_values_of_the_system_where_forces_failed(monkeypatch):
    monkeypatch.setitem(QUALITY, "forces", 0.05)
    executor = Pretended(
        of=lambda job: (
            JobResult(job.candidate, job.fold, 0.1, "failed", why="too short")
            if job.candidate == "forces"
            else None
        )
    )
    found = tried(with_forces("forces"))
    found.run(executor)
    assert "forces, fold 0: too short" in found.said
    greys = [job for job in executor.done if job.candidate == "grey"]
    assert [job.origin for job in greys] == [None] * 3


@pytest.mark.parametrize(
    ("unexplained", "error", "by_pieces"),
    [(0.05, math.inf, True), (0.05, 1.2, True), (0.05, 0.8, False), (0.5, 1.2, False)],
)
def test_equations_that_explain_the_forces_and_leave_the_records_change_the_scores_at_once(
    unexplained, error, by_pieces
):
    horizons = list[float | None]()

    def of(job: Job) -> JobResult:
        horizons.append(found.queue.context.scoring.horizon)
        if job.candidate == "forces":
            return scored(job, error * motion, unexplained={"angle": unexplained})
        return scored(job, 0.01)

    found = tried(with_forces("forces"), cutoff=4.0)
    motion = found.queue.context.motion_within_turns
    found.run(executor := Pretended(of=of))
    assert names(executor)[:2] == ["linear", "linear"] or "forces" in names(executor)[:3]
    after = horizons[names(executor).index("forces") + 1]
    assert (after is not None) == by_pieces
    assert len(found.queue.notes) == by_pieces
    # every other search is over these pieces, too, and what was searched over records is again
    greys = [(job.fold, job.recipe) for job in executor.done if job.candidate == "grey"]
    searched = [(f, r.search.horizon) for f, r in greys if isinstance(r, IdentificationRecipe)]
    over_pieces = {fold for fold, horizon in searched if horizon == after}
    assert over_pieces == {fold for fold, _ in searched}


def test_a_kind_goes_on_with_its_simplest_that_is_as_good():
    quality = {"grey": 0.01, "better grey": 0.01 - 1e-4}
    other = {"name": "better grey", "recipe": "best-grey"}

    def of(job: Job) -> JobResult:
        if job.candidate not in quality:
            return scored(job, QUALITY[job.candidate], 100.0)
        rmse = {f"r{job.fold}{i}": quality[job.candidate] * (1 + i) ** 2 for i in range(2)}
        if job.candidate == "grey":
            rmse = dict(zip(rmse, reversed(rmse.values()), strict=True))
        models = (FitScore(0, "finished", "m", None, {"model-20": rmse}),)
        return JobResult(job.candidate, job.fold, 100.0, "done", models)

    found = tried(
        {
            **PLAN,
            "candidates": [*PLAN["candidates"][:2], other],
            "keep": 1.0,
        }
    )
    found.run(executor := Pretended(of=of))
    assert set(names(executor, 1)) == {"grey", "linear"}


def test_a_second_one_of_a_kind_and_what_is_rarely_the_best_count_more():
    other = {"name": "another network", "recipe": "best-tustin"}
    rare = {"name": "rare grey", "recipe": "best-grey", "last": True}
    candidates = [*PLAN["candidates"][:2], rare, other, *PLAN["candidates"][2:]]
    quality = QUALITY | {"another network": 0.02, "rare grey": 0.03}
    seconds = {"linear": 1.0, "grey": 15.0, "rare grey": 15.0}
    executor = Pretended(
        of=lambda job: scored(job, quality[job.candidate], seconds.get(job.candidate, 35.0))
    )
    found = tried({**PLAN, "candidates": candidates, "scored": 1})
    found.run(executor)
    assert names(executor) == [
        "linear",
        "grey",
        "another network",
        "rare grey",
        "hybrid",
        "network",
    ]


def test_what_is_ahead_on_few_records_is_fitted_to_more_before_others_of_its_kind_are_tried():
    errors = {"linear": (0.09, 0.09), "grey": (0.3, 0.3), "another network": (0.2, 0.2)}
    errors["network"] = (0.01, 0.088)  # on two records no clear difference
    seconds = {"linear": 1.0, "grey": 15.0, "network": 35.0, "another network": 25.0}

    def of(job: Job) -> JobResult:
        pair = errors[job.candidate]
        rmse = {f"r{job.fold}{i}": error for i, error in enumerate(pair)}
        models = (FitScore(0, "finished", "m", None, {"model-20": rmse}),)
        return JobResult(job.candidate, job.fold, seconds[job.candidate], "done", models)

    other = {"name": "another network", "recipe": "best-tustin"}
    candidates = [*PLAN["candidates"][:3], other]
    found = tried({**PLAN, "candidates": candidates, "keep": 1.0})
    found.run(executor := Pretended(of=of))
    order = names(executor)
    assert order[:6] == ["linear", "grey", "linear", "linear", "network", "network"]
    assert order.index("another network") > 5


def test_where_the_best_is_lost_what_is_not_goes_on_before_networks_are_tried():
    seconds = {"linear": 1.0, "grey": 3.0, "network": 60.0}

    def of(job: Job) -> JobResult:
        is_lost = (job.candidate, job.fold) == ("grey", 1)
        return scored(job, 1e6 if is_lost else QUALITY[job.candidate], seconds[job.candidate])

    found = tried({**PLAN, "candidates": PLAN["candidates"][:3], "keep": 0.1})
    found.run(executor := Pretended(of=of))
    order = [(job.candidate, job.fold) for job in executor.done]
    assert order[:4] == [("linear", 0), ("grey", 0), ("grey", 1), ("linear", 1)]
    assert order.index(("linear", 2)) < order.index(("network", 0))


def test_what_the_records_speak_for_goes_on_with_the_best_of_its_kind():
    late = {"name": "late grey", "recipe": "best-grey", "last": True}
    plan = SelectionPlan.model_validate(
        {**PLAN, "candidates": [*PLAN["candidates"][:3], late], "keep": 0.1}
    )
    quality = QUALITY | {"late grey": 0.05}  # on the first fold
    seconds = {"linear": 1.0, "grey": 3.0, "late grey": 4.0, "network": 60.0}
    for promising in ((), ("late grey",)):
        context = RunContext(swings(), Scorer(3, "model-20"), Path("nowhere"))
        queue = CandidateQueue(plan, plan.candidates, context, print, promising=promising)
        executor = Pretended(
            of=lambda job: scored(job, quality[job.candidate], seconds[job.candidate])
        )
        Tried(queue).run(executor)
        folds = [job.fold for job in executor.done if job.candidate == "late grey"]
        assert folds == ([0, 1, 2] if promising else [0])


def test_what_fails_is_left_and_told_and_the_others_go_on():
    def of(job: Job) -> JobResult | None:
        if job.candidate == "grey":
            return JobResult("grey", job.fold, 1.0, "failed", why="arm.py fails at line 3")
        return None

    found = tried()
    left = found.run(Pretended(of=of))
    assert [r.name for r in left] == ["network", "linear"]
    assert found.queue.results["grey"].why == "arm.py fails at line 3"
    assert found.queue.results["hybrid"].why == "nothing to correct: grey"
    assert "grey, fold 0: arm.py fails at line 3" in found.said
    assert found.said.count("hybrid: left out, nothing to correct: grey") == 1


@pytest.fixture
def left(monkeypatch) -> list[float]:
    """The seconds that are left until every deadline."""
    left = [200.0]
    monkeypatch.setattr(Deadline, "remaining", property(lambda self: left[0]))
    return left


def spending(left: list[float], seconds: dict[str, float]) -> Callable[[Job], JobResult]:
    def of(job: Job) -> JobResult:
        left[0] -= seconds[job.candidate]
        return scored(job, QUALITY[job.candidate], seconds[job.candidate])

    return of


def test_what_was_scored_on_all_folds_can_be_chosen_whoever_was_ahead_on_the_first():
    """Of a ball on a beam a second mechanism was ahead on two records; the first was not chosen."""
    errors = {"linear": (0.2, 0.2), "grey": (0.1, 0.1), "better grey": (0.05, 0.3)}

    def of(job: Job) -> JobResult:
        first, others = errors[job.candidate]
        return scored(job, others if job.fold else first)

    candidates = [*PLAN["candidates"][:2], {"name": "better grey", "recipe": "best-grey"}]
    left = tried({**PLAN, "candidates": candidates}).run(Pretended(of=of))
    assert left[0].name == "grey"
    assert len(left[0].fits_by_fold) == 3


def test_no_job_begins_that_would_take_longer_than_what_is_left(left):
    seconds = {"linear": 1.0, "grey": 40.0, "network": 50.0, "hybrid": 5.0}
    found = tried(deadline=Deadline(0.0))
    result = found.run(executor := Pretended(of=spending(left, seconds)))
    assert left[0] > 0
    assert names(executor) == ["linear", "grey", "network", "network", "network"]
    assert result[0].name == "network"


def test_a_network_is_expected_to_take_longer_where_its_equations_did(left):
    """Of an arm of six joints XLA compiles them for minutes, which no limit of time ends."""
    seconds = {"linear": 1.0, "grey": 60.0, "network": 40.0, "hybrid": 300.0}
    found = tried({**PLAN, "scored": 1}, Deadline(0.0))
    found.run(executor := Pretended(of=spending(left, seconds)))
    assert names(executor) == ["linear", "grey", "network"]
    assert "hybrid: left out, no time was left for it" in found.said


def test_a_network_is_expected_to_take_longer_on_a_fold_with_stiffer_equations(left):
    seconds = {"linear": 1.0, "grey": 5.0, "network": 10.0, "hybrid": 20.0}

    def of(job: Job) -> JobResult:
        left[0] -= seconds[job.candidate]
        substeps = {"grey": 32 if job.fold == 1 else 4}.get(job.candidate, 1)
        return scored(job, QUALITY[job.candidate], seconds[job.candidate], substeps=substeps)

    found = tried(PLAN, Deadline(0.0))
    found.run(executor := Pretended(of=of))
    assert [job.fold for job in executor.done if job.candidate == "hybrid"] == [0, 2]
    assert left[0] < 160


def test_a_first_try_leaves_as_much_for_the_others_and_the_last_one_has_all(left):
    seconds = {"linear": 10.0, "grey": 50.0, "network": 30.0, "hybrid": 20.0}
    found = tried({**PLAN, "scored": 1}, Deadline(0.0))
    found.run(executor := Pretended(of=spending(left, seconds)))
    assert [job.limit for job in executor.done] == pytest.approx([100.0, 95.0, 100.0, 110.0])


def test_nothing_is_tried_for_the_first_time_in_the_last_seconds(left):
    seconds = {"linear": 195.0, "grey": 1.0, "network": 1.0, "hybrid": 1.0}
    found = tried(deadline=Deadline(0.0))
    scored_ones = found.run(executor := Pretended(of=spending(left, seconds)))
    assert [r.name for r in scored_ones] == ["linear"]
    assert len(executor.done) == 1
    assert "network: left out, no time was left for it" in found.said


def test_without_a_limit_of_time_jobs_have_none():
    found = tried()
    found.run(executor := Pretended())
    assert all(math.isinf(job.limit) for job in executor.done)


@pytest.mark.parametrize(("share", "by_pieces"), [(0.2, False), (0.4, True), (math.inf, True)])
def test_whole_records_of_which_nobody_follows_enough_decide_nothing(share, by_pieces):
    found = tried({**PLAN, "scored": 1})
    motion = found.queue.context.motion_within_turns
    found.run(Pretended(of=lambda job: scored(job, share * motion)))
    horizon = found.queue.context.scoring.horizon
    assert (horizon is not None) == by_pieces
    if by_pieces:  # what was solved and identified is scored again, before networks are tried
        again = [r.name for r in found.queue.remaining() if r.rmse() == {"r": 0.1}]
        assert sorted(again) == ["grey", "linear"]
        assert f"judged over pieces of {horizon:.3g} s instead" in found.queue.notes[0].text


@pytest.mark.parametrize(
    ("start", "pieces"), [("model-3", "a tenth of a record"), ("model-20", "three starts")]
)
@pytest.mark.parametrize("cutoff", [None, 4.0])
def test_pieces_are_a_tenth_of_a_record_and_longer_than_starts(start, pieces, cutoff):
    found = tried({**PLAN, "candidates": PLAN["candidates"][:1]}, start=start, cutoff=cutoff)
    data, motion = found.queue.context.data, found.queue.context.motion_within_turns
    found.run(Pretended(of=lambda job: scored(job, motion)))
    samples = {"a tenth of a record": 0.1 * len(data[0]), "three starts": 60.0}[pieces]
    assert found.queue.context.scoring.horizon == pytest.approx(samples * data.channels.dt)
    # over pieces whatever is further off than standing still is lost
    horizon = found.queue.context.scoring.horizon
    assert found.queue.results["linear"].lost == min(
        motion, find_reference(list(data), horizon).mean
    )
    # that a controller held the machine is what a cut-off of its motion tells
    assert ("of a machine that a controller held" in found.queue.notes[0].text) == bool(cutoff)


def test_trainings_that_their_limit_stopped_go_on_in_the_time_that_is_left(left):
    def of(job: Job) -> JobResult | None:
        left[0] -= 1.0
        if job.candidate != "network" or job.continues:
            return None
        models = (FitScore(0, "out of time", "m", None, {"model-20": {f"r{job.fold}0": 0.001}}),)
        return JobResult("network", job.fold, 1.0, "out of time", models, "spent")

    found = tried(deadline=Deadline(0.0))
    executor = Pretended(of=of)
    results = {r.name: r for r in found.run(executor)}
    assert "network, fold 0: spent" in found.said
    again = [(job.candidate, job.fold) for job in executor.done if job.continues]
    assert set(again) == {("network", fold) for fold in range(3)}
    assert {m.outcome for m in results["network"].fits} == {"finished"}


def test_what_is_lost_on_other_records_is_not_chosen_for_having_more_of_them(left):
    def of(job: Job) -> JobResult:
        seconds = 1.0 if job.candidate == "linear" else 90.0
        left[0] -= seconds
        error = 50.0 if job.fold else 0.011 if job.candidate == "linear" else 0.01
        return scored(job, error, seconds)

    found = tried({**PLAN, "candidates": PLAN["candidates"][:2]}, Deadline(0.0))
    remaining = found.run(executor := Pretended(of=of))
    assert names(executor) == ["linear", "grey", "linear", "linear"]
    assert remaining[0].name == "grey"
    assert any(line.startswith("best so far: grey, off by 0.0105 rad") for line in found.said)


@pytest.mark.parametrize("horizon", [None, 0.5])
def test_whole_records_decide_between_what_pieces_do_not_tell_apart(horizon, monkeypatch):
    far = {"grey": np.nan, "network": 0.2, "linear": 0.1}  # over whole records
    errors = {"grey": 0.02, "network": 0.0205, "linear": 0.09}
    plan = SelectionPlan.model_validate({**PLAN, "candidates": PLAN["candidates"][:3]})
    context = RunContext(swings(), Scorer(3, "model-20", horizon), Path("nowhere"))
    results = []
    for c in plan.candidates:
        result = CandidateResult(c.name)
        for fold in (0, 1):
            job = Job(c.name, context.recipe_of(c), fold)
            result = result.with_job(
                scored(job, errors[c.name] + 0.002 * fold * (c.name == "grey"))
            )
        results.append(result)

    def evaluate_folds(self, fits, start, horizon):
        name = next(r.name for r in results if r.fits_by_fold is fits)
        return {"r": Score("r", start, far[name], far[name], (), (), (), np.zeros((1, 2)))}

    monkeypatch.setattr(RunContext, "evaluate_folds", evaluate_folds)
    candidates = SelectionResults(plan, tuple(results), tuple(far))
    grey = candidates.result("grey")
    best, scores, alike = compare_whole_records(candidates, grey, context)
    expected = ("grey", ()) if horizon is None else ("network", ("grey", "network"))
    assert (best.name, alike) == expected
    assert scores["r"].rmse == pytest.approx(far[best.name], nan_ok=True)
