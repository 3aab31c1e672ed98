"""Free runs that leave what was recorded, in words and as plain values."""

from typing import Any

from tustinnet.data.experiment import Experiment
from tustinnet.simulate.range import ExtrapolationPoint


def left_words(left: ExtrapolationPoint, experiment: Experiment) -> str:
    """Where a free run leaves what was recorded, and how far."""
    at = f"from {_time(left, experiment):.3g} s on the free run leaves what the model was made from"
    if not left.signal:
        return (
            f"{at}: positions, velocities and inputs come together that did not in any record "
            f"({left.value:.3g} times as far from all of them as records are from one another)"
        )
    low, high = left.recorded
    return f"{at}: {left.signal} reaches {left.value:.4g}, recorded {low:.4g} to {high:.4g}"


def left_plain(left: ExtrapolationPoint, experiment: Experiment) -> dict[str, Any]:
    """The same for programs."""
    return {
        "time": _time(left, experiment),
        "what": left.signal,
        "value": left.value,
        "recorded": list(left.recorded),
    }


def _time(left: ExtrapolationPoint, experiment: Experiment) -> float:
    return float(experiment.t[left.sample] - experiment.t[0])
