"""Packages that load a module when something of it is first used.

A public name is loaded where `__init__.pyi` lists it. A module that is imported from a room, as in
`from tustinnet.store import files`, is loaded when the program first says `files.something`. So a
file can import at its top what takes seconds to load.
"""

import ast
import sys
from dataclasses import is_dataclass
from importlib import import_module
from importlib.util import find_spec
from inspect import isfunction
from pathlib import Path
from types import ModuleType
from typing import Any

from tustinnet.argument_types import check_arguments
from tustinnet.old_names import NAMES, attribute_error


class LateModule(ModuleType):
    """A stand-in for a module that may not be loaded yet, with all that the module has."""

    def __getattribute__(self, name: str) -> Any:
        return getattr(import_module(super().__getattribute__("__name__")), name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(import_module(super().__getattribute__("__name__")), name, value)


class LazyPackage(ModuleType):
    """A package that loads its modules, and those of its public names, when they are first used.

    Attributes:
        places: module of each public name, below the package; "" for a package itself.
    """

    places: dict[str, str] = {}  # noqa: RUF012 (none; a package sets its own)

    def __getattr__(self, name: str) -> Any:
        module = f"{self.__name__}.{self.places.get(name) or name}"
        if name in self.places:
            value = import_module(module)
            if self.places[name]:
                value = getattr(value, name)
            if isfunction(value):
                value = check_arguments(value)
            elif type(value) is type and is_dataclass(value):
                value.__init__ = check_arguments(value.__init__)
        elif find_spec(module):
            value = LateModule(module)
        else:
            raise attribute_error(f"module '{self.__name__}'", name, NAMES)
        vars(self)[name] = value
        return value

    def __setattr__(self, name: str, value: object) -> None:
        # Python sets a loaded module here: a room, whose modules are to be loaded late, too, or
        # one that would hide a function that is called like it
        if isinstance(value, ModuleType):
            if type(value) is ModuleType and hasattr(value, "__path__"):
                value.__class__ = LazyPackage
            if self.places.get(name):
                return
        super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted(self.places or vars(self))


def make_lazy(name: str, file: str) -> None:
    """Makes a package a lazy one, and the packages in it.

    Args:
        name: its `__name__`.
        file: its `__file__`, beside which `__init__.pyi` is.
    """
    package, stub = sys.modules[name], Path(file).with_suffix(".pyi")
    imports = [n for n in ast.parse(stub.read_text("utf-8")).body if isinstance(n, ast.ImportFrom)]
    places = {alias.name: node.module or "" for node in imports for alias in node.names}
    vars(package).update(places=places, __all__=sorted(places))
    package.__class__ = LazyPackage
