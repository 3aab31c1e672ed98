"""The verb: a model from records and a recipe, whatever the way of fitting."""

from collections.abc import Sequence

from tustinnet.data.dataset import DataSet
from tustinnet.fitting.gradient.plan import plan
from tustinnet.fitting.gradient.train import train_plan
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.shooting.identify import identify_task
from tustinnet.fitting.task import AnyRecipe, Member, Task, make_task
from tustinnet.models.contract import Model
from tustinnet.simulate.programs import make_room
from tustinnet.systems.files import AnySystem


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
        recipe: a packaged recipe's name, a TOML file, the same as a mapping, or a `Recipe`; by
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
            or has no use for what is given; see also `identify`.
    """
    task = make_task(data, recipe, [Member(seed)], physics=physics, system=system)
    return fit_task(task, listener)[0]


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
    members = [Member(seed, rate) for seed in seeds for rate in rates]
    return fit_task(make_task(data, recipe, members, physics=physics), listener)


def fit_task(task: Task, listener: Listener = SILENT) -> list[FitResult]:
    """Fits all members of a task, those that can together."""
    make_room()
    if task.recipe.family.trains:
        return train_plan(plan(task), listener)
    return [identify_task(task, member, listener) for member in task.members]
