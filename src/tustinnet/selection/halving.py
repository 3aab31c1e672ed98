"""Successive halving: rounds of more and more folds and seeds, each with fewer candidates."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.selection.jobs import Job, JobResult, RunContext
from tustinnet.selection.plan import Candidate, Round, SelectionPlan
from tustinnet.selection.ranking import CandidateResult, find_simplest, rank, shared_folds
from tustinnet.selection.runner import Executor, run_jobs
from tustinnet.store.run_folder import SCORES

_TRYING = 0.6  # share of the time in which candidates are tried for the first time
_TRYING_LAST = 0.4  # that share of candidates that come last or are another one of their kind
_SOON = 60.0  # s, but first tries have at least so much: one fold of each is better than two of one
_LEAST = 8.0  # s, what a first try takes at least: a network is compiled before it learns
_LEAST_SHARE = 0.25  # of a short time, that least
# a fit that was stopped goes on where so many times its time is left: it compiles, or begins, anew
_AGAIN = 1.5
_QUICK = 0.02  # share of the time, an identification that is quick: others of its kind may follow
_BY_FORCES = 2  # a first comparison of forces has this part of the time: nothing is as cheap
_EXPLAINED = 0.2  # of the inputs' force, that is unexplained by equations that explain it
_FAR = 0.3  # of the motion within turns, an error of whole records that says little of a model
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
        ending: seconds after that, in which the chosen system is identified from all records.
        promising: names of candidates that are tried early, whatever the plan says: the records
            speak for them.

    Attributes:
        plan: the plan.
        results: of each candidate, by name, from the simplest on.
        hopeless: whether free runs of whole records were far off for all candidates, as where a
            plant is unstable, turns over or only integrates, or left the records for equations that
            explain the forces, as of a robot that a controller held: then nothing further was
            begun.
    """

    def __init__(
        self,
        plan: SelectionPlan,
        candidates: Sequence[Candidate],
        context: RunContext,
        on_message: Callable[[str], None],
        deadline: Deadline = NEVER,
        ending: float = 0.0,
        promising: Collection[str] = (),
    ) -> None:
        self.plan, self._candidates, self._context = plan, tuple(candidates), context
        self._folds, self._on_message = context.scoring.folds, on_message
        self._deadline, self._time, self._ending = deadline, deadline.remaining, ending
        self._expected: dict[str, float] = {}  # seconds a seed takes on a fold
        # one of each kind is tried before others of it; forces are compared in seconds
        simulated = [c for c in candidates if not c.is_by_forces]
        kinds = [c.content.family.kind for c in simulated]
        self._last = {c.name for c in candidates if c.last} - {*promising}
        self._late = {c.name for i, c in enumerate(simulated) if kinds[i] in kinds[:i]}
        self._late = self._last | (self._late - {*promising})
        self._begun: dict[tuple[str, int], Job] = {}  # the last job of a candidate and fold
        self._stopped: list[Job] = []  # jobs that their share of the time stopped
        self._omitted = 0  # jobs of a round for which no time was left, and nobody was told
        self._results = 0  # of a round
        self._pending: list[Job] = []  # jobs of a round that have not begun
        self.results = {c.name: CandidateResult(c.name) for c in candidates}
        self.hopeless = False

    def run(self, executor: Executor) -> list[CandidateResult]:
        """Goes through the rounds; returns the candidates that remain, the best first."""
        alive = self._candidates
        for number, stage in enumerate(self.plan.rounds):
            jobs = self._list_jobs(number, stage, alive)
            # candidates that take less than a share of the time come first, on all folds
            share = self._deadline.remaining / max(len(jobs), 1)
            jobs.sort(key=lambda job: self._expected.get(job.candidate, 0.0) > share)
            self._omitted = self._results = 0
            if not number:
                jobs = self._compare_forces(jobs, executor)
                if self.hopeless:
                    break
            if not number and not math.isinf(self._time):
                jobs = self._try_physics(jobs, executor)
            self._run_jobs(jobs, executor)
            if number and jobs and not self._results:
                self._on_message(
                    f"the budget ended before round {number + 1} of {len(self.plan.rounds)}"
                )
                break
            ranking = rank([self.results[c.name] for c in alive])
            last = number + 1 == len(self.plan.rounds)
            kinds = ranking if last else self._best_of_kinds(ranking)
            count = len(kinds) if last else max(_FEWEST, math.ceil(stage.keep * len(kinds)))
            # candidates that go on, and the best that each of them corrects or begins with
            kept = {r.name for r in kinds[:count]}
            for c in reversed(alive):
                if c.name in kept:
                    needed = (self._best_of(c.corrects), self._best_of(c.begins_with))
                    kept |= {result.name for result in needed if result}
            alive = tuple(c for c in alive if c.name in kept)
            self._report(number, ranking, len(alive))
            if ranking and self._context.scoring.horizon is None:
                mean, _ = mean_and_error(ranking[0].rmse().values())
                self.hopeless = not mean <= _FAR * self._context.motion_within_turns
            if self._deadline.remaining <= 0 or self.hopeless:
                break
        if not self.hopeless:
            self._continue_stopped(rank([self.results[c.name] for c in alive]), executor)
        return rank([self.results[c.name] for c in alive])

    def _list_jobs(self, number: int, stage: Round, alive: Sequence[Candidate]) -> list[Job]:
        """The jobs of a round that were not done before, fold after fold."""
        late = set[str]()  # what corrects them does not wait for them
        if number:
            order = [r.name for r in rank([self.results[c.name] for c in alive])]
            ordered = sorted(alive, key=lambda c: order.index(c.name))
        else:
            ordered = sorted(
                alive,
                key=lambda c: (c.name in self._last, c.name in self._late, not c.is_by_forces),
            )
            late = self._last if math.isinf(self._time) else self._late
        jobs = []
        for fold in range(min(stage.folds, self._folds)):
            for c in ordered:
                seeds = c.content.family.select_seeds(range(stage.seeds))
                done = {s.seed for s in self.results[c.name].fits_by_fold.get(fold, ())}
                waits_for = (*c.corrects, *c.begins_with)
                waits_for = tuple(name for name in waits_for if name not in late)
                if missing := tuple(seed for seed in seeds if seed not in done):
                    recipe = self._context.recipe_of(c)
                    jobs.append(Job(c.name, recipe, fold, missing, waits_for=waits_for))
        return jobs

    def _run_jobs(self, jobs: Sequence[Job], executor: Executor, later: Sequence[Job] = ()) -> None:
        """Runs jobs; those that come `later` have shares of the time, too."""
        self._pending = [*jobs, *later]
        run_jobs(jobs, executor, self._deadline, prepare=self._prepare, on_result=self._add_result)

    def _compare_forces(self, jobs: Sequence[Job], executor: Executor) -> list[Job]:
        """Runs the jobs that compare forces, which take seconds; returns the others.

        Where equations that explain the forces leave the records when they are simulated, free runs
        of whole records say little of any model.
        """
        names = [c.name for c in self._candidates if c.is_by_forces]
        others = [job for job in jobs if job.candidate not in names]
        self._run_jobs([job for job in jobs if job.candidate in names], executor, later=others)
        motion = self._context.motion_within_turns
        self.hopeless = self._context.scoring.horizon is None and any(
            np.mean(list(result.unexplained.values())) < _EXPLAINED
            and not mean_and_error(result.rmse().values())[0] <= motion
            for result in (self.results[name] for name in names)
            if result.unexplained
        )
        return others

    def _try_physics(self, jobs: Sequence[Job], executor: Executor) -> list[Job]:
        """Runs the first jobs up to the last identification; returns the others in a new order.

        Where an identification took little time, others of its kind are late no more: they come
        next, before the networks, of which some correct the best of them.
        """

        def is_first_identification(job: Job) -> bool:
            return not job.recipe.family.has_seeds and job.candidate not in self._late

        count = max((i for i, job in enumerate(jobs, 1) if is_first_identification(job)), default=0)
        first, others = jobs[:count], jobs[count:]
        self._run_jobs(first, executor, later=others)
        quick = {
            job.recipe.family.kind
            for job in first
            if is_first_identification(job)
            and not self.plan.candidate(job.candidate).is_by_forces
            and self._expected.get(job.candidate, math.inf) < _QUICK * self._time
        }
        soon = {
            job.candidate
            for job in others
            if not job.recipe.family.has_seeds and job.recipe.family.kind in quick
        }
        self._late -= soon
        return sorted(others, key=lambda job: job.candidate not in soon)

    def _continue_stopped(self, ranking: Sequence[CandidateResult], executor: Executor) -> None:
        """Goes on, in the time that is left, with fits that their share of it stopped."""
        if math.isinf(self._deadline.remaining):
            return
        names = [result.name for result in ranking]
        jobs = [replace(job, continues=True) for job in self._stopped if job.candidate in names]
        self._run_jobs(sorted(jobs, key=lambda job: names.index(job.candidate)), executor)

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

    def _best_of(self, names: Sequence[str], fold: int | None = None) -> CandidateResult | None:
        """The simplest of some candidates that is as good as their best, in a fold or anywhere.

        None where none of them has a score.
        """
        results = [self.results[name] for name in names if name in self.results]
        scored = [
            r for r in results if (r.fits_by_fold if fold is None else fold in r.fits_by_fold)
        ]
        return find_simplest(scored, rank(scored)[0]) if scored else None

    def _prepare(self, job: Job) -> Job | None:
        """The job with what it corrects, what it begins with, and its share of the time.

        None where it has nothing to correct, or no time is left for it.
        """
        candidate, physics, origin = self.plan.candidate(job.candidate), job.physics, job.origin
        limit = self._limit(job, candidate)
        self._pending.remove(job)
        if candidate.corrects and not job.continues:
            corrected = self._best_of(candidate.corrects, job.fold)
            if corrected is None:
                names = [name for name in candidate.corrects if name in self.results]
                return self._omit(job, "nothing to correct: " + ", ".join(names))
            physics = corrected.fits_by_fold[job.fold][0].model
        first = self._best_of(candidate.begins_with, job.fold)
        if first is not None and not job.continues:
            origin = first.fits_by_fold[job.fold][0].model
        scores = self._context.folder / job.folder / SCORES
        is_done = scores.is_file() and not self._context.resume and not job.continues
        if limit is None and not is_done:
            if job.continues:
                return None
            return self._omit(job, NO_TIME)
        job = replace(job, physics=physics, origin=origin, limit=limit or math.inf)
        self._begun[job.candidate, job.fold] = job
        return job

    def _limit(self, job: Job, candidate: Candidate) -> float | None:
        """Seconds that a job may take, None where no time is left for it.

        Jobs that wait have equal shares of the time that is left; what one does not need is left
        for the next ones.
        """
        remaining, share = self._deadline.remaining, len(self._pending)
        if math.isinf(remaining):
            return math.inf
        expected = self._expected.get(job.candidate)
        if expected is None:  # tried for the first time
            if candidate.name in self._late:
                remaining -= (1 - _TRYING_LAST) * self._time
            else:
                remaining -= self._time - min(max(_TRYING * self._time, _SOON), self._time)
                share = sum(j.candidate not in self._late for j in self._pending)
                share = min(share, _BY_FORCES) if candidate.is_by_forces else share
            is_first = not any(r.fits_by_fold for r in self.results.values())
            least = 0.0 if is_first else min(_LEAST, _LEAST_SHARE * self._time)
        else:
            expected *= len(job.seeds)
            least = max(_AGAIN * expected if job.continues else expected, 1.0)
            best = rank(list(self.results.values()))[0]
            remaining -= max(self.seconds_for_final(best.name) - self._ending, 0.0)
        if remaining <= least:
            return None
        return max(remaining / share, min(least, remaining))

    def seconds_for_final(self, name: str) -> float:
        """Expected time of fitting a candidate once more, to all records; 0 where that is not done.

        It begins where a fold ended, and has more records.
        """
        is_fitted = not self.plan.candidate(name).content.family.averages_folds
        return self._expected.get(name, 0.0) if is_fitted else 0.0

    def _omit(self, job: Job, why: str) -> None:
        result = self.results[job.candidate]
        if not result.fits_by_fold and not result.why:
            self.results[job.candidate] = replace(result, why=why)
            self._on_message(f"{job.candidate}: left out, {why}")
        elif why == NO_TIME:
            self._omitted += 1

    def _add_result(self, result: JobResult) -> None:
        name = result.candidate
        self._results += 1
        self.results[name] = self.results[name].with_job(result)
        if result.scores and not result.earlier:
            self._expected[name] = result.seconds / len(result.scores)
        if result.ended == "done":
            return
        if result.ended == "out of time":
            self._stopped.append(self._begun[name, result.fold])
        if not result.earlier:  # what was said when it was done
            self._on_message(f"{name}, fold {result.fold}: {result.why}")

    def _report(self, number: int, ranking: Sequence[CandidateResult], kept: int) -> None:
        """Reports how the candidates stand after a round in which something was done."""
        if not ranking or not self._results:
            return
        shared = shared_folds(ranking)
        means = [(r.name, mean_and_error(r.rmse(shared).values())[0]) for r in ranking]
        rounds, count = len(self.plan.rounds), len(shared or ())
        folds = f"{count} of {self._folds} folds" if count > 1 else "one fold"
        on = f"; {kept} go{'es' if kept == 1 else ''} on" if number + 1 < rounds else ""
        figures = ", ".join(f"{name} {mean:.3g}" for name, mean in means)
        self._on_message(f"round {number + 1} of {rounds}, {folds}: {figures}{on}")
        if self._omitted:
            self._on_message(
                f"the budget ended this round early: no time was left for "
                f"{self._omitted} of its fits"
            )
