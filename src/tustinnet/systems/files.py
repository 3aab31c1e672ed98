"""Files of systems, read but not run, and what else stands for a system."""

import functools
import hashlib
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from tustinnet.channels import Coordinate, Input
from tustinnet.data.declaration import read_source
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.registry import SYSTEMS
from tustinnet.systems.robot_reading import ROBOT_ENDINGS, read_robot_text

_ROBOT_NAMES = re.compile(
    rf"""["']([^"'\n]+(?:{"|".join(map(re.escape, ROBOT_ENDINGS))}))["']"""
)  # texts in code that end as files of robots do
# the folder of the system file that runs now
running_in: ContextVar[Path | None] = ContextVar("running_in", default=None)


@dataclass(frozen=True)
class SystemFile:
    """A system file as it was read, so that the text that is checked, kept and run is one.

    Attributes:
        path: where it was read.
        text: its text.
    """

    path: Path
    text: str

    @property
    def sha256(self) -> str:
        """SHA-256 of the text in UTF-8."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def is_code(self) -> bool:
        """Whether it is Python code, which is run; a robot file is only read."""
        return self.path.suffix not in ROBOT_ENDINGS

    @functools.cached_property
    def robots(self) -> tuple["SystemFile", ...]:
        """Files of robots that the code names and that are there, as `load_robot` finds them.

        They are read once, as the code was.

        Raises:
            InputError: one of them cannot be read.
        """
        names = dict.fromkeys(_ROBOT_NAMES.findall(self.text)) if self.is_code else {}
        paths = {find_robot_path(name, self.path.parent) for name in names}
        return tuple(
            SystemFile(path, read_robot_text(path)) for path in sorted(paths) if path.is_file()
        )


def find_robot_path(name: str | Path, folder: Path | None = None) -> Path:
    """The path of a robot's file that a system file names.

    It is beside the system file, as a run keeps both, else in the working folder.

    Args:
        name: the path as it was given.
        folder: the folder of the system file; None for that which runs now, if one does.
    """
    folder = folder or running_in.get()
    given = Path(name)
    beside = [] if folder is None else [folder / given, folder / given.name]
    return next((path for path in beside if path.is_file()), given)


class SystemTemplate(ABC):
    """A packaged system that is made for records, with their coordinates and inputs.

    Attributes:
        name: its name.
    """

    name: str

    @abstractmethod
    def for_records(self, records: Sequence[Experiment]) -> LagrangianSystem:
        """The system to identify from some records."""

    @abstractmethod
    def restore(
        self,
        coordinates: Sequence[Coordinate],
        inputs: Sequence[Input],
        parameters: Sequence[Parameter],
    ) -> LagrangianSystem:
        """A system that was made before, from its coordinates, inputs and parameters."""


AnySystem = LagrangianSystem | SystemTemplate | SystemFile | str | Path


def find_system(which: str | Path) -> SystemFile | str:
    """A packaged system's name as it is, or a Python file, read but not run.

    Raises:
        InputError: no such name or file.
    """
    path = Path(which)
    if str(which) in SYSTEMS:
        return str(which)
    if path.suffix in ROBOT_ENDINGS:
        return SystemFile(path, read_robot_text(path))
    if path.suffix != ".py":
        raise InputError(
            f"system '{which}'",
            "no such system",
            f"one of {', '.join(SYSTEMS.names())}, or a file FILE.py, FILE.urdf or FILE.xml",
            f"run xacro {path} > arm.urdf" if path.suffix == ".xacro" else "",
        )
    return SystemFile(path, read_source(path, "a Python file that defines SYSTEM"))
