"""How a mechanism is drawn: a serial chain of rigid links."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.channels import Coordinate
from tustinnet.errors import InputError

Vector3 = tuple[int | float, ...]


@dataclass(frozen=True)
class Link:
    """A rigid link of a serial chain, with the joint at its beginning.

    The first joint is at the origin, each other one at the end of the link before. x points to the
    right, y away from the viewer, z up.

    Attributes:
        coordinate: the coordinate of the joint: an angular one turns the link about the axis, a
            linear one slides it along the axis.
        axis: the joint's axis in the frame of the link before, 3 numbers of
            any length but 0.
        reach: from the joint to the link's end in its own frame, 3 numbers [m].
    """

    coordinate: str
    axis: Vector3
    reach: Vector3

    def __post_init__(self) -> None:
        for name in ("axis", "reach"):
            vector = getattr(self, name)
            if len(vector) != 3 or not np.isfinite(vector).all():
                raise InputError(f"link of '{self.coordinate}'", f"{name} {vector}", "3 numbers")
        if not any(self.axis):
            raise InputError(f"link of '{self.coordinate}'", "an axis of length 0", "a direction")


def require_links(links: Sequence[Link], coordinates: Sequence[Coordinate], where: str) -> None:
    """Raises unless every link moves by one of some coordinates, each by another one."""
    known = [c.name for c in coordinates]
    moved = [link.coordinate for link in links]
    for name in moved:
        if name not in known or moved.count(name) > 1:
            raise InputError(
                where, f"a link of the coordinate '{name}'",
                f"one link each of {', '.join(known)}, at most",
            )  # fmt: skip
