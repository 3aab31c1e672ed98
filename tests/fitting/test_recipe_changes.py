"""Changes of recipes, `KEY=VALUE`, and what is refused by the kind of model."""

from copy import deepcopy
from typing import Any

import pytest

import tustinnet as tn
from tustinnet.fitting.recipe import IdentificationRecipe, TrainingRecipe

SMALL: dict[str, Any] = {
    "name": "small",
    "model": {"hidden": [8, 6]},
    "stages": [
        {
            "name": name,
            "windows": {"draw": "strided", "length": 10, "step": 8},
            "rate": 1e-3,
            "epochs": 5,
            "batch": 16,
        }
        for name in ("first", "second")
    ],
}


def training(*changes: str, which: Any = SMALL) -> TrainingRecipe:
    recipe = tn.read_recipe(which, changes)
    assert isinstance(recipe, TrainingRecipe)
    return recipe


def test_keys_reach_into_tables_and_lists():
    recipe = training(
        "model.activation=tanh",
        "stages.1.windows.length=20",
        "stages.0.epochs = 7",
        "model.hidden=[4]",
        "name=other",
    )
    assert recipe.name == "other"
    assert recipe.model.model_dump()["hidden"] == (4,)
    assert recipe.model.model_dump()["activation"] == "tanh"
    assert [s.windows.length for s in recipe.stages] == [10, 20]
    assert [s.epochs for s in recipe.stages] == [7, 5]
    assert training("model.hidden.1=3").model.model_dump()["hidden"] == (8, 3)


def test_dots_within_quotes_are_of_a_name():
    recipe = tn.read_recipe("grey", ['model.fixed."hand.mass[1.5kg]"=2.3'])
    assert isinstance(recipe, IdentificationRecipe)
    assert recipe.model.fixed == {"hand.mass[1.5kg]": 2.3}


def test_a_star_changes_all_stages():
    recipe = training("stages.*.epochs=3", "stages.*.windows.step=4")
    assert [(s.epochs, s.windows.step) for s in recipe.stages] == [(3, 4), (3, 4)]
    assert training("model.hidden.*=5").model.model_dump()["hidden"] == (5, 5)


def test_a_change_makes_the_table_that_it_needs():
    recipe = training(
        "stages.0.plateau.factor=0.5", "stages.0.plateau.patience=2", "stages.0.rate=2e-3"
    )
    first, second = recipe.stages
    assert first.plateau is not None
    assert (first.plateau.factor, first.plateau.patience) == (0.5, 2)
    assert second.plateau is None
    assert first.rate == 2e-3


def test_a_key_that_is_changed_twice_is_refused():
    with pytest.raises(tn.InputError, match=r"'stages\.0\.rate' twice"):
        training("stages.0.rate=1", "stages.0.rate=2e-3")


@pytest.mark.parametrize("written", ["model-20", '"model-20"', "'model-20'", " model-20 "])
def test_text_needs_no_quotes(written):
    assert training(f"start={written}").start == "model-20"


def test_values_are_read_as_toml_has_them():
    recipe = training("stages.0.mirror=true", "stages.0.windows={draw='random',length=5,count=3}")
    assert recipe.stages[0].mirror is True
    assert recipe.stages[0].windows.count == 3


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("stages.2.epochs=3", r"no place '2' in a list of 2; expected a number from 0 to 1, or \*"),
        ("stages.last.epochs=3", "no place 'last'"),
        ("stages.-1.epochs=3", "no place '-1'"),
        ("model.hidden.2=3", "no place '2'"),
        ("stages.0.epochs", r"KEY=VALUE; for instance stages\.0\.epochs=20"),
        ("=3", "KEY=VALUE"),
        ("name.first=3", "'name' is no table"),
        ("stages.0.epochs=none", r"stages\.0\.epochs: .*integer"),
        ("stages.0.epoch=3", "did you mean 'epochs'"),
        ("stages.*.epochs=0", r"stages\.0\.epochs: .*greater than 0"),
        ("model.kind=tustin", "no kind of model 'tustin'; expected one of tustin-net"),
        ("model.scaling=metres", "no scaling 'metres'; known: records, standard, published"),
        ("model=tustin-net", "expected a table with `kind"),
        ("start=somewhere", ", start: unknown start 'somewhere'"),
        ("stages.0.rate=inf", r"stages\.0\.rate: .*finite"),
        ("stages.0.clip=inf", r"stages\.0\.clip: .*finite"),
        ("stages.0.clip=1e300", r"stages\.0\.clip: .*less than or equal"),
        ("stages.0.rate=1e25", r"stages\.0\.rate: .*less than or equal"),
        ("stages.0.epochs=1000000000000", r"stages\.0\.epochs: .*less than or equal"),
        ("stages.0.epochs=99999999999999999999", "an integer of more than 64 bits"),
        ("stages.0.epochs=" + "9" * 5000, "`changes=`: '9999.*digits"),
        ("stages.0.batch=10000000000", r"stages\.0\.batch: .*less than or equal"),
        ("stages.0.windows.length=10000000000", r"windows\.length: .*less than or equal"),
        ("stages.0.windows.step=10000000000", r"windows\.step: .*less than or equal"),
        ("model.hidden=[100000]", r"model\.hidden\.0: .*less than or equal"),
        (f"model.hidden={[1] * 101}", r"model\.hidden: .*at most 100"),
        ("model.stem=100000", r"model\.stem: .*less than or equal"),
        ("model.memory=[inf]", r"model\.memory\.0: .*finite"),
        ("stages.0.frozen_layers=-1", r"frozen_layers: .*greater than or equal"),
        ("model.hidden=" + "[" * 3000, "`changes=`: .*nested deeper than 20"),
        ("model.hidden=" + "[" * 25 + "]" * 25, "nested deeper than 20"),
        (".".join("a" * 1000) + "=1", "nested deeper than 20"),
        ("stages.0.rate=1\nx=2", r"stages\.0\.rate: .*valid number"),
        ("name=a\x1b[31m", "name: .*holds the character"),
        ("stages.0.name=a/b", r"stages\.0\.name: the name 'a/b'"),
    ],
)
def test_a_change_that_cannot_be_made_is_refused_by_name(change, told):
    with pytest.raises(tn.InputError, match=told):
        tn.read_recipe(SMALL, [change])


@pytest.mark.parametrize(
    ("recipe", "change", "told"),
    [
        ("standard", "stages.0.penalty=0.1", r"stages\.0\.penalty: unknown key; train fewer"),
        ("gru", "stages.0.frozen_layers=1", r"stages\.0\.frozen_layers: unknown key"),
        ("standard", "search.robust=huber", "search: unknown key"),
        ("standard", "model.fades_at_rest=true", r"model\.fades_at_rest: unknown key"),
        ("grey", "stages.0.epochs=3", "stages: unknown key"),
        ("grey", "search.robst=huber", "did you mean 'robust'"),
        ("grey", "model.hidden=[3]", r"model\.hidden: unknown key"),
        ("grey", "search.initial=warm-up-20", "a start after the first sample"),
        ("gru", "model.hidden=1000000", r"model\.hidden: .*less than or equal"),
        ("gru", "model.warm_up=1000000000", r"model\.warm_up: .*less than or equal"),
        ("linear", "model.internal=1000000", r"model\.internal: .*less than or equal"),
        ("neural-ode", "model.substeps=1000000", r"model\.substeps: .*less than or equal"),
        ("neural-ode", "model.fades_at_rest=true", r"model\.fades_at_rest: unknown key"),
        ("best-hybrid", "stages.0.penalty=inf", r"stages\.0\.penalty: unknown key; train fewer"),
        ("best-hybrid", "model.correction.stem=100000", r"stem: .*less than or equal"),
        ("grey", "search.iterations=1000000000000", r"search\.iterations: .*less than or equal"),
        ("grey", "search.substeps=1000000000000", r"search\.substeps: .*less than or equal"),
        ("grey", "search.tolerance=inf", r"search\.tolerance: .*finite"),
        ("grey", "model.fixed.gain=nan", r"model\.fixed\.gain"),
        ("best-tustin", "model.odd=true", r"stage .*`mirror` does .* `odd`"),
        ("best-tustin", "model.remembered=0.5", "`remembered` is of internal states"),
        ("best-tustin", "model.remembered=1.5", "less than or equal to 1"),
        ("oscillator", "model.odd=true", "an odd network has no `output_bias`"),
        ("best-hybrid", "model.correction.odd=true", r"stage .*`mirror` does .* `odd`"),
        ("best-hybrid", "model.correction.hiden=[3]", "did you mean 'hidden'"),
        (
            "best-hybrid",
            "model.correction.kind=euler-lagrange",
            "a kind that computes accelerations",
        ),
        ("best-hybrid", "model.correction.kind=nothing", "nothing"),
    ],
)
def test_a_key_that_the_kind_does_not_know_is_refused_by_name(recipe, change, told):
    with pytest.raises(tn.InputError, match=told):
        tn.read_recipe(recipe, [change])


def test_keys_of_a_kind_are_read_by_that_kind():
    hybrid = training("model.correction.hidden=[4]", which="best-hybrid")
    assert hybrid.model.model_dump()["correction"]["hidden"] == (4,)
    grey = tn.read_recipe("grey", ["search.iterations=7", "model.fixed.gain=nominal"])
    assert isinstance(grey, IdentificationRecipe)
    assert grey.search.iterations == 7
    assert grey.model.model_dump()["fixed"] == {"gain": "nominal"}


def test_another_kind_can_be_chosen_by_a_change():
    assert training("model.kind=neural-ode").family.kind == "neural-ode"


def test_a_mapping_is_not_touched_by_changes_of_it():
    mine = deepcopy(SMALL)
    training("stages.*.epochs=3", "model.hidden=[3]", which=mine)
    assert mine == SMALL


def test_a_recipe_is_changed_like_the_file_it_came_from():
    for which in (SMALL, "best-tustin", "best-hybrid"):
        recipe = training(which=which)
        changes = ("stages.0.plateau.factor=0.5", "stages.0.plateau.patience=3", "name=mine")
        assert training(*changes, which=recipe) == training(*changes, which=which)
        assert tn.read_recipe(recipe) is recipe
    assert training("model.hidden.0=3", which=training()).model.model_dump()["hidden"] == (3, 6)
    changed = training("name=mine", which=training().with_stages(epochs=2))
    assert [s.epochs for s in changed.stages] == [2, 2]


def test_a_mapping_is_as_moderate_as_a_file():
    deep: dict[str, Any] = {}
    inside = deep
    for _ in range(5000):
        inside["a"] = inside = {}
    with pytest.raises(tn.InputError, match="nested deeper than 20"):
        tn.read_recipe({**SMALL, "model": deep})
    with pytest.raises(tn.InputError, match="more than 64 bits"):
        tn.read_recipe({**SMALL, "velocity": 10**5000})


def test_forces_behind_a_name_are_added_to_the_models_own():
    recipe = tn.read_recipe("mechanism + lag+coulomb:theta")
    assert recipe.name == "mechanism + lag + coulomb:theta"
    assert recipe.content["model"]["forces"] == ["coulomb", "lag", "coulomb:theta"]
    with pytest.raises(tn.InputError, match=r"'model.forces', and forces in 'mechanism \+ lag'"):
        tn.read_recipe("mechanism + lag", 'model.forces=["spring"]')
    with pytest.raises(tn.InputError, match=r"recipe 'network \+ lag', model.forces: unknown key"):
        tn.read_recipe("network + lag")


def test_a_single_change_needs_no_list():
    assert tn.read_recipe("grey", "search.iterations=7").search.iterations == 7  # pyright: ignore[reportAttributeAccessIssue]
