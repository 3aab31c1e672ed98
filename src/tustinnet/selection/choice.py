"""The account of a selection: its chosen model, its accuracy and the reasons."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

from tustinnet.data.experiment import Experiment
from tustinnet.data.spoiled import SpoiledPart, spoiled_header
from tustinnet.evaluate.bands import KEY as BANDS
from tustinnet.evaluate.bands import Calibration
from tustinnet.evaluate.horizons import describe_followed
from tustinnet.evaluate.metrics import ErrorRange, expected_range, mean_and_error
from tustinnet.evaluate.reference import Reference, find_reference
from tustinnet.evaluate.scores import Score, mean_rmse_by_unit, scores_header
from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.report import data_header
from tustinnet.fitting.roles import records_without_test
from tustinnet.models.contract import Model
from tustinnet.models.written_equations import equations_header
from tustinnet.selection.final_models import FinalModel, SelectionResults
from tustinnet.selection.folds import kind_of
from tustinnet.selection.jobs import LEFT_OUT, RunContext
from tustinnet.selection.ranking import (
    CLEAR,
    FEW,
    LEVEL,
    CandidateResult,
    paired_difference,
)
from tustinnet.shown import Plotted
from tustinnet.simulate.range import KEY as RANGE
from tustinnet.simulate.range import TrainingSupport, recorded_range, training_support
from tustinnet.store.kept_system import CANDIDATES
from tustinnet.store.run_folder import MODEL

_UNEVEN = 2.0  # times the typical error, a mean that few records make
_VAGUE = 10.0  # times the typical error, the end of a range that says nothing
_POOR = 0.2  # of the error of the reference, half of the records of a model of little use


@dataclass(frozen=True)
class Choice(Plotted):
    """The model that a selection chose, and what it was compared with.

    Attributes:
        context: folder, records, how candidates were compared.
        candidates: the results of the candidates.
        best: the candidate that was chosen.
        simplest: the simplest that is as good as it.
        origins: how the models of those that could be chosen were made, in words.
        model: the chosen model.
        reference: the trivial predictor that it is compared with.
        bands: around free runs of the chosen one, None where nothing says how wide they are.
        notes: what else was done or left out.
        seconds: time it took.
        seconds_by_part: of that, what each part of the selection took.
        budget: how long it was to take at most [s], None for no limit.
        spoiled: parts of the records that the model does not explain.
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
    notes: tuple[Finding, ...] = ()
    seconds: float = 0.0
    seconds_by_part: Mapping[str, float] = field(default_factory=dict)
    budget: float | None = None
    spoiled: tuple[SpoiledPart, ...] = ()
    is_cut: bool = False
    whole: Mapping[str, Score] = field(default_factory=dict)

    def __repr__(self) -> str:
        mean = self.result(self.best).mean
        return f"Choice({self.best!r}, RMSE {mean:.4g} {self.unit} on {len(self._rmse)} records)"

    @property
    def unit(self) -> str:
        """The unit of the RMSE."""
        return self.context.data.channels.unit

    @property
    def start(self) -> str:
        """The start of the free runs by which the chosen model was judged."""
        return self.result(self.best).start

    @property
    def horizon(self) -> float | None:
        """Length of these free runs [s], None for whole records."""
        return self.context.scoring.horizon

    def file(self, name: str) -> str:
        """The model file of a candidate that could be chosen, below the folder."""
        return f"{CANDIDATES}/{name}/{MODEL}"

    def result(self, name: str) -> CandidateResult:
        """The result of a candidate."""
        return self.candidates.result(name)

    @cached_property
    def _records(self) -> list[Experiment]:
        return records_without_test(self.context.data)

    @cached_property
    def _cloud(self) -> TrainingSupport | None:
        return training_support(self.context.data.channels, self._records)

    @cached_property
    def _rmse(self) -> dict[str, float]:
        return self.result(self.best).rmse()

    @cached_property
    def _median_share(self) -> float:
        return self.reference.median_share(self._rmse, self._records)

    @property
    def follows(self) -> bool:
        """Whether the chosen one follows most records better than a trivial predictor."""
        return self._median_share < 1

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The accuracy of the chosen model, and the reasons for the choice."""
        best = self.result(self.best)
        chosen = make_finding("chosen", name=self.best, made=self.origins[self.best])
        mean, _ = mean_and_error(self._rmse.values())
        if not math.isfinite(mean):
            return (chosen, make_finding("records diverge"), *self._unscored, *self.notes)
        return (
            chosen,
            *self._accuracy,
            *self._expectation,
            *self._shortfall,
            self._comparison_with_next(best),
            *self._stopped_fits,
            *self._alternatives(best),
            *[make_finding("spoiled", **part.as_plain()) for part in self.spoiled],
            *self._unscored,
            *self.notes,
        )

    @property
    def _accuracy(self) -> Iterator[Finding]:
        rmse, total = self._rmse, len(self._records)
        mean, error = mean_and_error(rmse.values())
        worst = max(rmse, key=lambda record: rmse[record])
        yield make_finding(
            "accuracy",
            horizon=self.context.scoring.horizon,
            records=len(rmse),
            total=total if total > len(rmse) else None,
            mean=mean,
            error=error,
            unit=self.unit,
            share=self._share_of_reference(mean),
            reference=self.reference.label,
            reference_error=self.reference.mean,
            worst=worst,
            largest=rmse[worst],
            few=len(rmse) < FEW,
        )
        if unexplained := self.result(self.best).unexplained:
            yield make_finding("forces unexplained", shares=unexplained)
        if self.whole:
            records = [self.context.data[name] for name in self.whole]
            scores, channels = list(self.whole.values()), self.context.data.channels
            if len(channels.units) > 1:
                reference = find_reference(records, None)
                yield make_finding(
                    "errors by unit",
                    errors=mean_rmse_by_unit(scores, channels),
                    reference=reference.label,
                    reference_errors=reference.mean_by_unit,
                )
            yield describe_followed(records, scores)

    def _share_of_reference(self, mean: float) -> float:
        return mean / self.reference.mean if self.reference.mean else math.inf

    @property
    def _shortfall(self) -> Iterator[Finding]:
        """The remedy where the chosen candidate is of little use on half of the records."""
        if self._median_share <= _POOR:
            return
        remedies = ["look at them (inspect)"]
        remedies += [] if self.budget is None else ["give more time (`budget=`)"]
        remedies += [] if self.context.system else ["give equations of motion (`system=`)"]
        yield make_finding(
            "nothing follows closely" if self.follows else "nothing follows",
            horizon=self.context.scoring.horizon,
            reference=self.reference.label,
            remedies=remedies,
        )

    @property
    def _stopped_fits(self) -> Iterator[Finding]:
        """Fits of the chosen one that the budget stopped."""
        fits = self.result(self.best).fits
        if stopped := sum(fit.is_out_of_time for fit in fits):
            family = self.candidates.plan.candidate(self.best).content.family
            code = "trainings stopped" if family.resumable else "identifications stopped"
            yield make_finding(code, stopped=stopped, total=len(fits))

    def _alternatives(self, best: CandidateResult) -> Iterator[Finding]:
        """The simplest that is as good, and the bands of the chosen one."""
        is_of_use = self.result(self.simplest).mean < self.reference.mean
        if self.simplest != self.best and is_of_use:
            difference = paired_difference(self.result(self.simplest), best)
            yield make_finding(
                "simplest",
                name=self.simplest,
                made=self.origins[self.simplest],
                difference=difference.mean,
                error=difference.standard_error,
                unit=self.unit,
                file=str(self.context.folder / self.file(self.simplest)),
            )
        if self.bands is not None:
            level = math.floor(100 * self.bands.highest_level)
            yield make_finding("bands", level=level, records=len(self.bands.records))

    @property
    def claim(self) -> ErrorRange | None:
        """The error that a new record is expected to have; None where one is lost."""
        return expected_range(self._rmse.values())

    @property
    def _expectation(self) -> Iterator[Finding]:
        """The error of a new record, and what makes the scores say little of it."""
        rmse, claim, unit = self._rmse, self.claim, self.unit
        if claim is not None:
            if claim.high > _VAGUE * claim.typical:
                errors = [*rmse.values()]
                ends = {"least": min(errors), "most": max(errors)}
                yield make_finding("expected vaguely", count=len(errors), unit=unit, **ends)
            else:
                yield make_finding(
                    "expected",
                    typical=claim.typical,
                    low=claim.low,
                    high=claim.high,
                    tenths=10 * claim.level,
                    unit=unit,
                )
            mean, _ = mean_and_error(rmse.values())
            if mean > _UNEVEN * claim.typical:
                by_kind = {kind: expected_range(errors) for kind, errors in self._by_kind.items()}
                typical = {kind: r.typical for kind, r in by_kind.items() if r}
                yield make_finding(
                    "few records make the mean",
                    records=[name for name, value in rmse.items() if value > mean],
                    kinds=typical if len(typical) > 1 else None,
                    unit=unit,
                )
        if self.is_cut:
            yield make_finding("pieces are alike")

    @property
    def _by_kind(self) -> dict[str, list[float]]:
        """The errors of the chosen candidate by kind of record, as folds know it."""
        by_kind: dict[str, list[float]] = {}
        for name, error in self._rmse.items():
            by_kind.setdefault(kind_of(name), []).append(error)
        return by_kind

    @property
    def _unscored(self) -> list[Finding]:
        """The candidates without scores, those of one reason together."""
        reasons: dict[str, list[str]] = {}
        for result in self.candidates.results:
            if not result.fits_by_fold:
                reasons.setdefault(result.why or "not tried", []).append(result.name)
        return [
            make_finding("without score", why=why, candidates=names)
            for why, names in reasons.items()
        ]

    def _comparison_with_next(self, best: CandidateResult) -> Finding:
        others = [r for r in self.candidates.results if r.follows_some and r is not best]
        compared = {r.name: paired_difference(r, best) for r in others}
        # what leaves all bounds on a record is worse by no number
        differences = {name: d for name, d in compared.items() if math.isfinite(d.mean)}
        if not differences:
            return make_finding("compared with nothing")
        name = min(differences, key=lambda other: differences[other].mean)
        difference = differences[name]
        mean, error, count = difference.mean, difference.standard_error, difference.records
        level = LEVEL * best.mean
        code = "not clearly better"
        if abs(mean) <= level:
            code = "next as good"
        elif mean < 0:
            code = "other better" if count >= FEW else "other better few"
        elif count < FEW or mean > CLEAR * error:
            code = "clearly better" if count >= FEW else "not clearly better few"
        return make_finding(
            code, other=name, difference=abs(mean), error=error, unit=self.unit, records=count
        )

    def header(self, name: str, final: FinalModel) -> dict[str, Any]:
        """The header of the model file of a candidate, beside the model's own."""
        result, data, scoring = self.result(name), self.context.data, self.context.scoring
        rmse = result.rmse()
        return {
            **final.header,
            "data": data_header(data.name, final.records or list(data)),
            RANGE: recorded_range(final.model, self._records, self._cloud).as_header(),
            "selection": {
                "plan": self.candidates.plan.name,
                "chosen": name,
                "made": self.origins[name],
            },
            "scores": {
                **scores_header(LEFT_OUT, result.start, data.channels, scoring.horizon, rmse),
                "standard_error": mean_and_error(rmse.values())[1],
                "reference": self.reference.as_header(rmse, self._records),
            },
            **self.context.system_header(final.model),
            **equations_header(final.model),
            **({BANDS: self.bands.as_header()} if self.bands and name == self.best else {}),
            **spoiled_header(self.findings),
        }

    def as_plain(self) -> dict[str, Any]:
        """The selection as plain values."""
        best = self.result(self.best)
        return {
            "plan": self.candidates.plan.model_dump(mode="json"),
            "data": self.context.data.name,
            "unit": self.unit,
            "folds": self.context.scoring.folds,
            "start": best.start,
            "horizon": self.context.scoring.horizon,
            "best": self.best,
            "simplest": self.simplest,
            "reference": self.reference.as_plain(),
            "claim": None if self.claim is None else asdict(self.claim),
            "seconds": self.seconds,
            "seconds_by_part": dict(self.seconds_by_part),
            "budget": self.budget,
            "findings": [finding.as_plain() for finding in self.findings],
            **spoiled_header(self.findings),
            "candidates": [self._result_as_plain(r, best) for r in self.candidates.results],
        }

    def _result_as_plain(self, result: CandidateResult, best: CandidateResult) -> dict[str, Any]:
        common = {"name": result.name, "seconds": result.seconds, "why": result.why}
        if not result.fits_by_fold:
            return common
        difference = paired_difference(result, best)
        rmse = result.rmse()
        mean, error = mean_and_error(rmse.values())
        return {
            **common,
            "model": self.file(result.name) if result.name in self.origins else None,
            "made": self.origins.get(result.name),
            "folds": sorted(result.fits_by_fold),
            **({"unexplained": result.unexplained} if result.unexplained else {}),
            "starts": {result.start: {"mean": mean, "standard_error": error, "rmse": rmse}},
            "difference": asdict(difference),
            "models": [fit.model for fit in result.fits if fit.model],
        }
