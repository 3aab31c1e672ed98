"""The interface of targets of an export."""

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
    """The files of a target cannot be run on this machine; the message has the reason."""


class Target(ABC):
    """A form of exported models.

    Attributes:
        name: its name in `to=`.
        bound: the largest accepted difference from the model's own step, relative to
            1 + the state.
        extra: the extra of this package that it needs, and the packages of it.
        fits_any_model: whether any model can be exported to it; only then it is one of `all`.
    """

    name: ClassVar[str]
    bound: ClassVar[float] = 1e-12
    extra: ClassVar[tuple[str, tuple[str, ...]] | None] = None
    fits_any_model: ClassVar[bool] = True

    @abstractmethod
    def files(self, source: Source) -> Files:
        """The files by name.

        Raises:
            InputError: the model has an operation that the target does not support.
        """

    @abstractmethod
    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by the files in a folder, computed by the tool for which they are meant.

        Takes (n_x,) and (n_w,), returns (n_x,). It is made of the files alone.

        Raises:
            NotRunnable: that tool is not on this machine.
        """

    def expected(self, source: Source) -> StepFunction:
        """The step that the files must equal: that of the model."""
        return source.function

    def at_operating_point(self, point: Mapping[str, float]) -> "Target":
        """A target about an operating point; most have none and return themselves.

        Args:
            point: values of states and inputs by name; those that are not named are 0.
        """
        return self

    def notes(self, source: Source) -> tuple[str, ...]:
        """Remarks for those who use the files, beside those on the model."""
        return ()

    def require_extra(self) -> None:
        """Raises unless the packages are installed that the target needs."""
        extra, packages = self.extra or ("", ())
        for package in packages:
            require_package(package, extra, f"`to=` {self.name}")
