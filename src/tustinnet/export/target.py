"""What every target of an export answers."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from tustinnet.errors import require_package
from tustinnet.export.source import Source, StepFunction

Vector = Float[np.ndarray, " _"]
Files = dict[str, bytes | str]
Stepper = Callable[[Vector, Vector], Vector]


class NotRunnable(Exception):
    """What was written cannot be run here, and why."""


class Target(ABC):
    """A form that models leave the house in.

    Attributes:
        name: what `--to` calls it.
        bound: the largest difference from the model's own step that is let out, relative to
            1 + the state.
        extra: the extra of this package that it needs, and the packages of it.
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
            NotRunnable: who is to use it is not on this machine.
        """

    def expected(self, source: Source) -> StepFunction:
        """What the steps have to equal: those of the model."""
        return source.function

    def at_operating_point(self, point: Mapping[str, float]) -> "Target":
        """The same target about an operating point; most have none and return themselves.

        Args:
            point: values of states and inputs by name; those that are not named are 0.
        """
        return self

    def require_extra(self) -> None:
        """Raises unless the libraries are here that the target needs."""
        extra, packages = self.extra or ("", ())
        for package in packages:
            require_package(package, extra, f"--to {self.name}")
