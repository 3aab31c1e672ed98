"""The reference pages have every public name, every key of cards and recipes, and every term."""

import re
import tomllib
from collections.abc import Iterator
from importlib import import_module
from inspect import unwrap
from pathlib import Path

import pytest
from documented import DOCS, anchor

import tustinnet as tn
from tustinnet.data import card
from tustinnet.data.declaration import Declaration
from tustinnet.families.family import TrainedFamily
from tustinnet.fitting import recipe, recipe_reading
from tustinnet.registry import FAMILIES

REFERENCE = DOCS / "reference"
CARDS = (
    card.Card,
    card.FormatCard,
    card.TimeCard,
    card.CoordinateCard,
    card.VelocityCard,
    card.InputCard,
    card.FileCard,
    card.ControllerCard,
    card.PDLoopCard,
    card.SetPointCard,
)
RECIPES = (
    recipe.TrainingRecipe,
    recipe.StageRecipe,
    recipe.WindowRecipe,
    recipe.PlateauRecipe,
    recipe.IdentificationRecipe,
    recipe.SearchRecipe,
)


def page(name: str) -> str:
    return (REFERENCE / name).read_text(encoding="utf-8")


def named() -> list[object]:
    """What the page on Python asks mkdocstrings for."""
    return [thing(path) for path in re.findall(r"^::: (\S+)$", page("python.md"), flags=re.M)]


def thing(path: str) -> object:
    """What a dotted path means on the page: modules come before what the package offers."""
    parts = path.split(".")
    for split in range(len(parts), 0, -1):
        try:
            found: object = import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        for part in parts[split:]:
            found = getattr(found, part)
        return found
    raise AssertionError(path)


@pytest.mark.parametrize("name", sorted({*dir(tn)} - {"__version__"}))
def test_every_public_name_is_on_the_page_once(name):
    public = unwrapped(getattr(tn, name))
    assert sum(unwrapped(found) is public for found in named()) == 1, name


def unwrapped(found: object) -> object:
    """A function as it is written: the package gives one that judges its arguments, too."""
    return unwrap(found) if callable(found) else found


def fields(*kinds: type[Declaration]) -> set[str]:
    return {name for kind in kinds for name in kind.model_fields}


def written(text: str) -> set[str]:
    """The keys that are named as code: `key`, or `[key]` and `[[key]]` of a table."""
    return set(re.findall(r"`\[{0,2}(\w+)\]{0,2}`", text))


def test_every_key_of_a_data_card_is_on_its_page():
    assert not fields(*CARDS) - written(page("data.md"))


def test_every_key_of_a_recipe_is_on_its_page():
    fitted = [f for f in map(FAMILIES.__getitem__, FAMILIES.names()) if not f.remedy]
    keys = fields(
        *RECIPES,
        *(f.hyper for f in fitted),
        *(f.stage for f in fitted if isinstance(f, TrainedFamily)),
    )
    assert not keys - written(page("training.md"))


@pytest.mark.parametrize("name", recipe_reading.packaged_recipes())
def test_every_packaged_recipe_is_on_the_page(name):
    assert f"`{name}`" in page("training.md")


@pytest.mark.parametrize("block", re.findall(r"```toml\n(.*?)```", page("training.md"), flags=re.S))
def test_the_recipes_on_the_page_are_valid(block):
    tn.read_recipe({"name": "of the page", **tomllib.loads(block)})


def terms() -> list[str]:
    return re.findall(r"^### (.*)$", page("glossary.md"), flags=re.M)


def links() -> Iterator[tuple[Path, str]]:
    """All links to a word of the glossary: from where, to which."""
    for file in sorted([*DOCS.rglob("*.md"), *DOCS.rglob("*.py")]):
        pattern = r"\]\(#([^)]+)\)" if file.name == "glossary.md" else r"glossary\.md#([^)\s]+)\)"
        for word in re.findall(pattern, file.read_text(encoding="utf-8")):
            yield file, word


def test_the_glossary_has_every_word_that_pages_link_to():
    known = {anchor(term) for term in terms()}
    assert not [f"{file.name}: {word}" for file, word in links() if word not in known]


def test_the_glossary_is_in_order_and_names_each_word_once():
    order = [re.sub(r"[-_]", " ", term).replace(",", "").lower() for term in terms()]
    assert order == sorted(set(order))
