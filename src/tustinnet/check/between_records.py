"""Checks of records against one another: is one reversed, scaled, late, swapped, another machine?

A small model (`motion_model`) is fitted to all records but one and asked of that one. Where it
fails, the samples of the record are changed as a fault would have changed them (`Suspicion`); a
fault is found where the model then holds as it does for the others. Where no change helps, and
other parameters do, the record is of a machine with another payload or friction.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.check.card_lines import (
    coordinate_line,
    file_line,
    input_line,
    times_too_large,
    top_line,
    without_record,
)
from tustinnet.check.finding import Finding
from tustinnet.check.motion_model import (
    Equations,
    MotionModel,
    delay,
    fit_motion_model,
    has_windows,
    make_regressors,
    split_into_blocks,
    stride_for,
)
from tustinnet.check.view import RecordView

_FEWEST_RECORDS = 3
_FEWEST_SUSPECTS, _MOST_SUSPECTS, _MOST_TRIALS = 2, 4, 400
_MOST_FAULTY = 1 / 3  # of the records
_POOR = 2.0  # times the usual residual: a record that is worth a closer look
_GAIN_DROP = 0.2  # the same, of a gain, which the curve of an actuator looks like
_DROP = 0.3  # of the residual, which a fault of a record leaves when it is undone
_USUAL = 3.0  # times the usual residual of the others: so well the model must hold then
_CLEAR = 0.04  # of the residual: a drop that leaves no doubt
_EXPLAINED = 0.3  # of the accelerations, at least, by the model when a fault is undone
_CLEARER = 0.7  # a fault with a number must explain a record so much better than one without
_PROMISING = 0.75  # of the residual: a size worth refining
_COMMON = 0.9  # of the usual residual, by which a delay in all records makes it smaller
_OTHER_MACHINE = 0.4  # of the residual, which other parameters leave
_OTHER_FACTOR, _OTHER_RATIO = np.log(1.6), np.log(2.0)  # of forces, and between two of them
_POORER = 3.0  # times the usual residual, at least, of a record of another machine
_NOVEL, _NOVEL_MACHINE = 4.0, 2.0  # times the others' motion: farther out the model extrapolates
_COARSE = 2  # times the stride of the fit: windows of a suspicion
_GOLDEN = 8  # steps of the search for a number

_LAGS = np.array([-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0, 16.0])  # samples
_GAINS = np.array([0.1, 0.5, 0.8, 1.25, 2.0, 10.0])
_UNITS = np.array([np.pi / 180, 180 / np.pi, 1e3, 1e-3])
_PERIODS = np.array([0.1, 0.5, 0.8, 1.25, 2.0, 10.0])
_FORCES = {
    "position": "gravity and springs",
    "input": "inputs",
    "velocity": "friction",
    "speed product": "centrifugal forces",
}

Arrays = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Suspicion:
    """A fault that a record may have, and how its samples look without it.

    Attributes:
        check: name of the check.
        channels: names of the channels.
        undo: samples (positions, inputs) without a fault of a size.
        sizes: sizes to try; a single one of a fault without a number.
        least: sizes that are nearer than this to `none` are no fault.
        none: the size of no fault.
        is_relative: whether sizes are factors.
        is_period: whether the size is a factor of the period; the samples stay.
    """

    check: str
    channels: tuple[str, ...]
    undo: Callable[[np.ndarray, np.ndarray, float], Arrays]
    sizes: Float[np.ndarray, " s"]
    least: float = 0.0
    none: float = 0.0
    is_relative: bool = False
    is_period: bool = False

    @property
    def has_number(self) -> bool:
        """Whether faults of this kind have a size."""
        return len(self.sizes) > 1

    def distance(self, size: float) -> float:
        """How far a size is from that of no fault."""
        if self.is_relative:
            return abs(float(np.log(abs(size) / self.none)))
        return abs(size - self.none)


@dataclass(frozen=True)
class _Verdict:
    """A suspicion that explains a record, its size, and the residual before and after."""

    suspicion: Suspicion
    size: float
    before: float
    after: float


def list_suspicions(channels: Channels, ranges: Float[np.ndarray, " n_q"]) -> list[Suspicion]:
    """Faults that a record with some channels may have.

    Args:
        channels: coordinates and inputs.
        ranges: range of each coordinate over all records, (n_q,).
    """
    suspicions = []
    for j, c in enumerate(channels.coordinates):
        extent = max(float(ranges[j]), 1e-300)
        offsets = extent * np.array([-1, -0.5, -0.25, -0.1, 0.1, 0.25, 0.5, 1.0])
        if c.kind == "angular":
            offsets = np.r_[offsets, np.pi / 2 * np.array([-1, 1, 2])]
        shift = Suspicion("offset", (c.name,), _change(0, j, np.add), offsets, 0.03 * extent)
        suspicions += [
            *_scales(c.name, 0, j, np.r_[_GAINS, _UNITS], 0.08),
            shift,
            *_delays(c.name, 0, j)[: channels.n_q - 1],  # of a single one nothing is late
        ]
    for k, i in enumerate(channels.inputs):
        suspicions += _scales(i.name, 1, k, np.r_[_GAINS, 1e3, 1e-3], 0.15)
        suspicions += _delays(i.name, 1, k)
    for side, listed in enumerate((channels.coordinates, channels.inputs)):
        for j, i in combinations(range(len(listed)), 2):
            undo = _change(side, [j, i], lambda x, _: x[:, ::-1])
            names = (listed[i].name, listed[j].name)
            suspicions.append(Suspicion("swap", names, undo, np.ones(1)))
    suspicions.append(
        Suspicion(
            "record period",
            (),
            lambda q, u, _: (q, u),
            _PERIODS,
            0.02,
            1.0,
            is_relative=True,
            is_period=True,
        )
    )
    return suspicions


def _scales(
    name: str, side: int, column: int, sizes: Float[np.ndarray, " s"], least: float
) -> list[Suspicion]:
    """Another sign and another gain of a channel."""
    undo = _change(side, column, np.multiply)
    return [
        Suspicion("sign", (name,), undo, np.array([-1.0])),
        Suspicion("gain", (name,), undo, sizes, least, 1.0, is_relative=True),
    ]


def _delays(name: str, side: int, column: int) -> list[Suspicion]:
    """A delay of a channel."""
    return [Suspicion("lag", (name,), _change(side, column, delay), _LAGS, 0.7)]


def _change(
    side: int, columns: int | list[int], change: Callable[[np.ndarray, float], np.ndarray]
) -> Callable[[np.ndarray, np.ndarray, float], Arrays]:
    """Changes columns of the positions (side 0) or inputs (side 1) of a record."""

    def undo(q: np.ndarray, u: np.ndarray, size: float) -> Arrays:
        arrays = q.copy(), u.copy()
        arrays[side][:, columns] = change(arrays[side][:, columns], size)
        return arrays

    return undo


def compare_records(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Faults of single records that the others show, the clearest first.

    Args:
        views: records of one machine, three at least.
    """
    if len(views) < _FEWEST_RECORDS:
        return
    regressors = make_regressors(views)
    if regressors is None:
        return
    ranges = np.median([np.ptp(v.experiment.q, axis=0) for v in views], axis=0)
    suspicions = list_suspicions(views[0].experiment.channels, ranges)
    weights = np.ones(len(views))
    model = fit_motion_model(regressors, views, weights)
    remaining = max(1, int(_MOST_FAULTY * len(views)))
    while model is not None and remaining:
        verdicts = {
            r: verdict
            for r in _find_suspects(model, suspicions)
            if (verdict := _judge(model, views[r], r, suspicions)) is not None
        }
        verdicts = {r: v for r, v in verdicts.items() if _has_whole_file(r, verdicts, views)}
        if not verdicts:
            break
        r = max(verdicts, key=lambda r: verdicts[r].before / verdicts[r].after)
        delayed = _delay_everywhere(model, views, verdicts[r])
        if delayed is not None:
            yield _common_delay(views, verdicts[r])
            model = delayed
            remaining -= 1
            continue
        yield _describe(views[r], verdicts[r])
        remaining -= 1
        weights[r] = 0.0
        model = fit_motion_model(model.regressors, views, weights)
    if model is not None:
        yield from _other_machines(model, views)


def _has_whole_file(r: int, verdicts: Mapping[int, _Verdict], views: Sequence[RecordView]) -> bool:
    """Whether all parts of a record's file have its fault: a column is reversed as a whole."""
    fault, source = verdicts[r].suspicion, views[r].experiment.source
    parts = [k for k, view in enumerate(views) if source and view.experiment.source == source]
    faults = [verdicts[k].suspicion if k in verdicts else None for k in parts]
    return all(
        f is not None and (f.check, f.channels) == (fault.check, fault.channels) for f in faults
    )


def _delay_everywhere(
    model: MotionModel, views: Sequence[RecordView], verdict: _Verdict
) -> MotionModel | None:
    """The model with the delay of an input in all records, None where it holds no better so."""
    names = [i.name for i in views[0].experiment.inputs]
    name = verdict.suspicion.channels[0] if verdict.suspicion.channels else ""
    if verdict.suspicion.check != "lag" or name not in names or verdict.size <= 0:
        return None
    regressors = model.regressors.with_delay(names.index(name), verdict.size)
    delayed = fit_motion_model(regressors, views, model.weights)
    if delayed is None:
        return None
    before, after = (
        np.mean(
            [
                np.mean((e.left - e.right @ p) ** 2 / model.noise**2)
                for e, p, w in zip(m.equations, m.others, m.weights, strict=True)
                if w > 0
            ]
        )
        for m in (model, delayed)
    )
    medians = [np.median(np.square(m.noise) / np.square(model.noise)) for m in (model, delayed)]
    return delayed if after < before and medians[1] < _COMMON * medians[0] else None


def _costs(model: MotionModel) -> Float[np.ndarray, " r"]:
    """Residual of each record under the parameters of the others, not finite where too short."""
    return np.array(
        [
            model.cost(e, p) if has_windows(e) else np.nan
            for e, p in zip(model.equations, model.others, strict=True)
        ]
    )


def _usual_cost(model: MotionModel, without: int) -> float:
    """The median residual of the other records that are not known to be wrong."""
    cost = _costs(model)
    others = (model.weights > 0) & np.isfinite(cost)
    others[without] = False
    return float(np.median(cost[others])) if others.any() else np.inf


def _find_suspects(model: MotionModel, suspicions: Sequence[Suspicion]) -> list[int]:
    """Records that the parameters of the others explain poorly, the poorest first.

    Poor is a residual that is large, or that is a large share of the record's accelerations.
    """
    poorness = np.zeros(len(model.equations))
    shares = np.array(
        [
            1 - model.explained(e, p) if has_windows(e) else np.nan
            for e, p in zip(model.equations, model.others, strict=True)
        ]
    )
    for value in (_costs(model), shares):
        known = np.isfinite(value) & (model.weights > 0)
        if known.sum() > 1:
            poorness = np.fmax(poorness, value / max(float(np.median(value[known])), 1e-300))
    suspects = [
        int(r) for r in np.argsort(-poorness) if model.weights[r] > 0 and poorness[r] > _POOR
    ]
    trials = sum(len(s.sizes) for s in suspicions)
    return suspects[: int(np.clip(_MOST_TRIALS // trials, _FEWEST_SUSPECTS, _MOST_SUSPECTS))]


def _judge(
    model: MotionModel, view: RecordView, r: int, suspicions: Sequence[Suspicion]
) -> _Verdict | None:
    """The fault that explains a record best, None where none does."""
    e, parameters = view.experiment, model.others[r]
    usual = _usual_cost(model, r)

    def equations(suspicion: Suspicion | None, size: float) -> Equations:
        q, u, scale = e.q, e.u, 1.0
        if suspicion is not None:
            q, u = suspicion.undo(q, u, size)
            scale = size if suspicion.is_period else 1.0
        blocks = split_into_blocks(q, u)
        return model.regressors.equations(blocks, _COARSE * stride_for(blocks), scale)

    plain = equations(None, 0.0)
    before = model.cost(plain, parameters)
    verdicts: list[_Verdict] = []
    for suspicion in suspicions:

        def cost(size: float, suspicion: Suspicion = suspicion) -> float:
            changed = equations(suspicion, size)
            # smaller accelerations leave smaller residuals: what matters is their share
            return model.cost(changed, parameters) / _shrinkage(suspicion, changed, plain)

        costs = [cost(float(size)) for size in suspicion.sizes]
        best = int(np.argmin(costs))
        size, after = float(suspicion.sizes[best]), costs[best]
        if after > _PROMISING * before:
            continue
        if suspicion.has_number:
            size, after = _refine(cost, suspicion, best, after)
            if suspicion.distance(size) < suspicion.least:
                continue
        changed = equations(suspicion, size)
        # energetic motion leaves more, whatever is right about its record
        allowed = max(_USUAL * usual, _CLEAR * before)
        drop = _GAIN_DROP if suspicion.check == "gain" else _DROP
        # a size can be chosen so that motion beyond that of the others fits by chance
        is_extrapolated = suspicion.has_number and model.novelty(changed, r) > _NOVEL
        if (
            after < drop * before
            and model.cost(changed, parameters) < allowed
            and model.explained(changed, parameters) > _EXPLAINED
            and not is_extrapolated
        ):
            verdicts.append(_Verdict(suspicion, size, before, after))
    if not verdicts:
        return None
    best_verdict = min(verdicts, key=lambda v: v.after)
    simple = [v for v in verdicts if not v.suspicion.has_number]
    if simple:
        simplest = min(simple, key=lambda v: v.after)
        if best_verdict.after > _CLEARER * simplest.after:
            return simplest
    return best_verdict


def _shrinkage(suspicion: Suspicion, changed: Equations, plain: Equations) -> float:
    """Mean square accelerations of a changed record over those before, at most 1."""
    if not suspicion.is_relative:
        return 1.0
    after, before = (np.mean(e.left**2, axis=0) for e in (changed, plain))
    ratio = after[before > 0] / before[before > 0]
    return float(np.clip(ratio.min(initial=1.0), 1e-12, 1.0))


def _refine(
    cost: Callable[[float], float], suspicion: Suspicion, best: int, after: float
) -> tuple[float, float]:
    """The size of smallest cost near the best one that was tried, by golden sections."""
    sizes = np.sort(np.append(suspicion.sizes, suspicion.none))
    size = float(suspicion.sizes[best])
    at = int(np.searchsorted(sizes, size))
    forward = np.log if suspicion.is_relative else np.asarray
    backward = np.exp if suspicion.is_relative else np.asarray
    low, high = (
        float(forward(sizes[max(at - 1, 0)])),
        float(forward(sizes[min(at + 1, len(sizes) - 1)])),
    )
    share = (np.sqrt(5) - 1) / 2
    for _ in range(_GOLDEN):
        left, right = high - share * (high - low), low + share * (high - low)
        at_left, at_right = cost(float(backward(left))), cost(float(backward(right)))
        if at_left < at_right:
            high, candidate, value = right, left, at_left
        else:
            low, candidate, value = left, right, at_right
        if value < after:
            size, after = float(backward(candidate)), value
    return size, after


# --- sentences ---


def _describe(view: RecordView, verdict: _Verdict) -> Finding:
    """The finding of a fault in a record."""
    e, suspicion, size = view.experiment, verdict.suspicion, verdict.size
    names, shown = suspicion.channels, " and ".join(suspicion.channels)
    is_input = bool(names) and names[0] in {i.name for i in e.inputs}
    unit = _unit(e.channels, names[0]) if names else ""
    drop = (
        f"the model of the others leaves {verdict.after / verdict.before:.2g} of its residual then"
    )
    line = input_line if is_input else coordinate_line
    in_file = "in a card of its own, " if names else ""
    if suspicion.check == "sign":
        what = f"{shown} has the opposite sign in this record"
        evidence, remedy = f"{drop}", f"{in_file}{line(shown, 'sign = -1')}"
    elif suspicion.check == "swap":
        what, evidence = f"{shown} are swapped in this record", drop
        remedy = f"{in_file}{line(names[0], 'column: that of ' + names[1])}, and the reverse"
    elif suspicion.check == "gain":
        what = f"{shown} has another gain in this record"
        evidence = f"{1 / size:.4g} times as large as in the others; {drop}"
        key = f"scale = {size:.4g}" if is_input else _gain_key(view, shown, size)
        remedy = f"{in_file}{line(shown, key)}"
    elif suspicion.check == "offset":
        what = f"{shown} has another zero in this record"
        evidence = f"{-size:+.3g} {unit}; {drop}"
        block = view.coordinate_card(shown)
        factor = block.factor() * block.sign if block else 1.0
        offset = (block.offset if block else 0.0) - size / factor
        remedy = f"{in_file}{line(shown, f'offset = {offset:.4g}')}"
    elif suspicion.check == "lag":
        # what must be delayed to fit came too early
        word = "early" if size > 0 else "late"
        what = f"{shown} comes {word} in this record"
        evidence = f"by {1e3 * abs(size) * e.dt:.3g} ms, {abs(size):.1f} samples; {drop}"
        remedy = (
            f"{in_file}{line(shown, f'delay = {size * e.dt:.3g}')}"
            if is_input
            else without_record(e)
        )
    else:
        what = "the record is of another sampling period, or of a machine that is as much slower"
        evidence = f"{1e3 * size * e.dt:.4g} ms against {1e3 * e.dt:.4g} ms; {drop}"
        remedy = f"in a card of its own, {top_line(f'dt = {size * e.dt:.4g}')}, or groups"
    # a size may stand for a change of the machine; a sign and a swap cannot
    severity = "warning" if suspicion.has_number else "severe"
    return view.finding(
        suspicion.check, severity, what, evidence, remedy, names[0] if names else ""
    )


def _gain_key(view: RecordView, name: str, size: float) -> str:
    """The key of a coordinate that changes its positions by a factor."""
    block = view.coordinate_card(name)
    if block is not None and block.counts_per_revolution and block.unit == "counts":
        return f"counts_per_revolution = {block.counts_per_revolution / size:.6g}"
    for unit, factor in (("deg", np.pi / 180), ("rad", 180 / np.pi)):
        if abs(size / factor - 1) < 0.15:
            return f'unit = "{unit}"'
    return f"unit: {times_too_large(1 / size)}"


def _unit(channels: Channels, name: str) -> str:
    return next(c.unit for c in (*channels.coordinates, *channels.inputs) if c.name == name)


def _common_delay(views: Sequence[RecordView], verdict: _Verdict) -> Finding:
    """The finding of an input that acts late in all records."""
    name, dt = verdict.suspicion.channels[0], views[0].experiment.dt
    finding = views[0].finding(
        "input delay",
        "note",
        f"{name} acts later than its timestamps say",
        f"{1e3 * verdict.size * dt:.3g} ms, {verdict.size:.1f} samples, in all records",
        input_line(name, f"delay = {verdict.size * dt:.3g}"),
        name,
    )
    return replace(finding, records=())


def _other_machines(model: MotionModel, views: Sequence[RecordView]) -> Iterator[Finding]:
    """Records that scaled friction, weights or gains explain: another friction, another payload."""
    cost = _costs(model)
    forces = [
        k for k in ("position", "input", "velocity", "speed product") if k in model.regressors.kinds
    ]
    for r, view in enumerate(views):
        usual = _usual_cost(model, r)
        if not (model.weights[r] > 0 and cost[r] > _POORER * usual):
            continue
        equations = model.equations[r]
        if model.novelty(equations, r) > _NOVEL_MACHINE:
            continue
        for word, kinds in (("friction", ["velocity"]), ("payload", forces)):
            parameters, factors = model.scale_groups(r, kinds)
            after = model.cost(equations, parameters)
            told = [k for k in kinds if k in ("position", "input") or word == "friction"]
            told_factors = np.concatenate([factors[kind] for kind in told])
            if (told_factors <= 0).any():  # nothing weighs or rubs less than nothing
                continue
            logs = np.log(told_factors)
            has_changed = np.abs(logs).max() > _OTHER_FACTOR or np.ptp(logs) > _OTHER_RATIO
            explains = after < _OTHER_MACHINE * cost[r]
            if not (explains and has_changed and (word == "friction" or after < _USUAL * usual)):
                continue
            sizes = ", ".join(
                f"{_FORCES[kind]} " + " and ".join(f"{f:.2g}" for f in factors[kind])
                for kind in kinds
            )
            group = f'groups = {{ {word} = "other" }}'
            yield view.finding(
                word,
                "warning",
                f"the record is one of another {word}",
                f"times those of the others: {sizes}; these leave {after / cost[r]:.2g} of the "
                f"residual, which is {cost[r] / usual:.3g} times the usual one",
                file_line(view.experiment, group),
            )
            break
