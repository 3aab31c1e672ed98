"""Fits: a model from records and a recipe, by training or by identification."""

from collections.abc import Callable, Sequence

from tustinnet.data.dataset import DataSet
from tustinnet.fitting.gradient.loop import ResumePoint, ShouldStop, never_stop
from tustinnet.fitting.gradient.plan import TrainingPlan, groups_alike, make_plan
from tustinnet.fitting.gradient.train import train_plan
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import TrainingRecipe
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.shooting.identify import identify_task
from tustinnet.fitting.shooting.levenberg_marquardt import ShouldStopSearch, never_stop_search
from tustinnet.fitting.task import AnyRecipe, Member, Task, make_task
from tustinnet.models.contract import Model, warn_of_single_precision
from tustinnet.simulate.programs import make_room
from tustinnet.systems.files import AnySystem

MakeListener = Callable[[TrainingPlan | Task], Listener]
MakeStopCheck = Callable[[TrainingPlan], ShouldStop]


def fit(
    data: DataSet,
    recipe: AnyRecipe | None = None,
    seed: int = 0,
    *,
    physics: Model | None = None,
    system: AnySystem | None = None,
    listener: Listener = SILENT,
) -> FitResult:
    """Fits a model to a data set, as a recipe says.

    Args:
        data: records with the splits `train` and, if free runs are to choose, `validation`.
        recipe: a packaged recipe's name, a TOML file, its content as a mapping, or a `Recipe`; by
            default `standard`, with a `system` `grey`, with `physics` `best-hybrid`.
        seed: initial weights, windows and shuffling follow from it; an identification has none.
        physics: a model to correct, as an identification gives it; it stays as it is.
        system: the system whose parameters are identified, its name or its file.
        listener: functions that are called while the fit goes on, see `Listener`.

    Returns:
        The model and how it came about. A training that diverged returns the best weights it
        had and says so in `outcome`.

    Raises:
        InputError: records too short for a window, no training split, a recipe that does not fit
            or to which an argument is not applicable; see also `identify`.
    """
    warn_of_single_precision("fit")
    task = make_task(data, recipe, [Member(seed)], physics=physics, system=system)
    return fit_task(task, lambda _: listener)[0]


def fit_many(
    data: DataSet,
    recipe: AnyRecipe | None = None,
    seeds: Sequence[int] = (0,),
    rates: Sequence[float] = (1.0,),
    *,
    physics: Model | None = None,
    listener: Listener = SILENT,
) -> list[FitResult]:
    """Trains a recipe from several seeds, at several rates, as one batched program.

    Each training has its own learning rate and its own best weights. One that diverges does not
    disturb the others.

    Args:
        data: as for `fit`.
        recipe: as for `fit`.
        seeds: one training each.
        rates: factors of the recipe's rates; every seed is trained with each.
        physics: as for `fit`.
        listener: as for `fit`.

    Returns:
        One result, as `fit` returns it, for each seed and rate: all rates of the first seed, then
        those of the next.

    Raises:
        InputError: no seed, a rate that is not positive; see `fit`.
    """
    warn_of_single_precision("fit_many")
    members = [Member(seed, rate) for seed in seeds for rate in rates]
    return fit_task(make_task(data, recipe, members, physics=physics), lambda _: listener)


def fit_task(
    task: Task,
    make_listener: MakeListener = lambda _: SILENT,
    resume: Sequence[tuple[Sequence[Member], ResumePoint]] = (),
    make_stop_check: MakeStopCheck = lambda _: never_stop,
    should_stop_search: ShouldStopSearch = never_stop_search,
) -> list[FitResult]:
    """Fits all members of a task; those that are alike train together.

    Args:
        task: what is to be fitted.
        make_listener: returns the listener of fits that run together; called before they begin
            with the plan of a training, whose records are then known to fit the recipe, or with
            the task of an identification.
        resume: members whose training goes on together, and from where; the others begin anew.
        make_stop_check: given the plan of trainings that run together, returns the `should_stop`
            of `train_plan`.
        should_stop_search: the `should_stop` of `identify_task`.

    Returns:
        One result for each member, in their order.

    Raises:
        InputError: see `fit`; also where an identification was stopped before it had a model.
    """
    make_room()
    if not isinstance(task.recipe, TrainingRecipe):
        listener = make_listener(task)
        return [
            identify_task(task, member, listener, should_stop_search) for member in task.members
        ]
    resumed = {member for members, _ in resume for member in members}
    fresh = [member for member in task.members if member not in resumed]
    groups: list[tuple[Sequence[Member], ResumePoint | None]] = [
        (group, None) for group in groups_alike(task.with_members(fresh))
    ]
    results: dict[Member, FitResult] = {}
    for members, state in [*groups, *resume]:
        plan = make_plan(task.with_members(members))
        trained = train_plan(plan, make_listener(plan), state, make_stop_check(plan))
        results.update(zip(members, trained, strict=True))
    return [results[member] for member in task.members]
