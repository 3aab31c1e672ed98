"""The links of a mechanism, by which it is drawn: a tree of rigid bodies."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from tustinnet.channels import Coordinate
from tustinnet.errors import InputError

BASE = "base"  # the parent of links on the ground

Vector3 = tuple[int | float, ...]
Shape = Literal["rod", "rope", "beam", "wheel", "propeller", "ball", "spring"]
_SLIDING = ("ball", "spring")  # shapes of links that slide


@dataclass(frozen=True)
class Link:
    """A rigid link with the joint at its beginning.

    Links are listed after those that carry them. Without a parent each is carried by the link
    before, so that they form a chain; the first one stands on the base. x points to the right,
    y away from the viewer, z up.

    Attributes:
        coordinate: the coordinate of the joint: an angular one turns the link about the axis, a
            linear one slides it along the axis.
        axis: the joint's axis in the frame of what carries it, 3 numbers of
            any length but 0.
        reach: from the joint to the link's end in its own frame, 3 numbers [m].
        parent: the coordinate of the link that carries it, or `base`; None for the link before.
        at: where the joint is at 0 in the frame of what carries it, 3 numbers [m]; None for the end
            of the link that carries it, on the base for the origin.
        shape: how it looks. A `rod` is a line from the joint to its end, and a cart where its
            length is 0 and it slides. What turns may be a `rope` with a load, a `beam` that
            reaches as far to the other side, a `wheel` with its rim at the end, or a rod with a
            `propeller`. What slides may be a `ball` about its end that touches the joint, or a
            cart on a `spring`.
    """

    coordinate: str
    axis: Vector3
    reach: Vector3
    parent: str | None = None
    at: Vector3 | None = None
    shape: Shape = "rod"

    def __post_init__(self) -> None:
        for name in ("axis", "reach", "at"):
            vector = getattr(self, name)
            if vector is not None and (len(vector) != 3 or not np.isfinite(vector).all()):
                raise InputError(f"link of '{self.coordinate}'", f"{name} {vector}", "3 numbers")
        if not any(self.axis):
            raise InputError(f"link of '{self.coordinate}'", "an axis of length 0", "a direction")
        shapes = get_args(Shape)
        if self.shape not in shapes:
            problem, expected = f"the shape '{self.shape}'", f"one of {', '.join(shapes)}"
            raise InputError(f"link of '{self.coordinate}'", problem, expected)
        if self.shape not in ("rod", "spring") and not any(self.reach):
            problem = f"the shape '{self.shape}' with a reach of length 0"
            raise InputError(f"link of '{self.coordinate}'", problem, "its size as the reach")


def require_links(links: Sequence[Link], coordinates: Sequence[Coordinate], where: str) -> None:
    """Raises unless every link moves by a coordinate of its own and has a parent before it.

    The parent is a link that is listed before, or the base. Balls and springs slide; all other
    shapes but rods turn.
    """
    names = [c.name for c in coordinates]
    moved = [link.coordinate for link in links]
    for i, link in enumerate(links):
        name = link.coordinate
        if name not in names or moved.count(name) > 1:
            raise InputError(
                where,
                f"a link of the coordinate '{name}'",
                f"one link each of {', '.join(names)}, at most",
            )
        kind = "linear" if link.shape in _SLIDING else "angular"
        if link.shape != "rod" and coordinates[names.index(name)].kind != kind:
            problem = f"the shape '{link.shape}' of the link of '{name}'"
            raise InputError(where, problem, f"this shape only for {kind} coordinates")
        if link.parent not in (None, BASE, *moved[:i]):
            raise InputError(
                where,
                f"the link of '{name}' on '{link.parent}'",
                f"{', '.join([*moved[:i], BASE])}",
                "list a link after the one that carries it",
            )


def parent_indices(links: Sequence[Link]) -> list[int | None]:
    """The index of each link's parent, None for the base."""
    places = {link.coordinate: i for i, link in enumerate(links)}
    return [
        (i - 1 if i else None)
        if link.parent is None
        else None
        if link.parent == BASE
        else places[link.parent]
        for i, link in enumerate(links)
    ]
