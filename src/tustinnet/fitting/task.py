"""Tasks: records, a recipe, and members that may be fitted together."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.fitting.recipe import IdentificationRecipe, Recipe, TrainingRecipe
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.roles import Roles, assign_roles
from tustinnet.models.contract import Model, require_fit
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.registry import FAMILIES
from tustinnet.systems.files import AnySystem, SystemTemplate
from tustinnet.systems.loading import load_system_or_template

DEFAULT_RECIPE = "standard"
_DEFAULT_RECIPES = {"system": "grey", "physics": "best-hybrid"}  # where one of them is given

AnyRecipe = Recipe | str | Path | Mapping[str, Any]


@dataclass(frozen=True)
class Member:
    """One of the fits that run together.

    Attributes:
        seed: initial weights, windows and shuffling follow from it.
        rate: multiplies the recipe's rates.
        fold: which of the task's folds it is fitted to.
    """

    seed: int = 0
    rate: float = 1.0
    fold: int = 0

    @property
    def name(self) -> str:
        """The name of the member in files and messages."""
        fold = f"fold-{self.fold}-" if self.fold else ""
        return f"{fold}seed-{self.seed}" + ("" if self.rate == 1.0 else f"-rate-{self.rate:g}")


@dataclass(frozen=True)
class Origin:
    """A fitted model that a fit begins with.

    Attributes:
        model: the model.
        provenance: its file and records, as the files of the fit name them.
        fits_records: whether it was fitted to the records of the fit that begins with it, which
            then needs no first estimate.
    """

    model: Model
    provenance: Mapping[str, Any] = field(default_factory=dict)
    fits_records: bool = False


@dataclass(frozen=True)
class Fold:
    """The records of a fit, the physics that it corrects, and the model that it begins with.

    Attributes:
        roles: the records that train, and those that choose.
        physics: the model that a network corrects, or None.
        origin: the model whose weights are trained on, or None to begin anew.
    """

    roles: Roles
    physics: Model | None = None
    origin: Origin | None = None


@dataclass(frozen=True)
class Task:
    """Fits of one recipe.

    Attributes:
        recipe: how a model is built and fitted.
        folds: records to fit to; one, but for cross-validation.
        members: what is fitted; of kinds that are identified, one a fold.
        system: the system whose parameters are identified, or None.
    """

    recipe: Recipe
    folds: tuple[Fold, ...]
    members: tuple[Member, ...] = (Member(),)
    system: LagrangianSystem | SystemTemplate | None = None

    @property
    def training_recipe(self) -> TrainingRecipe:
        """The recipe, of a training."""
        assert isinstance(self.recipe, TrainingRecipe)  # `fit_task` trains no other
        return self.recipe

    @property
    def identification_recipe(self) -> IdentificationRecipe:
        """The recipe, of an identification."""
        assert isinstance(self.recipe, IdentificationRecipe)  # `fit_task` identifies no other
        return self.recipe

    def with_members(self, members: Sequence[Member]) -> "Task":
        """Task with some of the members."""
        return replace(self, members=tuple(members))


def make_task(
    data: DataSet,
    recipe: AnyRecipe | None = None,
    members: Sequence[Member] = (Member(),),
    *,
    physics: Model | None = None,
    system: AnySystem | None = None,
    origin: Origin | None = None,
) -> Task:
    """Makes a task after checking that its parts fit together.

    Args:
        data: the records.
        recipe: a recipe, its name or file; by default `standard`, with a system `grey`, with
            physics `best-hybrid`.
        members: seeds and rates; an identification has neither.
        physics: a model whose accelerations a network corrects, for recipes that do so.
        system: a system whose parameters are identified, for recipes that do so.
        origin: a fitted model of the recipe's kind to begin with: weights go on from its own, a
            correction stays with its physics where none is given, an identification begins at
            its values.

    Raises:
        InputError: an argument that is not applicable to the recipe, or one that is missing.
    """
    if recipe is None:
        recipe = default_recipe_name(system=system is not None, physics=physics is not None)
    recipe = read_recipe(recipe)
    family = recipe.family
    if origin is not None:
        family.require_own(origin.model)
        if physics is None:
            physics = family.physics_in(origin.model)
    if system is None:
        system = resolve_system(recipe, None)
    for name, part in {"system": system, "physics": physics}.items():
        kind = f"a recipe of kind '{family.kind}'"
        if part is None and name in family.needs:
            raise InputError(
                f"recipe '{recipe.name}'",
                f"no {name}",
                f"a {name}: `{name}=`",
                f"{kind} needs it",
            )
        if part is not None and name not in family.needs:
            raise InputError(
                f"`{name}=`",
                f"not applicable to {kind}",
                f"a recipe that takes a {name}",
                f"leave it out, or add `recipe=` {_DEFAULT_RECIPES[name]}",
            )
    if physics is not None and not family_of(physics).correctable:
        raise InputError(
            "`physics=`",
            f"a model of kind '{family_of(physics).kind}', which is trained already",
            "a model that a network can correct",
            "identify one with `system=` first",
        )
    require_feedback(recipe, data)
    _require_members(members, recipe)
    loaded = None if system is None else load_system_or_template(system)
    roles = assign_roles(data)
    if origin is not None:
        for e in data:
            require_fit(origin.model, e)
        recipe = begin_with(recipe, origin.model, loaded, data)
        made_from = origin.provenance.get("made_from", {})
        is_of_these = all(e.sha256 in made_from for e in roles.train)
        origin = replace(origin, fits_records=origin.fits_records or is_of_these)
    return Task(recipe, (Fold(roles, physics, origin),), tuple(members), loaded)


def require_feedback(recipe: Recipe, data: DataSet) -> None:
    """Raises if the kind of a recipe has no use for the controller in the loop of records."""
    if data.channels.controller is not None and not recipe.family.has_feedback:
        kinds = [kind for kind in FAMILIES.names() if FAMILIES[kind].has_feedback]
        raise InputError(
            f"data set '{data.name}', [controller]",
            f"not applicable to models of kind '{recipe.family.kind}' (recipe '{recipe.name}')",
            f"a recipe of kind {' or '.join(kinds)}",
            "add `recipe=` grey and `system=` FILE, or take [controller] out of the card",
        )


def begin_with(
    recipe: Recipe,
    model: Model,
    system: LagrangianSystem | SystemTemplate | None,
    records: Iterable[Experiment],
) -> Recipe:
    """The recipe of a fit of records that begins with a fitted model of its kind.

    Raises:
        InputError: a model of another kind.
    """
    is_made = isinstance(system, SystemTemplate)
    return recipe.from_model(model, system.for_records(list(records)) if is_made else system)


def _require_members(members: Sequence[Member], recipe: Recipe) -> None:
    """Raises unless seeds and rates of members are possible for a recipe, and all different."""
    if not recipe.family.has_seeds and list(members) != [Member()]:
        raise InputError(
            "seeds", "a fit that is no training has no seeds", "a recipe whose models are trained"
        )
    rates = [m.rate for m in members]
    seeds, is_possible = [m.seed for m in members], all(m.rate > 0 <= m.seed for m in members)
    if not members or not is_possible or len(set(members)) < len(members):
        raise InputError(
            "fit",
            f"seeds {seeds}, rates {rates}",
            "different seeds from 0 on and different factors above 0",
        )


def resolve_system(
    recipe: Recipe, system: AnySystem | None
) -> LagrangianSystem | SystemTemplate | None:
    """The system whose parameters a recipe identifies: `system`, or else the one that it names.

    None for recipes that identify none, and where no system is named.
    """
    if not isinstance(recipe, IdentificationRecipe):
        return None
    named = recipe.model.system if system is None else system
    return None if named is None else load_system_or_template(named)


def default_recipe_name(*, system: bool, physics: bool) -> str:
    """The name of the default recipe, where a system or physics is given or not."""
    if physics:
        return _DEFAULT_RECIPES["physics"]
    return _DEFAULT_RECIPES["system"] if system else DEFAULT_RECIPE
