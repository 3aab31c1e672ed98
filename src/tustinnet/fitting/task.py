"""What is to be fitted: records, a recipe, members that may be fitted together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.fitting.recipe import Recipe, rates_of
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.roles import Roles, roles
from tustinnet.models.contract import Model, require_fit
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.systems.files import AnySystem, SystemTemplate, load_system_or_template

DEFAULT_RECIPE = "standard"
_DEFAULT_FOR = {"system": "grey", "physics": "best-hybrid"}  # where one of them is given

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
        """What it is called in files and messages."""
        fold = f"fold-{self.fold}-" if self.fold else ""
        return f"{fold}seed-{self.seed}" + ("" if self.rate == 1.0 else f"-rate-{self.rate:g}")


@dataclass(frozen=True)
class Origin:
    """A fitted model that a fit begins with.

    Attributes:
        model: the model.
        account: what the files of the fit say of it.
    """

    model: Model
    account: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Fold:
    """The records of a fit, the physics that it corrects, and the model that it begins with.

    Attributes:
        roles: which records train, which choose.
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

    def of(self, members: Sequence[Member]) -> "Task":
        """The same for some of the members."""
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
    """What is to be fitted, checked.

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
        InputError: something is given that the recipe has no use for, or something is missing.
    """
    given = {"system": system, "physics": physics}
    usual = usual_recipe(system=system is not None, physics=physics is not None)
    chosen = read_recipe(usual if recipe is None else recipe)
    family = chosen.family
    if origin is not None:
        family.require_own(origin.model.dynamics)
        given["physics"] = physics = physics or family.corrected(origin.model.dynamics)
    if system is None:
        given["system"] = system = system_for(chosen, None)
    for what, thing in given.items():
        kind = f"a recipe of kind '{family.kind}'"
        if thing is None and what in family.needs:
            raise InputError(f"recipe '{chosen.name}'", f"no {what}", f"a {what}: --{what} ...",
                             f"{kind} needs it")  # fmt: skip
        if thing is not None and what not in family.needs:
            raise InputError(f"--{what}", f"means nothing to {kind}",
                             f"a recipe that takes a {what}",
                             f"leave it out, or add --recipe {_DEFAULT_FOR[what]}")  # fmt: skip
    if physics is not None and not family_of(physics).correctable:
        raise InputError(
            "--physics", f"a model of kind '{family_of(physics).kind}', which is trained already",
            "a model that a network can correct", "identify one with --system first",
        )  # fmt: skip
    _require_members(members, chosen)
    found = None if system is None else load_system_or_template(system)
    if origin is not None:
        for e in data:
            require_fit(origin.model, e)
        if not family.trains:
            known = found.for_records(list(data)) if isinstance(found, SystemTemplate) else found
            table = family.beginning(chosen.model, origin.model, known)
            chosen = chosen.model_copy(update={"model": table})
    return Task(chosen, (Fold(roles(data), physics, origin),), tuple(members), found)


def system_for(recipe: Recipe, given: AnySystem | None) -> LagrangianSystem | SystemTemplate | None:
    """The system whose parameters a recipe identifies: what is given, or else what it names.

    None for recipes that identify none, and where nobody says which.
    """
    if "system" not in recipe.family.needs:
        return None
    which = getattr(recipe.model, "system", None) if given is None else given
    return None if which is None else load_system_or_template(which)


def usual_recipe(*, system: bool, physics: bool) -> str:
    """The recipe where nobody names one, by what is given."""
    if physics:
        return _DEFAULT_FOR["physics"]
    return _DEFAULT_FOR["system"] if system else DEFAULT_RECIPE


def _require_members(members: Sequence[Member], recipe: Recipe) -> None:
    if not recipe.family.trains and list(members) != [Member()]:
        raise InputError(
            "seeds", "an identification has no seeds", "a recipe of a kind with weights"
        )  # fmt: skip
    rates = [m.rate for m in members]
    if not members or not all(r > 0 for r in rates) or len(set(members)) < len(members):
        raise InputError(
            "fit", f"seeds {[m.seed for m in members]}, rates {rates}",
            "different seeds and different factors above 0",
        )  # fmt: skip
    asked = rates_of(recipe)
    if asked != (1.0,) and set(rates) != set(asked):
        raise InputError(
            f"recipe '{recipe.name}'", f"rates {list(asked)}, of which {rates} would be trained",
            "no `rates`", "they are for the command fit and for fit_many",
        )  # fmt: skip
