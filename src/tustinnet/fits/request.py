"""Requests of fits: all that a fit is of, and the task that comes of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tustinnet.data.dataset import DataSet
from tustinnet.evaluate.spoiled import find_spoiled
from tustinnet.finding import Finding, make_finding
from tustinnet.fits.preparation import PreparationOptions, PreparedRecords, prepare_records
from tustinnet.fits.timing import refine_delays
from tustinnet.fitting.inverse_dynamics.along import require_possible
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe_reading import is_published
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.roles import assign_roles
from tustinnet.fitting.task import AnyRecipe, Member, Origin, Task, make_task
from tustinnet.models.contract import Model
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.systems.files import AnySystem


@dataclass(frozen=True)
class FitRequest:
    """Fits of one recipe to records.

    Attributes:
        data: the records.
        recipe: a packaged recipe's name, a TOML file, its content as a mapping, or a `Recipe`; by
            default `standard`, with a `system` `grey`, with `physics` `best-hybrid`.
        members: seeds and rates; an identification has neither.
        physics: a model whose accelerations a network corrects, or None.
        system: the system whose parameters are identified, or None.
        origin: a fitted model to begin with, or None.
        leaves_out_spoiled: whether parts of records that spoil the fit are left out.
    """

    data: DataSet
    recipe: AnyRecipe | None = None
    members: Sequence[Member] = (Member(),)
    physics: Model | None = None
    system: AnySystem | None = None
    origin: Origin | None = None
    leaves_out_spoiled: bool = False


@dataclass(frozen=True)
class PreparedFit:
    """Fits whose records are prepared.

    Attributes:
        task: the fits.
        records: their records, and what was done to them.
    """

    task: Task
    records: PreparedRecords

    def complete(self, results: Sequence[FitResult]) -> list[FitResult]:
        """Results that also have their records, and what was found out about these.

        A correction that validation records do not show to be better than its physics is left out.
        """
        roles, data = self.task.folds[0].roles, self.records.data.name
        completed = []
        for result in map(_choose_physics, results):
            own = result.identification
            findings = (*result.findings, *self.records.findings, *self._find_spoiled(result))
            if own is not None:
                own = replace(own, findings=findings)
            completed.append(
                replace(result, findings=findings, identification=own, roles=roles, data=data)
            )
        return completed

    def _find_spoiled(self, result: FitResult) -> list[Finding]:
        """Parts that an identified model does not explain, unless they were searched for before."""
        own = result.identification
        if own is None or own.force_errors or self.records.left_out:
            return []
        parts = find_spoiled(result.model, self.task.folds[0].roles.all)
        return [make_finding("spoiled", **part.as_plain()) for part in parts]


def _choose_physics(result: FitResult) -> FitResult:
    """A fit, with a correction of 0 where that of its network is no better on validation."""
    trained, alone = result.validation_rmse, result.physics_rmse
    if trained is None or alone is None or trained < alone or not math.isfinite(alone):
        return result
    model = result.recipe.family.without_correction(result.model)
    assert model is not None
    values = {"trained": trained, "physics": alone, "unit": model.channels.unit}
    return replace(
        result,
        model=model,
        validation_rmse=alone,
        details={way: {**own, "kept_epoch": 0} for way, own in result.details.items()},
        findings=(make_finding("physics alone", **values),),
    )


def prepare(request: FitRequest, listener: Listener = SILENT) -> PreparedFit:
    """Checks that the parts of a request fit together, and prepares its records.

    Holds and delays of a fit that begins with a model, or corrects one, are those of the model. An
    identification begins at a delay that was found, and has it as a parameter: physics is exact
    enough to show what the records alone leave of it.

    Args:
        request: what is fitted.
        listener: see `PreparationOptions`.

    Raises:
        InputError: an argument that is not applicable to the recipe, or one that is missing; see
            `make_task`.
    """
    task = make_task(
        request.data,
        request.recipe,
        request.members,
        physics=request.physics,
        system=request.system,
        origin=request.origin,
    )
    recipe, (fold,) = task.recipe, task.folds
    model = fold.physics or (fold.origin and fold.origin.model)
    if recipe.is_by_forces and isinstance(task.system, LagrangianSystem):
        require_possible(task.system, request.data.experiments)  # before time is spent
    options = PreparationOptions(
        system=task.system,
        finds_timing=model is None and not (recipe.is_by_forces or is_published(recipe)),
        leaves_out_spoiled=request.leaves_out_spoiled,
        listener=listener,
    )
    data = request.data
    if model is not None and any(i.hold == "unknown" for i in data.channels.inputs):
        data = replace(data, experiments=tuple(e.with_timing(model.inputs) for e in data))
    records = prepare_records(data, options)
    task = replace(task, recipe=refine_delays(recipe, records.delays))
    if records.data is not request.data:
        task = replace(task, folds=(replace(fold, roles=assign_roles(records.data)),))
    return PreparedFit(task, records)
