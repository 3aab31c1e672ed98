"""Successive halving: rounds of more and more folds and seeds, each with fewer candidates."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.selection.deadline import NEVER, Deadline
from tustinnet.selection.jobs import SCORES, Job, JobResult, RunContext
from tustinnet.selection.plan import Candidate, SelectionPlan
from tustinnet.selection.ranking import CandidateResult, find_simplest, rank, shared_folds
from tustinnet.selection.runner import Executor, run_jobs

_TRYING = 0.6  # share of the time after which no candidate is tried for the first time
_TRYING_LAST = 0.4  # that share of candidates that come last
NO_TIME = "no time was left for it"
_FEWEST = 2  # candidates that go on, where there are as many


class Halving:
    """Candidates on their way through the rounds of a plan.

    Args:
        plan: the plan.
        candidates: those of its candidates that take part.
        context: the records, how they are scored.
        on_message: called with sentences on what happens.
        deadline: when the rounds have to end.

    Attributes:
        plan: the plan.
        results: of each candidate, by name, from the simplest on.
        cheapest: of the candidates that time ended before they were scored once, the job that
            would have ended first; None without any.
        hopeless: whether free runs of whole records were further off than the records move, for
            all candidates: then the first round was the last one.
    """

    def __init__(
        self,
        plan: SelectionPlan,
        candidates: Sequence[Candidate],
        context: RunContext,
        on_message: Callable[[str], None],
        deadline: Deadline = NEVER,
    ) -> None:
        self.plan, self._candidates, self._context = plan, tuple(candidates), context
        self._folds, self._on_message = context.scoring.folds, on_message
        self._deadline, self._time = deadline, deadline.remaining
        self._expected: dict[str, float] = {}  # seconds a seed takes on a fold
        self._omitted = 0  # jobs of a round for which no time was left
        self._pending = 0  # jobs of a round that have not begun
        self.results = {c.name: CandidateResult(c.name) for c in candidates}
        self.cheapest: JobResult | None = None
        self.hopeless = False

    def run(self, executor: Executor) -> list[CandidateResult]:
        """Goes through the rounds; returns the candidates that remain, the best first."""
        alive = self._candidates
        for number, stage in enumerate(self.plan.rounds):
            if number:
                order = [r.name for r in rank([self.results[c.name] for c in alive])]
                ordered = sorted(alive, key=lambda c: order.index(c.name))
            else:
                ordered = sorted(alive, key=lambda c: c.last)
            late = set() if number else {c.name for c in alive if c.last}
            jobs = []
            for fold in range(min(stage.folds, self._folds)):
                for c in ordered:
                    seeds = c.content.family.select_seeds(range(stage.seeds))
                    done = {s.seed for s in self.results[c.name].folds.get(fold, ())}
                    waits_for = tuple(name for name in c.corrects if name not in late)
                    if missing := tuple(seed for seed in seeds if seed not in done):
                        jobs.append(Job(c.name, c.content, fold, missing, waits_for=waits_for))
            self._omitted, self._pending = 0, len(jobs)
            run_jobs(
                jobs, executor, self._deadline, prepare=self._prepare, on_result=self._add_result
            )
            ranking = rank([self.results[c.name] for c in alive])
            last = number + 1 == len(self.plan.rounds)
            kinds = ranking if last else self._best_of_kinds(ranking)
            count = len(kinds) if last else max(_FEWEST, math.ceil(stage.keep * len(kinds)))
            # candidates that go on, and the best that each of them corrects
            kept = {r.name for r in kinds[:count]}
            for c in alive:
                corrected = self._corrected(c) if c.name in kept else None
                kept |= {corrected.name} if corrected else set()
            alive = tuple(c for c in alive if c.name in kept)
            self._report(number, ranking, len(alive))
            if number == 0 and ranking and self._context.scoring.horizon is None:
                mean, _ = mean_and_error(ranking[0].rmse().values())
                self.hopeless = not mean <= self._context.motion
            if self._deadline.remaining <= 0 or self.hopeless:
                break
        return rank([self.results[c.name] for c in alive])

    def _best_of_kinds(self, ranking: Sequence[CandidateResult]) -> list[CandidateResult]:
        """The simplest of each kind of model that is as good as its best, in the order of these."""
        kind = {c.name: c.content.family.kind for c in self._candidates}
        by_kind: dict[str, list[CandidateResult]] = {}
        for result in ranking:
            by_kind.setdefault(kind[result.name], []).append(result)
        place = list(kind).index
        return [
            find_simplest(sorted(results, key=lambda r: place(r.name)), results[0])
            for results in by_kind.values()
        ]

    def _corrected(self, by: Candidate, fold: int | None = None) -> CandidateResult | None:
        """The candidate to correct, in a fold or anywhere: the simplest as good as the best."""
        results = [self.results[name] for name in by.corrects if name in self.results]
        scored = [r for r in results if (r.folds if fold is None else fold in r.folds)]
        return find_simplest(scored, rank(scored)[0]) if scored else None

    def _prepare(self, job: Job) -> Job | None:
        """The job with what it corrects; None where it has nothing to, or no time is left."""
        self._pending -= 1
        candidate, physics = self.plan.candidate(job.candidate), None
        if candidate.corrects:
            corrected = self._corrected(candidate, job.fold)
            if corrected is None:
                return self._omit(job, "nothing to correct: " + ", ".join(candidate.corrects))
            physics = corrected.folds[job.fold][0].model
        remaining = self._deadline.remaining
        if candidate.name in self._expected:
            affordable = remaining > len(job.seeds) * self._expected[candidate.name]
        else:
            trying = _TRYING_LAST if candidate.last else _TRYING
            affordable = remaining > (1 - trying) * self._time or math.isinf(remaining)
        scores = self._context.folder / job.folder / SCORES
        if not affordable and (self._context.resume or not scores.is_file()):
            self._omitted += 1
            return self._omit(job, NO_TIME)
        return replace(job, physics=physics, yields=self._pending > 0)

    def _omit(self, job: Job, why: str) -> None:
        result = self.results[job.candidate]
        if not result.folds and not result.why:
            self.results[job.candidate] = replace(result, why=why)
            self._on_message(f"{job.candidate}: left out, {why}")

    def _add_result(self, result: JobResult) -> None:
        name = result.candidate
        self.results[name] = self.results[name].with_job(result)
        if result.scores:
            seconds = result.seconds if result.needs is None else result.needs
            self._expected[name] = seconds / len(result.scores)
        if result.ended == "done":
            return
        self._on_message(f"{name}, fold {result.fold}: {result.why}")
        if result.needs is not None and not self.results[name].folds:
            best = self.cheapest
            if best is None or result.needs < (best.needs or math.inf):
                self.cheapest = result

    def _report(self, number: int, ranking: Sequence[CandidateResult], kept: int) -> None:
        """Reports how the candidates stand after a round."""
        if not ranking:
            return
        shared = shared_folds(ranking)
        means = [(r.name, mean_and_error(r.rmse(shared).values())[0]) for r in ranking]
        rounds, count = len(self.plan.rounds), len(shared or ())
        folds = f"{count} of {self._folds} folds" if count > 1 else "one fold"
        on = f"; {kept} go on" if number + 1 < rounds else ""
        figures = ", ".join(f"{name} {mean:.3g}" for name, mean in means)
        self._on_message(f"round {number + 1} of {rounds}, {folds}: {figures}{on}")
        if self._omitted:
            self._on_message(f"the budget ended this round early: no time was left for "
                             f"{self._omitted} of its fits")  # fmt: skip
