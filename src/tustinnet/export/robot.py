"""The file of a robot with identified values, in the format that it had or in MuJoCo's.

What a program makes of the file is compared: of a file in MuJoCo's format the mass matrix and the
forces that MuJoCo computes, of a URDF those by the numbers in it. What a format cannot hold is left
out on both sides, and said with the accelerations that it makes of the same torques.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.export.source import Source, StepFunction
from tustinnet.export.target import Files, Stepper, Target, Vector
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.models.sensors import delay_name
from tustinnet.program.numbers import run
from tustinnet.program.reading import read
from tustinnet.systems.mjcf import joint_forces
from tustinnet.systems.robot import find_lead
from tustinnet.systems.robot_options import RobotOptions
from tustinnet.systems.robot_reading import read_robot
from tustinnet.systems.robots import RobotFile, robot_in

_COMPARED = 50  # states at which accelerations with and without what is left out are compared


@dataclass(frozen=True)
class RobotTarget(Target):
    """The file from which a robot was made, with the values of a model in it.

    Attributes:
        name: the name of its format, in `to=`.
        endings: the endings of files of that format.
        description: the format in words.
        origins: the endings of files from which it can be made.
        extra: see `Target`.
    """

    # of each instance, as one class serves both formats
    name: str  # pyright: ignore[reportIncompatibleVariableOverride]
    endings: tuple[str, ...]
    description: str
    origins: tuple[str, ...]
    extra: tuple[str, tuple[str, ...]] | None = None  # pyright: ignore[reportIncompatibleVariableOverride]

    bound = 1e-9  # inertias go through their matrices and back
    fits_any_model = False

    def files(self, source: Source) -> Files:
        """The file, `robot.urdf` or `robot.xml`."""
        text, _ = self._written(source)
        return {self._file_name: text}

    def notes(self, source: Source) -> tuple[str, ...]:
        """Remarks on what the file does not hold."""
        equations, file = self._robot(source)
        _, lacking = self._written(source)
        values, notes = self._plain_values(source)
        units = {p.name: p.unit for p in equations.system.parameters}
        sizes = [f"{n} ({values[n]:.3g} {units[n.partition('[')[0]]})" for n in lacking]
        sizes += [
            f"{name} ({i.delay:.3g} s)"
            for i in source.channels.inputs
            if i.delay and (name := delay_name(i)) not in lacking
        ]
        if file.path.suffix not in self.endings:
            notes.append(f"shapes and largest speeds of {file.path.name} are not in the file")
        if sizes:
            has_armature = any(name.endswith(".armature") for name in lacking)
            better = "; `to=` mjcf holds armatures" if has_armature else ""
            notes.append(
                f"{self.description} cannot hold {', '.join(sizes)}: left out"
                f"{self._describe_effect(source, lacking)}{better}"
            )
        if not isinstance(source.model, Discretised):
            notes.append(f"{self.name}: what the model adds to the equations is not in the file")
        return tuple(notes)

    def expected(self, source: Source) -> StepFunction:
        """Velocities after a sampling period at constant acceleration, (n_q,).

        By the equations with what the file can hold.
        """
        return _velocities(source, *self._held(source))

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """The step by the written file: by MuJoCo, or by the equations with the numbers in a URDF.

        Dry friction is that of the equations in both, with the numbers in the file.
        """
        path = folder / self._file_name
        text = path.read_text(encoding="utf-8")
        (_, file), (_, lacking) = self._robot(source), self._written(source)
        system, values = self._held(source)
        again = RobotFile(text, path, RobotOptions(file.options.locked)).load().nominal()
        # MuJoCo's dry friction is a constraint, which has no width
        kept = {k for k in values if k not in lacking and not k.endswith(".coulomb_speed")}
        values |= {k: x for k, x in again.items() if k in kept}
        sizes = {"x": source.n_x, "u": source.n_w}
        if self.name == "urdf":
            function = _velocities(source, system, values)
            program = read(lambda x, u: {"v": function(x, u)}, sizes)
            return lambda x, u: run(program, x=x, u=u)["v"]
        names, n = [c.name for c in system.coordinates], len(system.coordinates)
        lead = find_lead(read_robot(text, path), names, file.options.locked)
        forces = joint_forces(text, path, lead)
        dry = _model(system, values | {f"{name}.viscous": 0.0 for name in names})

        def applied(x: Any, u: Any) -> dict[str, Any]:
            w = _plant_inputs(source, system, u)
            return {"force": dry.applied(x[:n], x[n : 2 * n], jnp.zeros(0), w)}

        program = read(applied, sizes)

        def step(x: Vector, u: Vector) -> Vector:
            mass, force = forces(x[:n], x[n : 2 * n])
            acceleration = np.linalg.solve(mass, force + run(program, x=x, u=u)["force"])
            return x[n : 2 * n] + source.channels.dt * acceleration

        return step

    @property
    def _file_name(self) -> str:
        return f"robot{self.endings[0]}"

    def _written(self, source: Source) -> tuple[str, tuple[str, ...]]:
        """The text of the file, and names of parameters that it cannot hold."""
        equations, file = self._robot(source)
        values = {name: float(x) for name, x in equations.values.items()}
        return file.with_values(values, self.endings[0])

    def _plain_values(self, source: Source) -> tuple[dict[str, float], list[str]]:
        """The values with the frictions that a file can hold, and remarks on these."""
        equations, file = self._robot(source)
        return file.plain_values({name: float(x) for name, x in equations.values.items()})

    def _held(self, source: Source) -> tuple[LagrangianSystem, dict[str, float]]:
        """The robot without what options and recipes add, and the values that the file can hold."""
        (equations, file), (_, lacking) = self._robot(source), self._written(source)
        plant = equations.system.plant
        options = RobotOptions(file.options.locked, file.options.motor_constants)
        plain = RobotFile(file.text, file.path, options)
        system = plain.for_channels(plant.coordinates, plant.inputs, file.path)
        # files have torques and forces as inputs, of whatever motor
        unheld = {name for name in lacking if not name.endswith(".motor_constant")}
        plain_values, _ = self._plain_values(source)
        values = {
            name: x if name in unheld else plain_values.get(name, x)
            for name, x in system.nominal().items()
        }
        return system, values

    def _describe_effect(self, source: Source, lacking: tuple[str, ...]) -> str:
        """Accelerations by the file and with what it lacks, where they differ most."""
        (equations, _), (system, held) = self._robot(source), self._held(source)
        missing = {k: float(equations.values[k]) for k in lacking if k in held}
        missing = {k: x for k, x in missing.items() if x != held[k]}
        if not missing:
            return ""
        kinds = " and ".join(dict.fromkeys(name.rpartition(".")[2] for name in missing))
        states, inputs = source.samples(_COMPARED)
        n_x, n_w, n = source.n_x, source.n_w, len(system.coordinates)

        def accelerations(point: Any) -> Any:
            values = {**held, **dict(zip(missing, point[n_x + n_w :], strict=True))}
            w = _plant_inputs(source, system, point[n_x : n_x + n_w])
            return _model(system, values).acceleration(point[: 2 * n], w)

        formula = Formula(accelerations, n_x + n_w + len(missing))
        by_file, with_all = (
            evaluate(formula, np.hstack([states, inputs, np.tile(values, (_COMPARED, 1))]))
            for values in ([held[k] for k in missing], [*missing.values()])
        )
        differences = np.nan_to_num(np.abs(by_file - with_all), nan=np.inf)
        at, k = np.unravel_index(np.argmax(differences), differences.shape)
        coordinate = system.coordinates[k]
        return (
            f"; the same torques give {coordinate.name} {by_file[at, k]:.4g} "
            f"{coordinate.unit}/s^2 by the file and {with_all[at, k]:.4g} with {kinds}"
        )

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
        if path.suffix not in self.origins:
            raise InputError(
                f"`to=` {self.name}", f"the robot was made from {path.name}", "`to=` mjcf"
            )
        return robot


def _velocities(
    source: Source, system: LagrangianSystem, values: Mapping[str, float]
) -> StepFunction:
    """Velocities after a sampling period at constant acceleration, of states and inputs."""
    n, model = len(system.coordinates), _model(system, values)

    def step(x: Any, u: Any) -> Any:
        acceleration = model.acceleration(x[: 2 * n], _plant_inputs(source, system, u))
        return x[n : 2 * n] + source.channels.dt * acceleration

    return step


def _model(system: LagrangianSystem, values: Mapping[str, Any]) -> LagrangianModel:
    """The equations with values that may be plain numbers."""
    return system.model({name: jnp.asarray(x) for name, x in values.items()})


def _plant_inputs(source: Source, system: LagrangianSystem, samples: Any) -> Any:
    """The inputs of a robot where a period begins; set points of a controller are none."""
    if source.channels.controller is not None:
        return jnp.zeros(len(system.inputs))
    return samples[: len(system.inputs)]


URDF = RobotTarget("urdf", (".urdf",), "a URDF", (".urdf",))
MJCF = RobotTarget(
    "mjcf",
    (".xml", ".mjcf"),
    "a file in MuJoCo's format",
    (".xml", ".mjcf", ".urdf"),
    ("robots", ("mujoco",)),
)
