"""The account of a selection: its chosen model, its accuracy and the reasons."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

from tustinnet.data.experiment import Experiment
from tustinnet.data.spoiled import SpoiledPart, spoiled_header
from tustinnet.evaluate.bands import KEY as BANDS
from tustinnet.evaluate.bands import Calibration
from tustinnet.evaluate.horizons import describe_followed
from tustinnet.evaluate.metrics import ErrorRange, expected_range, mean_and_error
from tustinnet.evaluate.reference import Reference
from tustinnet.evaluate.scores import Score, scores_header
from tustinnet.fitting.report import data_header
from tustinnet.fitting.roles import records_without_test
from tustinnet.models.contract import Model
from tustinnet.models.written_equations import equations_header
from tustinnet.selection.final_models import FinalModel, SelectionResults
from tustinnet.selection.folds import kind_of
from tustinnet.selection.jobs import LEFT_OUT, FitScore, RunContext
from tustinnet.selection.ranking import (
    CLEAR,
    FEW,
    LEVEL,
    CandidateResult,
    find_decisive_record,
    paired_difference,
)
from tustinnet.simulate.range import KEY as RANGE
from tustinnet.simulate.range import TrainingSupport, recorded_range, training_support
from tustinnet.store.kept_system import CANDIDATES
from tustinnet.store.run_folder import MODEL
from tustinnet.wording import percent

_UNEVEN = 2.0  # times the typical error, a mean that few records make
_VAGUE = 10.0  # times the typical error, the end of a range that says nothing
_POOR = 0.2  # of that of the reference, an error with which a model is of little use


@dataclass(frozen=True)
class Choice:
    """The model that a selection chose, and what it was compared with.

    Attributes:
        context: folder, records, how candidates were compared.
        candidates: the results of candidates and committees.
        best: the candidate or committee that was chosen.
        simplest: the simplest that is as good as it.
        origins: how the models of those that could be chosen were made, in words.
        model: the chosen model.
        reference: the trivial predictor that it is compared with.
        bands: around free runs of the chosen one, None where nothing says how wide they are.
        notes: what else was done or left out, in sentences.
        seconds: time it took.
        seconds_by_part: of that, what each part of the selection took.
        budget: how long it was to take at most [s], None for no limit.
        spoiled: parts of the records that the model does not explain.
        left_out: sentences on the parts of records that were left out; `notes` have them, too.
        is_cut: whether the records are pieces of one or two.
        whole: free runs of whole records, by models of the chosen kind that do not know them.
    """

    context: RunContext
    candidates: SelectionResults
    best: str
    simplest: str
    origins: Mapping[str, str]
    model: Model
    reference: Reference
    bands: Calibration | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    seconds_by_part: Mapping[str, float] = field(default_factory=dict)
    budget: float | None = None
    spoiled: tuple[SpoiledPart, ...] = ()
    left_out: tuple[str, ...] = ()
    is_cut: bool = False
    whole: Mapping[str, Score] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """The unit of the RMSE."""
        return self.context.data.channels.unit

    @property
    def starts(self) -> tuple[str, ...]:
        """The starts that candidates were scored from, first the one that decides."""
        starts = [start for r in self.candidates.all_results for start in r.starts]
        return tuple(dict.fromkeys([self.context.scoring.start, *starts]))

    def file(self, name: str) -> str:
        """The model file of a candidate or committee that could be chosen, below the folder."""
        return f"{CANDIDATES}/{name}/{MODEL}"

    def result(self, name: str) -> CandidateResult:
        """The result of a candidate or committee."""
        return self.candidates.result(name)

    @cached_property
    def _records(self) -> list[Experiment]:
        return records_without_test(self.context.data)

    @cached_property
    def _cloud(self) -> TrainingSupport | None:
        return training_support(self.context.data.channels, self._records)

    @property
    def follows(self) -> bool:
        """Whether the chosen one follows the records better than a trivial predictor."""
        mean, _ = mean_and_error(self.result(self.best).rmse().values())
        return mean < self.reference.mean

    @property
    def sentences(self) -> tuple[str, ...]:
        """The accuracy of the chosen model, and the reasons for it, in plain words."""
        best, unit = self.result(self.best), self.unit
        rmse = best.rmse()
        mean, error = mean_and_error(rmse.values())
        sentences = [f"chosen: {self.best}, {self.origins[self.best]}"]
        if not math.isfinite(mean):
            sentences.append("free runs of some records diverge: set `horizon` in the plan")
            return (*sentences, *self._unscored, *self.notes)
        spread = "" if math.isnan(error) else f" ± {error:.2g}"
        worst = max(rmse, key=lambda record: rmse[record])
        plural, total = "s" if len(rmse) > 1 else "", len(self._records)
        count = f"{len(rmse)} of the {total}" if total > len(rmse) > 1 else f"{len(rmse)}"
        few = ", few of them: other records may be much further off" if len(rmse) < FEW else ""
        reference, horizon = self.reference, self.context.scoring.horizon
        share = mean / reference.mean if reference.mean else math.inf
        length = "" if horizon is None else f"over {horizon:.3g} s "
        sentences.append(
            f"free runs {length}of {count} record{plural} that its models were not fitted to: "
            f"{mean:.3g}{spread} {unit}, {percent(share)} % of the error of {reference.label} "
            f"({reference.mean:.3g} {unit}); worst {worst}, {rmse[worst]:.3g} {unit}{few}"
        )
        if best.unexplained:
            shares = ", ".join(f"{name} {percent(x)} %" for name, x in best.unexplained.items())
            sentences.append(f"forces along these records that it does not explain: {shares}")
        if self.whole:
            records = [self.context.data[name] for name in self.whole]
            sentences.append(describe_followed(records, list(self.whole.values())))
        sentences += self._expectation
        if share > _POOR:
            remedies = ["look at them (inspect)"]
            remedies += [] if self.budget is None else ["give more time (`budget=`)"]
            remedies += [] if self.context.system else ["give equations of motion (`system=`)"]
            follows = "no candidate follows these records closely"
            if not self.follows:
                follows = f"nothing follows these records {length}better than {reference.label}"
            sentences.append(f"{follows}: {' or '.join(remedies)}")
        sentences.append(self._comparison_with_next(best))
        scored = [r for r in self.candidates.all_results if r.fits_by_fold and r.name != best.name]
        decisive = find_decisive_record(best, scored)
        if decisive is not None:
            record, other, difference = decisive
            sentences.append(
                f"one record decides: without {record}, {other.name} would be better by "
                f"{-difference.mean:.2g} ± {difference.standard_error:.2g} {unit} on "
                f"{difference.records} records; see whether {record} was made with the same "
                "machine, load and settings"
            )
        trainings, searches = list[FitScore](), list[FitScore]()
        for result, _ in self.candidates.members(self.best):
            family = self.candidates.plan.candidate(result.name).content.family
            (trainings if family.resumable else searches).extend(result.fits)
        if stopped := sum(fit.is_out_of_time for fit in trainings):
            sentences.append(
                f"{_count_stopped(stopped, len(trainings), 'training')} stopped by the budget: "
                f"{'its' if stopped == 1 else 'their'} best weights so far were taken; `resume=` "
                "goes on, more time (`budget=`) avoids it"
            )
        if stopped := sum(fit.is_out_of_time for fit in searches):
            sentences.append(
                f"{_count_stopped(stopped, len(searches), 'identification')} stopped by the "
                f"budget: {'its' if stopped == 1 else 'their'} last finished stage was taken; "
                "`resume=` repeats it, more time (`budget=`) avoids it"
            )
        if self.simplest != self.best:
            difference = paired_difference(self.result(self.simplest), best)
            sentences.append(
                f"simplest that is as good: {self.simplest}, {self.origins[self.simplest]} "
                f"({difference.mean:+.2g} ± {difference.standard_error:.2g} {unit}): "
                f"{self.context.folder / self.file(self.simplest)}"
            )
        if self.bands is not None:
            level = math.floor(100 * self.bands.highest_level)
            sentences.append(
                f"its free runs have bands (simulate `band=`) of up to {level} %, calibrated on "
                f"the {len(self.bands.records)} records that folds left out"
            )
        spoiled = [f"spoiled: {part.sentence}" for part in self.spoiled]
        return (*sentences, *spoiled, *self._unscored, *self.notes)

    @property
    def claim(self) -> ErrorRange | None:
        """The error that a new record is expected to have; None where too few were scored."""
        return expected_range(self.result(self.best).rmse().values())

    @property
    def _expectation(self) -> list[str]:
        """Sentences on the error of a new record, and on what makes the scores say little of it."""
        rmse, claim, unit = self.result(self.best).rmse(), self.claim, self.unit
        sentences = list[str]()
        if claim is not None:
            interval = (
                f"{claim.low:.2g} to {claim.high:.2g} {unit} in {10 * claim.level:.0f} of 10 cases"
            )
            if claim.high > _VAGUE * claim.typical:
                interval = "and so few records do not tell how far off it may be"
            sentences.append(
                f"a new record of these kinds: typically {claim.typical:.2g} {unit}, {interval}"
            )
            mean, _ = mean_and_error(rmse.values())
            if mean > _UNEVEN * claim.typical:
                large = [name for name, value in rmse.items() if value > mean]
                by_kind = {kind: expected_range(errors) for kind, errors in self._by_kind.items()}
                typical = [f"{kind} {r.typical:.2g}" for kind, r in by_kind.items() if r]
                kinds = f"; typical of a kind: {', '.join(typical)} {unit}" * (len(typical) > 1)
                sentences.append(
                    "the mean is pessimistic for most records, as few of them make it: "
                    f"{', '.join(large)}; see what is special there{kinds}"
                )
        if self.is_cut:
            sentences.append(
                "optimistic: pieces of one record are alike, and a new record may be several times "
                "as far off; record more of them"
            )
        return sentences

    @property
    def _by_kind(self) -> dict[str, list[float]]:
        """The errors of the chosen candidate by kind of record, as folds know it."""
        by_kind: dict[str, list[float]] = {}
        for name, error in self.result(self.best).rmse().items():
            by_kind.setdefault(kind_of(name), []).append(error)
        return by_kind

    @property
    def _unscored(self) -> list[str]:
        """Sentences on the candidates without scores, those of one reason in one."""
        reasons: dict[str, list[str]] = {}
        for result in self.candidates.results:
            if not result.fits_by_fold:
                reasons.setdefault(result.why or "not tried", []).append(result.name)
        return [f"without a score, {why}: {', '.join(names)}" for why, names in reasons.items()]

    def _comparison_with_next(self, best: CandidateResult) -> str:
        def others(results: Iterable[CandidateResult]) -> list[CandidateResult]:
            are_alike = self.candidates.are_alike
            return [r for r in results if r.fits_by_fold and not are_alike(r.name, best.name)]

        results = others(self.candidates.choosable) or others(self.candidates.all_results)
        differences = {r.name: paired_difference(r, best) for r in results}
        if not differences:
            return "nothing else was scored to compare it with"
        name = min(differences, key=lambda other: differences[other].mean)
        difference = differences[name]
        mean, error, count = difference.mean, difference.standard_error, difference.records
        # one record has no standard error
        on = (
            f"± {error:.2g} {self.unit} on {count} records"
            if count > 1
            else f"{self.unit} on one record"
        )
        if mean < 0:
            return f"{name} is better by {-mean:.2g} {on}, not clearly, and was scored on no others"
        level = LEVEL * mean_and_error(best.rmse().values())[0]
        is_large = mean > max(CLEAR * error, level)
        if is_large and count < FEW:
            on += ", too few records to be sure"
        word = "clearly" if is_large and count >= FEW else "not clearly"
        return f"{word} better than the next, {name}: by {mean:.2g} {on}"

    def header(self, name: str, final: FinalModel) -> dict[str, Any]:
        """The header of the model file of a candidate or committee, beside the model's own."""
        result, data, scoring = self.result(name), self.context.data, self.context.scoring
        rmse = result.rmse()
        return {
            **final.header,
            "data": data_header(data.name, list(data)),
            RANGE: recorded_range(final.model, self._records, self._cloud).as_header(),
            "selection": {
                "plan": self.candidates.plan.name,
                "chosen": name,
                "made": self.origins[name],
            },
            "scores": {
                **scores_header(LEFT_OUT, result.starts[0], data.channels, scoring.horizon, rmse),
                "standard_error": mean_and_error(rmse.values())[1],
            },
            **self.context.system_header(final.model),
            **equations_header(final.model),
            **({BANDS: self.bands.as_header()} if self.bands and name == self.best else {}),
            **spoiled_header(self.spoiled, self.left_out),
        }

    def as_plain(self) -> dict[str, Any]:
        """The selection as plain values."""
        best = self.result(self.best)
        return {
            "plan": self.candidates.plan.model_dump(mode="json"),
            "data": self.context.data.name,
            "unit": self.unit,
            "folds": self.context.scoring.folds,
            "start": self.context.scoring.start,
            "horizon": self.context.scoring.horizon,
            "best": self.best,
            "simplest": self.simplest,
            "reference": self.reference.as_plain(),
            "claim": None if self.claim is None else asdict(self.claim),
            "seconds": self.seconds,
            "seconds_by_part": dict(self.seconds_by_part),
            "budget": self.budget,
            "sentences": list(self.sentences),
            **spoiled_header(self.spoiled, self.left_out),
            "candidates": [self._result_as_plain(r, best) for r in self.candidates.all_results],
        }

    def _result_as_plain(self, result: CandidateResult, best: CandidateResult) -> dict[str, Any]:
        common = {"name": result.name, "seconds": result.seconds, "why": result.why}
        if not result.fits_by_fold:
            return common
        difference = paired_difference(result, best)
        by_start = {start: result.rmse(start=start) for start in result.starts}
        committee = self.candidates.committees.get(result.name)
        return {
            **common,
            "model": self.file(result.name) if result.name in self.origins else None,
            "made": self.origins.get(result.name),
            "shares": None if committee is None else dict(committee.shares),
            "folds": sorted(result.fits_by_fold),
            "seeds": sorted({fit.seed for fit in result.fits}),
            **({"unexplained": result.unexplained} if result.unexplained else {}),
            "starts": {
                start: dict(
                    zip(("mean", "standard_error"), mean_and_error(rmse.values()), strict=True)
                )
                | {"rmse": rmse}
                for start, rmse in by_start.items()
            },
            "difference": {
                "mean": difference.mean,
                "standard_error": difference.standard_error,
                "records": difference.records,
            },
            "models": [fit.model for fit in result.fits if fit.model],
        }


def _count_stopped(stopped: int, total: int, noun: str) -> str:
    """The number of stopped fits of all, with the verb: "2 of its 5 trainings were"."""
    if total == 1:
        return f"its {noun} was"
    return f"{stopped} of its {total} {noun}s {'was' if stopped == 1 else 'were'}"
