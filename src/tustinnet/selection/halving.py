"""Successive halving: rounds of more and more folds and seeds, each with fewer candidates."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.selection.executors import Executor
from tustinnet.selection.jobs import Job, JobResult, Workplace
from tustinnet.selection.plan import Candidate, Round, SelectionPlan
from tustinnet.selection.ranking import Standing, ranked, shared_folds, simplest

_TRYING = 0.6  # share of the time after which no candidate is tried for the first time
_TRYING_LAST = 0.4  # the same of candidates that come last
NO_TIME = "no time was left for it"
_FEWEST = 2  # candidates that go on, where there are as many


class _Wanted(NamedTuple):
    """A job that waits until what it corrects is there."""

    candidate: Candidate
    fold: int
    seeds: tuple[int, ...]


class Halving:
    """Candidates on their way through the rounds of a plan.

    Args:
        plan: the plan.
        candidates: those of its candidates that take part.
        at: the records, how they are judged, when time is up.
        told: who is told what happens, in sentences.

    Attributes:
        plan: the plan.
        standings: what has been found of each candidate, by name, from the simplest on.
        cheapest: of the candidates that time ended before they were scored once, the job that
            would have ended first; None without any.
        hopeless: whether free runs of whole records were further off than the records move, for
            all candidates: then the first round was the last one.
    """

    def __init__(
        self,
        plan: SelectionPlan,
        candidates: Sequence[Candidate],
        at: Workplace,
        told: Callable[[str], None],
    ) -> None:
        self.plan, self._candidates, self._at = plan, tuple(candidates), at
        self._folds, self._clock, self._told = at.judging.folds, at.clock, told
        self._begun_with = at.clock.left
        self._expected: dict[str, float] = {}  # seconds a seed takes on a fold
        self._left_out = 0  # jobs of a round for which no time was left
        self.standings = {c.name: Standing(c.name) for c in candidates}
        self.cheapest: JobResult | None = None
        self.hopeless = False

    def run(self, executor: Executor) -> list[Standing]:
        """Goes through the rounds; the candidates that are left, the best first."""
        alive = self._candidates
        for number, of in enumerate(self.plan.rounds):
            ordered = self._by_rank(alive) if number else sorted(alive, key=lambda c: c.last)
            late = set() if number else {c.name for c in alive if c.last}
            self._left_out = 0
            self._do(self._wanted(ordered, of), late, executor)
            found = ranked([self.standings[c.name] for c in alive])
            last = number + 1 == len(self.plan.rounds)
            kinds = found if last else self._best_of_kinds(found)
            count = len(kinds) if last else max(_FEWEST, math.ceil(of.keep * len(kinds)))
            alive = self._needed([s.name for s in kinds[:count]], alive)
            self._tell(number, found, len(alive))
            self.hopeless = number == 0 and self._says_nothing(found)
            if self._clock.left <= 0 or self.hopeless:
                break
        return ranked([self.standings[c.name] for c in alive])

    def _says_nothing(self, found: Sequence[Standing]) -> bool:
        """Whether even the best is further off than the records move, over whole records."""
        if not found or self._at.judging.horizon is not None:
            return False
        mean, _ = mean_and_error(found[0].rmse().values())
        return not mean <= self._at.motion

    def _best_of_kinds(self, found: Sequence[Standing]) -> list[Standing]:
        """Of each kind of model the simplest that is as good as its best, in the order of these."""
        kind = {c.name: c.content.family.kind for c in self._candidates}
        by_kind: dict[str, list[Standing]] = {}
        for standing in found:
            by_kind.setdefault(kind[standing.name], []).append(standing)
        place = list(kind).index
        return [simplest(sorted(of, key=lambda s: place(s.name)), of[0]) for of in by_kind.values()]

    def _by_rank(self, alive: Sequence[Candidate]) -> list[Candidate]:
        order = [s.name for s in ranked([self.standings[c.name] for c in alive])]
        return sorted(alive, key=lambda c: order.index(c.name))

    def _needed(self, names: Sequence[str], alive: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """The candidates of these names, and the best that each of them corrects."""
        kept = set(names)
        for c in alive:
            if c.name in kept:
                corrected = self._corrected(c)
                kept |= {corrected.name} if corrected else set()
        return tuple(c for c in alive if c.name in kept)

    def _corrected(self, by: Candidate, fold: int | None = None) -> Standing | None:
        """What a candidate corrects, in a fold or anywhere: the simplest as good as the best."""
        there = [self.standings[name] for name in by.corrects if name in self.standings]
        found = [s for s in there if (s.folds if fold is None else fold in s.folds)]
        return simplest(found, ranked(found)[0]) if found else None

    def _wanted(self, alive: Sequence[Candidate], of: Round) -> list[_Wanted]:
        """The jobs of a round that are not done, fold by fold."""
        found = []
        for fold in range(min(of.folds, self._folds)):
            for c in alive:
                seeds = range(of.seeds if c.content.family.trains else 1)
                done = {s.seed for s in self.standings[c.name].folds.get(fold, ())}
                if missing := tuple(seed for seed in seeds if seed not in done):
                    found.append(_Wanted(c, fold, missing))
        return found

    def _do(self, wanted: Sequence[_Wanted], late: set[str], executor: Executor) -> None:
        """Does jobs in their order as soon as what they correct is there, unless that is `late`."""
        waiting, running = list(wanted), set[tuple[str, int]]()
        while waiting or running:
            busy = running | {(w.candidate.name, w.fold) for w in waiting}
            busy = {(name, fold) for name, fold in busy if name not in late}
            ready = self._ready(waiting, busy) if executor.free else None
            if ready is not None:
                waiting.remove(ready)
                job = self._job(ready)
                if job is not None:
                    running.add((job.candidate, job.fold))
                    executor.submit(job)
                continue
            result = executor.result()
            running.remove((result.candidate, result.fold))
            self._note(result)

    @staticmethod
    def _ready(waiting: Sequence[_Wanted], busy: set[tuple[str, int]]) -> _Wanted | None:
        for wanted in waiting:
            if not any((name, wanted.fold) in busy for name in wanted.candidate.corrects):
                return wanted
        return None

    def _job(self, wanted: _Wanted) -> Job | None:
        """The job, unless it has nothing to correct or no time is left for it."""
        candidate, fold, seeds = wanted
        name, physics = candidate.name, None
        if candidate.corrects:
            corrected = self._corrected(candidate, fold)
            if corrected is None:
                return self._leave(name, "nothing to correct: " + ", ".join(candidate.corrects))
            physics = corrected.folds[fold][0].model
        if not self._affordable(candidate, len(seeds)):
            self._left_out += 1
            return self._leave(name, NO_TIME)
        return Job(name, candidate.content, fold, seeds, physics)

    def _affordable(self, candidate: Candidate, seeds: int) -> bool:
        left = self._clock.left
        if candidate.name in self._expected:
            return left > seeds * self._expected[candidate.name]
        trying = _TRYING_LAST if candidate.last else _TRYING
        return left > (1 - trying) * self._begun_with or math.isinf(left)

    def _leave(self, name: str, why: str) -> None:
        standing = self.standings[name]
        if not standing.folds and not standing.why:
            self.standings[name] = Standing(name, {}, standing.seconds, why)
            self._told(f"{name}: left out, {why}")

    def _note(self, result: JobResult) -> None:
        """What a job came to."""
        name = result.candidate
        before = self.standings[name]
        self.standings[name] = after = before.after(result)
        if result.ended == "done":
            self._expected[name] = result.seconds / len(result.scores)
            return
        self._told(f"{name}, fold {result.fold}: {result.why}")
        if result.needs is not None and not after.folds:
            best = self.cheapest
            if best is None or result.needs < (best.needs or math.inf):
                self.cheapest = result

    def _tell(self, number: int, found: Sequence[Standing], kept: int) -> None:
        """How the candidates stand after a round."""
        if not found:
            return
        shared = shared_folds(found)
        means = [(s.name, mean_and_error(s.rmse(shared).values())[0]) for s in found]
        rounds, count = len(self.plan.rounds), len(shared or ())
        folds = f"{count} of {self._folds} folds" if count > 1 else "one fold"
        on = f"; {kept} go on" if number + 1 < rounds else ""
        figures = ", ".join(f"{name} {mean:.3g}" for name, mean in means)
        self._told(f"round {number + 1} of {rounds}, {folds}: {figures}{on}")
        if self._left_out:
            self._told(f"the budget ended this round early: no time was left for {self._left_out} "
                       "of its fits")  # fmt: skip
