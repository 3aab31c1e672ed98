"""Registries of what has a name: families of models, scalings, systems, targets, readers of files.

A new one is a line here. Other packages add theirs by entry points of the groups
`tustinnet.families`, `tustinnet.scalings`, `tustinnet.systems`, `tustinnet.targets` and
`tustinnet.readers`; a program adds one by `register`.
"""

import sys
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any

from tustinnet.errors import InputError, convert_errors


@cache
def _entry_points(group: str, path: tuple[str, ...]) -> EntryPoints:
    """The entry points of a group by installed packages; reading them all takes 30 ms.

    Args:
        group: the group.
        path: where packages are, `sys.path`.
    """
    return entry_points(group=group)


@dataclass(frozen=True)
class Registry:
    """Items by name, loaded when they are first used.

    Attributes:
        noun: what an item is, for messages.
        group: the group of entry points by which other packages add theirs.
        places: where each item is, `module:attribute`, or the item itself.
    """

    noun: str
    group: str
    places: dict[str, Any]

    def names(self) -> tuple[str, ...]:
        """All names, those of other packages included."""
        return (*self.places, *(e.name for e in _entry_points(self.group, tuple(sys.path))))

    def register(self, name: str, item: Any) -> None:
        """Adds an item, or replaces the one of the same name."""
        self.places[name] = item

    def __contains__(self, name: object) -> bool:
        return name in self.names()

    def place(self, name: str) -> Any:
        """The place of an item as `module:attribute`, the item itself, or None without it."""
        if name in self.places:
            return self.places[name]
        entries = _entry_points(self.group, tuple(sys.path))
        return next((entry.value for entry in entries if entry.name == name), None)

    def __getitem__(self, name: str) -> Any:
        place = self.place(name)
        if place is None:
            raise InputError(
                f"{self.noun} '{name}'", f"no such {self.noun}", f"one of {', '.join(self.names())}"
            )
        if not isinstance(place, str):
            return place
        with convert_errors(
            f"{self.noun} '{name}'",
            f"{place} cannot be loaded",
            "a package for this version of tustinnet",
            "update or uninstall the package",
        ):
            return load_place(place)


def load_place(place: str) -> Any:
    """The attribute of a module at `module:attribute`."""
    return EntryPoint("", place, "").load()


FAMILIES = Registry(
    "kind of model",
    "tustinnet.families",
    {
        "tustin-net": "tustinnet.families.tustin_net:FAMILY",
        "euler-lagrange": "tustinnet.families.euler_lagrange:FAMILY",
        "hybrid": "tustinnet.families.hybrid:FAMILY",
        "gru": "tustinnet.families.gru:FAMILY",
        "neural-ode": "tustinnet.families.neural_ode:FAMILY",
        "linear": "tustinnet.families.linear:FAMILY",
        "committee": "tustinnet.families.committee:FAMILY",
    },
)
DEFAULT_FAMILY = next(iter(FAMILIES.places))  # the kind of a recipe that names none
SCALINGS = Registry(
    "scaling",
    "tustinnet.scalings",
    {
        "records": "tustinnet.models.blocks:learn_scaling",
        "standard": "tustinnet.models.blocks:learn_standard_scaling",
        "published": "tustinnet.reproduce.published:published_scaling",
    },
)
SYSTEMS = Registry(
    "system",
    "tustinnet.systems",
    {
        "qube-servo2": "tustinnet.systems.qube_servo2:SYSTEM",
        "qube-servo2-naive": "tustinnet.systems.qube_servo2:NAIVE",
        "qube-servo2-memory": "tustinnet.systems.qube_servo2:WITH_MEMORY",
        "qube-servo2-rubbing": "tustinnet.systems.qube_servo2:WITH_CABLE_FRICTION",
        "qube-servo2-turned": "tustinnet.systems.qube_servo2:WITH_INITIAL_DEFLECTION",
        "mechanism": "tustinnet.systems.mechanism:MECHANISM",
        "cart-pole": "tustinnet.systems.library.cart_pole:SYSTEM",
        "2-link-chain": "tustinnet.systems.library.link_chain:TWO_LINKS",
        "3-link-chain": "tustinnet.systems.library.link_chain:THREE_LINKS",
        "two-mass-drive": "tustinnet.systems.library.two_mass_drive:SYSTEM",
        "crane": "tustinnet.systems.library.crane:SYSTEM",
        "ball-and-beam": "tustinnet.systems.library.ball_and_beam:SYSTEM",
        "reaction-wheel": "tustinnet.systems.library.reaction_wheel:SYSTEM",
        "propeller-pendulum": "tustinnet.systems.library.propeller_pendulum:SYSTEM",
        "positioning-axis": "tustinnet.systems.library.positioning_axis:SYSTEM",
        "duffing": "tustinnet.systems.library.duffing:SYSTEM",
    },
)
TARGETS = Registry(
    "target",
    "tustinnet.targets",
    {
        "c": "tustinnet.export.c:TARGET",
        "fmu": "tustinnet.export.fmu:TARGET",
        "casadi": "tustinnet.export.casadi:TARGET",
        "onnx": "tustinnet.export.onnx:TARGET",
        "js": "tustinnet.export.javascript:TARGET",
        "stablehlo": "tustinnet.export.stablehlo:TARGET",
        "mat": "tustinnet.export.mat:TARGET",
        "urdf": "tustinnet.export.robot:URDF",
        "mjcf": "tustinnet.export.robot:MJCF",
    },
)
READERS = Registry(
    "reader",
    "tustinnet.readers",
    {
        ".parquet": "tustinnet.data.formats.parquet:READER",
        ".mat": "tustinnet.data.formats.mat:READER",
        ".npz": "tustinnet.data.formats.npz:READER",
        ".bag": "tustinnet.data.formats.ros:READER",
        ".db3": "tustinnet.data.formats.ros:READER",
        ".mcap": "tustinnet.data.formats.mcap:READER",
        ".ulg": "tustinnet.data.formats.ulog:READER",
        ".mf4": "tustinnet.data.formats.mdf:READER",
        ".mdf": "tustinnet.data.formats.mdf:READER",
        ".tdms": "tustinnet.data.formats.tdms:READER",
        ".xlsx": "tustinnet.data.formats.excel:READER",
        ".h5": "tustinnet.data.formats.hdf5:READER",
        ".hdf5": "tustinnet.data.formats.hdf5:READER",
        ".json": "tustinnet.data.formats.json_rows:READER",
        ".jsonl": "tustinnet.data.formats.json_rows:READER",
        ".ndjson": "tustinnet.data.formats.json_rows:READER",
    },
)  # by the ending of the files
PUBLICATION = "tustinnet.reproduce"  # the package whose recipes are those of the publication
RECIPE_HOMES: list[str] = ["tustinnet.fitting", PUBLICATION]  # packages with `recipes/`
