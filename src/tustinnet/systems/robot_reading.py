"""Files of robots as they are read: their endings, their text, the robot in it.

Nothing here loads JAX, so that a file that cannot be read is found at once.
"""

from functools import lru_cache
from pathlib import Path

from tustinnet.data.declaration import read_source
from tustinnet.errors import InputError, convert_errors
from tustinnet.systems.mjcf import include_files, read_mjcf
from tustinnet.systems.robot import Robot
from tustinnet.systems.urdf import read_urdf

ROBOT_ENDINGS = (".urdf", ".xml", ".mjcf")


def read_robot_text(path: Path) -> str:
    """The text of a robot's file, with what it includes from its folder and those below.

    Raises:
        InputError: a file that is not there, no XML, or an included file elsewhere.
    """
    text = read_source(path, "a robot file")
    if path.suffix == ".urdf":
        return text

    def read_included(name: str) -> str:
        included = path.parent / name
        with convert_errors(included, "cannot be followed", "a file"):
            is_inside = included.resolve().is_relative_to(path.parent.resolve())
        if not is_inside:
            raise InputError(
                path,
                f"includes '{name}', outside of its folder",
                f"files below {path.parent}",
                "copy the file there",
            )
        return read_source(included, "an included robot file")

    return include_files(text, path, read_included)


@lru_cache(maxsize=4)  # a file in MuJoCo's format is compiled in a process of its own
def read_robot(text: str, path: Path) -> Robot:
    """The robot of a text, in the format that the ending of its file says.

    Args:
        text: the text, without includes.
        path: the file.

    Raises:
        InputError: see `read_urdf` and `read_mjcf`.
    """
    return (read_urdf if path.suffix == ".urdf" else read_mjcf)(text, path)
