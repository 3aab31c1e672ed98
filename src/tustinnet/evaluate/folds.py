"""Cross-validation: every record scored by models that never saw it."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.evaluate.scores import evaluate, rmse_by_record
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.gradient.plan import groups_alike, make_plan
from tustinnet.fitting.gradient.train import train_plan
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import AnyRecipe, Fold, Member, Task, resolve_system
from tustinnet.models.contract import Model
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.simulate.horizon import effective_horizon, horizon_samples
from tustinnet.simulate.starts import FIT_SAMPLES, default_start, start_named
from tustinnet.systems.files import AnySystem, SystemTemplate, load_system_or_template

FOLDS = 5


@dataclass(frozen=True)
class FoldScore:
    """A record, scored by a model that never saw it.

    Attributes:
        record: the record.
        fold: the fold it is in, from 0.
        seed: the seed of the model.
        rmse: RMSE of its free run by start [rad or m].
    """

    record: str
    fold: int
    seed: int
    rmse: Mapping[str, float]


@dataclass(frozen=True)
class Validated:
    """What a cross-validation found.

    Attributes:
        recipe: what was fitted.
        unit: of the RMSE.
        scores: of every record, for every seed.
        outcomes: why each fit ended, by fold and seed.
        seconds: time of all fits.
    """

    recipe: str
    unit: str
    scores: tuple[FoldScore, ...]
    outcomes: Mapping[str, str]
    seconds: float

    def means(self, start: str) -> dict[str, float]:
        """Mean over the seeds of every record's RMSE [rad or m]."""
        by_record: dict[str, list[float]] = {}
        for score in self.scores:
            by_record.setdefault(score.record, []).append(score.rmse[start])
        return {record: float(np.mean(values)) for record, values in by_record.items()}

    def summary(self) -> dict[str, dict[str, Any]]:
        """By start: mean over the records, its standard error, the mean of each seed."""
        found = {}
        for start in self.scores[0].rmse:
            mean, error = mean_and_error(self.means(start).values())
            seeds = sorted({score.seed for score in self.scores})
            found[start] = {
                "mean": mean,
                "standard_error": error,
                "by_seed": {
                    str(seed): float(
                        np.mean([s.rmse[start] for s in self.scores if s.seed == seed])
                    )
                    for seed in seeds
                },
            }
        return found

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values."""
        return {
            "recipe": self.recipe,
            "unit": self.unit,
            "summary": self.summary(),
            "seconds": self.seconds,
            "outcomes": dict(self.outcomes),
            "records": [
                {"record": s.record, "fold": s.fold, "seed": s.seed, "rmse": dict(s.rmse)}
                for s in self.scores
            ],
        }


@dataclass(frozen=True)
class Deal:
    """A fold: the records to score, those that choose, those that train."""

    scored: tuple[Experiment, ...]
    roles: Roles


def taking_part(data: DataSet) -> list[Experiment]:
    """The records that folds are made of: all but the test split."""
    return [e for e in data if e.split != "test"]


def dealt(data: DataSet, folds: int = FOLDS) -> list[Deal]:
    """Deals records into folds like cards, those of a kind one after the other.

    Records are of a kind whose names begin with the same letters. Each fold is scored once; the
    next one chooses the weights of the models that score it, the others train them. Records of
    the split `test` take part in nothing.

    Args:
        data: the records.
        folds: how many.

    Raises:
        InputError: fewer than 3 folds, or fewer records than folds.
    """
    known = taking_part(data)
    if not 3 <= folds <= len(known):
        raise InputError(
            "--folds", f"{folds} folds of {len(known)} records",
            f"3 to {len(known)}" if len(known) >= 3 else "at least 3 records",
            "one fold is scored, one chooses, the others train",
        )  # fmt: skip
    ordered = sorted(known, key=lambda e: (_kind(e.name), str(e.split), e.name))
    piles = [tuple(ordered[f::folds]) for f in range(folds)]
    deals = []
    for f, scored in enumerate(piles):
        chooses = (f + 1) % folds
        train = tuple(e for i, pile in enumerate(piles) if i not in (f, chooses) for e in pile)
        deals.append(Deal(scored, Roles(train, piles[chooses])))
    return deals


def _kind(name: str) -> str:
    found = re.match("[a-zA-Z]+", name)
    return found.group() if found else ""


@dataclass(frozen=True)
class Question:
    """What a cross-validation is asked.

    Attributes:
        recipe: what is fitted.
        physics: the recipe that identifies what a hybrid corrects, anew in every fold, or None.
        system: the system that is identified, or None.
        folds: how many.
        seeds: those of every fold.
        starts: where free runs start; by default the usual start, and `model-20`.
    """

    recipe: Recipe
    physics: Recipe | None = None
    system: LagrangianSystem | SystemTemplate | None = None
    folds: int = FOLDS
    seeds: tuple[int, ...] = (0,)
    starts: tuple[str, ...] = ()


PHYSICS = "best-grey"  # what identifies the physics of a hybrid where nothing else is said


def make_question(
    recipe: AnyRecipe,
    *,
    system: AnySystem | None = None,
    physics: AnyRecipe | None = None,
    folds: int = FOLDS,
    seeds: Sequence[int] | None = None,
    starts: Sequence[str] = (),
) -> Question:
    """What `cross_validate` is to do, checked.

    Args:
        recipe: what is fitted.
        system: the system that is identified, or whose identified model a network corrects.
        physics: the recipe that identifies what a network corrects; `best-grey` by default.
        folds: how many.
        seeds: those of every fold; 0 by default.
        starts: where free runs start; by default the usual start, and `model-20`.

    Returns:
        The question that `cross_validate` takes.

    Raises:
        InputError: an argument that means nothing to the recipe, or one that it needs is missing.
    """
    chosen = read_recipe(recipe)
    family = chosen.family
    corrects = "physics" in family.needs
    if physics is not None and not corrects:
        raise InputError("--physics", f"means nothing to a recipe of kind '{family.kind}'",
                         "a recipe that corrects physics")  # fmt: skip
    if seeds is not None and not family.trains:
        raise InputError("--seeds", "an identification has no seeds", "a recipe with weights")
    if seeds is not None and (not seeds or len(set(seeds)) < len(seeds)):
        raise InputError("--seeds", f"{list(seeds)}", "at least one, all different")
    identifying = read_recipe(physics or PHYSICS) if corrects else chosen
    if corrects and not identifying.family.correctable:
        raise InputError(
            "--physics", f"a recipe of kind '{identifying.family.kind}', whose models are trained",
            "a recipe whose models a network can correct",
        )  # fmt: skip
    wanted = "system" in identifying.family.needs
    if system is None:
        system = resolve_system(identifying, None)
    if (system is None) == wanted:
        found = "no system" if wanted else "a system, which means nothing to this recipe"
        raise InputError("--system", found, "a system for recipes that identify one")
    return Question(
        recipe=chosen,
        physics=identifying if corrects else None,
        system=None if system is None else load_system_or_template(system),
        folds=folds,
        seeds=tuple(seeds or (0,)),
        starts=tuple(start_named(start).name for start in starts),
    )


Tell = Callable[[Any], Listener]


def cross_validate(data: DataSet, asked: Question, tell: Tell = lambda task: SILENT) -> Validated:
    """Fits a recipe to every choice of folds and scores the records that were left out.

    Members of all folds train together where their models and windows are alike.

    Args:
        data: the records; the folds do not respect splits, but `test` stays out.
        asked: what to fit, how often.
        tell: given what is fitted together, the plan of trainings or the task of an
            identification, returns a `Listener`. By default nobody is told.

    Returns:
        The score of every record for every seed; `summary` has means and standard errors.

    Raises:
        InputError: too few records; see also `fit`.
    """
    deals, recipe = dealt(data, asked.folds), asked.recipe
    starts_asked(data, asked)  # before anything is fitted
    physics = [None] * len(deals) if asked.physics is None else _physics(deals, asked, tell)
    folds = tuple(Fold(used_by(d.roles, recipe), p) for d, p in zip(deals, physics, strict=True))
    own = None if asked.physics else asked.system
    seeds = asked.seeds if recipe.family.trains else (0,)
    members = tuple(Member(seed, fold=f) for f in range(len(folds)) for seed in seeds)
    task, results = Task(recipe, folds, members, own), []
    for group in groups_alike(task):
        results += fitted(task.with_members(group), tell)
    results.sort(key=lambda r: members.index(r.member))
    scores = [
        score
        for r in results
        for score in fold_scores(
            r.model, (r.member.fold, r.seed), r.horizon, deals[r.member.fold].scored, data, asked
        )
    ]
    return Validated(
        recipe=recipe.name,
        unit=data.channels.unit,
        scores=tuple(scores),
        outcomes={f"fold {r.member.fold}, seed {r.seed}": r.outcome for r in results},
        seconds=sum(r.seconds for r in results),
    )


def starts_asked(data: DataSet, asked: Question) -> tuple[str, ...]:
    """Where the free runs start that judge, of models without a start of their own.

    Raises:
        InputError: a horizon of the recipe that is too short for one of them, or too long.
    """
    known = taking_part(data)
    starts = _starts(asked, known)
    for start in starts:
        horizon_samples(asked.recipe.longest_run, known, start_named(start))
    return starts


def _starts(asked: Question, records: Sequence[Experiment], *models: Model) -> tuple[str, ...]:
    """The starts that are asked for, else the usual one and `model-20`."""
    return asked.starts or (default_start(records, *models), f"model-{FIT_SAMPLES}")


def used_by(of: Roles, recipe: Recipe) -> Roles:
    """The records of a fold as a recipe uses them.

    Those that would choose train, too, where the recipe leaves them nothing to choose.
    """
    return of if recipe.needs_validation else Roles(of.all, ())


def _physics(deals: Sequence[Deal], asked: Question, tell: Tell) -> list[Model]:
    """What every fold's networks correct, identified from all records that are not scored."""
    assert asked.physics is not None
    folds = tuple(Fold(used_by(d.roles, asked.physics)) for d in deals)
    members = tuple(Member(fold=f) for f in range(len(folds)))
    task = Task(asked.physics, folds, members, asked.system)
    return [result.model for result in fitted(task, tell)]


def fitted(task: Task, tell: Tell) -> list[FitResult]:
    """Members that can be fitted together, followed by whoever wants to know."""
    if not task.recipe.family.trains:
        return fit_task(task, tell)
    prepared = make_plan(task)
    return train_plan(prepared, tell(prepared))


def fold_scores(
    model: Model,
    by: tuple[int, int],
    horizon: float | None,
    scored: Sequence[Experiment],
    data: DataSet,
    asked: Question,
) -> list[FoldScore]:
    """The scores of the records of a fold.

    Args:
        model: a model that was not fitted to them.
        by: the fold and the seed.
        horizon: over how long its fit compared [s], None for whole records.
        scored: the records.
        data: all records.
        asked: where free runs start.
    """
    within_reach = effective_horizon(horizon, scored)
    by_start = {
        start: rmse_by_record(evaluate(model, scored, start_named(start), horizon=within_reach))
        for start in dict.fromkeys(_starts(asked, list(data), model))
    }
    fold, seed = by
    return [
        FoldScore(e.name, fold, seed, {s: of[e.name] for s, of in by_start.items()}) for e in scored
    ]
