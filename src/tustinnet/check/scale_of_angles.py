"""Check of the scale of an angle by gravity, whose force has the period of a turn.

Sines of an angle in degrees, or of one whose encoder has other counts in a turn than declared, fit
the motion worse than those of the true angle. Small swings do not tell: their sine is straight.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tustinnet.check.card_lines import coordinate_line
from tustinnet.check.finding import Finding
from tustinnet.check.motion_model import Regressors, make_regressors, unexplained_share
from tustinnet.check.view import RecordView

_RECORDS = 5  # of them, from everywhere in the list
_SCALES = {  # of the true angle to the declared one
    "deg": np.pi / 180, "rad": 180 / np.pi, "twice": 2.0, "half": 0.5, "four": 4.0, "quarter": 0.25,
}  # fmt: skip
_UNITS = ("deg", "rad")
_FEW_COORDINATES = 2  # of more the model is too poor for other scales
_DROP = 0.4  # of what the model leaves, which the true scale leaves
_POOR = 0.5  # so much the model must explain with the true scale
_LEAST = 0.01  # of the accelerations: a model that leaves less needs no other scale
_SMALL_RANGE = 3.0  # rad; a spring may hold an angle that stays within


def scale_of_angles(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Angles that gravity, or another force with the period of a turn, shows in another scale."""
    step = max(1, len(views) // _RECORDS)
    some = views[::step][:_RECORDS]
    regressors = make_regressors(some)
    if regressors is None:
        return
    channels = some[0].experiment.channels
    q = np.concatenate([v.experiment.q for v in some])
    plain = unexplained_share(regressors, some, np.ones(channels.n_q))
    if plain < _LEAST:
        return
    angles = [j for j, c in enumerate(channels.coordinates)
              if c.kind == "angular" and any(v.moving[j] for v in some)]  # fmt: skip
    together = list(_unit_of_all(regressors, some, q, angles, plain)) if len(angles) > 1 else []
    if together:
        yield from together
        return
    for j in angles:
        c = channels.coordinates[j]
        tried = _SCALES if channels.n_q <= _FEW_COORDINATES else {k: _SCALES[k] for k in _UNITS}
        shares = {
            name: _scaled_share(regressors, some, q, [j], scale) for name, scale in tried.items()
        }
        best = min(shares, key=lambda name: shares[name])
        if shares[best] > _DROP * plain or shares[best] > 1 - _POOR:
            continue
        evidence = (
            f"its range is {np.ptp(q[:, j]):.3g} rad; gravity fits {1 / _SCALES[best]:.3g} times "
            f"smaller angles: the model leaves {shares[best]:.2%} of the accelerations, not "
            f"{plain:.2%}"
        )
        card = views[0].coordinate_card(c.name)
        if best in _UNITS:
            what, key = f"{c.name} is not in the declared unit", f'unit = "{best}"'
        else:
            counts = card.counts_per_revolution if card is not None else None
            what = f"{c.name} has another scale than declared"
            key = (
                f"counts_per_revolution = {counts / _SCALES[best]:.6g}" if counts
                else f"unit: its numbers are {1 / _SCALES[best]:.3g} times too large"
            )  # fmt: skip
        finding = views[0].finding("angle unit", "severe", what, evidence,
                                   coordinate_line(c.name, key), c.name)  # fmt: skip
        yield replace(finding, records=())


def _unit_of_all(
    regressors: Regressors, views: Sequence[RecordView], q: np.ndarray, angles: list[int],
    plain: float,
) -> Iterator[Finding]:  # fmt: skip
    """Findings that all angles are in another unit, where one alone explains less."""
    shares = {name: _scaled_share(regressors, views, q, angles, _SCALES[name]) for name in _UNITS}
    best = min(shares, key=lambda name: shares[name])
    if shares[best] > _DROP * plain or shares[best] > 1 - _POOR:
        return
    alone = min(_scaled_share(regressors, views, q, [j], _SCALES[best]) for j in angles)
    if shares[best] > _DROP * alone:
        return
    for j in angles:
        name = views[0].experiment.coordinates[j].name
        evidence = (
            f"its range is {np.ptp(q[:, j]):.3g} rad; with all angles {1 / _SCALES[best]:.3g} "
            f"times smaller the model leaves {shares[best]:.2%} of the accelerations, not "
            f"{plain:.2%}"
        )
        finding = views[0].finding(
            "angle unit", "severe", f"{name} is not in the declared unit", evidence,
            coordinate_line(name, f'unit = "{best}"'), name,
        )  # fmt: skip
        yield replace(finding, records=())


def _scaled_share(
    regressors: Regressors, views: Sequence[RecordView], q: np.ndarray, which: list[int],
    scale: float,
) -> float:  # fmt: skip
    """Share of the accelerations that the model leaves where some angles have another scale."""
    scales = np.ones(q.shape[1])
    scales[which] = scale
    at_rest = regressors.held.copy()
    at_rest[which] = np.ptp(q[:, which], axis=0) * scale < _SMALL_RANGE
    scaled = replace(regressors, held=at_rest, creep=regressors.creep * scales)
    first = views[0].experiment
    return unexplained_share(scaled.with_names(first.q[:2], first.u[:2]), views, scales)
