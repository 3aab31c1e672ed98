"""Successive halving, with jobs that only pretend."""

import math
import time
from collections.abc import Callable

import pytest
from small_selection import swings

from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.selection.halving import Halving
from tustinnet.selection.jobs import FitScore, Job, JobResult, RunContext
from tustinnet.selection.plan import SelectionPlan
from tustinnet.selection.scoring import Scorer

PLAN = {
    "name": "pretended",
    "candidates": [
        {"name": "linear", "recipe": "linear"},
        {"name": "grey", "recipe": "best-grey"},
        {"name": "network", "recipe": "best-tustin"},
        {"name": "hybrid", "recipe": "best-hybrid", "corrects": ["grey"]},
    ],
    "rounds": [{"folds": 1}, {"folds": 3, "keep": 0.5}, {"folds": 3, "seeds": 2}],
}
QUALITY = {"linear": 0.9, "grey": 0.3, "better grey": 0.25, "network": 0.2, "hybrid": 0.1}


class Pretended:
    """Does jobs at once, the last that it was given first where it may have several."""

    def __init__(self, slots: int = 1, of: Callable[[Job], JobResult | None] = lambda job: None):
        self.done: list[Job] = []
        self._slots, self._of = slots, of
        self._waiting: list[Job] = []

    @property
    def is_free(self) -> bool:
        return len(self._waiting) < self._slots

    def submit(self, job: Job, deadline: Deadline) -> None:
        self._waiting.append(job)

    def result(self) -> JobResult:
        job = self._waiting.pop()
        self.done.append(job)
        other = self._of(job)
        if other is not None:
            return other
        rmse = {f"r{job.fold}{i}": QUALITY[job.candidate] + 0.01 * i for i in range(2)}
        models = tuple(
            FitScore(seed, "finished", f"{job.folder}/{seed}", None, {"model-20": rmse})
            for seed in job.seeds
        )
        return JobResult(job.candidate, job.fold, 1.0, "done", models)


def halving(plan: dict | None = None, deadline: Deadline = NEVER) -> tuple[Halving, list[str]]:
    of, said = SelectionPlan.model_validate(plan or PLAN), []
    context = RunContext(swings(), Scorer(3, "model-20"))
    return Halving(of, of.candidates, context, said.append, deadline), said


@pytest.mark.parametrize("slots", [1, 3])
def test_each_round_has_more_folds_and_seeds_and_fewer_candidates(slots):
    executor, (found, said) = Pretended(slots), halving()
    left = found.run(executor)
    assert [s.name for s in left] == ["hybrid", "network", "grey"]
    jobs = {(j.candidate, j.fold, j.seeds) for j in executor.done}
    assert jobs == {
        ("linear", 0, (0,)),
        *((name, fold, (0,)) for name in ("grey", "network", "hybrid") for fold in range(3)),
        *((name, fold, (1,)) for name in ("network", "hybrid") for fold in range(3)),
    }
    assert len(executor.done) == len(jobs)
    assert said[0] == (
        "round 1 of 3, one fold: hybrid 0.105, network 0.205, grey 0.305, linear 0.905; 3 go on"
    )


@pytest.mark.parametrize("slots", [1, 4])
def test_a_network_that_corrects_waits_for_the_physics_of_its_fold(slots):
    executor, (found, _) = Pretended(slots), halving()
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
    executor = Pretended()
    found, _ = halving(
        {**PLAN, "candidates": candidates, "rounds": [{"folds": 1, "keep": 0.1}, {"folds": 3}]}
    )
    found.run(executor)
    assert {j.candidate for j in executor.done if j.fold == 2} == {"hybrid", "better grey"}
    used = [j.physics for j in executor.done if j.candidate == "hybrid"]
    assert used == [f"candidates/better grey/fold-{f}-seeds-0/0" for f in range(3)]


BY_FORCES = {"name": "forces", "recipe": "inverse-dynamics", "when": "fully-actuated"}


def with_forces(*begins_with: str) -> dict:
    """The plan with a candidate by forces, second, with which the grey one begins."""
    grey = {**PLAN["candidates"][1], "begins_with": begins_with}
    return {**PLAN, "candidates": [PLAN["candidates"][0], BY_FORCES, grey, *PLAN["candidates"][2:]]}


@pytest.mark.parametrize("slots", [1, 3])
def test_a_search_begins_with_what_forces_say_in_its_fold_as_long_as_it_goes_on(slots, monkeypatch):
    monkeypatch.setitem(QUALITY, "forces", 0.5)
    executor, (found, _) = Pretended(slots), halving(with_forces("forces"))
    remaining = found.run(executor)
    assert {r.name for r in remaining} == {"hybrid", "network", "grey", "forces"}
    done: list[tuple[str, int]] = []
    for job in executor.done:
        if job.candidate == "grey":
            assert job.origin == f"candidates/forces/fold-{job.fold}-seeds-0/0"
            assert ("forces", job.fold) in done
        else:
            assert job.origin is None
        done.append((job.candidate, job.fold))
    # it takes seconds, so it comes first of all
    assert done[0][0] == "forces" or slots > 1


def test_a_search_begins_at_the_values_of_the_system_where_forces_failed(monkeypatch):
    monkeypatch.setitem(QUALITY, "forces", 0.5)
    executor = Pretended(
        of=lambda job: (
            JobResult(job.candidate, job.fold, 0.1, "failed", why="too short")
            if job.candidate == "forces"
            else None
        )
    )
    found, said = halving(with_forces("forces"))
    found.run(executor)
    assert said[0] == "forces, fold 0: too short"
    greys = [job for job in executor.done if job.candidate == "grey"]
    assert [job.origin for job in greys] == [None] * 3


def test_the_same_kind_by_forces_does_not_make_a_search_by_simulation_wait(monkeypatch):
    monkeypatch.setitem(QUALITY, "forces", 0.5)
    executor, (found, _) = Pretended(), halving(with_forces("forces"), Deadline.after(1000.0))
    found.run(executor)
    assert [job.candidate for job in executor.done[:4]] == ["forces", "linear", "grey", "network"]


@pytest.mark.parametrize(
    ("unexplained", "error", "hopeless"),
    [(0.05, math.inf, True), (0.05, 1.2, True), (0.05, 0.8, False), (0.5, 1.2, False)],
)
def test_equations_that_explain_the_forces_and_leave_the_records_end_it_at_once(
    unexplained, error, hopeless
):
    executor = Pretended(
        of=lambda job: (
            JobResult(
                "forces",
                job.fold,
                0.1,
                "done",
                (
                    FitScore(
                        0,
                        "finished",
                        "m",
                        0.25,
                        {"model-20": {f"r{job.fold}": error * motion}},
                        {"angle": unexplained},
                    ),
                ),
            )
            if job.candidate == "forces"
            else None
        )
    )
    found, _ = halving(with_forces("forces"))
    motion = found._context.motion_within_turns
    found.run(executor)
    assert found.hopeless == hopeless
    assert ({job.candidate for job in executor.done} == {"forces"}) == hopeless


def test_a_kind_goes_on_with_its_simplest_that_is_as_good():
    quality = {"grey": 0.01, "better grey": 0.01 - 1e-4}
    other = {"name": "better grey", "recipe": "best-grey"}

    def of(job: Job) -> JobResult | None:
        if job.candidate not in quality:
            return None
        rmse = {f"r{job.fold}{i}": quality[job.candidate] * (1 + i) ** 2 for i in range(2)}
        if job.candidate == "grey":
            rmse = dict(zip(rmse, reversed(rmse.values()), strict=True))
        models = (FitScore(0, "finished", "m", None, {"model-20": rmse}),)
        return JobResult(job.candidate, job.fold, 1.0, "done", models)

    found, _ = halving(
        {
            **PLAN,
            "candidates": [*PLAN["candidates"][:2], other],
            "rounds": [{"folds": 1, "keep": 1.0}, {"folds": 2}],
        }
    )
    found.run(executor := Pretended(of=of))
    assert [j.candidate for j in executor.done if j.fold == 1] == ["grey", "linear"]


def test_what_comes_last_is_not_waited_for_in_the_first_round():
    other = {"name": "better grey", "recipe": "best-grey", "last": True}
    hybrid = {**PLAN["candidates"][3], "corrects": ["grey", "better grey"]}
    candidates = [*PLAN["candidates"][:2], other, PLAN["candidates"][2], hybrid]
    executor = Pretended()
    found, _ = halving(
        {**PLAN, "candidates": candidates, "rounds": [{"folds": 1, "keep": 1.0}, {"folds": 2}]}
    )
    found.run(executor)
    assert [j.candidate for j in executor.done if j.fold == 0] == [
        "linear",
        "grey",
        "network",
        "hybrid",
        "better grey",
    ]
    used = [j.physics for j in executor.done if j.candidate == "hybrid"]
    assert used == ["candidates/grey/fold-0-seeds-0/0", "candidates/better grey/fold-1-seeds-0/0"]


def test_what_fails_is_left_and_told_and_the_others_go_on():
    def of(job: Job) -> JobResult | None:
        if job.candidate == "grey":
            return JobResult("grey", job.fold, 1.0, "failed", why="arm.py fails at line 3")
        return None

    found, said = halving()
    left = found.run(Pretended(of=of))
    assert [s.name for s in left] == ["network", "linear"]
    assert found.results["grey"].why == "arm.py fails at line 3"
    assert found.results["hybrid"].why == "nothing to correct: grey"
    assert "grey, fold 0: arm.py fails at line 3" in said
    assert said.count("hybrid: left out, nothing to correct: grey") == 1


def test_no_job_begins_that_would_take_longer_than_what_is_left():
    found, said = halving(
        deadline=Deadline(time.monotonic() + 0.9)
    )  # every job says that it took 1 s
    left = found.run(executor := Pretended())
    assert {j.fold for j in executor.done} == {0}
    assert [s.name for s in left][:2] == ["hybrid", "network"]
    assert len(executor.done) == 4
    assert any("1 of 3" in line for line in said)


def test_candidates_are_not_tried_for_the_first_time_when_most_of_the_time_is_spent(monkeypatch):
    left = [100.0]
    monkeypatch.setattr(Deadline, "remaining", property(lambda self: left[0]))

    def slow(job: Job) -> None:
        left[0] -= 61.0

    found, said = halving(deadline=Deadline(0.0))
    scored = found.run(executor := Pretended(of=slow))
    assert [s.name for s in scored] == ["linear"]
    assert len(executor.done) == 1
    assert "network: left out, no time was left for it" in said


def test_free_runs_that_are_far_off_end_it_after_a_round():
    def of(job: Job) -> JobResult:
        rmse = {f"r{job.fold}": float("inf") if job.candidate == "grey" else 50.0}
        models = (FitScore(0, "finished", "m", None, {"model-20": rmse}),)
        return JobResult(job.candidate, job.fold, 1.0, "done", models)

    found, _ = halving()
    found.run(executor := Pretended(of=of))
    assert found.hopeless
    assert {j.fold for j in executor.done} == {0}


@pytest.mark.parametrize(("share", "hopeless"), [(0.2, False), (0.4, True)])
def test_whole_records_of_which_little_is_followed_decide_nothing(share, hopeless):
    def of(job: Job) -> JobResult:
        rmse = {f"r{job.fold}": share * motion}
        fits = (FitScore(0, "finished", "m", None, {"model-20": rmse}),)
        return JobResult(job.candidate, job.fold, 1.0, "done", fits)

    jobs, _ = halving()
    motion = jobs._context.motion_within_turns
    jobs.run(Pretended(of=of))
    assert jobs.hopeless == hopeless


def test_jobs_that_wait_have_equal_shares_of_the_time_and_what_one_leaves_is_for_the_others(
    monkeypatch,
):
    left = [200.0]
    monkeypatch.setattr(Deadline, "remaining", property(lambda self: left[0]))
    seconds = {"linear": 10.0, "grey": 50.0, "network": 30.0, "hybrid": 20.0}

    def of(job: Job) -> None:
        left[0] -= seconds[job.candidate]

    jobs, _ = halving(deadline=Deadline(0.0))
    jobs.run(executor := Pretended(of=of))
    # first tries have 120 s
    assert [job.limit for job in executor.done[:4]] == pytest.approx([30.0, 110 / 3, 30.0, 30.0])


def test_without_a_limit_of_time_jobs_have_none():
    jobs, _ = halving()
    jobs.run(executor := Pretended())
    assert all(math.isinf(job.limit) for job in executor.done)


def test_one_of_each_kind_is_tried_before_others_of_it():
    other = {"name": "better grey", "recipe": "best-grey"}
    candidates = [*PLAN["candidates"][:2], other, *PLAN["candidates"][2:]]
    jobs, _ = halving({**PLAN, "candidates": candidates})
    jobs.run(executor := Pretended())
    assert [job.candidate for job in executor.done if job.fold == 0][:5] == [
        "linear",
        "grey",
        "network",
        "hybrid",
        "better grey",
    ]


@pytest.mark.parametrize(("seconds", "soon"), [(1.0, True), (5.0, False)])
def test_others_of_a_kind_that_is_identified_quickly_come_before_networks(
    monkeypatch, seconds, soon
):
    left = [200.0]
    monkeypatch.setattr(Deadline, "remaining", property(lambda self: left[0]))

    def of(job: Job) -> JobResult | None:
        left[0] -= seconds
        rmse = {f"r{job.fold}{i}": QUALITY[job.candidate] for i in range(2)}
        models = (FitScore(0, "finished", "m", None, {"model-20": rmse}),)
        return JobResult(job.candidate, job.fold, seconds, "done", models)

    other = {"name": "better grey", "recipe": "best-grey", "last": True}
    hybrid = {**PLAN["candidates"][3], "corrects": ["grey", "better grey"]}
    candidates = [*PLAN["candidates"][:2], other, PLAN["candidates"][2], hybrid]
    jobs, _ = halving({**PLAN, "candidates": candidates}, deadline=Deadline(0.0))
    jobs.run(executor := Pretended(of=of))
    names = [job.candidate for job in executor.done if job.fold == 0][:5]
    early, late = (["better grey"], []) if soon else ([], ["better grey"])
    assert names == ["linear", "grey", *early, "network", "hybrid", *late]


def test_trainings_that_their_share_stopped_go_on_in_the_time_that_is_left(monkeypatch):
    left = [100.0]
    monkeypatch.setattr(Deadline, "remaining", property(lambda self: left[0]))

    def of(job: Job) -> JobResult | None:
        left[0] -= 1.0
        if job.candidate != "network" or job.continues:
            return None
        models = (FitScore(0, "out of time", "m", None, {"model-20": {f"r{job.fold}0": 0.01}}),)
        return JobResult("network", job.fold, 1.0, "out of time", models, "spent")

    jobs, messages = halving(deadline=Deadline(0.0))
    executor = Pretended(of=of)
    results = {r.name: r for r in jobs.run(executor)}
    assert "network, fold 0: spent" in messages
    assert any(line.startswith("round 1 of 3, one fold: network 0.01, ") for line in messages)
    again = [(job.candidate, job.fold, job.seeds) for job in executor.done if job.continues]
    assert again == [("network", fold, (seed,)) for seed in range(2) for fold in range(3)]
    assert {m.outcome for m in results["network"].fits} == {"finished"}
    assert len(results["network"].fits) == 6
