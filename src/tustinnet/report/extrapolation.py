"""Motions that leave the range of the training data, in words and as plain values."""

from typing import Any

from tustinnet.simulate.range import ExtrapolationPoint


def describe_extrapolation(
    point: ExtrapolationPoint, dt: float, motion: str = "the free run"
) -> str:
    """Describes where a motion leaves the range of the training data, and how far it goes."""
    start = f"from {point.sample * dt:.3g} s on {motion} is outside the range of the training data"
    if not point.signal:
        return (
            f"{start}: this combination of positions, velocities and inputs is in no record "
            f"({point.value:.3g} times as far from all of them as records are from one another)"
        )
    low, high = point.recorded
    return f"{start}: {point.signal} reaches {point.value:.4g}, recorded {low:.4g} to {high:.4g}"


def extrapolation_content(point: ExtrapolationPoint, dt: float) -> dict[str, Any]:
    """Plain values of the place where a free run leaves the range of the training data."""
    return {
        "time": point.sample * dt,
        "what": point.signal,
        "value": point.value,
        "recorded": list(point.recorded),
    }
