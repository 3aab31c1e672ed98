"""Runs: fits of one recipe, scored, and kept in a folder with all that belongs to them."""

import csv
import io
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from tustinnet.channels import Channels
from tustinnet.data.spoiled import spoiled_header
from tustinnet.evaluate.reference import Reference, find_reference
from tustinnet.evaluate.scores import (
    Score,
    mean_rmse,
    mean_rmse_by_unit,
    rmse_by_record,
    score_runs,
    scores_header,
)
from tustinnet.fits.in_folder import fit_in_folder
from tustinnet.fits.request import PreparedFit
from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.report import FitResult, Identification, data_header
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Task
from tustinnet.models.contract import Model, require_float64
from tustinnet.models.written_equations import equations_header
from tustinnet.simulate.horizon import effective_horizon
from tustinnet.simulate.range import KEY as RANGE
from tustinnet.simulate.range import TrainingSupport, recorded_range, training_support
from tustinnet.store import model_file
from tustinnet.store.files import lock_folder, to_json, write_into
from tustinnet.store.header import ORIGIN
from tustinnet.store.kept_system import require_copy_fits, system_header, write_system_copy
from tustinnet.store.run_folder import (
    BASE_PARAMETERS,
    MODEL,
    SUMMARY,
    Earlier,
    prepare_run_folder,
)
from tustinnet.store.specification import SPECIFICATION, make_specification, write_specification
from tustinnet.systems.files import SystemFile


@dataclass(frozen=True)
class MemberRun:
    """The fit of one member.

    Attributes:
        result: the model and how it came about.
        scores: free runs of the judging records, in float64.
        folder: where its files are.
    """

    result: FitResult
    scores: tuple[Score, ...]
    folder: Path

    @property
    def mean(self) -> float:
        """Mean RMSE over the judging records [rad or m]."""
        return mean_rmse(self.scores)

    @property
    def rmse(self) -> dict[str, float]:
        """RMSE of each judging record [rad or m]."""
        return rmse_by_record(self.scores)


@dataclass(frozen=True)
class Run:
    """Fits of one recipe.

    Attributes:
        members: each of them.
        data: what the records are called.
        roles: the records.
        start: where the free runs start that rank the members.
        folder: where the files are.
        system: the system's file, where one was given.
        origin: the account of the model that the fits began with, empty where they began anew.
    """

    members: tuple[MemberRun, ...]
    data: str
    roles: Roles
    start: str
    folder: Path
    system: SystemFile | None = None
    origin: Mapping[str, Any] = field(default_factory=dict)

    @property
    def best(self) -> MemberRun:
        """The member with the lowest mean RMSE."""
        return min(self.members, key=lambda run: run.mean)

    @cached_property
    def reference(self) -> Reference:
        """The errors of trivial predictors on the records that rank the members."""
        return find_reference(self.roles.ranking, self.best.scores[0].horizon)

    @property
    def follows(self) -> bool:
        """Whether the best model follows these records better than a trivial predictor."""
        return self.reference.median_share(self.best.rmse, self.roles.ranking) < 1

    @cached_property
    def training_rmse(self) -> Mapping[str, float]:
        """RMSE of the best model on each training record [rad or m].

        Of a training that of its free run; of an identification from its initial states.
        """
        identification = self.best.result.identification
        return (
            rmse_by_record(self.training_scores) if identification is None else identification.rmse
        )

    @cached_property
    def training_scores(self) -> Sequence[Score]:
        """Scores of the best model's free runs of the training records."""
        result = self.best.result
        if self.roles.ranking is self.roles.train:
            return self.best.scores
        horizon = effective_horizon(result.horizon, self.roles.train)
        return score_runs(result.model, self.roles.train, result.start, horizon=horizon)

    @property
    def channels(self) -> Channels:
        """Coordinates, inputs and sampling period of the records."""
        return self.roles.train[0].channels

    @cached_property
    def _support(self) -> TrainingSupport | None:
        return training_support(self.channels, self.roles.train)

    @property
    def seconds(self) -> float:
        """Time that the fits of all members took [s]."""
        return sum(member.result.seconds for member in self.members)

    @property
    def judging_split(self) -> str:
        """The split whose free runs rank them."""
        return self.roles.ranking_split

    def spread(self) -> dict[str, float]:
        """Median, mean, standard deviation, lowest and highest mean RMSE [rad or m]."""
        means = [run.mean for run in self.members]
        return {
            "median": statistics.median(means),
            "mean": statistics.fmean(means),
            "std": statistics.stdev(means) if len(means) > 1 else 0.0,
            "min": min(means),
            "max": max(means),
        }

    def header(self, member: MemberRun) -> dict[str, Any]:
        """The header of the model file of a member, beside the model's own."""
        channels = self.channels
        return {
            **member.result.as_header(),
            "data": data_header(self.data, self.roles.all),
            RANGE: recorded_range(member.result.model, self.roles.train, self._support).as_header(),
            "scores": scores_header(
                self.judging_split,
                self.start,
                channels,
                member.scores[0].horizon,
                member.rmse,
                mean_rmse_by_unit(member.scores, channels),
                self.reference.as_header(member.rmse, self.roles.ranking),
            ),
            **system_header(self.system),
            **equations_header(member.result.model),
            **({ORIGIN: dict(self.origin)} if self.origin else {}),
            **spoiled_header(member.result.findings),
        }

    def summary(self) -> dict[str, Any]:
        """The account of the run as plain values: the best model's header, and every member."""
        best = self.best
        return {
            **self.header(best),
            "recipe": best.result.recipe.name,
            "kind": best.result.recipe.model.kind,
            "split": self.judging_split,
            "start": self.start,
            "horizon": best.scores[0].horizon,
            "best_seed": best.result.seed,
            "spread": self.spread(),
            "training_rmse": dict(self.training_rmse),
            "seeds": [
                {
                    "seed": run.result.seed,
                    "rate": run.result.member.rate,
                    "outcome": run.result.outcome,
                    "mean": run.mean,
                    "mean_by_unit": mean_rmse_by_unit(run.scores, self.channels),
                    "rmse": run.rmse,
                    "train_seconds": run.result.seconds,
                    **run.result.details.get("training", {}),
                    "findings": [f.as_plain() for f in run.result.findings],
                    "model": (run.folder / MODEL).relative_to(self.folder).as_posix(),
                }
                for run in self.members
            ],
        }


def run_fit(
    fit: PreparedFit,
    folder: Path,
    earlier: Earlier = "refuse",
    listener: Listener = SILENT,
    system: SystemFile | None = None,
) -> Run:
    """Fits all members of a prepared fit, scores them, and keeps everything in a folder.

    Args:
        fit: the fits, of one fold.
        folder: where the files go.
        earlier: what to do with a run that the folder holds: `refuse`, `discard`, or `resume`: go
            on from the checkpoints that are there; members without one start.
        listener: functions that are called while they go on.
        system: the file of the system that the fits are of; a copy is kept with the models.

    Raises:
        InputError: the folder cannot be written, another run is writing there, it holds an earlier
            run that is neither resumed nor discarded; a resumed run had another specification, or
            its checkpoints belong to another run; an identification is to be resumed.
    """
    require_float64("run_fit")
    task = fit.task
    with lock_folder(folder):
        own = [folder / MODEL, folder / SPECIFICATION] if earlier == "discard" else []
        require_copy_fits(system, folder, own)
        specification, family = make_specification(task, system), task.recipe.family
        prepare_run_folder(folder, earlier, specification, resumable=family.resumable)

        def on_begin(prepared: TrainingPlan | Task) -> None:
            # the records of a training are known to fit the recipe now
            if isinstance(prepared, TrainingPlan):
                write_specification(folder, specification)
            listener.on_begin(prepared)

        results = fit_in_folder(
            folder, task, replace(listener, on_begin=on_begin), resume=earlier == "resume"
        )
        fits = fit.complete(results)
        (fold,) = task.folds
        roles = fold.roles.with_long_validation(fits[0].fewest_samples)
        members = []
        for member, result in zip(task.members, fits, strict=True):
            place = folder / member.name if family.has_seeds else folder
            members.append(_score_fit(result, roles, place))
        run = Run(
            tuple(members),
            fit.records.data.name,
            roles,
            fits[0].start,
            folder,
            system,
            {} if fold.origin is None else fold.origin.provenance,
        )
        identification = run.best.result.identification
        write_specification(folder, specification)
        if system is not None:
            write_system_copy(system, folder)
        for member in run.members:
            model_file.save(member.result.model, member.folder / MODEL, **run.header(member))
        model_file.save(run.best.result.model, folder / MODEL, **run.header(run.best))
        if identification is not None and identification.base_parameters:
            write_into(folder, BASE_PARAMETERS, _base_parameters_csv(identification))
        write_into(folder, SUMMARY, to_json(run.summary()))
    return run


def save(model: Model | FitResult, path: str | Path, **header: Any) -> None:
    """Writes a model file, whole or not at all.

    That of a fit has its recipe, records, errors and scores, as the command writes it.

    Args:
        model: the model, of any registered kind, or the result of a fit.
        path: the file, usually ending in `.safetensors`.
        header: further entries of the file.

    Raises:
        InputError: a model of no registered kind, or the file cannot be written; of a fit also
            where float64 is off.
    """
    if isinstance(model, FitResult):
        header = {**_header_of(model), **header}
        model = model.model
    model_file.save(model, path, **header)


def _header_of(result: FitResult) -> dict[str, Any]:
    """The header of the model file of a fit, whose validation records are scored for it."""
    if result.roles is None:
        return result.as_header()
    roles = result.roles.with_long_validation(result.fewest_samples)
    member = _score_fit(result, roles, Path())
    return Run((member,), result.data, roles, result.start, Path()).header(member)


def _score_fit(result: FitResult, roles: Roles, folder: Path) -> MemberRun:
    """A fit with the scores of the records that rank it."""
    horizon = effective_horizon(result.horizon, roles.ranking)
    scores = score_runs(result.model, roles.ranking, result.start, horizon=horizon)
    return MemberRun(result, tuple(scores), folder)


def _base_parameters_csv(identification: Identification) -> str:
    """The base parameters of an identification as CSV: a row each, with value and interval."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["base parameter", "unit", "value", "low (95 %)", "high (95 %)"])
    for b in identification.base_parameters:
        writer.writerow([b.expression, b.unit, b.value, *(b.interval or ("", ""))])
    return text.getvalue()
