"""Models and systems that verbs read."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tustinnet.cli import terminal
from tustinnet.errors import InputError

if TYPE_CHECKING:
    from tustinnet.fitting.task import Origin
    from tustinnet.models.contract import Model
    from tustinnet.systems.files import AnySystem, SystemFile


def load_model(path: Path, system: str | None) -> "Model":
    """Loads a model with the system that was named, or that is stored with it."""
    from tustinnet.store import model_file
    from tustinnet.systems.files import find_system

    model_system = kept_system(path) if system is None else find_system(system)
    return model_file.load_model(path, model_system)


def kept_system(model: Path) -> "SystemFile | None":
    """The system file that is stored with a model; raises an error unless the user trusts it."""
    from tustinnet.store.kept_system import find_trusted_copy

    def ask(copy: "SystemFile") -> bool:
        if terminal.confirm(f"{copy.path} is Python code that was kept with this model; run it?"):
            return True
        raise InputError(
            copy.path,
            "Python code that was kept with the model, and not trusted on this machine",
            "your consent",
            f"if you would run it yourself, add --system {copy.path}",
        )

    return find_trusted_copy(model, ask)


def read_recipe_in(model: Path) -> "Mapping[str, Any]":
    """Reads the recipe that is stored in a model file; raises an error if it has none."""
    from tustinnet.store.header import read_header

    header = read_header(model)
    if not isinstance(recipe := header.get("recipe"), dict):
        raise InputError(
            f"--from {model}",
            f"a model of kind '{header['kind']}' that names no recipe",
            "a model that `fit` has made by a recipe",
            "of a model of one kind, name the recipe: --recipe NAME",
        )
    return recipe


def read_origin(
    model: Path, system: "AnySystem | None", changes: "Sequence[str] | None"
) -> "Origin":
    """Reads the model that `--from` names.

    Raises:
        InputError: `--set` changes the same initial values; see also `load_model`.
    """
    from tustinnet.store.model_file import load_origin

    for change in changes or ():
        if change.strip().startswith("model.begin"):
            raise InputError(
                f"--set {change}", "--from sets the same initial values", "one of them", "omit one"
            )
    return load_origin(model, kept_system(model) if system is None else system)


def find_system_to_fit(
    system: str | None, default_density: float | None
) -> "SystemFile | str | None":
    """The system of a fit, if one was named.

    Args:
        system: its name or file.
        default_density: density by which links of a URDF get inertias [kg/m^3]; None for none.

    Raises:
        InputError: no such system, or a density for what is no robot.
    """
    from tustinnet.systems.files import find_system

    file = None if system is None else find_system(system)
    if default_density is None:
        return file
    from tustinnet.systems.robot_shapes import with_inertias

    if file is None or isinstance(file, str):
        raise InputError(
            "--default-density",
            "not applicable without the file of a robot",
            "--system FILE.urdf",
            "omit it",
        )
    return with_inertias(file, default_density)


def require_readable_robot(system: str | None) -> None:
    """Raises unless the file of a robot can be read, if one was named; JAX is not loaded for it."""
    from tustinnet.systems.robot_reading import ROBOT_ENDINGS, read_robot, read_robot_text

    if system is not None and (path := Path(system)).suffix in ROBOT_ENDINGS:
        read_robot(read_robot_text(path), path)


def require_system_of_card(system: "SystemFile | str | None", data: str, card: Path | None) -> None:
    """Raises unless a system can be loaded and a card has its coordinates and inputs.

    Records are not read for it.

    Args:
        system: the system, None for none.
        data: the data set; a folder without a card is not compared.
        card: its card, if it was named.
    """
    from tustinnet.data.catalog import CARD_NAME, lacks_card, locate
    from tustinnet.models.lagrangian import LagrangianSystem
    from tustinnet.systems.loading import load_system_or_template

    loaded = None if system is None else load_system_or_template(system)
    if not isinstance(loaded, LagrangianSystem) or (card is None and lacks_card(data)):
        return
    folder, content = locate(data, card)
    channels = content.channels(content.dt or 1.0).plant
    place = card or (data if Path(data).suffix == ".toml" else folder / CARD_NAME)
    loaded.for_channels(channels.coordinates, channels.inputs, place)
