"""Recipes of identifications: `grey`, `best-grey` and the keys of `[search]`."""

from pathlib import Path
from typing import Any

import pytest

import tustinnet as tn
from tustinnet.fitting.recipe import IdentificationRecipe, SearchRecipe
from tustinnet.fitting.recipe_reading import packaged_recipes


def search_of(which: str | Path | dict[str, Any], *changes: str) -> SearchRecipe:
    """The table `[search]` of a recipe."""
    recipe = tn.read_recipe(which, changes)
    assert isinstance(recipe, IdentificationRecipe)
    assert recipe.model.kind == "euler-lagrange"
    return recipe.search


def written(path: Path, table: str) -> Path:
    """A recipe of an identification with a table `[search]`."""
    path.write_text(f'name = "mine"\n[model]\nkind = "euler-lagrange"\n[search]\n{table}\n')
    return path


def test_the_packaged_recipes_are_there_and_valid():
    names = packaged_recipes()
    assert {"grey", "best-grey"} <= set(names)
    assert len(set(names)) == len(names)
    for name in ("grey", "best-grey"):
        assert tn.read_recipe(name).name == name
        search_of(name)


def test_a_recipe_gives_the_values_it_names(tmp_path):
    usual: dict[str, Any] = {
        "initial": "choose",
        "periodic": False,
        "scaled": True,
        "part": "whole",
        "method": "levenberg-marquardt",
        "cutoff": None,
        "candidates": (),
        "tolerance": 1e-5,
        "iterations": 200,
        "substeps": None,
        "horizon": None,
        "robust": "none",
        "refine": "none",
    }
    assert search_of("grey").model_dump() == usual
    best = SearchRecipe(initial="anchored", refine="model-20")
    assert search_of("best-grey") == best
    mine = written(tmp_path / "mine.toml", "iterations = 7\nperiodic = true")
    assert search_of(mine).model_dump() == usual | {"iterations": 7, "periodic": True}


def test_changes_are_those_of_the_recipe_and_of_nothing_else():
    content = {"name": "a", "model": {"kind": "euler-lagrange"}, "search": {"part": "transients"}}
    changes = ("search.part=whole", "search.substeps=3", "search.initial=derived-6")
    expected = SearchRecipe(substeps=3, initial="derived-6")
    assert search_of(content, *changes) == expected
    assert content["search"] == {"part": "transients"}
    recipe = tn.read_recipe("best-grey", changes)
    assert isinstance(recipe, IdentificationRecipe)
    assert recipe.search == expected.model_copy(update={"refine": "model-20"})
    assert tn.read_recipe(recipe) is recipe
    assert search_of("best-grey").initial == "anchored"


def test_a_recipe_says_what_is_fixed_and_where_the_search_begins():
    changes = ("model.fixed.gain=4", "model.fixed.inertia=nominal", "model.begin.damping=0.5")
    model = tn.read_recipe("grey", changes).model.model_dump()
    assert model["fixed"] == {"gain": 4.0, "inertia": "nominal"}
    assert model["begin"] == {"damping": 0.5}
    with pytest.raises(tn.InputError, match=r"model\.fixed\.gain"):
        tn.read_recipe("grey", ["model.fixed.gain=usual"])


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ('robst = "huber"', r"search\.robst: unknown key.*did you mean 'robust'"),
        ('loss = "state"', r"search\.loss: unknown key; a search compares positions"),
        ('robust = "median"', r"search\.robust: .*'huber' or 'student' \(got 'median'\)"),
        ('times = "nominal"', r"search\.times: unknown key; to ignore timestamps, give `dt`"),
        ('part = "other"', r"search\.part: .*'whole' or 'transients'"),
        ('method = "other"', r"search\.method: .*'levenberg-marquardt'"),
        ("iterations = 0", r"search\.iterations: .*greater than 0"),
        ("tolerance = 0", r"search\.tolerance: .*greater than 0"),
        ("substeps = 0", r"search\.substeps: .*greater than 0"),
        ('initial = "guessed"', "unknown start 'guessed'"),
        ('initial = "warm-up-20"', r"a start after the first sample; expected choose, anchored"),
        ('initial = "model-20"', r"fitted through the model; expected .*; `refine` fits the"),
        ('refine = "guessed"', "unknown start 'guessed'"),
        ('refine = "warm-up-20"', r"a start after the first sample; expected none, model-20, file"),
        ("refine = true", r"search\.refine: .*string"),
        ('[[stages]]\nname = "first"', "stages: unknown key"),
    ],
)
def test_a_wrong_recipe_is_refused_with_the_key(tmp_path, table, told):
    with pytest.raises(tn.InputError, match=told):
        tn.read_recipe(written(tmp_path / "wrong.toml", table))


def test_a_recipe_of_a_training_has_no_search(small_recipe):
    with pytest.raises(tn.InputError, match="search: unknown key"):
        tn.read_recipe(small_recipe, ["search.robust=huber"])


def test_an_unknown_recipe_is_refused_with_the_known_ones():
    with pytest.raises(tn.InputError, match=r"no recipe 'grye'; expected one of best-grey.* grey"):
        tn.read_recipe("grye")
