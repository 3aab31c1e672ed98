"""Robots as systems: a file, the options by which it is used, and the equations that they make.

`robot_tree` has the bodies, `robot_channels` coordinates and inputs, `robot_parameters` what is
searched for, `robot_equations` the forces, `robot_options` the options of `load_robot`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from tustinnet.channels import Coordinate, Input
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.chains import Chain
from tustinnet.models.contract import ContinuousModel, Model
from tustinnet.models.lagrangian import ChannelSource, LagrangianModel, LagrangianSystem
from tustinnet.models.physical_values import equations_in
from tustinnet.systems.files import find_robot_path, find_system
from tustinnet.systems.robot_channels import RobotChannels
from tustinnet.systems.robot_equations import RobotEquations, Spring
from tustinnet.systems.robot_options import RobotOptions
from tustinnet.systems.robot_parameters import (
    RecordedMotion,
    make_parameters,
    place_frictions,
    plain_friction,
    recorded_motion,
)
from tustinnet.systems.robot_reading import ROBOT_ENDINGS, read_robot
from tustinnet.systems.robot_shapes import with_inertias
from tustinnet.systems.robot_tree import RobotTree
from tustinnet.systems.robot_writing import write_values


def load_robot(
    path: str | Path,
    *,
    locked: Mapping[str, float] | None = None,
    motor_constants: Mapping[str, float] | None = None,
    per: Mapping[str, str] | None = None,
    friction: Sequence[str] = (),
    elastic: Mapping[str, float] | None = None,
    backlash: Mapping[str, float] | None = None,
    encoders: Mapping[str, str] | str = "link",
    default_density: float | None = None,
    gravity: Sequence[float] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> LagrangianSystem:
    """A robot as a system, from a URDF file or one in MuJoCo's format.

    Args:
        path: the file, `arm.urdf` or `robot.xml`. In a system file a relative path is looked for
            beside that file first.
        locked: joints that do not move, with their positions [rad or m].
        motor_constants: joints whose input is the current of a motor, with the force or torque by
            current [N m/A or N/A]; below 0 where the current counts the other way round.
        per: links whose mass, centre and inertia differ between groups of records, with the name of
            the group, `{"flange": "payload"}`.
        friction: friction of all joints beside the viscous and the Coulomb one: "stribeck" (more at
            the onset of motion), "load" (grows with the torque or force of gravity at the joint),
            "curve" (grows with the speed, and ever less so). A recipe's `[model] forces` adds the
            same laws, to all joints or to some.
        elastic: joints between whose motor and link there is a spring, as in a harmonic drive, with
            its stiffness [N m/rad or N/m], from which the search begins.
        backlash: elastic joints with play in the gear, with its whole width [rad or m].
        encoders: where the encoders of elastic joints are, `{"joint2": "motor"}`: "motor" or
            "link", which is the default; a single word is for all elastic joints. The coordinate of
            a joint is what its encoder reads, at a motor in units of the joint.
        default_density: density [kg/m^3] by which links without an inertia get that of their
            shapes; for a URDF.
        gravity: its acceleration in the frame of the base [m/s^2], in place of that of the file: of
            a robot below a ceiling (0, 0, 9.81), on a wall as the base stands there.
        ranges: smallest and largest value of parameters by name, `{"joint1.viscous": (0, 5)}`, in
            place of those that follow from the file and the records. The constant of a motor that
            has one is searched for; a mass that is known has to tell it.

    Raises:
        InputError: a file that cannot be read, an option that names no such joint or link, a value
            that is no number in range, or a robot without equations here.
    """
    path = find_robot_path(path)
    file = find_system(path)
    if isinstance(file, str) or file.is_code:
        raise InputError(path, "no file of a robot", f"a file with {', '.join(ROBOT_ENDINGS)}")
    if default_density is not None:
        file = with_inertias(file, default_density)
    options = RobotOptions.checked(
        path,
        locked=locked,
        motor_constants=motor_constants,
        per=per,
        friction=friction,
        elastic=elastic,
        backlash=backlash,
        encoders=encoders,
        default_density=default_density,
        gravity=gravity,
        ranges=ranges,
    )
    return RobotFile(file.text, file.path, options).load()


@dataclass(frozen=True)
class RobotFile(ChannelSource):
    """A robot file and how it is used, from which systems are made.

    Attributes:
        text: the file's text, without includes.
        path: the file.
        options: how it is used.
    """

    text: str
    path: Path
    options: RobotOptions = field(default_factory=RobotOptions, hash=False)

    def load(self) -> LagrangianSystem:
        """The system with all joints that move freely, and all actuators.

        Raises:
            InputError: a robot without equations here.
        """
        return self._system(self._channels())

    def for_channels(
        self, coordinates: Sequence[Coordinate], inputs: Sequence[Input], where: object
    ) -> LagrangianSystem:
        """The system as a data card has it, see `RobotChannels.arrange`."""
        return self._system(self._channels(coordinates, inputs, where))

    def for_records(self, records: Sequence[Experiment], where: object) -> LagrangianSystem:
        """The system for the coordinates and inputs of records, with ranges by their motion.

        Args:
            records: records of one kind.
            where: see `for_channels`.

        Raises:
            InputError: see `for_channels`.
        """
        channels = self._channels(records[0].coordinates, records[0].inputs, where)
        return self._system(channels, recorded_motion(channels, records))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on what counts otherwise than the file says it."""
        return tuple(f"{self.path.name}, {remark}" for remark in self._channels().tree.remarks)

    def input_joints(self) -> dict[str, str]:
        """Of each input the coordinate on which it acts, by name."""
        channels = self._channels()
        return {
            i.name: channels.tree.free[drive.coordinate]
            for i, drive in zip(channels.inputs, channels.drives, strict=True)
        }

    def call(self, **more: object) -> str:
        """The line of a system file that loads this robot as it is used, with more options."""
        return self.options.call(self.path.name, more)

    def plain_values(self, values: Mapping[str, float]) -> tuple[dict[str, float], list[str]]:
        """The values with the frictions that a file can hold, see `plain_friction`."""
        return plain_friction(self._channels(), values)

    def with_values(
        self, values: Mapping[str, float], ending: str = ""
    ) -> tuple[str, tuple[str, ...]]:
        """The file's text with values of parameters in it, and the names of those that it lacks.

        Further frictions are in it as the nearest viscous and Coulomb ones.

        Args:
            values: the parameters of the system by name. Where some have a value for each group of
                records, the one without a group is written.
            ending: the ending of the file to write; that of the file by default. A URDF is also
                written in MuJoCo's format.

        Raises:
            InputError: a file whose inertias do not count.
        """
        channels = self._channels()
        values, _ = plain_friction(channels, values)
        text, written = write_values(self.text, channels, values, ending or self.path.suffix)
        # what options of `load_robot` add is not in the file, whatever its value
        plain = RobotFile(self.text, self.path, RobotOptions(locked=self.options.locked))
        nominal = plain.load().nominal()
        lacking = [
            name
            for name, x in values.items()
            if name.partition("[")[0] not in written and x != nominal.get(name, 0.0)
        ]
        return text, tuple(lacking)

    def _channels(self, *card: Any) -> RobotChannels:
        """The bodies, coordinates and inputs of the file, as a card has them where it is given.

        Raises:
            InputError: an option that names no joint or link for which it is there.
        """
        options, path = self.options, self.path
        robot = read_robot(self.text, path)
        if options.gravity is not None:
            robot = replace(robot, gravity=options.gravity)
        tree = RobotTree(robot, path, options.locked)
        gears = "is elastic: give it a stiffness by elastic="
        for option, possible, what in (
            ("locked", tree.moving, "moves"),
            ("motor_constants", tree.moving, "moves"),
            ("elastic", tree.free, "moves by itself"),
            ("backlash", options.elastic, gears),
        ):
            if unknown := [name for name in getattr(options, option) if name not in possible]:
                raise InputError(
                    path,
                    f"{option}: the joint '{unknown[0]}'",
                    f"a joint that {what}",
                    f"there are: {', '.join(possible) or 'none'}",
                )
        channels = RobotChannels(tree, options)
        tree.require_moving_links(options.per)
        if card:
            channels.arrange(*card)
        return channels

    def _system(
        self, channels: RobotChannels, motions: Sequence[RecordedMotion] = ()
    ) -> LagrangianSystem:
        """The system with all that the file says, and ranges by the motion in records."""
        tree, options = channels.tree, channels.options
        # behind an elastic gear the motor moves by itself
        armatures = tuple(None if n in options.elastic else f"{n}.armature" for n in tree.free)
        elastic, backlash, at_motor = (
            tuple(k for k, name in enumerate(tree.free) if name in names)
            for names in (options.elastic, options.backlash, options.encoders)
        )
        equations = _make_equations(
            Chain(tuple(tree.bodies), tree.robot.gravity, armatures),
            tuple(tree.free),
            tuple(channels.drives),
            tuple(
                Spring(joint.name, k, ratio, offset, joint.spring_rest)
                for k in range(len(tree.free))
                for joint, ratio, offset in tree.moved(k)
                if joint.stiffness
            ),
            place_frictions(channels),
            elastic,
            backlash,
            at_motor,
            tuple(
                tree.joints[n].effort or tree.largest_load(k)[1] for k, n in enumerate(tree.free)
            ),
        )
        system = LagrangianSystem(
            name=tree.robot.name,
            coordinates=tree.coordinates,
            inputs=channels.inputs,
            parameters=make_parameters(channels, motions),
            kinetic=equations.kinetic,
            potential=equations.potential,
            dissipation=equations.dissipation,
            input_map=equations.input_map,
            links=tree.drawn_links(),
            inertia=equations.inertia,
            source=self,
            limits=tuple(channels.limits(k) for k in range(len(tree.free))),
            unmeasured=equations.unmeasured,
        )
        if not equations.integrating:
            return system
        return replace(system, **system.inside(equations.goals, equations.with_goals))


@lru_cache(maxsize=64)  # so that equal systems serve the same compiled programs
def _make_equations(*parts: Any) -> RobotEquations:
    """The equations of a robot, one object of equal parts: only then its methods are equal."""
    return RobotEquations(*parts)


def robot_in(model: Model | ContinuousModel) -> tuple[LagrangianModel, RobotFile] | None:
    """The equations of the robot in a model, and its file; None in a model of no robot."""
    equations = equations_in(model)
    if equations is None or not isinstance(equations.system.source, RobotFile):
        return None
    return equations, equations.system.source
