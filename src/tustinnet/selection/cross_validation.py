"""Cross-validation: every record scored by models that never saw it."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluate.metrics import mean_and_error, mean_by_key
from tustinnet.fits.preparation import PreparationOptions, prepare_records
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.recipe_reading import is_published, read_recipe
from tustinnet.fitting.roles import records_without_test
from tustinnet.fitting.task import AnyRecipe, require_feedback, resolve_system
from tustinnet.models.contract import require_float64
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.selection.folds import split_into_folds
from tustinnet.selection.jobs import Job, JobResult, RunContext
from tustinnet.selection.runner import Workplace, run_jobs
from tustinnet.selection.scoring import RecipeScorer
from tustinnet.shown import Shown
from tustinnet.simulate.horizon import horizon_samples
from tustinnet.simulate.starts import default_start, start_named
from tustinnet.store.kept_system import CANDIDATES
from tustinnet.store.run_folder import SCORES
from tustinnet.systems.files import AnySystem, SystemTemplate
from tustinnet.systems.loading import load_system_or_template

DEFAULT_PHYSICS = "best-grey"  # identifies the physics of a hybrid where nothing else is given
PHYSICS, RECIPE = "physics", "recipe"  # names of the candidates, and of their jobs' folders


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
class CrossValidationResult(Shown):
    """Scores of a cross-validation.

    Attributes:
        recipe: the recipe that was fitted.
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

    def __repr__(self) -> str:
        means = [f"{values['mean']:.4g} from {start}" for start, values in self.summary().items()]
        text = f"{len(self.scores)} scores, mean RMSE {' and '.join(means)} [{self.unit}]"
        return f"CrossValidationResult({self.recipe!r}, {text})"

    def means(self, start: str) -> dict[str, float]:
        """Mean over the seeds of every record's RMSE [rad or m]."""
        return mean_by_key((score.record, score.rmse[start]) for score in self.scores)

    def summary(self) -> dict[str, dict[str, Any]]:
        """By start: mean over the records, its standard error, the mean of each seed."""
        summary = {}
        for start in self.scores[0].rmse:
            mean, error = mean_and_error(self.means(start).values())
            by_seed = mean_by_key((score.seed, score.rmse[start]) for score in self.scores)
            summary[start] = {
                "mean": mean,
                "standard_error": error,
                "by_seed": {str(seed): by_seed[seed] for seed in sorted(by_seed)},
            }
        return summary

    def as_plain(self) -> dict[str, Any]:
        """The result as plain values."""
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
class CrossValidationOptions:
    """Recipe, folds and starts of a cross-validation.

    Attributes:
        recipe: the recipe that is fitted.
        physics: the recipe that identifies the physics that a hybrid corrects, anew in every fold,
            or None.
        system: the system that is identified, or None.
        folds: how many; by default 5, or as many as there are records.
        seeds: those of every fold.
        starts: where free runs start; by default the usual start.
    """

    recipe: Recipe
    physics: Recipe | None = None
    system: LagrangianSystem | SystemTemplate | None = None
    folds: int | None = None
    seeds: tuple[int, ...] = (0,)
    starts: tuple[str, ...] = ()


def make_cross_validation_options(
    recipe: AnyRecipe,
    *,
    system: AnySystem | None = None,
    physics: AnyRecipe | None = None,
    folds: int | None = None,
    seeds: Sequence[int] | None = None,
    starts: Sequence[str] = (),
) -> CrossValidationOptions:
    """Options of `cross_validate`, checked.

    Args:
        recipe: the recipe that is fitted.
        system: the system that is identified, or whose identified model a network corrects.
        physics: the recipe that identifies the physics that a network corrects; `best-grey` by
            default.
        folds: how many; by default 5, or as many as there are records.
        seeds: those of every fold; 0 by default.
        starts: where free runs start; by default the usual start.

    Raises:
        InputError: an argument that is not applicable to the recipe, or one that it requires is
            missing.
    """
    recipe = read_recipe(recipe)
    family = recipe.family
    corrects = "physics" in family.needs
    if physics is not None and not corrects:
        raise InputError(
            "`physics=`",
            f"not applicable to a recipe of kind '{family.kind}'",
            "a recipe that corrects physics",
        )
    if seeds is not None and not family.has_seeds:
        raise InputError(
            "`seeds=`", "a fit that is no training has no seeds", "a recipe that trains"
        )
    if seeds is not None and (not seeds or len(set(seeds)) < len(seeds)):
        raise InputError("`seeds=`", f"{list(seeds)}", "at least one, all different")
    if folds is not None and folds < 3:
        raise InputError("`folds=`", f"{folds}", "3 or more", "one is scored, one chooses")
    identification = read_recipe(physics or DEFAULT_PHYSICS) if corrects else recipe
    if corrects and not identification.family.correctable:
        raise InputError(
            "`physics=`",
            f"a recipe of kind '{identification.family.kind}', whose models are trained",
            "a recipe whose models a network can correct",
        )
    needs_system = "system" in identification.family.needs
    if system is None:
        system = resolve_system(identification, None)
    if (system is None) == needs_system:
        given = "no system" if needs_system else "a system, not applicable to this recipe"
        raise InputError("`system=`", given, "a system for recipes that identify one")
    return CrossValidationOptions(
        recipe=recipe,
        physics=identification if corrects else None,
        system=None if system is None else load_system_or_template(system),
        folds=folds,
        seeds=tuple(seeds or (0,)),
        starts=tuple(start_named(start).name for start in starts),
    )


def cross_validate(
    data: DataSet,
    options: CrossValidationOptions,
    listener: Listener = SILENT,
    *,
    folder: Path | None = None,
    executor: Executor | None = None,
    system: AnySystem | None = None,
) -> CrossValidationResult:
    """Fits a recipe to every choice of folds and scores the records that were left out.

    In this process, members of all folds train together where their models and windows are alike.
    An executor does a job for every fold; jobs that are done below the folder already, of the same
    fit, are not done again.

    Args:
        data: the records; the folds do not respect splits, but `test` stays out.
        options: the recipe, the number of folds and seeds.
        listener: functions that are called while fits of this process go on; gets sentences on the
            holds and delays of inputs, which are searched for once where the data card does not
            declare them.
        folder: where an executor's jobs write models and logs, below `candidates`.
        executor: where the jobs are done, as for `select_model`; by default in this process, and
            nothing is written.
        system: the system of the options as it was named, for workers to load.

    Returns:
        The score of every record for every seed; `summary` has means and standard errors.

    Raises:
        InputError: too few records, a horizon of the recipe that is too short for a start, or too
            long; see also `fit`.
    """
    require_float64("cross_validate")
    data = prepare_for_validation(data, options, listener)
    records = records_without_test(data)
    folds = len(split_into_folds(data, options.folds))
    starts = options.starts or (default_start(records),)
    for start in starts:
        horizon_samples(options.recipe.longest_run, records, start_named(start))
    context = RunContext(
        data,
        RecipeScorer(folds, starts[0], names=options.starts),
        folder or Path(),
        models={} if executor is None else None,
        # in this process the system is loaded already; a worker loads its file
        system=options.system if executor is None else system or options.system,
    )
    workplace = Workplace(executor, lambda job: listener, listener.on_message, raises=True)
    seeds = options.recipe.family.select_seeds(options.seeds)
    jobs = [Job(RECIPE, options.recipe, fold, seeds) for fold in range(folds)]
    results = fit_splits(options, jobs, context, workplace)
    fits = sorted((r for r in results if r.candidate == RECIPE), key=lambda r: r.fold)
    return CrossValidationResult(
        recipe=options.recipe.name,
        unit=data.channels.unit,
        scores=tuple(
            FoldScore(e.name, r.fold, s.seed, {start: s.rmse[start][e.name] for start in s.rmse})
            for r in fits
            for s in r.scores
            for e in context.splits[r.fold].scored
        ),
        outcomes={f"fold {r.fold}, seed {s.seed}": s.outcome for r in fits for s in r.scores},
        seconds=sum(r.seconds for r in results),
    )


def prepare_for_validation(
    data: DataSet, options: CrossValidationOptions, listener: Listener
) -> DataSet:
    """Records as all fits of a validation take them.

    Those inputs included whose timing the data card calls `unknown`: it is found once.

    Args:
        data: the records.
        options: the recipe, the system.
        listener: gets sentences on the holds and delays of inputs.
    """
    require_feedback(options.physics or options.recipe, data)
    preparation = PreparationOptions(
        system=options.system, finds_timing=not is_published(options.recipe), listener=listener
    )
    prepared = prepare_records(data, preparation)
    for finding in prepared.findings:
        listener.on_message(finding.text)
    return prepared.data


def fit_splits(
    options: CrossValidationOptions,
    jobs: Sequence[Job],
    context: RunContext,
    workplace: Workplace,
) -> list[JobResult]:
    """Fits a recipe to splits of records, the physics that it corrects before.

    Args:
        options: the recipes.
        jobs: the recipe's, one for each split.
        context: the splits, and how the records are scored that they leave out.
        workplace: where jobs are done; where it raises no errors, they are results.

    Returns:
        The results of all jobs, in the order in which they ended. Where the physics of a split
        could not be identified, there is none of its recipe.
    """
    results: list[JobResult] = []

    def on_result(result: JobResult) -> None:
        if result.ended != "done" and workplace.raises:
            raise InputError(f"fold {result.fold}", result.why)
        results.append(result)

    def run(jobs: Sequence[Job]) -> None:
        """Runs jobs of one recipe; in this process those of a training together."""
        together = workplace.executor is None and jobs and jobs[0].recipe.family.has_seeds
        waiting = [jobs] if together else [[job] for job in jobs]
        run_jobs(lambda: waiting.pop(0) if waiting else (), on_result, lambda: context, workplace)

    if options.physics is not None:
        run([Job(PHYSICS, options.physics, job.fold) for job in jobs])
        physics = {r.fold: r.scores[0].model for r in results if r.ended == "done"}
        jobs = [replace(job, physics=physics[job.fold]) for job in jobs if job.fold in physics]
    run(jobs)
    return results


def remove_results(folder: Path, files: Sequence[str], *, jobs: bool) -> None:
    """Removes the results of an earlier validation by name, and perhaps the scores of its jobs.

    An interruption then leaves no results of another validation.
    """
    for name in files:
        (folder / name).unlink(missing_ok=True)
    for name in (PHYSICS, RECIPE) if jobs else ():
        for path in (folder / CANDIDATES / name).glob(f"*/{SCORES}"):
            path.unlink()
