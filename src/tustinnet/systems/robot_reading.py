"""Files of robots as they are read: their endings, their text, the robot in it.

Nothing here loads JAX, so that a file that cannot be read is found at once.
"""

from pathlib import Path

from tustinnet.data.declaration import read_source
from tustinnet.systems.mjcf import include_files, read_mjcf
from tustinnet.systems.robot import Robot
from tustinnet.systems.urdf import read_urdf

ROBOT_ENDINGS = (".urdf", ".xml", ".mjcf")


def read_robot_text(path: Path) -> str:
    """The text of a robot's file, with what it includes.

    Raises:
        InputError: a file that is not there, or no XML.
    """
    text = read_source(path, "a robot file")
    if path.suffix == ".urdf":
        return text
    return include_files(
        text, path, lambda name: read_source(path.parent / name, "an included robot file")
    )


def read_robot(text: str, path: Path) -> Robot:
    """The robot of a text, in the format that the ending of its file says.

    Args:
        text: the text, without includes.
        path: the file.

    Raises:
        InputError: see `read_urdf` and `read_mjcf`.
    """
    return (read_urdf if path.suffix == ".urdf" else read_mjcf)(text, path)
