"""Files of robots with identified values."""

from pathlib import Path

from tustinnet.errors import InputError
from tustinnet.models.contract import ContinuousModel, Model
from tustinnet.store.files import require_outputs, write_into
from tustinnet.systems.robots import robot_in


def write_robot(
    model: Model | ContinuousModel, path: str | Path, *, overwrite: bool = False
) -> tuple[str, ...]:
    """Writes the file of a robot with the values of an identified model.

    Masses, centres and inertias of the links that move, frictions, in MuJoCo's format also
    armatures and springs. Only these numbers change: comments, order and all else stay as they are;
    the robot of a URDF in MuJoCo's format has neither comments nor shapes.

    Args:
        model: a model of a robot that was made from a URDF file, or one in MuJoCo's format.
        path: the file to write, with the ending of the robot's own. The robot of a URDF is also
            written in MuJoCo's format, to a file with the ending .xml.
        overwrite: replace a file that is there.

    Returns:
        Names of the parameters that differ from the file and that its format cannot hold, as
        offsets, and armatures in a URDF.

    Raises:
        InputError: a model without such a file, another ending, a file that is there, or an inertia
            that no body has.
    """
    robot, path = robot_in(model), Path(path)
    if robot is None:
        raise InputError(
            "write_robot",
            "a model that was not made from a robot's file",
            "one that was",
            "fit with `system=` arm.urdf",
        )
    equations, source = robot
    own = source.path.suffix
    endings = (own, ".xml") if own == ".urdf" else (own,)
    if path.suffix not in endings:
        expected = " or ".join(f"'{ending}'" for ending in endings)
        raise InputError(path, f"ending '{path.suffix}'", f"{expected} as of the robot")
    require_outputs([path], overwrite=overwrite, read=[source.path])
    values = {name: float(value) for name, value in equations.values.items()}
    if not values.keys() >= equations.system.nominal().keys():
        raise InputError(
            "write_robot",
            "a model with values by group",
            "values of one group",
            "take those of a record: model.for_record(record)",
        )
    text, lacking = source.with_values(values, path.suffix)
    write_into(path.parent, path.name, text)
    return lacking
