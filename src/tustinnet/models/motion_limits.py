"""Limits of the motion along a coordinate, and of the force that moves it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a coordinate; None where they are unknown.

    Attributes:
        position: smallest and largest position [rad or m].
        velocity: largest velocity [rad/s or m/s], in both directions.
        acceleration: largest acceleration [rad/s^2 or m/s^2], in both directions.
        force: largest force of the actuators [N m or N], in both directions.
    """

    position: tuple[float, float] | None = None
    velocity: float | None = None
    acceleration: float | None = None
    force: float | None = None
