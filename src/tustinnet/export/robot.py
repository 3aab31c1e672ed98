"""The file of a robot with identified values, in the format that it had."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import jax.numpy as jnp

from tustinnet.errors import InputError
from tustinnet.export.source import Source
from tustinnet.export.target import Files, Stepper, Target
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.models.physical_values import with_values
from tustinnet.program.numbers import run
from tustinnet.systems.robots import RobotFile, robot_in


@dataclass(frozen=True)
class RobotTarget(Target):
    """The file from which a robot was made, with the values of a model in it.

    Attributes:
        name: the name of its format, in `to=`.
        endings: the endings of files of that format.
        description: the format in words.
    """

    # of each instance, as one class serves both formats
    name: str  # pyright: ignore[reportIncompatibleVariableOverride]
    endings: tuple[str, ...]
    description: str

    bound = 1e-9  # inertias go through their matrices and back
    fits_any_model = False

    def files(self, source: Source) -> Files:
        """The file, `robot.urdf` or `robot.xml`."""
        text, _ = self._written(source)
        return {self._file_name: text}

    def notes(self, source: Source) -> tuple[str, ...]:
        """Remarks on what the file does not hold."""
        _, lacking = self._written(source)
        notes = []
        if lacking:
            notes.append(f"{self.description} cannot hold {', '.join(lacking)}: left out")
        if not isinstance(source.model, Discretised):
            notes.append(f"{self.name}: what the model adds to the equations is not in the file")
        return tuple(notes)

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by the parameters of the file, as it is read again.

        Those that it cannot hold are the model's.
        """
        equations, file = self._robot(source)
        text = (folder / self._file_name).read_text(encoding="utf-8")
        again = replace(file, text=text, path=folder / self._file_name).load().nominal()
        _, lacking = self._written(source)
        values = {
            name: jnp.asarray(again[name])
            for name in equations.values
            if name in again and name not in lacking
        }
        program = replace(source, model=with_values(source.model, values)).step
        return lambda x, u: run(program, x=x, u=u)["x"]

    @property
    def _file_name(self) -> str:
        return f"robot{self.endings[0]}"

    def _written(self, source: Source) -> tuple[str, tuple[str, ...]]:
        """The text of the file, and names of parameters that it cannot hold."""
        equations, file = self._robot(source)
        return _write_values(file, tuple((name, float(x)) for name, x in equations.values.items()))

    def _robot(self, source: Source) -> tuple[LagrangianModel, RobotFile]:
        """The equations of the robot, and the file from which they were made."""
        robot = robot_in(source.model)
        if robot is None:
            raise InputError(
                f"`to=` {self.name}",
                "not applicable to a model that was not made from the file of a robot",
                "one that was",
                "fit with `system=` arm.urdf or robot.xml",
            )
        path = robot[1].path
        if path.suffix not in self.endings:
            raise InputError(
                f"`to=` {self.name}",
                f"the robot was made from {path.name}",
                f"`to=` {'mjcf' if self.name == 'urdf' else 'urdf'}",
            )
        return robot


@lru_cache(maxsize=1)  # an export needs the text and its gaps three times
def _write_values(
    file: RobotFile, values: tuple[tuple[str, float], ...]
) -> tuple[str, tuple[str, ...]]:
    """The text of a robot's file with values of parameters, see `RobotFile.with_values`."""
    return file.with_values(dict(values))


URDF = RobotTarget("urdf", (".urdf",), "a URDF")
MJCF = RobotTarget("mjcf", (".xml", ".mjcf"), "a file in MuJoCo's format")
