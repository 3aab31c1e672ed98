"""Check of the scale of an angle by gravity, whose force has the period of a turn.

Sines of an angle in degrees, or of one whose encoder has other counts in a turn than declared, fit
the motion worse than those of the true angle. They are compared beside polynomials of the angle,
so that a spring, or a controller that holds a position, is no gravity. Small swings do not tell
the scale: their sine is a polynomial.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tustinnet.check.card_lines import coordinate_line
from tustinnet.check.levels import LEVELS
from tustinnet.check.motion_model import make_regressors, unexplained_share
from tustinnet.check.view import RecordView
from tustinnet.data.units import ANGLE
from tustinnet.finding import Finding

_RECORDS = 5  # of them, from everywhere in the list
_UNITS = {unit: ANGLE[unit] for unit in ("deg", "rad")}


@dataclass(frozen=True)
class ScaleOfAngle:
    """Another scale of an angle, as a key of its block in the card.

    Attributes:
        index: the coordinate.
        key: `unit` or `counts_per_revolution`.
        value: the value of the key.
        factor: of the true angle to the declared one.
    """

    index: int
    key: str
    value: str
    factor: float


@dataclass(frozen=True)
class Evidence:
    """Other scales of one or all angles, with which a model explains the motion far better.

    Attributes:
        scales: the scales.
        before: share of the accelerations that the model leaves with the declared ones.
        after: the share that it leaves with these.
    """

    scales: tuple[ScaleOfAngle, ...]
    before: float
    after: float


def scale_of_angles(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Angles that gravity, or another force with the period of a turn, shows in another scale."""
    evidence = find_scale_of_angles(views)
    if evidence is None:
        return
    for scale in evidence.scales:
        name = views[0].experiment.coordinates[scale.index].name
        extent = np.ptp(np.concatenate([v.experiment.q[:, scale.index] for v in views]))
        is_unit = scale.key == "unit"
        value = json.dumps(scale.value) if is_unit else scale.value
        yield views[0].finding(
            "angle unit" if is_unit else "angle scale",
            coordinate_line(name, f"{scale.key} = {value}"),
            name,
            severity="severe" if is_unit else "warning",
            extent=extent,
            factor=scale.factor,
            after=evidence.after,
            before=evidence.before,
            is_of_all=True,
        )


def find_scale_of_angles(views: Sequence[RecordView]) -> Evidence | None:
    """Another scale of an angle, or another unit of all angles, that gravity shows.

    Args:
        views: records of a machine.
    """
    some = views[:: max(1, len(views) // _RECORDS)][:_RECORDS]
    regressors = make_regressors(some)
    if regressors is None:
        return None
    n_q = regressors.channels.n_q
    regressors = replace(regressors, held=np.ones(n_q, bool))

    def share(scales: Sequence[ScaleOfAngle]) -> float:
        factors = np.ones(n_q)
        factors[[s.index for s in scales]] = [s.factor for s in scales]
        scaled = replace(regressors, creep=regressors.creep * factors)
        return unexplained_share(scaled, some, factors)

    before = share(())
    if before < LEVELS.least_by_scale:
        return None
    alone = [s for j in range(n_q) for s in _other_scales(some, j)]
    groups = [tuple(s for s in alone if s.value == unit) for unit in _UNITS]
    shares = {trial: share(trial) for trial in (*((s,) for s in alone), *filter(None, groups))}
    # several angles are of another unit where that explains far more than that of one
    chosen = min(
        shares, key=lambda t: shares[t] / (LEVELS.drop_by_scale if len(t) > 1 else 1), default=()
    )
    after = shares.get(chosen, 1.0)
    clear = min(LEVELS.drop_by_scale * before, before - LEVELS.least_by_scale)
    return Evidence(chosen, before, after) if after < clear else None


def _other_scales(views: Sequence[RecordView], j: int) -> Iterator[ScaleOfAngle]:
    """Scales of an angle other than the declared one, with which it does not turn too fast."""
    c = views[0].experiment.coordinates[j]
    card = views[0].coordinate_card(j)
    if c.kind != "angular" or not any(v.moving[j] for v in views) or (card and card.sine):
        return
    if card is None or card.unit != "counts":
        declared = card.factor() / card.scale if card else 1.0
        scales = [ScaleOfAngle(j, "unit", u, factor / declared) for u, factor in _UNITS.items()]
    else:
        counts, key = card.counts_per_revolution, "counts_per_revolution"
        # edges that are counted or not
        times = (2.0, 0.5, 4.0, 0.25) if counts else ()
        scales = [ScaleOfAngle(j, key, f"{x * (counts or 0):.6g}", 1 / x) for x in times]
    for scale in scales:
        is_declared = abs(scale.factor - 1) < 1e-6
        if not (is_declared or any(v.wild_share(j, scale.factor) for v in views)):
            yield scale
