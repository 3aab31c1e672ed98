"""Fits in memory: a model from records and a recipe, by training or by identification."""

from collections.abc import Mapping, Sequence

from tustinnet.data.dataset import DataSet
from tustinnet.data.declaration import declare
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import IdentificationRecipe
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.report import FitResult, Identification
from tustinnet.fitting.task import AnyRecipe, Member
from tustinnet.models.contract import Model, warn_of_single_precision
from tustinnet.systems.files import AnySystem

DEFAULT_IDENTIFICATION = "grey"


def fit_many(
    data: DataSet,
    recipe: AnyRecipe | None = None,
    seeds: Sequence[int] = (0,),
    rates: Sequence[float] = (1.0,),
    *,
    physics: Model | None = None,
    system: AnySystem | None = None,
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
        system: as for `fit`; an identification has neither seeds nor rates.
        listener: as for `fit`.

    Returns:
        One result, as `fit` returns it, for each seed and rate: all rates of the first seed, then
        those of the next.

    Raises:
        InputError: no seed, a rate that is not positive; see `fit`.
    """
    warn_of_single_precision("fit_many")
    members = tuple(Member(seed, rate) for seed in seeds for rate in rates)
    request = FitRequest(data, recipe, members, physics=physics, system=system)
    return fit_request(request, listener)


def identify(
    data: DataSet,
    system: AnySystem,
    recipe: AnyRecipe = DEFAULT_IDENTIFICATION,
    *,
    begin: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    listener: Listener = SILENT,
) -> Identification:
    """Identifies a system's parameters by the simulation error over all training records at once.

    Holds and delays of inputs that the records do not declare are searched for first. First values
    come from the equations of motion on the measured motion; then the simulation error over
    segments of one swing, of four swings and over whole records is minimised. Records along which
    errors grow without end, as about an unstable equilibrium that a controller holds, stay in
    segments; `findings` says which.

    Args:
        data: records; those of the split `train` are used, or all where there are no splits.
        system: the system, its name or its file, see `LagrangianSystem`.
        recipe: a recipe of a kind that is identified; `grey` by default.
        begin: values where the search starts, by name, besides those of the recipe; the nominal
            values for all others.
        fixed: parameters to fix at a value, besides those that the recipe and the system fix.
        listener: functions that are called while the search goes on. A search that its
            `should_stop` ends returns the model of its last finished stage, and says so in
            `outcome`.

    Returns:
        The model, its parameters with errors and correlations, and findings.

    Raises:
        InputError: records of another system, a value outside its range, a mass matrix that is
            not positive definite, float64 is off; it was stopped before a stage was finished
            (`UnfinishedSearchError`).
    """
    recipe = read_recipe(recipe)
    if isinstance(recipe, IdentificationRecipe):
        table = recipe.model
        tables = {
            "begin": {**table.begin, **(begin or {})},
            "fixed": {**table.fixed, **(fixed or {})},
        }
        model = declare({**table.model_dump(), **tables}, type(table), "identify")
        recipe = recipe.model_copy(update={"model": model})
    request = FitRequest(data, recipe, system=system)
    (result,) = fit_request(request, listener)
    assert result.identification is not None
    return result.identification


def fit_request(request: FitRequest, listener: Listener) -> list[FitResult]:
    """Prepares the records of a request and fits its members.

    Args:
        request: all that the fits are of.
        listener: functions that are called while they go on.
    """
    prepared = prepare(request, listener)
    return prepared.complete(fit_task(prepared.task, listener))
