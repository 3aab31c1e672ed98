"""Recipes of identifications as data."""

import pytest

import tustinnet as tn
from tustinnet.identification.recipe import identification_recipes, read_identification_recipe
from tustinnet.identification.search import Settings
from tustinnet.training.recipe import packaged_recipes


def test_the_packaged_recipes_are_there_and_valid():
    assert "best-grey" in identification_recipes()
    for name in identification_recipes():
        assert read_identification_recipe(name).name == name
        assert name not in packaged_recipes()


def test_a_recipe_gives_the_settings_it_names(tmp_path):
    assert read_identification_recipe("best-grey").settings == Settings(
        loss="state", initial="anchored"
    )
    mine = tmp_path / "mine.toml"
    mine.write_text('name = "mine"\nmost = 7\nperiodic = true\n')
    assert read_identification_recipe(mine).settings == Settings(most=7, periodic=True)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ('name = "a"\nlos = "state"\n', "did you mean 'loss'"),
        ('name = "a"\nloss = "speed"\n', "loss"),
        ('name = "a"\nmost = 0\n', "most"),
    ],
)
def test_a_wrong_recipe_is_refused_with_the_key(tmp_path, content, told):
    path = tmp_path / "wrong.toml"
    path.write_text(content)
    with pytest.raises(tn.InputError, match=told):
        read_identification_recipe(path)


def test_an_unknown_recipe_is_refused_with_the_known_ones():
    with pytest.raises(tn.InputError, match=r"no recipe .standard.; expected one of best-grey"):
        read_identification_recipe("standard")
