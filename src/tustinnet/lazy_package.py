"""Packages whose public names are loaded when they are first used; `__init__.pyi` lists them."""

import ast
import sys
from importlib import import_module
from inspect import isfunction
from pathlib import Path
from types import ModuleType
from typing import Any

from tustinnet.argument_types import check_arguments
from tustinnet.old_names import NAMES, attribute_error


class LazyPackage(ModuleType):
    """A package that loads the modules of its public names when these are first used.

    Attributes:
        places: module of each public name, below the package; "" for a package itself.
    """

    places: dict[str, str]

    def __getattr__(self, name: str) -> Any:
        if name not in self.places:
            raise attribute_error(f"module '{self.__name__}'", name, NAMES)
        module = import_module(f"{self.__name__}.{self.places[name] or name}")
        value = getattr(module, name) if self.places[name] else module
        if isfunction(value):
            value = check_arguments(value)
        vars(self)[name] = value
        return value

    def __setattr__(self, name: str, value: object) -> None:
        # Python sets a loaded module here, which would hide a function that is called like it
        if not (isinstance(value, ModuleType) and self.places.get(name)):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted(self.places)


def make_lazy(name: str, file: str) -> None:
    """Makes a package a lazy one.

    Args:
        name: its `__name__`.
        file: its `__file__`, beside which `__init__.pyi` is.
    """
    package, stub = sys.modules[name], Path(file).with_suffix(".pyi")
    imports = [n for n in ast.parse(stub.read_text("utf-8")).body if isinstance(n, ast.ImportFrom)]
    places = {alias.name: node.module or "" for node in imports for alias in node.names}
    vars(package).update(places=places, __all__=sorted(places))
    package.__class__ = LazyPackage
