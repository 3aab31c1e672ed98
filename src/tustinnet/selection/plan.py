"""Plan files: the candidates that are worth trying, and how they are compared, as data."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from tustinnet.data.declaration import (
    Declaration,
    Name,
    Sentence,
    declare,
    list_packaged,
    read_packaged,
)
from tustinnet.errors import InputError
from tustinnet.fitting.recipe import Horizon, IdentificationRecipe, Recipe
from tustinnet.fitting.recipe_reading import read_recipe, split_forces
from tustinnet.simulate.starts import start_named

USUAL = "usual"  # the plan where nobody names one
_MOST_FOLDS, _MANY = 100, 100
_HOME, _PLAN = "tustinnet.selection", "plan"  # packaged plans are in its folder `plans`


class Candidate(Declaration):
    """A recipe that is worth trying.

    Attributes:
        name: what it is called in tables and folders; the recipe where none is given.
        recipe: a packaged recipe, or a TOML file, as `read_recipe` takes it.
        set: changes of the recipe, `KEY=VALUE` as the command takes them.
        corrects: candidates whose models are what a recipe that corrects physics corrects: in
            every fold the one of them that is best so far.
        begins_with: candidates at whose values an identification begins: in every fold at those of
            the one of them that is best so far; where there is none, at the system's.
        when: `always`, or only for records that are `fast` or `slow`: where a coordinate has few
            samples in a period of its dominant frequency, or none has; or only where `no-system` is
            given; or only for systems that are `fully-actuated`: whose inputs drive all
            coordinates, so that inverse dynamics tells all forces.
        last: whether it is rarely the best, so that it is tried after others that take as long.
    """

    name: Name
    recipe: str
    when: Literal["always", "fast", "slow", "no-system", "fully-actuated"] = "always"
    last: bool = False
    set: tuple[str, ...] = ()
    corrects: tuple[str, ...] = ()
    begins_with: tuple[str, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _name_by_recipe(cls, content: Any) -> Any:
        has_name = not isinstance(content, Mapping) or "name" in content
        return content if has_name else {"name": content.get("recipe"), **content}

    @cached_property
    def content(self) -> Recipe:
        """The recipe.

        Raises:
            InputError: no such recipe, or changes that it does not take.
        """
        return read_recipe(self.recipe, self.set)

    def recipe_over(self, horizon: float) -> Recipe:
        """The recipe, a search that begins with other candidates over a horizon [s].

        Unless it has a horizon of its own. What forces say of a machine that a controller held is
        lost in a search over whole records.
        """
        recipe = self.content
        if not (self.begins_with and isinstance(recipe, IdentificationRecipe)):
            return recipe
        search = recipe.search
        if search.horizon is None:
            search = search.model_copy(update={"horizon": horizon})
        return recipe.model_copy(update={"search": search})


class SelectionPlan(Declaration):
    """Candidates that are tried, and how they are compared.

    Attributes:
        name: what it is called.
        description: a sentence for people.
        folds: into how many folds the records are split; with fewer records as many as there are.
        scored: how many of the folds are scored, from the first on; all where it is not said.
        keep: share of the kinds of models that go on from the first fold to the others, the best
            first, two at least; each kind with one candidate, the simplest that is as good as its
            best.
        start: where the free runs start that judge; models that need a warm-up start with theirs.
        horizon: how long a free run that judges lasts at most [s]; none for whole records.
        candidates: from the simplest to the most complex, which is also by increasing cost.
    """

    name: Name
    description: Sentence = ""
    folds: int = Field(default=5, ge=3, le=_MOST_FOLDS)
    scored: int | None = Field(default=None, gt=0)
    keep: float = Field(default=0.5, gt=0, le=1)
    start: str = "model-20"
    horizon: Horizon | None = None
    candidates: tuple[Candidate, ...] = Field(min_length=1, max_length=_MANY)

    @field_validator("start")
    @classmethod
    def _require_start(cls, start: str) -> str:
        return start_named(start, "").name

    @model_validator(mode="after")
    def _check_names_and_folds(self) -> "SelectionPlan":
        if self.scored is not None and self.scored > self.folds:
            raise ValueError(f"{self.scored} of {self.folds} folds are scored")
        earlier = list[str]()
        for candidate in self.candidates:
            if candidate.name in earlier:
                raise ValueError(f"two candidates are called '{candidate.name}'")
            for verb in ("corrects", "begins_with"):
                for name in getattr(candidate, verb):
                    if name not in earlier:
                        who = f"'{candidate.name}' {verb.replace('_', ' ')}"
                        raise ValueError(f"{who} '{name}', which is no candidate before it")
            earlier.append(candidate.name)
        return self

    def candidate(self, name: str) -> Candidate:
        """The candidate of that name."""
        return next(c for c in self.candidates if c.name == name)


def packaged_plans() -> list[str]:
    """Names of the plans that come with the package."""
    return list(list_packaged([_HOME], _PLAN))


def read_plan(which: "str | Path | SelectionPlan") -> SelectionPlan:
    """A packaged plan by name, or a plan from a TOML file, its recipes read and checked.

    Args:
        which: the plan.

    Raises:
        InputError: no such plan; an unknown key, a wrong value, a recipe that is not known or
            cannot be a candidate; the message names the candidate.
    """
    if isinstance(which, SelectionPlan):
        plan = which
    else:
        content, where = read_packaged(which, [_HOME], _PLAN)
        plan = declare(content, SelectionPlan, where)
        if str(which) not in packaged_plans():  # its recipe files are beside it
            folder = Path(which).parent
            candidates = tuple(
                c.model_copy(update={"recipe": str(folder / c.recipe)})
                if split_forces(c.recipe)[0].endswith(".toml")
                else c
                for c in plan.candidates
            )
            plan = plan.model_copy(update={"candidates": candidates})
    for candidate in plan.candidates:
        _check(candidate, plan)
    return plan


def _check(candidate: Candidate, plan: SelectionPlan) -> None:
    where = f"plan '{plan.name}', candidate '{candidate.name}'"
    try:
        recipe = candidate.content
    except InputError as error:
        raise InputError(where, str(error)) from error
    takes = "physics" in recipe.family.needs
    if takes != bool(candidate.corrects):
        given = "no `corrects`" if takes else "`corrects`"
        raise InputError(
            where,
            f"{given} with a recipe of kind '{recipe.family.kind}'",
            "candidates to correct, for recipes that correct physics",
        )
    for name in candidate.corrects:
        family = plan.candidate(name).content.family
        if not family.correctable:
            raise InputError(
                where,
                f"corrects '{name}' of kind '{family.kind}'",
                "a candidate whose models a network can correct",
            )
    if candidate.begins_with and not isinstance(recipe, IdentificationRecipe):
        raise InputError(
            where,
            f"`begins_with` with a recipe of kind '{recipe.family.kind}'",
            "a recipe that identifies a system",
        )
    for name in candidate.begins_with:
        kind = plan.candidate(name).content.family.kind
        if kind != recipe.family.kind:
            raise InputError(
                where,
                f"begins with '{name}' of kind '{kind}'",
                f"a candidate of its own kind, '{recipe.family.kind}'",
            )
