"""Checks of records against one another: is one reversed, scaled, late, swapped, another machine?

A small model (`motion_model`) is fitted to all files but one and asked of that one. Where it
fails, the samples of the file are changed as a fault would have changed them (`Suspicion`); a
fault is found where the model then holds as it does for the others. Where no change helps, and
parameters of its own do, the file is of another machine, or of one with another payload.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import PurePath
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.check.card_lines import (
    coordinate_line,
    file_line,
    input_line,
    top_line,
    unit_key,
    without_record,
)
from tustinnet.check.levels import LEVELS
from tustinnet.check.motion_model import (
    Equations,
    MotionModel,
    Regressors,
    fit_motion_model,
    make_regressors,
    split_into_blocks,
)
from tustinnet.check.view import RecordView
from tustinnet.data.card import CoordinateCard
from tustinnet.data.experiment import Experiment
from tustinnet.data.spoiled import card_entry
from tustinnet.finding import Finding

_OFFSETS = np.array([-1, -0.5, -0.25, -0.1, 0.1, 0.25, 0.5, 1.0])  # of the range
_LAGS = np.array([-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0, 16.0])  # samples
_FACTORS = np.log([0.1, 0.5, 0.8, 1.25, 2.0, 10.0])
_UNITS = np.log([np.pi / 180, 180 / np.pi, 1e3, 1e-3])
_USUAL_GAINS = np.abs([np.log(2), np.log(4), np.log(10), *_UNITS])  # of units, and of counted edges

Samples = Float[np.ndarray, "n c"]  # of coordinates and inputs


@dataclass(frozen=True)
class Suspicion:
    """A fault that a record may have, and how its samples look without it.

    Attributes:
        check: name of the check.
        columns: the columns of the samples that have it; none where times are wrong.
        remove: the columns without a fault of a size.
        sizes: sizes to try, of which 0 is no fault: logarithms of factors, or numbers with a unit;
            a single one of a fault without a number.
    """

    check: str
    columns: list[int]
    remove: Callable[[Samples, float], Samples]
    sizes: Float[np.ndarray, " s"]

    @property
    def has_number(self) -> bool:
        """Whether faults of this kind have a size."""
        return len(self.sizes) > 1

    def undo(self, samples: Samples, size: float) -> Samples:
        """Samples without a fault of a size."""
        changed = samples.copy()
        changed[:, self.columns] = self.remove(samples[:, self.columns], size)
        return changed

    def best_size(self, cost: Callable[[float], float], enough: float) -> tuple[float, float]:
        """The smallest cost of all sizes, and its size.

        Args:
            cost: cost of a size.
            enough: cost from which on sizes between those to try are tried, too.
        """
        best = min((cost(size), size) for size in self.sizes.tolist())
        if self.has_number and best[0] < enough:
            step = np.partition(np.abs(np.append(self.sizes, 0.0) - best[1]), 2)[2]
            for _ in range(8):
                step /= 2
                sizes = (best[1] - step, best[1] + step)
                best = min(best, *((cost(float(size)), float(size)) for size in sizes))
        return best


@dataclass(frozen=True)
class _Verdict:
    """A suspicion that explains a record, its size, and the residual before and after."""

    suspicion: Suspicion
    size: float
    before: float
    after: float

    @property
    def may_be_machine(self) -> bool:
        """Whether another machine or payload does the same: a gain that is none of a unit."""
        is_usual = np.abs(_USUAL_GAINS - abs(self.size)).min() < LEVELS.usual_gain
        return self.suspicion.check == "gain" and not bool(is_usual)


def list_suspicions(
    channels: Channels, ranges: Float[np.ndarray, " n_q"], *, has_times: bool
) -> list[Suspicion]:
    """Faults that a record with some channels may have.

    Args:
        channels: coordinates and inputs.
        ranges: range of each coordinate over all records, (n_q,).
        has_times: whether records have times, so that a slower one is of a slower machine.
    """
    n_q, n, one = channels.n_q, channels.n_q + len(channels.inputs), np.ones(1)
    suspicions = []
    for k in range(n):
        is_input = k >= n_q
        suspicions += [
            Suspicion("sign", [k], lambda x, _: -x, one),
            Suspicion("gain", [k], lambda x, size: x * np.exp(size), np.r_[_FACTORS, _UNITS]),
        ]
        if is_input or n_q > 1:  # of a single coordinate nothing is late
            suspicions.append(Suspicion("lag", [k], _delay, _LAGS))
        if not is_input:
            turns = np.pi / 2 * np.array([-1, 1, 2] if channels.angular[k] else [])
            suspicions.append(Suspicion("offset", [k], np.add, np.r_[ranges[k] * _OFFSETS, turns]))
    pairs = [*combinations(range(n_q), 2), *combinations(range(n_q, n), 2)]
    suspicions += [Suspicion("swap", [j, i], lambda x, _: x[:, ::-1], one) for i, j in pairs]
    if not has_times:
        suspicions.append(Suspicion("record period", [], lambda x, _: x, _FACTORS))
    return suspicions


def _delay(columns: Samples, samples: float) -> Samples:
    """A column that is later by some samples, its ends held."""
    k = np.arange(len(columns))
    return np.interp(k - samples, k, columns[:, 0])[:, None]


def compare_records(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Faults of single records that the others show, the clearest first.

    Parts of a file are compared as one: a column is reversed as a whole.

    Args:
        views: records of one machine, of three files at least.
    """
    regressors = make_regressors(views)
    if regressors is None:
        return
    files: dict[tuple[str, str], list[RecordView]] = {}
    for view in views:
        e = view.experiment  # elements of a MAT file are files of their own
        files.setdefault((e.source or e.name, e.name.partition("[")[2]), []).append(view)
    parts, samples, equations = [], [], []
    for file in files.values():
        blocks = [block for view in file for block in split_into_blocks(view.samples)]
        equation = regressors.equations(blocks)
        if len(equation.left) >= LEVELS.fewest_windows:
            parts, samples = [*parts, file], [*samples, blocks]
            equations.append(equation)
    windows = sum(len(e.left) for e in equations)
    if len(parts) < LEVELS.fewest_files or windows < 3 * equations[0].right.shape[1]:
        return
    ranges = np.median([np.ptp(v.experiment.q, axis=0) for v in views], axis=0)
    card = views[0].card
    suspicions = list_suspicions(
        views[0].experiment.channels, ranges, has_times=card is not None and card.time is not None
    )
    weights = np.ones(len(parts))
    model = fit_motion_model(equations, weights)
    for _ in range(len(parts) // 3):  # of more faulty ones the others are no measure
        verdicts = {
            r: verdict
            for r in _find_suspects(model)
            if (verdict := _judge(model, regressors, samples, r, suspicions)) is not None
        }
        if not verdicts:
            break
        r = max(verdicts, key=lambda r: verdicts[r].before / verdicts[r].after)
        if not (verdicts[r].may_be_machine and _is_in_other_groups(parts[r], parts)):
            yield from (_describe(view, verdicts[r]) for view in parts[r])
        weights[r] = 0.0
        model = fit_motion_model(equations, weights)
    yield from _other_machines(model, parts)


def _find_suspects(model: MotionModel) -> list[int]:
    """Files that the parameters of the others explain poorly, the poorest first.

    Poor is a residual that is large, or that is a large share of the file's accelerations.
    """
    is_sound = model.weights > 0
    shares = model.costs / np.maximum([model.size(e) for e in model.equations], 1e-300)
    poorness = np.fmax(*(x / max(np.median(x[is_sound]), 1e-300) for x in (model.costs, shares)))
    suspects = [int(r) for r in np.argsort(-poorness) if is_sound[r] and poorness[r] > LEVELS.poor]
    return suspects[: LEVELS.most_suspects]


def _judge(
    model: MotionModel,
    regressors: Regressors,
    samples: Sequence[Sequence[Samples]],
    r: int,
    suspicions: Sequence[Suspicion],
) -> _Verdict | None:
    """The fault that explains file r best, None where none does."""
    plain = regressors.equations(samples[r], coarse=2)
    before = model.cost(plain, model.others[r])

    def undone(suspicion: Suspicion, size: float, file: int = r) -> Equations:
        slow = 1.0 if suspicion.columns else float(np.exp(size))
        return regressors.equations([suspicion.undo(x, size) for x in samples[file]], 2, slow)

    def is_common(suspicion: Suspicion, size: float) -> bool:
        """Whether most other files fit better without it, too, as without an input's delay."""
        ratios = [
            model.cost(undone(suspicion, size, k), model.others[k]) / model.costs[k]
            for k in np.flatnonzero(model.weights).tolist()
            if k != r
        ]
        return bool(np.median(ratios) < 1)

    def verdict_of(suspicion: Suspicion) -> _Verdict | None:
        def relative_cost(size: float) -> float:
            changed = undone(suspicion, size)
            # smaller accelerations leave smaller residuals: what matters is their share
            share = min(1.0, model.size(changed) / model.size(plain))
            return model.cost(changed, model.others[r]) / max(share, 1e-12)

        after, size = suspicion.best_size(relative_cost, LEVELS.promising * before)
        if after > LEVELS.drop * before:
            return None
        changed = undone(suspicion, size)
        # energetic motion leaves more, whatever is right about its record
        allowed = min(
            max(LEVELS.usual * model.usual_cost(r), LEVELS.clear * before),
            LEVELS.unexplained * model.size(changed),
        )
        # a size can be chosen so that motion beyond that of the others fits by chance
        is_extrapolated = suspicion.has_number and model.novelty(changed, r) > LEVELS.novel
        is_explained = model.cost(changed, model.others[r]) < allowed and not is_extrapolated
        if not is_explained or is_common(suspicion, size):
            return None
        return _Verdict(suspicion, size, before, after)

    verdicts = [verdict for s in suspicions if (verdict := verdict_of(s)) is not None]
    # a fault with a number must explain a record so much better than one without
    return min(
        verdicts,
        key=lambda v: v.after * (1.0 if v.suspicion.has_number else LEVELS.clearer),
        default=None,
    )


def _describe(view: RecordView, verdict: _Verdict) -> Finding:
    """The finding of a fault in a record."""
    e, check, size = view.experiment, verdict.suspicion.check, verdict.size
    channels = [(*e.coordinates, *e.inputs)[k] for k in verdict.suspicion.columns]
    name = channels[0].name if channels else ""
    is_input = bool(channels) and channels[0] in e.inputs
    block = view.channel_card(name)
    factor, key, values = float(np.exp(size)), "", dict[str, Any]()
    mend = without_record(e)
    if check == "sign":
        key = f"sign = {-block.sign if block else -1}"
    elif check == "swap":
        key = f"exchange `column` with that of {channels[1].name}"
        values.update(channels=[c.name for c in channels])
    elif check == "gain":
        values.update(gain=1 / factor, may_be_machine=verdict.may_be_machine)
        key = "" if verdict.may_be_machine else _gain_key(view, name, factor)
        mend = _of_other_machine(e)
    elif check == "offset":
        values.update(offset=-size, unit=channels[0].unit)
        scale = block.factor() * block.sign if isinstance(block, CoordinateCard) else 1.0
        key = f"offset = {(block.offset if block else 0.0) - size / scale:.4g}"
    elif check == "lag":
        # what must be delayed to fit came too early
        directions = ("early", "late") if size > 0 else ("late", "early")
        # against the input a single coordinate is as much late as this is early
        alone = len(e.coordinates) == 1
        values.update(direction=directions[0], opposite=directions[1], alone=alone)
        values.update(milliseconds=1e3 * abs(size) * e.dt, samples=abs(size))
        if is_input:
            declared = next(i.delay for i in e.inputs if i.name == name) or 0.0
            key = f"delay = {declared + size * e.dt:.3g}"
    else:
        values.update(milliseconds=1e3 * factor * e.dt, declared=1e3 * e.dt)
        mend = f"in a card of its own, {top_line(f'dt = {factor * e.dt:.4g}')}"
    if key:
        mend = f"in a card of its own, {(input_line if is_input else coordinate_line)(name, key)}"
    return view.finding(check, mend, name, residual=verdict.after / verdict.before, **values)


def _gain_key(view: RecordView, name: str, factor: float) -> str:
    """The key of a channel that changes its samples by a factor."""
    block = view.channel_card(name)
    if isinstance(block, CoordinateCard):
        if block.unit == "counts" and block.counts_per_revolution:
            return f"counts_per_revolution = {block.counts_per_revolution / factor:.6g}"
        if block.unit == "counts":
            return f"resolution = {factor * (block.resolution or 1.0):.6g}"
        if unit := unit_key(block, factor):
            return unit
    return f"scale = {factor * (block.scale if block else 1.0):.4g}"


def _of_other_machine(e: Experiment) -> str:
    """The line of the card by which a record has parameters of its own."""
    if PurePath(e.source).stem == e.name:
        return file_line(e, card_entry(e, 0, len(e), {"machine": "other"}))
    # a part of a file keeps what its entry says
    return f'in the entry of {e.name}: groups = {{ "machine" = "other" }}'


def _is_in_other_groups(file: Sequence[RecordView], files: Sequence[Sequence[RecordView]]) -> bool:
    """Whether the card has a file in other groups than most."""
    groups = Counter(part[0].experiment.groups for part in files)
    return file[0].experiment.groups != groups.most_common(1)[0][0]


def _other_machines(model: MotionModel, files: Sequence[Sequence[RecordView]]) -> Iterator[Finding]:
    """Files that parameters of their own explain, and those of the others do not."""
    for r in np.flatnonzero(model.weights).tolist():
        equations, usual = model.equations[r], model.usual_cost(r)
        of_others, of_own = model.costs[r], model.cost(equations, model.own[r])
        if (
            of_others > LEVELS.poorer * usual
            and of_own < min(LEVELS.usual * usual, LEVELS.drop * of_others)
            and model.novelty(equations, r) < LEVELS.novel
            and not _is_in_other_groups(files[r], files)
        ):
            for view in files[r]:
                yield view.finding(
                    "other machine",
                    _of_other_machine(view.experiment),
                    of_others=of_others / usual,
                    of_own=of_own / usual,
                )
