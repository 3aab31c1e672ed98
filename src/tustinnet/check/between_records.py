"""Checks of records against one another: is one reversed, scaled, late, swapped, another machine?

A small model (`motion_model`) is fitted to all files but one and asked of that one. Where it
fails, the samples of the file are changed as a fault would have changed them (`Suspicion`); a
fault is found where the model then holds as it does for the others. Where no change helps, and
parameters of its own do, the file is of another machine, or of one with another payload.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.check.card_lines import (
    coordinate_line,
    file_line,
    input_line,
    top_line,
    without_record,
)
from tustinnet.check.levels import LEVELS
from tustinnet.check.motion_model import (
    Equations,
    MotionModel,
    Regressors,
    Samples,
    delay,
    fit_motion_model,
    make_regressors,
    split_into_blocks,
)
from tustinnet.check.view import RecordView
from tustinnet.data.experiment import Experiment
from tustinnet.data.spoiled import card_entry
from tustinnet.finding import Finding

_OFFSETS = np.array([-1, -0.5, -0.25, -0.1, 0.1, 0.25, 0.5, 1.0])  # of the range
_LAGS = np.array([-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0, 16.0])  # samples
_FACTORS = np.log([0.1, 0.5, 0.8, 1.25, 2.0, 10.0])
_UNITS = np.log([np.pi / 180, 180 / np.pi, 1e3, 1e-3])
_USUAL_GAINS = np.abs([np.log(2), np.log(4), np.log(10), *_UNITS])  # of units, and of counted edges


@dataclass(frozen=True)
class Suspicion:
    """A fault that a record may have, and how its samples look without it.

    Attributes:
        check: name of the check.
        channels: names of the channels.
        undo: samples without a fault of a size.
        sizes: sizes to try, of which 0 is no fault: logarithms of factors, or numbers with a unit;
            a single one of a fault without a number.
        least: smaller sizes are no fault.
    """

    check: str
    channels: tuple[str, ...]
    undo: Callable[[np.ndarray, np.ndarray, float], Samples]
    sizes: Float[np.ndarray, " s"]
    least: float = 0.0

    @property
    def has_number(self) -> bool:
        """Whether faults of this kind have a size."""
        return len(self.sizes) > 1


@dataclass(frozen=True)
class _Verdict:
    """A suspicion that explains a record, its size, and the residual before and after."""

    suspicion: Suspicion
    size: float
    before: float
    after: float


def list_suspicions(
    channels: Channels, ranges: Float[np.ndarray, " n_q"], *, has_times: bool
) -> list[Suspicion]:
    """Faults that a record with some channels may have.

    Args:
        channels: coordinates and inputs.
        ranges: range of each coordinate over all records, (n_q,).
        has_times: whether records have times, so that a slower one is of a slower machine.
    """
    suspicions = []
    for side, listed in enumerate((channels.coordinates, channels.inputs)):
        for j, c in enumerate(listed):
            name, is_input = (c.name,), side == 1
            suspicions += [
                Suspicion("sign", name, _change(side, j, lambda x, _: -x), np.ones(1)),
                Suspicion(
                    "gain",
                    name,
                    _change(side, j, lambda x, size: x * np.exp(size)),
                    np.r_[_FACTORS, _UNITS],
                    LEVELS.gain_of_input if is_input else LEVELS.gain_of_coordinate,
                ),
            ]
            if is_input or channels.n_q > 1:  # of a single coordinate nothing is late
                suspicions.append(
                    Suspicion("lag", name, _change(side, j, delay), _LAGS, LEVELS.lag)
                )
            if not is_input:
                extent = max(float(ranges[j]), 1e-300)
                turn = np.pi / 2 * np.array([-1, 1, 2] if channels.angular[j] else [])
                shift = _change(side, j, np.add)
                sizes = np.r_[extent * _OFFSETS, turn]
                suspicions.append(Suspicion("offset", name, shift, sizes, LEVELS.offset * extent))
        for j, i in combinations(range(len(listed)), 2):
            undo = _change(side, [j, i], lambda x, _: x[:, ::-1])
            suspicions.append(Suspicion("swap", (listed[i].name, listed[j].name), undo, np.ones(1)))
    if not has_times:
        suspicions.append(
            Suspicion(
                "record period", (), lambda q, u, _: (q, u), _FACTORS, LEVELS.period_by_motion
            )
        )
    return suspicions


def _change(
    side: int, columns: int | list[int], change: Callable[[np.ndarray, float], np.ndarray]
) -> Callable[[np.ndarray, np.ndarray, float], Samples]:
    """Changes columns of the positions (side 0) or inputs (side 1) of a record."""

    def undo(q: np.ndarray, u: np.ndarray, size: float) -> Samples:
        arrays = q.copy(), u.copy()
        arrays[side][:, columns] = change(arrays[side][:, columns], size)
        return arrays

    return undo


def compare_records(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Faults of single records that the others show, the clearest first.

    Parts of a file are compared as one: a column is reversed as a whole.

    Args:
        views: records of one machine, of three files at least.
    """
    files: dict[tuple[str, str], list[RecordView]] = {}
    for view in views:
        e = view.experiment  # elements of a MAT file are files of their own
        files.setdefault((e.source or e.name, e.name.partition("[")[2]), []).append(view)
    regressors = make_regressors(views)
    if len(files) < LEVELS.fewest_files or regressors is None:
        return
    ranges = np.median([np.ptp(v.experiment.q, axis=0) for v in views], axis=0)
    card = views[0].card
    suspicions = list_suspicions(
        views[0].experiment.channels, ranges, has_times=card is not None and card.time is not None
    )
    parts = [*files.values()]
    samples = [
        [b for v in file for b in split_into_blocks(v.experiment.q, v.experiment.u)]
        for file in parts
    ]
    equations = [regressors.equations(blocks) for blocks in samples]
    weights = np.ones(len(parts))
    model = fit_motion_model(equations, weights)
    for _ in range(len(parts) // 3):  # of more faulty ones the others are no measure
        verdicts = (
            {
                r: verdict
                for r in _find_suspects(model, suspicions)
                if (verdict := _judge(model, regressors, samples, r, suspicions)) is not None
            }
            if model
            else {}
        )
        if not verdicts:
            break
        r = max(verdicts, key=lambda r: verdicts[r].before / verdicts[r].after)
        yield from (_describe(view, verdicts[r]) for view in parts[r])
        weights[r] = 0.0
        model = fit_motion_model(equations, weights)
    if model is not None:
        yield from _other_machines(model, parts)


def _usual_cost(model: MotionModel, without: int) -> float:
    """The median residual of the other files that are not known to be wrong."""
    cost = model.costs()
    others = (model.weights > 0) & np.isfinite(cost)
    others[without] = False
    return float(np.median(cost[others])) if others.any() else np.inf


def _find_suspects(model: MotionModel, suspicions: Sequence[Suspicion]) -> list[int]:
    """Files that the parameters of the others explain poorly, the poorest first.

    Poor is a residual that is large, or that is a large share of the file's accelerations.
    """
    costs = model.costs()
    known = (model.weights > 0) & np.isfinite(costs)
    if not known.any():
        return []
    shares = costs / np.maximum([model.size(e) for e in model.equations], 1e-300)
    poorness = np.fmax(*(x / max(np.median(x[known]), 1e-300) for x in (costs, shares)))
    suspects = [int(r) for r in np.argsort(-poorness) if known[r] and poorness[r] > LEVELS.poor]
    trials = sum(len(s.sizes) for s in suspicions)
    return suspects[: int(np.clip(LEVELS.most_trials // trials, 2, 4))]


def _judge(
    model: MotionModel,
    regressors: Regressors,
    samples: Sequence[Sequence[Samples]],
    r: int,
    suspicions: Sequence[Suspicion],
) -> _Verdict | None:
    """The fault that explains file r best, None where none does."""
    plain = regressors.equations(samples[r], coarse=2)
    before, accelerations = model.cost(plain, model.others[r]), model.size(plain)

    def undone(suspicion: Suspicion, size: float, file: int = r) -> Equations:
        slow = float(np.exp(size)) if suspicion.check == "record period" else 1.0
        blocks = [suspicion.undo(q, u, size) for q, u in samples[file]]
        return regressors.equations(blocks, 2, slow)

    def is_common(suspicion: Suspicion, size: float) -> bool:
        """Whether most other files fit better without it, too, as without an input's delay."""
        ratios = [
            model.cost(undone(suspicion, size, k), model.others[k]) / cost
            for k, cost in enumerate(model.costs())
            if k != r and model.weights[k] > 0 and np.isfinite(cost)
        ]
        return bool(np.median(ratios) < 1)

    def residual(suspicion: Suspicion, size: float) -> float:
        changed = undone(suspicion, size)
        # smaller accelerations leave smaller residuals: what matters is their share
        share = min(1.0, model.size(changed) / accelerations)
        return model.cost(changed, model.others[r]) / max(share, 1e-12)

    verdicts: list[_Verdict] = []
    for suspicion in suspicions:
        cost = partial(residual, suspicion)
        after, size = min((cost(float(size)), float(size)) for size in suspicion.sizes)
        if suspicion.has_number and after < LEVELS.promising * before:
            after, size = min((after, size), _refine(cost, suspicion.sizes, size))
        if after > LEVELS.drop * before or abs(size) < suspicion.least:
            continue
        changed = undone(suspicion, size)
        # energetic motion leaves more, whatever is right about its record
        allowed = min(
            max(LEVELS.usual * _usual_cost(model, r), LEVELS.clear * before),
            LEVELS.unexplained * model.size(changed),
        )
        # a size can be chosen so that motion beyond that of the others fits by chance
        is_extrapolated = suspicion.has_number and model.novelty(changed, r) > LEVELS.novel
        if (
            model.cost(changed, model.others[r]) < allowed
            and not is_extrapolated
            and not is_common(suspicion, size)
        ):
            verdicts.append(_Verdict(suspicion, size, before, after))
    # a fault with a number must explain a record so much better than one without
    return min(
        verdicts,
        key=lambda v: v.after * (1.0 if v.suspicion.has_number else LEVELS.clearer),
        default=None,
    )


def _refine(cost: Callable[[float], float], sizes: np.ndarray, size: float) -> tuple[float, float]:
    """The smallest cost near the best size that was tried, and its size, by golden sections."""
    grid = np.sort(np.append(sizes, 0.0))
    at = int(np.searchsorted(grid, size))
    low, high = float(grid[max(at - 1, 0)]), float(grid[min(at + 1, len(grid) - 1)])
    share = (np.sqrt(5) - 1) / 2
    for _ in range(8):
        left, right = high - share * (high - low), low + share * (high - low)
        low, high = (low, right) if cost(left) < cost(right) else (left, high)
    return cost((low + high) / 2), (low + high) / 2


def _describe(view: RecordView, verdict: _Verdict) -> Finding:
    """The finding of a fault in a record."""
    e, check, size = view.experiment, verdict.suspicion.check, verdict.size
    names = verdict.suspicion.channels
    name = names[0] if names else ""
    channel = next((c for c in (*e.coordinates, *e.inputs) if c.name == name), None)
    is_input = channel in e.inputs
    factor, dt, values = float(np.exp(size)), e.dt, dict[str, Any]()
    if check == "sign":
        key = "sign = -1"
    elif check == "swap":
        key = f"exchange `column` with that of {names[1]}"
        values.update(channels=names)
    elif check == "gain":
        is_usual = np.abs(_USUAL_GAINS - abs(size)).min() < LEVELS.gain_of_coordinate
        values.update(gain=1 / factor, may_be_machine=not is_usual)
        key = f"scale = {factor:.4g}" if is_input else _gain_key(view, name, factor)
    elif check == "offset" and channel is not None:
        values.update(offset=-size, unit=channel.unit)
        block = view.channel_card(name)
        scale = block.factor() * block.sign if block else 1.0
        key = f"offset = {(block.offset if block else 0.0) - size / scale:.4g}"
    elif check == "lag":
        # what must be delayed to fit came too early
        values.update(direction="early" if size > 0 else "late")
        values.update(milliseconds=1e3 * abs(size) * dt, samples=abs(size))
        key = f"delay = {size * dt:.3g}" if is_input else ""
    else:
        values.update(milliseconds=1e3 * factor * dt, declared=1e3 * dt)
        key = f"dt = {factor * dt:.4g}"
    if values.get("may_be_machine"):
        mend = _of_other_machine(e)
    elif key:
        line = (input_line if is_input else coordinate_line)(name, key) if name else top_line(key)
        mend = f"in a card of its own, {line}"
    else:
        mend = without_record(e)
    return view.finding(
        check,
        mend,
        name,
        residual=verdict.after / verdict.before,
        **values,
    )


def _gain_key(view: RecordView, name: str, factor: float) -> str:
    """The key of a coordinate that changes its positions by a factor."""
    block = view.channel_card(name)
    if block is not None and block.unit == "counts":
        if block.counts_per_revolution:
            return f"counts_per_revolution = {block.counts_per_revolution / factor:.6g}"
        return f"resolution = {factor * (block.resolution or 1.0):.6g}"
    for unit, other in (("deg", np.pi / 180), ("rad", 180 / np.pi)):
        if abs(factor / other - 1) < LEVELS.same_unit:
            return f'unit = "{unit}"'
    return f"scale = {factor * (block.scale if block else 1.0):.4g}"


def _of_other_machine(e: Experiment) -> str:
    """The line of the card by which a record has parameters of its own."""
    return file_line(e, card_entry(e, 0, len(e), {"machine": "other"}))


def _other_machines(model: MotionModel, files: Sequence[Sequence[RecordView]]) -> Iterator[Finding]:
    """Files that parameters of their own explain, and those of the others do not."""
    cost = model.costs()
    for r, views in enumerate(files):
        usual, own = _usual_cost(model, r), model.cost(model.equations[r], model.own[r])
        if (
            model.weights[r] > 0
            and cost[r] > LEVELS.poorer * usual
            and own < min(LEVELS.usual * usual, LEVELS.drop * cost[r])
            and model.novelty(model.equations[r], r) < LEVELS.novel_machine
        ):
            for view in views:
                yield view.finding(
                    "other machine",
                    _of_other_machine(view.experiment),
                    of_others=cost[r] / usual,
                    of_own=own / usual,
                )
