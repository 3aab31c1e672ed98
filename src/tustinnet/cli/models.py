"""Models and systems that verbs read."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tustinnet as tn
from tustinnet.cli import terminal
from tustinnet.data import catalog
from tustinnet.errors import InputError
from tustinnet.fitting import task
from tustinnet.store import kept_system as kept_systems
from tustinnet.store import model_file
from tustinnet.systems import files as system_files
from tustinnet.systems import loading, robot_reading


def load_model(path: Path, system: str | None) -> "tn.Model":
    """Loads a model with the system that was named, or that is stored with it."""
    model_system = kept_system(path) if system is None else system_files.find_system(system)
    return model_file.load_model(path, model_system)


def kept_system(model: Path) -> "system_files.SystemFile | None":
    """The system file that is stored with a model; raises an error unless the user trusts it."""

    def ask(copy: "system_files.SystemFile") -> bool:
        if terminal.confirm(f"{copy.path} is Python code that was kept with this model; run it?"):
            return True
        raise InputError(
            copy.path,
            "Python code that was kept with the model, and not trusted on this machine",
            "your consent",
            f"if you would run it yourself, add --system {copy.path}",
        )

    return kept_systems.find_trusted_copy(model, ask)


def read_recipe_in(model: Path) -> Mapping[str, Any]:
    """Reads the recipe that is stored in a model file; raises an error if it has none."""
    header = tn.read_header(model)
    if not isinstance(recipe := header.get("recipe"), dict):
        raise InputError(
            f"--from {model}",
            f"a model of kind '{header['kind']}' that names no recipe",
            "a model that `fit` has made by a recipe",
            "of a model of one kind, name the recipe: --recipe NAME",
        )
    return recipe


def read_origin(
    model: Path, system: "system_files.AnySystem | None", changes: Sequence[str] | None
) -> "task.Origin":
    """Reads the model that `--from` names.

    Raises:
        InputError: `--set` changes the same initial values; see also `load_model`.
    """
    for change in changes or ():
        if change.strip().startswith("model.begin"):
            raise InputError(
                f"--set {change}", "--from sets the same initial values", "one of them", "omit one"
            )
    return model_file.load_origin(model, kept_system(model) if system is None else system)


def require_readable_robot(system: str | None) -> None:
    """Raises unless the file of a robot can be read, if one was named; JAX is not loaded for it."""
    if system is not None and (path := Path(system)).suffix in robot_reading.ROBOT_ENDINGS:
        robot_reading.read_robot(robot_reading.read_robot_text(path), path)


def require_system_of_card(
    system: "system_files.SystemFile | str | None", data: str, card: Path | None
) -> None:
    """Raises unless a system can be loaded and a card has its coordinates and inputs.

    Records are not read for it.

    Args:
        system: the system, None for none.
        data: the data set; a folder without a card is not compared.
        card: its card, if it was named.
    """
    loaded = None if system is None else loading.load_system_or_template(system)
    if not isinstance(loaded, tn.LagrangianSystem) or (card is None and catalog.lacks_card(data)):
        return
    folder, content = catalog.locate(data, card)
    channels = content.channels(content.dt or 1.0).plant
    place = card or (data if Path(data).suffix == ".toml" else folder / catalog.CARD_NAME)
    loaded.for_channels(channels.coordinates, channels.inputs, place)
