"""The choice of a selection: which model, how good, why."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.bands import KEY as BANDS
from tustinnet.evaluate.bands import Calibration
from tustinnet.evaluate.folds import taking_part
from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.evaluate.scores import scores_header
from tustinnet.fitting.report import data_header
from tustinnet.models.contract import Model
from tustinnet.selection.ending import Final, Found
from tustinnet.selection.jobs import LEFT_OUT, Workplace
from tustinnet.selection.ranking import CLEAR, Standing, hanging, paired
from tustinnet.simulate.range import KEY as RANGE
from tustinnet.simulate.range import TrainingSupport, recorded_range, training_support
from tustinnet.store.kept_system import CANDIDATES, header_of
from tustinnet.store.run import MODEL

_POOR = 0.2  # of the motion, an error with which a model is of little use


@dataclass(frozen=True)
class Choice:
    """What a selection came to.

    Attributes:
        at: where it is, the records, how candidates were compared.
        found: what was found of candidates and committees.
        best: the candidate or committee that was chosen.
        simplest: the simplest that is as good as it.
        made: what the models of those that could be chosen were made of, in words.
        model: the chosen model.
        bands: around free runs of the chosen one, None where nothing says how wide they are.
        notes: what else was done or left out, in sentences.
        seconds: time it took.
        budget: how long it was to take at most [s], None for no limit.
    """

    at: Workplace
    found: Found
    best: str
    simplest: str
    made: Mapping[str, str]
    model: Model
    bands: Calibration | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    budget: float | None = None

    @property
    def unit(self) -> str:
        """Of the RMSE."""
        return self.at.data.channels.unit

    @property
    def starts(self) -> tuple[str, ...]:
        """The starts that candidates were scored from, first the one that judges."""
        every = [start for s in self.found.standings for start in s.starts]
        return tuple(dict.fromkeys([self.at.judging.start, *every]))

    def file(self, name: str) -> str:
        """The model file of a candidate or committee that could be chosen, below the folder."""
        return f"{CANDIDATES}/{name}/{MODEL}"

    def standing(self, name: str) -> Standing:
        """That of a candidate or committee."""
        return self.found.standing(name)

    @cached_property
    def _recorded(self) -> list[Experiment]:
        return taking_part(self.at.data)

    @cached_property
    def _cloud(self) -> TrainingSupport | None:
        return training_support(self.at.data.channels, self._recorded)

    @property
    def sentences(self) -> tuple[str, ...]:
        """How good the chosen model is, and why this one, in plain words."""
        best = self.standing(self.best)
        rmse = best.rmse()
        mean, error = mean_and_error(rmse.values())
        told = [f"chosen: {self.best}, {self.made[self.best]}"]
        if not math.isfinite(mean):
            told.append("free runs of some records leave all bounds: set `horizon` in the plan")
            return (*told, *self.notes)
        spread = "" if math.isnan(error) else f" ± {error:.2g}"
        worst = max(rmse, key=lambda record: rmse[record])
        several, every = "s" if len(rmse) > 1 else "", len(self._recorded)
        of = f" of the {every}" if every > len(rmse) > 1 else ""
        share = mean / self.at.motion
        told.append(
            f"free runs of {len(rmse)}{of} record{several} that its models were not fitted to: "
            f"{mean:.3g}{spread} {self.unit}, {100 * share:.2g} % of the motion; "
            f"worst {worst}, {rmse[worst]:.3g} {self.unit}"
        )
        if share > _POOR:
            told.append(
                "no candidate follows these records closely: look at them (inspect), give more "
                "time (--budget) or equations of motion (--system)"
            )
        told.append(self._against(best))
        told += self._hanging(best)
        if self.simplest != self.best:
            than = paired(self.standing(self.simplest), best)
            told.append(
                f"simplest that is as good: {self.simplest}, {self.made[self.simplest]} "
                f"({than.mean:+.2g} ± {than.standard_error:.2g} {self.unit}): "
                f"{self.at.folder / self.file(self.simplest)}"
            )
        if self.bands is not None:
            most, known = math.floor(100 * self.bands.most), len(self.bands.records)
            told.append(
                f"its free runs have bands (simulate --band) of up to {most} %, calibrated on the "
                f"{known} records that folds left out"
            )
        return (*told, *self.notes)

    def _against(self, best: Standing) -> str:
        """How the chosen one stands to the next one."""
        left = self.found.choosable
        every = left if len(left) > 1 else [s for s in self.found.standings if s.folds]
        others = [s for s in every if s.name != best.name]
        if not others:
            return "nothing else was scored to compare it with"
        than = {s.name: paired(s, best) for s in others}
        name = min(than, key=lambda other: than[other].mean)
        mean, error = than[name].mean, than[name].standard_error
        word = "clearly" if mean > CLEAR * error else "not clearly"
        count = than[name].records
        # one record has no standard error
        on = (
            f"± {error:.2g} {self.unit} on {count} records"
            if count > 1
            else f"{self.unit} on one record"
        )
        return f"{word} better than the next, {name}: by {mean:.2g} {on}"

    def _hanging(self, best: Standing) -> list[str]:
        """Whether a single record decided."""
        others = [s for s in self.found.standings if s.folds and s.name != best.name]
        found = hanging(best, others)
        if found is None:
            return []
        record, other, than = found
        return [
            f"one record decides: without {record}, {other.name} would be better by "
            f"{-than.mean:.2g} ± {than.standard_error:.2g} {self.unit} on {than.records} records; "
            f"see whether {record} was made with the same machine, load and settings"
        ]

    def header(self, name: str, final: Final) -> dict[str, Any]:
        """What the model file of a candidate or committee says beside the model."""
        standing = self.standing(name)
        rmse, channels, horizon = standing.rmse(), self.at.data.channels, self.at.judging.horizon
        needs_system = any(
            self.found.plan.candidate(s.name).content.family.needs
            for s, _ in self.found.members(name)
        )
        return {
            **final.about,
            "data": data_header(self.at.data.name, list(self.at.data)),
            RANGE: recorded_range(final.model, self._recorded, self._cloud).as_header(),
            "selection": {"plan": self.found.plan.name, "chosen": name, "made": self.made[name]},
            "scores": {
                **scores_header(LEFT_OUT, standing.starts[0], channels, horizon, rmse),
                "standard_error": mean_and_error(rmse.values())[1],
            },
            **(header_of(self.at.system_file) if needs_system else {}),
            **({BANDS: self.bands.as_header()} if self.bands and name == self.best else {}),
        }

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values."""
        best = self.standing(self.best)
        return {
            "plan": self.found.plan.model_dump(mode="json"),
            "data": self.at.data.name,
            "unit": self.unit,
            "folds": self.at.judging.folds,
            "start": self.at.judging.start,
            "horizon": self.at.judging.horizon,
            "best": self.best,
            "simplest": self.simplest,
            "seconds": self.seconds,
            "budget": self.budget,
            "sentences": list(self.sentences),
            "candidates": [self._plain(s, best) for s in self.found.standings],
        }

    def _plain(self, of: Standing, best: Standing) -> dict[str, Any]:
        common = {"name": of.name, "seconds": of.seconds, "why": of.why}
        if not of.folds:
            return common
        than = paired(of, best)
        by_start = {start: of.rmse(start=start) for start in of.starts}
        averages = self.found.averages
        return {
            **common,
            "model": self.file(of.name) if of.name in self.made else None,
            "made": self.made.get(of.name),
            "shares": dict(averages[of.name].shares) if of.name in averages else None,
            "folds": sorted(of.folds),
            "seeds": sorted({m.seed for m in of.models}),
            "starts": {
                start: dict(
                    zip(("mean", "standard_error"), mean_and_error(rmse.values()), strict=True)
                )
                | {"rmse": rmse}
                for start, rmse in by_start.items()
            },
            "difference": {
                "mean": than.mean,
                "standard_error": than.standard_error,
                "records": than.records,
            },
            "models": [m.model for m in of.models if m.model],
        }
