"""The queue of a selection: which job is next, and what is known of the candidates by then.

Every candidate is tried on the first fold; the best kinds go on to the others. Next is what could
change the ranking soonest, which is what takes least: first fits of every kind, and those of the
best by then to further folds, and of what may be better still: it is ahead on too few records to be
sure, or the best is lost where it was not tried, or the records speak for it. After these, further
fits of others that are among the best.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.finding import Finding, make_finding
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.selection.jobs import FitScore, Job, JobResult, RunContext
from tustinnet.selection.plan import Candidate, SelectionPlan
from tustinnet.selection.ranking import (
    CandidateResult,
    find_simplest,
    is_ahead,
    may_overtake,
    paired_difference,
    rank,
)
from tustinnet.simulate.starts import start_named
from tustinnet.store.run_folder import SCORES
from tustinnet.wording import counted, percent

NO_TIME = "no time was left for it"


@dataclass(frozen=True)
class QueueOptions:
    """Numbers that decide in the queue.

    Attributes:
        first_try: share of the time left that a first fit may take while others wait for theirs:
            as much is left for all of those; and the share of the time that it is expected to take
            without which it is not begun.
        rarely: factor of the time of what rarely changes the ranking: for further folds, and for
            every kind that is better; twice for a first try of a second one of a kind, and of what
            the plan calls `last`.
        again: times what a fit took before it was stopped, that have to be left for it to go on: it
            compiles, or begins, anew.
        fewest: kinds of candidates that go on to further folds, where there are as many.
        far: of the motion within turns, an error of whole records that says little of a model.
        explained: of the inputs' force, what equations leave unexplained that explain it.
        horizon: of a record, the length of pieces at most.
        starts: the length of pieces is at least so many times what a start is fitted to.
    """

    first_try: float = 0.5
    rarely: float = 2.0
    again: float = 1.5
    fewest: int = 2
    far: float = 0.3
    explained: float = 0.2
    horizon: float = 0.1
    starts: int = 3


OPTIONS = QueueOptions()


class CandidateQueue:
    """The jobs of a plan's candidates, in an order that follows from what is known of them.

    Args:
        plan: the plan.
        candidates: those of its candidates that take part.
        context: the records, how they are scored.
        on_message: called with sentences on what happens.
        deadline: when the last job has to end.
        ending: seconds after that, in which the chosen system is identified from all records.
        promising: names of candidates that the records speak for, however rarely they are best.

    Attributes:
        plan: the plan.
        context: the records, how they are scored by now.
        results: of each candidate, by name, from the simplest on.
        notes: findings on how records are scored.
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
        self.plan, self.context, self.notes = plan, context, list[Finding]()
        lost = context.lost_error
        self.results = {c.name: CandidateResult(c.name, lost=lost) for c in candidates}
        self._candidates, self._on_message = tuple(candidates), on_message
        self._deadline, self._ending = deadline, ending
        self._promising = promising
        self._seconds: dict[str, float] = {}  # that a candidate takes on a fold
        self._seconds_of_usual: dict[float, float] = {}  # of what usually takes so long
        self._substeps: dict[str, int] = {}  # of the equations that a candidate corrected then
        self._running = list[Job]()
        self._jobs: dict[tuple[str, int], Job] = {}  # all that began, by candidate and fold
        self._stopped: dict[tuple[str, int], float] = {}  # seconds of jobs that may go on
        self._reported: tuple[str, bool, float | None] | None = None

    # --- what is next ---

    def choose(self) -> list[Job]:
        """The job that is next, complete; none where nothing can begin at present."""
        steps = self._list_steps()
        if (not steps or self._is_costly(steps[0][0])) and self._is_lost():
            if self._running:
                return []
            self._judge_by_pieces()
            return self.choose()
        earlier = {(job.candidate, job.fold) for job in self._running}  # or further ahead
        coming = earlier | {(job.candidate, job.fold) for _, jobs in steps for job in jobs}
        known = len(self._jobs)
        for candidate, jobs in steps:
            for job in jobs:
                waits = any((name, job.fold) in earlier for name in candidate.corrects)
                waits |= any((name, job.fold) in coming for name in candidate.begins_with)
                next_job = None if waits else self._begin(job, candidate, steps)
                if next_job is not None:
                    return [next_job]
            earlier |= {(job.candidate, job.fold) for job in jobs}
        if len(self._jobs) > known:  # some were left out: others may have waited for them
            return self.choose()
        return self._continue_stopped()

    def _is_costly(self, candidate: Candidate) -> bool:
        """Whether a candidate costs so much that scores have to say something of it.

        That is: trainings, and identifications on further folds.
        """
        family = candidate.content.family
        return family.has_seeds or ("system" in family.needs and candidate.name in self._seconds)

    def _list_steps(self) -> list[tuple[Candidate, list[Job]]]:
        """The candidates that have jobs left, with these, by what they take.

        Of each kind of model the simplest that is as good as its best goes on to further folds, of
        as many kinds as the plan keeps; and what is ahead.
        """
        steps, places, ahead = [], self._places(), self._find_ahead()
        kinds = len({*places.values()})
        kept = max(OPTIONS.fewest, math.ceil(self.plan.keep * kinds))
        for c in self._candidates:
            place = places.get(c.name, 0)
            goes_on = (c.name in places and place < kept) or c.name in ahead
            if jobs := self._missing(c, self._folds if goes_on else 1):
                behind = ahead.get(c.name, (jobs[0].fold > 0) + place)
                leads = (kinds > 1 and place == 0) or c.name in ahead
                weight = self._weight(c, jobs[0], behind, leads=leads)
                steps.append((weight, c, jobs))
        return [(c, jobs) for _, c, jobs in sorted(steps, key=lambda step: step[0])]

    def remaining(self) -> list[CandidateResult]:
        """The candidates that have scores, the best first; none that is lost, unless all are.

        Lost is what is lost on every record.
        """
        ranking = self._rank()
        return [r for r in ranking if r.follows_some] or ranking

    def seconds_for_final(self, name: str) -> float:
        """Expected time of fitting a candidate once more, to all records; 0 where that is not done.

        It begins where a fold ended, and has more records.
        """
        is_fitted = not self.plan.candidate(name).content.family.averages_folds
        return self._seconds.get(name, 0.0) if is_fitted else 0.0

    def _rank(self) -> list[CandidateResult]:
        """The candidates that have scores, the best first."""
        return rank(self.results.values())

    @property
    def _folds(self) -> int:
        """The number of folds that are scored."""
        folds = self.context.scoring.folds
        return min(self.plan.scored or folds, folds)

    def _missing(self, candidate: Candidate, folds: int) -> list[Job]:
        """The jobs of a candidate on the first folds that never began, fold after fold."""
        recipe = self.context.recipe_of(candidate)
        missing = [fold for fold in range(folds) if (candidate.name, fold) not in self._jobs]
        return [Job(candidate.name, recipe, fold) for fold in missing]

    def _places(self) -> dict[str, int]:
        """The number of kinds that are better than each candidate, by name.

        What a candidate corrects or begins with is as good as it.
        """
        kinds = self._best_of_kinds(self._rank())
        places = {result.name: place for place, result in enumerate(kinds)}
        for c in reversed(self._candidates):
            if c.name in places:
                for name in self._needed(c):
                    places[name] = min(places[c.name], places.get(name, len(kinds)))
        return places

    def _find_ahead(self) -> dict[str, int]:
        """The candidates that may be better than the best, which too few records tell, by name.

        They are ahead where both were scored, by more than nobody minds, or not lost where the best
        is lost, or the records speak for them. With what these correct or begin with. Each with
        the number of those that are ahead by more.
        """
        ranking = self._rank()
        found = [
            r
            for r in ranking[1:]
            if is_ahead(r, ranking[0])
            or may_overtake(r, ranking[0])
            or (r.name in self._promising and r.follows_some)
        ]
        found.sort(key=lambda r: paired_difference(r, ranking[0]).mean)
        ahead = {r.name: place for place, r in enumerate(found)}
        for name in [*ahead]:
            for needed in self._needed(self.plan.candidate(name)):
                ahead[needed] = min(ahead[name], ahead.get(needed, len(ahead)))
        return ahead

    def _needed(self, candidate: Candidate) -> set[str]:
        """The best that a candidate corrects and begins with, by name."""
        needed = (self._best_of(candidate.corrects), self._best_of(candidate.begins_with))
        return {result.name for result in needed if result}

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

    # --- what it costs ---

    def _weight(
        self, candidate: Candidate, job: Job, behind: int, *, leads: bool
    ) -> tuple[bool, float]:
        """A key that orders candidates: whether the job rarely changes the ranking, and its cost.

        First fits and those of the best to further folds are first. The cost is the expected
        seconds, which count more the rarer that is, as for first fits of second ones of a kind and
        of what the plan calls `last`, and for every fold before.

        Args:
            candidate: the candidate.
            job: its next job.
            behind: 1 on further folds, and one more for every kind that is better; of what is ahead
                how many are so by more.
            leads: whether it is better than another kind, and none is better, or is ahead.
        """
        power, is_further = behind, candidate.name in self._seconds
        if not is_further and candidate.name not in self._promising:
            tried = [c.content.family for c in self._candidates if c.name in self._seconds]
            power = 2 * (candidate.last or candidate.content.family in tried)
        folds = self.results[candidate.name].fits_by_fold
        cost = max(len(folds), 1) * self._expected(job) * OPTIONS.rarely**power
        return is_further and not leads, cost

    def _expected(self, job: Job) -> float:
        """Expected seconds of a job: as before, else as one that usually takes as long, else that.

        More where the equations that it corrects or begins with took longer than usual, or all
        fits did, as on a machine that others use, and where the equations of its fold are stiffer
        than those that it corrected before. Nothing where it is done already.
        """
        if self._is_on_disk(job):
            return 0.0
        usual, candidate = job.recipe.usual_seconds, self.plan.candidate(job.candidate)
        ratios = {
            name: seconds / self.plan.candidate(name).content.usual_seconds
            for name, seconds in self._seconds.items()
        }
        related = {*candidate.corrects, *candidate.begins_with} & ratios.keys()
        slower = min((ratios[name] for name in related or ratios), default=1.0)
        seconds = max(self._seconds_of_usual.get(usual, usual), slower * usual)
        if job.candidate in self._seconds:
            stiffer = self._substeps_of_physics(job) / self._substeps[job.candidate]
            seconds = stiffer * self._seconds[job.candidate]
        return seconds

    def _substeps_of_physics(self, job: Job) -> int:
        """Integration steps in a period of the equations that a job corrects; 1 without these."""
        physics = self._best_of(self.plan.candidate(job.candidate).corrects, job.fold)
        return physics.fits_by_fold[job.fold][0].substeps if physics else 1

    def _is_on_disk(self, job: Job) -> bool:
        """Whether a run that is resumed has the scores of a job."""
        return self.context.resume and (self.context.folder / job.folder / SCORES).is_file()

    def _limit(self, job: Job, others_wait: bool) -> float | None:
        """Seconds that a job may take, None where not enough are left for it."""
        remaining = self._deadline.remaining
        if math.isinf(remaining) or self._is_on_disk(job):
            return math.inf
        scored = self._rank()
        if job.candidate not in self._seconds:
            share = OPTIONS.first_try
            least = share * self._expected(job) if scored else 0.0
            if remaining <= least:
                return None
            return max(share * remaining, least) if others_wait else remaining
        if scored:
            remaining -= max(self.seconds_for_final(scored[0].name) - self._ending, 0.0)
        return remaining if remaining > self._expected(job) else None

    def _begin(
        self, job: Job, candidate: Candidate, steps: Sequence[tuple[Candidate, Sequence[Job]]]
    ) -> Job | None:
        """The job with what it corrects, what it begins with and its limit.

        None where it has to wait, or is left out for want of these.

        Args:
            job: the job.
            candidate: its candidate.
            steps: the candidates that have jobs, with these.
        """
        physics = self._best_of(candidate.corrects, job.fold)
        if candidate.corrects and physics is None:
            names = [name for name in candidate.corrects if name in self.results]
            coming = [*self._running, *(other for _, jobs in steps for other in jobs)]
            if not any(other.candidate in names and other.fold == job.fold for other in coming):
                self._leave_out(job, "nothing to correct: " + ", ".join(names))
            return None
        limit = self._limit(job, others_wait=sum(len(jobs) for _, jobs in steps) > 1)
        if limit is None:
            self._leave_out(job, NO_TIME)
            return None
        origin = self._best_of(candidate.begins_with, job.fold)
        return self._start(
            replace(
                job,
                physics=None if physics is None else physics.fits_by_fold[job.fold][0].model,
                origin=None if origin is None else origin.fits_by_fold[job.fold][0].model,
                limit=limit,
            )
        )

    def _start(self, job: Job) -> Job:
        self._running.append(job)
        self._jobs[job.candidate, job.fold] = job
        return job

    def _leave_out(self, job: Job, why: str) -> None:
        """Leaves out a job for good."""
        self._jobs[job.candidate, job.fold] = job
        result = self.results[job.candidate]
        if not result.fits_by_fold and not result.why:
            self.results[job.candidate] = replace(result, why=why)
            self._on_message(f"{job.candidate}: left out, {why}")

    def _continue_stopped(self) -> list[Job]:
        """Goes on with a job of the best candidates that its limit stopped, where time is left."""
        remaining = self._deadline.remaining
        if not math.isinf(remaining) and not self._running:
            for result in self.remaining():
                for key, seconds in self._stopped.items():
                    if key[0] == result.name and remaining > OPTIONS.again * seconds:
                        del self._stopped[key]
                        job = replace(self._jobs[key], continues=True, limit=remaining)
                        return [self._start(job)]
        return []

    # --- what came of it ---

    def add(self, result: JobResult) -> None:
        """Takes the result of a job."""
        name = result.candidate
        job = next(j for j in self._running if (j.candidate, j.fold) == (name, result.fold))
        self._running.remove(job)
        self.results[name] = self.results[name].with_job(result)
        if result.ended != "failed":
            self._seconds[name] = result.seconds
            self._seconds_of_usual[job.recipe.usual_seconds] = self._seconds[name]
            self._substeps[name] = self._substeps_of_physics(job)
        if result.ended == "out of time":
            self._stopped[name, job.fold] = result.seconds
        if result.ended != "done" and not result.earlier:  # what was said when it was done
            self._on_message(f"{job.label}: {result.why}")
        if any(self._explains_forces_and_is_lost(fit) for fit in result.scores):
            self._judge_by_pieces()
        self._report_best()

    def _explains_forces_and_is_lost(self, fit: FitScore) -> bool:
        """Whether equations that explain the forces leave the records when they are simulated.

        Then free runs of whole records say little of any model.
        """
        if not fit.unexplained or self._is_judged_as_it_can_be:
            return False
        means = (mean_and_error(rmse.values())[0] for rmse in fit.rmse.values())
        is_lost = not any(mean <= self.context.motion_within_turns for mean in means)
        return is_lost and fmean(fit.unexplained.values()) < OPTIONS.explained

    def _is_lost(self) -> bool:
        """Whether whole records are judged and no candidate follows them.

        As where a plant is unstable, turns over or only integrates.
        """
        if self._is_judged_as_it_can_be or not (ranking := self._rank()):
            return False
        far = OPTIONS.far * self.context.motion_within_turns
        return not any(mean_and_error(r.compared().values())[0] <= far for r in ranking)

    def _piece_horizon(self) -> float:
        """The shortest horizon [s] that a fit chose, or a tenth of a record; beyond a start."""
        data, start = self.context.data, start_named(self.context.scoring.start)
        chosen = [fit.horizon for r in self.results.values() for fit in r.fits if fit.horizon]
        usual = OPTIONS.horizon * float(np.median([len(e) for e in data])) * data.channels.dt
        return max(min([usual, *chosen]), OPTIONS.starts * start.samples * data.channels.dt)

    @property
    def _is_judged_as_it_can_be(self) -> bool:
        """Whether pieces of records are judged, or records that are no longer than pieces."""
        data = self.context.data
        span = (min(map(len, data)) - 1) * data.channels.dt
        return self.context.scoring.horizon is not None or self._piece_horizon() > span

    def judge_by_pieces_if_lost(self) -> None:
        """Scores over pieces of records where no candidate follows whole ones."""
        if self._is_lost():
            self._judge_by_pieces()

    def _judge_by_pieces(self) -> None:
        """Scores again, over pieces of records.

        Searches that begin at the values of others are over these pieces, too: fitted again.
        """
        before = self.context
        horizon = self._piece_horizon()
        may_be_controlled = before.cutoff is not None and before.data.channels.controller is None
        self.notes.append(
            make_finding("judged by pieces", horizon=horizon, may_be_controlled=may_be_controlled)
        )
        self._on_message(self.notes[-1].text)
        self.context = before.with_changes(scoring=replace(before.scoring, horizon=horizon))
        changed, lost = set[str](), self.context.lost_error
        for c in self._candidates:
            if self.context.recipe_of(c) != before.recipe_of(c) or changed & set(c.corrects):
                changed.add(c.name)
                self.results[c.name] = CandidateResult(c.name, lost=lost)
                self._jobs = {key: job for key, job in self._jobs.items() if key[0] != c.name}
            else:
                result = self.results[c.name]
                fits_by_fold = self._score_again(result)
                self.results[c.name] = replace(result, fits_by_fold=fits_by_fold, lost=lost)
        if changed:  # what this run has fitted is not gone on with
            self.context = self.context.with_changes(resume=False)

    def _score_again(self, result: CandidateResult) -> dict[int, tuple[FitScore, ...]]:
        """The fits of a candidate with the scores of how records are scored now."""
        context = self.context

        def score(fit: FitScore, fold: int) -> FitScore:
            rmse = context.score(context.load_model(fit.model), fit.horizon, fold)
            return replace(fit, rmse=rmse)

        return {
            fold: tuple(score(fit, fold) for fit in fits)
            for fold, fits in result.fits_by_fold.items()
        }

    def _report_best(self) -> None:
        """Reports what is best by now and how good, where that is news."""
        ranking = self.remaining()
        if not ranking:
            return
        best, folds = ranking[0], self._folds
        news = (best.name, len(best.fits_by_fold) == folds, self.context.scoring.horizon)
        if news == self._reported:
            return
        self._reported, rmse, reference = news, best.rmse(), self.context.reference
        off = f"off by {best.mean:.3g} {self.context.data.channels.unit}"
        of_reference, _ = mean_and_error([x for n, x in reference.rmse.items() if n in rmse])
        if of_reference > 0:
            off += f" ({percent(best.mean / of_reference)} % of {reference.label})"
        is_lost = best.mean >= self.context.motion_within_turns
        self._on_message(
            f"best so far: {best.name}, {'which is lost' if is_lost else off} "
            f"on {counted(len(rmse), 'record')}, "
            f"{len(best.fits_by_fold)} of {counted(folds, 'fold')}"
        )
