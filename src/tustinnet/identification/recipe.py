"""Recipes of identifications, as data."""

from pathlib import Path

from pydantic import Field

from tustinnet.data.declaration import Declaration, packaged_names, read_packaged
from tustinnet.identification.search import Loss, Method, Part, Settings, Times

_HOME = "tustinnet.identification"


class IdentificationRecipe(Declaration):
    """How a system's parameters are identified: `Settings` by name.

    Attributes:
        name: what it is called.
        description: a sentence for people.

    The others are those of `Settings`.
    """

    name: str
    description: str = ""
    initial: str = "choose"
    loss: Loss = "positions"
    periodic: bool = False
    times: Times = "recorded"
    part: Part = "whole"
    method: Method = "levenberg-marquardt"
    tolerance: float = Field(default=1e-5, gt=0)
    most: int = Field(default=50, gt=0)
    substeps: int | None = Field(default=None, gt=0)

    @property
    def settings(self) -> Settings:
        """The settings."""
        return Settings(**self.model_dump(exclude={"name", "description"}))


def identification_recipes() -> list[str]:
    """Names of the identification recipes that come with the package."""
    return packaged_names(_HOME)


def read_identification_recipe(name: str | Path) -> IdentificationRecipe:
    """A packaged identification recipe by name, or one from a TOML file.

    Raises:
        InputError: no such recipe; an unknown key or a wrong value in the file.
    """
    return read_packaged(name, _HOME, IdentificationRecipe)
