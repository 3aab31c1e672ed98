"""Plan files: what they may say, and how what they may not say is told."""

import re
from typing import Any

import pytest
from small_selection import plan_in

from tustinnet.errors import InputError
from tustinnet.fitting.recipe import IdentificationRecipe
from tustinnet.selection.plan import Candidate, packaged_plans, read_plan


def broken(folder, old: str, new: str):
    path = plan_in(folder)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize("name", packaged_plans())
def test_packaged_plans_are_whole(name):
    plan = read_plan(name)
    assert plan.name == name
    assert plan.description


def test_recipes_that_are_files_stand_beside_the_plan(tmp_path):
    plan = read_plan(plan_in(tmp_path))
    assert plan.candidate("hybrid").content.family.kind == "hybrid"
    assert plan.candidate("grey").content.name == "short-grey"


def test_a_candidate_may_change_its_recipe(tmp_path):
    path = broken(
        tmp_path, 'recipe = "small.toml"', 'recipe = "small.toml"\nset = ["model.hidden=[3]"]'
    )
    hyper: Any = read_plan(path).candidate("network").content.model
    assert hyper.hidden == (3,)


def test_a_search_that_begins_with_forces_is_over_pieces_but_for_its_own_horizon():
    def horizon(**keys) -> float | None:
        candidate = Candidate.model_validate({"name": "grey", "recipe": "best-grey", **keys})
        recipe = candidate.recipe_over(0.5)
        assert isinstance(recipe, IdentificationRecipe)
        return recipe.search.horizon

    assert horizon() is None
    assert horizon(begins_with=("forces",)) == 0.5
    assert horizon(begins_with=("forces",), set=("search.horizon=2.0",)) == 2.0


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"small.toml"', '"best-tustn"', "candidate 'network'.*no recipe 'best-tustn'"),
        ('recipe = "small.toml"', 'recipe = "small.toml"\nepoch = 3', "epoch: unknown key"),
        (
            'recipe = "small.toml"',
            'recipe = "small.toml"\nset = ["model.hiden=[3]"]',
            "'network'.*hiden",
        ),
        ('corrects = ["grey"]', "", "candidate 'hybrid'.*no `corrects`"),
        (
            'corrects = ["grey"]',
            'corrects = ["network"]',
            "corrects 'network' of kind 'tustin-net'",
        ),
        ('corrects = ["grey"]', 'corrects = ["gray"]', "'gray', which is no candidate before it"),
        (
            'recipe = "small.toml"',
            'recipe = "small.toml"\nbegins_with = ["grey"]',
            "candidate 'network'.*`begins_with` with a recipe of kind 'tustin-net'",
        ),
        (
            'recipe = "grey.toml"',
            'recipe = "grey.toml"\nbegins_with = ["gray"]',
            "'grey' begins with 'gray', which is no candidate before it",
        ),
        (
            'recipe = "hybrid.toml"\ncorrects = ["grey"]',
            'recipe = "grey.toml"\nbegins_with = ["network"]',
            "begins with 'network' of kind 'tustin-net'.*its own kind, 'euler-lagrange'",
        ),
        ('name = "network"', 'name = "grey"', "called 'grey'"),
        ("keep = 1.0", "scored = 4", "4 of 3 folds are scored"),
        ("keep = 1.0", "keep = 1.5", "keep: Input should be less than or equal to 1"),
        ('start = "model-10"', 'start = "model"', "start"),
        ("folds = 3", "folds = 2", "folds"),
        (
            'recipe = "small.toml"',
            'recipe = "small.toml"\nset = ["rates=[1.0, 2.0]"]',
            "rates: unknown key; train each by itself",
        ),
    ],
)
def test_a_plan_that_does_not_fit_is_refused_in_a_line(tmp_path, old, new, told):
    with pytest.raises(InputError) as found:
        read_plan(broken(tmp_path, old, new))
    assert re.search(told, str(found.value)), str(found.value)
    assert "\n" not in str(found.value)


def test_an_unknown_plan_is_told_with_those_that_there_are():
    with pytest.raises(InputError, match=r"no plan 'best'.*usual.*\.toml"):
        read_plan("best")
