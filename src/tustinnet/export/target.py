"""What every target of an export answers."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError
from tustinnet.export.source import Source

Vector = Float[np.ndarray, " _"]
Files = dict[str, bytes | str]
Stepper = Callable[[Vector, Vector], Vector]


class Unbuilt(Exception):
    """What was written cannot be run here, and why."""


class Target(ABC):
    """A form that models leave the house in.

    Attributes:
        name: what `--to` calls it.
        bound: the largest difference from the model's own step that is let out, relative to
            1 + the state.
        extra: the extra of this package that it needs, and the modules of it.
    """

    name: ClassVar[str]
    bound: ClassVar[float] = 1e-12
    extra: ClassVar[tuple[str, tuple[str, ...]] | None] = None

    @abstractmethod
    def files(self, source: Source) -> Files:
        """The files by name.

        Raises:
            InputError: the target cannot say what the model does.
        """

    @abstractmethod
    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by what was written into a folder, done by who is to use it.

        Takes (n_x,) and (n_w,), returns (n_x,). It is made of the files alone.

        Raises:
            Unbuilt: who is to use it is not on this machine.
        """

    def require_extra(self) -> None:
        """Raises unless the libraries are here that the target needs."""
        extra, modules = self.extra or ("", ())
        missing = [module for module in modules if find_spec(module) is None]
        if missing:
            raise InputError(
                f"--to {self.name}", f"the package {missing[0]} is not installed", missing[0],
                f"pip install 'tustinnet[{extra}]'",
            )  # fmt: skip
