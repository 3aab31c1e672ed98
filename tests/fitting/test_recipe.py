"""Recipes as data."""

import pickle

import pytest

import tustinnet as tn
from tustinnet.families.tustin_net import TustinNetHyper
from tustinnet.fitting.recipe import TrainingRecipe
from tustinnet.fitting.recipe_reading import packaged_recipes


def test_the_packaged_recipes_are_there_and_valid():
    names = packaged_recipes()
    assert set(names) >= {
        "paper-standard",
        "paper-transfer",
        "paper-code-standard",
        "paper-code-transfer",
        "standard",
        "network",
        "network-hybrid",
        "transfer",
        "best-tustin",
        "tustin-memory",
        "best-hybrid",
        "hybrid",
        "inverse-dynamics",
        "grey",
        "best-grey",
        "gru",
        "neural-ode",
        "linear",
        "oscillator",
    }
    for name in names:
        recipe = tn.read_recipe(name)
        assert recipe.name == name
        assert pickle.loads(pickle.dumps(recipe)) == recipe


def test_the_papers_transfer_recipe_says_what_the_paper_says():
    recipe = tn.read_recipe("paper-transfer")
    assert isinstance(recipe, TrainingRecipe)
    assert isinstance(recipe.model, TustinNetHyper)
    first, second = recipe.stages
    assert recipe.model.hidden == (100, 100)
    assert recipe.model.stem is None
    assert not recipe.model.output_bias
    assert (first.windows.count, first.windows.length, first.epochs) == (1408, 50, 300)
    assert (second.windows.count, second.windows.length) == (864, 75)
    assert second.model_dump()["frozen_layers"] == 2
    assert (first.windows.until, second.windows.until) == ("k_bar", "end")


@pytest.mark.real
def test_the_codes_standard_and_transfer_recipes_process_as_many_points(real_data):
    from tustinnet.fitting.gradient.plan import make_plan
    from tustinnet.fitting.task import make_task

    data = tn.load(real_data)
    points = {}
    for name in ("paper-code-standard", "paper-code-transfer"):
        stages = make_plan(make_task(data, name)).stages
        points[name] = sum(s.recipe.epochs * s.windows.rows.size * s.windows.length for s in stages)
    assert points["paper-code-standard"] == pytest.approx(17.3e6, rel=2e-3)
    assert points["paper-code-transfer"] == pytest.approx(17.3e6, rel=2e-3)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("epochs = 5", "epoch = 5"), "did you mean 'epochs'"),
        (("factor = 0.5", "facto = 0.5"), "did you mean 'factor'"),
        (("length = 10", "lenght = 10"), "did you mean 'length'"),
        (("hidden =", "hiden ="), "did you mean 'hidden'"),
        (("rate = 3e-3", "rate = -1"), "greater than 0"),
        (("frozen_layers = 1", "frozen_layers = 3"), "freezes 3 of 2 hidden layers"),
        (('name = "second"', 'name = "first"'), "two stages have the same name"),
        (("step = 8", "step = 8, count = 5"), "either `step` or `count`"),
        (("count = 40", "part = 0.5"), "take `count`"),
        (("[8, 6]", "[]"), "at least 1 item"),
        (("batch = 16", 'batch = 16\ndecay = "cosine"'), "`decay` .* leave out `plateau`"),
        (("frozen_layers = 1", 'patience = 3\ndecay = "cosine"'), "leave out `patience`"),
        (("frozen_layers = 1", 'patience = 3\nkeep = "last"'), "`patience` is not applicable"),
    ],
)
def test_a_wrong_recipe_is_refused_with_the_key(small_recipe, change, told):
    text = small_recipe.read_text()
    assert change[0] in text
    small_recipe.write_text(text.replace(*change, 1))
    with pytest.raises(tn.InputError, match=told):
        tn.read_recipe(small_recipe)


def test_an_unknown_recipe_is_refused_with_the_known_ones():
    with pytest.raises(tn.InputError, match="paper-code-transfer"):
        tn.read_recipe("paper-code")


@pytest.mark.parametrize(
    ("keep", "plateau", "asks"),
    [
        ("last", None, False),
        ("training", {"watch": "training"}, False),
        ("validation", None, True),
        ("last", {"watch": "validation-loss"}, True),
    ],
)
def test_a_training_asks_validation_records_where_a_stage_does(keep, plateau, asks):
    stage = {
        "windows": {"draw": "strided", "length": 5, "count": 9},
        "rate": 1e-3,
        "epochs": 2,
        "batch": 4,
    }
    rule = {} if plateau is None else {"plateau": {"factor": 0.5, "patience": 2, **plateau}}
    quiet, asked = {**stage, "name": "one", "keep": "last"}, {**stage, "name": "two", "keep": keep}
    recipe = tn.read_recipe({"name": "mine", "model": {}, "stages": [quiet, {**asked, **rule}]})
    assert recipe.needs_validation is asks
