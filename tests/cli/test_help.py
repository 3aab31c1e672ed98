"""Help texts that list names list those that exist."""

import re
from typing import get_args

import pytest
import typer

from tustinnet.cli import completion, export
from tustinnet.cli.main import app
from tustinnet.cli.reproduce import Keep
from tustinnet.data.catalog import QUBE_SERVO2
from tustinnet.data.declaration import list_packaged
from tustinnet.fitting.recipe import Criterion
from tustinnet.fitting.recipe_reading import packaged_recipes
from tustinnet.fitting.task import default_recipe_name
from tustinnet.registry import SYSTEMS, TARGETS
from tustinnet.reproduce.entries import ALL_MODELS, DEFAULT_MODELS, ENTRIES
from tustinnet.selection.plan import USUAL
from tustinnet.simulate.start_names import START_NAMES
from tustinnet.simulate.start_rules import start_named

VERBS = typer.main.get_group(app).commands


def help_of(verb: str, option: str) -> str:
    """The help text of an option or argument."""
    (text,) = [getattr(p, "help", "") for p in VERBS[verb].params if option in (*p.opts, p.metavar)]
    return text


def with_option(option: str) -> list[str]:
    return [verb for verb, c in VERBS.items() if any(option in p.opts for p in c.params)]


@pytest.mark.parametrize(
    "verb", sorted(set(with_option("--system")) - {"evaluate", "report"})
)  # these take files or drawings of other models
def test_every_system_is_in_the_help(verb):
    listed = help_of(verb, "--system").split(": ")[1].split(", a Python")[0]
    assert tuple(listed.split(", ")) == tuple(SYSTEMS.places)


def test_every_target_is_in_the_help_of_export():
    listed = help_of("export", "--to").split(";")[0].replace(" or ", ", ")
    assert tuple(listed.split(", ")) == tuple(TARGETS.places)
    names = {
        "c": "C",
        "fmu": "FMU",
        "casadi": "CasADi",
        "onnx": "ONNX",
        "js": "JavaScript",
        "stablehlo": "StableHLO",
        "mat": "matrices",
        "urdf": "URDF",
        "mjcf": "MJCF",
    }
    assert names.keys() == TARGETS.places.keys()
    sentence = (export.export.__doc__ or "").rstrip(".").replace(" or ", ", ")
    assert sentence.removeprefix("Write a model as ").split(", ") == list(names.values())


@pytest.mark.parametrize("verb", with_option("--start"))
def test_every_start_is_completed_and_in_the_help(verb):
    assert [start_named(name).kind for name in completion.start("")] == [*START_NAMES]
    text = help_of(verb, "--start")
    if "as for evaluate" not in text:
        assert all(f"{name} (" in text for name in completion.start(""))


def test_the_recipes_and_plans_in_the_help_are_defaults():
    assert f"with --physics: {default_recipe_name(system=False, physics=True)}" in help_of(
        "fit", "--recipe"
    )
    text = help_of("cross-validate", "--recipe")
    assert f"Default: {default_recipe_name(system=False, physics=False)};" in text
    assert f"with --system: {default_recipe_name(system=True, physics=False)};" in text
    assert f"with --physics: {default_recipe_name(system=False, physics=True)}" in text
    assert f"Default: {USUAL}." in help_of("fit", "--plan")
    assert USUAL in list_packaged(["tustinnet.selection"], "plan")
    default = help_of("cross-validate", "--physics").split("Default: ")[1].rstrip(".")
    assert default in packaged_recipes()


def test_the_models_of_the_publication_are_in_the_help_of_reproduce():
    models, default = help_of("reproduce", "--models").split("; separated")
    assert tuple(models.split(", ")) == ALL_MODELS
    without = default.split("all but ")[1].rstrip(".").replace(" and ", ", ").split(", ")
    assert set(without) == set(ALL_MODELS) - set(DEFAULT_MODELS)
    for entry in ENTRIES.values():
        assert entry.recipe in packaged_recipes()
        assert entry.system is None or entry.system in SYSTEMS
        assert entry.corrects is None or entry.corrects in ENTRIES


def test_choices_are_those_of_the_package():
    assert {choice.value for choice in Keep} == set(get_args(Criterion))


@pytest.mark.parametrize(
    "verb", [v for v, c in VERBS.items() if any(p.metavar == "DATA" for p in c.params)]
)
def test_the_published_data_set_is_in_the_help(verb):
    assert QUBE_SERVO2.name in help_of(verb, "DATA")


@pytest.mark.parametrize(
    ("verb", "first"),
    [
        ("fit", "--out --recipe --system --set --budget --overwrite"),
        ("cross-validate", "--out --recipe --system --set --folds --records"),
        ("evaluate", "--split --start --horizon --band --residuals --figures"),
        ("control", "--out --at --swing-up --to --follow --limits"),
    ],
)
def test_the_help_of_many_options_begins_with_those_that_are_used_most(verb, first):
    command = VERBS[verb]
    text = command.get_help(typer.Context(command))
    head, more = text.split("More options:")
    assert re.findall(r"^  (--[a-z-]+)", head.split("Options:")[1], flags=re.M) == first.split()
    assert "--help" in more
    few = VERBS["inspect"]
    assert "More options" not in few.get_help(typer.Context(few))
