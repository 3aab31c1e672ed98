"""Mistakes in the columns of records, found by what the forces along a motion leave unexplained.

A reversed sign, two columns that are exchanged, torques in another unit or before a gear: a fit by
inverse dynamics ends with most of the force missing, and says nothing of the cause. Here the forces
are compared once more under each such mistake, linearised about the nominal values of the system,
which the priors hold near the file. What explains the records clearly better is a finding.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.inverse_dynamics.along import filter_record
from tustinnet.fitting.inverse_dynamics.linear_forces import LinearForces
from tustinnet.fitting.inverse_dynamics.solver import (
    Prior,
    coordinates_of,
    left_out_squares,
    solve,
)
from tustinnet.fitting.inverse_dynamics.sums import Columns, ForceSums, sum_up
from tustinnet.fitting.report import ForceError
from tustinnet.fitting.shooting.base_parameters import LinearCoordinates
from tustinnet.fitting.shooting.least_squares import solve_in_box
from tustinnet.fitting.shooting.problem import Problem
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.lagrangian import LagrangianSystem

# codes of the findings that name what would mend the columns
COLUMN_MISTAKES = {
    "forces by factor",
    "position in other unit",
    "columns exchanged",
    "column sign reversed",
}

_MUCH = 0.15  # share of the force that is missing at a joint, from which columns are doubted
_MOST = 0.5  # share from which a sentence says what to look at though no mistake explains it
_LEFT = 0.4  # times the missing share, that may be left where a mistake is mended
_LEFT_OF_ALL = 0.7  # the same of the mean square of all joints
_EQUAL = 1.3  # times the least missing share: as good an explanation
_NO_NOISE = 1.1  # of a force by its limit
_USUAL_GAIN = 3.0  # factor by which forces may be off by the file's masses alone
_TURN = 2 * np.pi  # rad; an angle that moves by more may be in degrees
_UNITS = {1e-3: "kN m or kN", 1e3: "mN m or mN", 1e2: "N cm", 0.10197: "kgf m or kgf"}
_SAME_UNIT = 0.3  # relative; a factor this near to one of a unit
# widths of a range beyond it; radians in degrees are 57 times as large, metres in mm 1000 times
_FAR_ANGLE, _FAR_LENGTH = 3.0, 8.0
_FEWEST = 3  # records, of which one can be unlike the others
_MISTAKES = 3  # that are looked for one after the other
_RECORDS, _SECONDS = 4, 20.0  # that are enough to tell, and their length


class _Change(NamedTuple):
    """A change of the columns that would mend a mistake.

    Attributes:
        kind: `gain`, `gains`, `signs`, `units`, `positions`, `forces`, `both`: what is changed.
        joints: indices of the joints whose columns are changed.
        factors: factors of the position columns, (n,).
        order: of each joint the index of its position column, (n,).
        columns: of each joint, in a row, the factor of each column of forces, (n, n).
        free: joints whose force has an unknown factor in common.
    """

    kind: str
    joints: tuple[int, ...]
    factors: Float[np.ndarray, " n"]
    order: Int[np.ndarray, " n"]
    columns: Float[np.ndarray, "n n"]
    free: tuple[int, ...] = ()


class _Outcome(NamedTuple):
    """Missing forces that a change leaves.

    Attributes:
        shares: missing force of each joint by that of its actuators; 0 without one, (n,).
        gain: the factor of the forces of the joints that have one in common; 1 without.
    """

    shares: Float[np.ndarray, " n"]
    gain: float

    @property
    def total(self) -> float:
        """Mean square of the shares, of which none counts more than 2."""
        return float(np.mean(np.minimum(self.shares, 2.0) ** 2))


def describe_column_mistakes(
    problem: Problem, space: SearchSpace, errors: Sequence[ForceError], cutoff: float
) -> list[Finding]:
    """Columns that are probably mistaken; none where forces are explained.

    Args:
        problem: the problem of the system alone.
        space: the parameters.
        errors: what is missing of the forces.
        cutoff: frequency up to which forces are compared [Hz].
    """
    driven = [e for e in errors if e.split == "train" and e.is_driven]
    poor = [e for e in errors if e.split == "train" and e.share > _MUCH]
    if _describe_far_positions(problem.system, problem.records):
        return []  # it is said already
    if not poor:
        return _describe_small_forces(driven)
    comparison = _Comparison(problem, space, cutoff)
    if mistakes := comparison.find_mistakes():
        return mistakes
    return _describe_poor([e for e in poor if e.is_driven])


def describe_groups_apart(
    problem: Problem, columns: Sequence[Columns], prior: Prior, start: ParameterVector
) -> list[Finding]:
    """Records of a group that no parameter is per, and which parameters of their own explain.

    Args:
        problem: the problem, with its records.
        columns: the forces of each record.
        prior: the priors.
        start: the parameters that explain all of them best.
    """
    records, modelled = problem.records, {p.per for p in problem.system.grouped}
    apart: dict[str, Finding] = {}
    for group, value in sorted({g for e in records for g in e.groups}):
        inside = [e.group(group) == value for e in records]
        if group in modelled or all(inside):
            continue
        own, others = (
            sum_up([c for c, is_own in zip(columns, inside, strict=True) if is_own == kept])
            for kept in (True, False)
        )
        by_others = own.total.squares(
            coordinates_of(prior.space, solve(others, prior, start).vector)
        )
        by_own = left_out_squares(own, prior, start, range(len(own.counts)))
        squares = np.stack([by_others[0].sum(axis=1), by_own.sum(axis=0)])
        before, after = np.mean(np.sqrt(squares / own.sizes.sum(axis=(0, 2))), axis=1).tolist()
        if after < _LEFT * before:
            values = {"before": before, "after": after, "group": group, "value": value}
            apart[group] = make_finding("group apart", **values)
    return [*apart.values()]


def describe_odd_record(
    records: Sequence[Experiment],
    sums: ForceSums,
    prior: Prior,
    start: ParameterVector,
    errors: Sequence[ForceError],
) -> list[Finding]:
    """The record without which the force that is missing most is explained, if there is one.

    Args:
        records: the records; of more than ten some are one fold.
        sums: the sums of their folds.
        prior: the priors.
        start: the parameters that explain all of them best.
        errors: what is missing of the forces.
    """
    trained = [e for e in errors if e.split == "train"]
    shares = [e.share if e.is_driven else 0.0 for e in trained]
    k = int(np.argmax(shares))
    if len(records) < _FEWEST or shares[k] <= _MUCH:
        return []
    left, folds = [], np.arange(len(sums.counts))
    for f in folds:
        others = sums.of_folds(folds != f).total
        vector = solve(others, prior, start).vector
        squares = others.squares(coordinates_of(prior.space, vector))
        left.append(float(np.sqrt(squares[0, k].sum() / others.sizes[0, k].sum())))
    i = int(np.argmin(left))
    if left[i] >= _LEFT * shares[k]:
        return []
    names = [records[j].name for j in np.array_split(np.arange(len(records)), len(folds))[i]]
    values = {"before": shares[k], "after": left[i], "without": names}
    return [make_finding("record apart", joint=trained[k].coordinate, **values)]


def describe_beyond_limits(
    system: LagrangianSystem, records: Sequence[Experiment]
) -> tuple[Finding, ...]:
    """Motions far beyond the limits that a robot's file says, and forces beyond them.

    Such are degrees taken for radians, the angle of a motor before its gear, and torques in mN m.

    Args:
        system: the system.
        records: records with its coordinates and inputs.
    """
    if system.source is None:
        return ()
    return (*_describe_far_positions(system, records), *_describe_large_forces(system, records))


def _describe_far_positions(
    system: LagrangianSystem, records: Sequence[Experiment]
) -> list[Finding]:
    """Motions far beyond the limits that a robot's file says."""
    if system.source is None:
        return []
    findings = []
    for k, (c, limits) in enumerate(zip(system.coordinates, system.limits, strict=True)):
        if limits.position is None:
            continue
        q = np.concatenate([e.q[:, k] for e in records])
        (low, high), (least, most) = (float(q.min()), float(q.max())), limits.position
        is_angle = c.kind == "angular"
        far = (_FAR_ANGLE if is_angle else _FAR_LENGTH) * (most - least)
        if low < least - far or high > most + far:
            findings.append(
                make_finding(
                    "far angle" if is_angle else "far position",
                    coordinate=c.name,
                    low=low,
                    high=high,
                    unit=c.unit,
                    least=least,
                    most=most,
                    file=system.source.path.name,
                )
            )
    return findings


def _describe_large_forces(
    system: LagrangianSystem, records: Sequence[Experiment]
) -> list[Finding]:
    """Forces beyond those that a robot's file allows."""
    system = rigid_system(system)
    if system.input_map is None:  # goals that integrate are no forces
        return []
    assert system.source is not None
    nominal, findings = system.nominal(), []
    still, none = jnp.zeros(len(system.coordinates)), jnp.zeros(len(system.inputs))
    rest = system.input_map(still, still, none, nominal)
    for j, i in enumerate(system.inputs):
        u = none.at[j].set(max(float(np.abs(e.u[:, j]).max()) for e in records))
        force = np.abs(np.asarray(system.input_map(still, still, u, nominal) - rest))
        k = int(np.argmax(force))
        most = system.limits[k].force
        if most is None or force[k] <= _NO_NOISE * most:
            continue
        unit = system.force_unit(system.coordinates[k])
        findings.append(
            make_finding(
                "force at limit" if force[k] <= _USUAL_GAIN * most else "force beyond limit",
                input=i.name,
                force=force[k],
                unit=unit,
                coordinate=system.coordinates[k].name,
                most=most,
                file=system.source.path.name,
            )
        )
    return findings


def _describe_small_forces(driven: Sequence[ForceError]) -> list[Finding]:
    """Forces of all joints far below those by the file, which other masses explain as well."""
    shares = [e.by_file for e in driven]
    if min(shares, default=0.0) <= _USUAL_GAIN:
        return []
    return [make_finding("forces small", least=min(shares), most=max(shares))]


def _describe_poor(poor: Sequence[ForceError]) -> list[Finding]:
    """Joints at which most of the force is missing, and nothing simple explains it."""
    names = [e.coordinate for e in poor if e.share > _MOST]
    if not names:
        return []
    return [make_finding("forces missing", joints=names)]


class _Comparison:
    """Forces along the records, compared under changes of their columns.

    Args:
        problem: the problem of the system alone.
        space: the parameters.
        cutoff: frequency up to which forces are compared [Hz].
    """

    def __init__(self, problem: Problem, space: SearchSpace, cutoff: float) -> None:
        self.problem, self.space, self.prior = problem, space, Prior(space)
        self.names = [c.name for c in problem.system.coordinates]
        self.kinds = [c.kind for c in problem.system.coordinates]
        self.n = len(self.names)
        records = sorted(problem.records, key=len, reverse=True)[:_RECORDS]
        records = [
            take_busiest_part(e, max(2, int(_SECONDS / len(records) / e.dt))) for e in records
        ]
        self.parts = tuple(filter_record(e, cutoff) for e in records)
        recorded = LinearForces(problem.system, space, self.parts)
        values = space.to_values(self.prior.centre)
        # what the recorded inputs put on the coordinates
        self.forces = [own.needed(values) - own.missing(values) for own in recorded.along]
        weighted = [(p.weight, f) for p, f in zip(self.parts, self.forces, strict=True)]
        self.products = sum(weight * forces.T @ forces for weight, forces in weighted)
        self.weight = sum(weight * len(forces) for weight, forces in weighted)
        self.driven = np.diag(self.products) > 0
        self.spans = np.ptp(np.concatenate([e.q for e in records]), axis=0)
        self.products_by_geometry: dict[object, Float[np.ndarray, "n m m"]] = {}

    def find_mistakes(self) -> list[Finding]:
        """Mistakes, one after the other as long as each explains clearly more."""
        current = _Change("", (), np.ones(self.n), np.arange(self.n), np.eye(self.n))
        mistakes: list[Finding] = []
        before = self._explain(current)
        while len(mistakes) < _MISTAKES:
            outcomes = [
                (change, outcome)
                for change in self._changes(current)
                if self._is_better(change, outcome := self._explain(change), before)
            ]
            if not outcomes:
                break
            best, after = min(outcomes, key=lambda pair: pair[1].total)
            alike = [
                change
                for change, outcome in outcomes
                if outcome.total < _EQUAL**2 * after.total and {*change.joints} == {*best.joints}
            ]
            mistakes.append(self._describe(best, alike, before, after))
            columns = best.columns.copy()
            columns[[*best.free]] *= after.gain
            current = best._replace(kind="", columns=columns, free=())
            before = after
        return mistakes

    def _is_better(self, change: _Change, outcome: _Outcome, before: _Outcome) -> bool:
        """Whether a change explains the forces clearly better, at its own joints or at all."""
        is_usual = 1 / _USUAL_GAIN < outcome.gain < _USUAL_GAIN
        if change.kind in ("gain", "gains") and is_usual:
            return False
        own, every = [*change.joints], slice(None)
        # a joint may take the masses that suit its wrong columns, and others miss their force then
        is_explained = any(
            (worst := float(np.max(before.shares[joints]))) > _MUCH
            and float(np.max(outcome.shares[joints])) < _LEFT * worst
            for joints in (own, every)
        )
        return is_explained and outcome.total < _LEFT_OF_ALL * before.total

    def _changes(self, current: _Change) -> Iterator[_Change]:
        """Changes beside those that are made already: signs, factors, columns exchanged."""
        recorded = np.einsum("ki,ij,kj->k", current.columns, self.products, current.columns)
        driven = [k for k in range(self.n) if recorded[k] > 0]
        for k in driven:
            yield current._replace(kind="gain", joints=(k,), free=(k,))
        if len(driven) > 1:
            yield current._replace(kind="gains", joints=tuple(driven), free=tuple(driven))
        signs = 1 - 2 * np.eye(self.n)  # in a row those with that of one joint reversed
        for k in range(self.n):
            factors, turned = current.factors * signs[k], current.columns * signs[k][:, None]
            yield current._replace(kind="positions", joints=(k,), factors=factors)
            yield current._replace(kind="both", joints=(k,), factors=factors, columns=turned)
        for i, j in itertools.combinations(driven, 2):
            turned = current.columns * (signs[i] * signs[j])[:, None]
            yield current._replace(kind="signs", joints=(i, j), columns=turned)
        spans = np.where(np.array(self.kinds) == "angular", self.spans * current.factors, np.nan)
        # of an angle that moves by more than a turn, or by so little that it would in degrees
        for factor, fits in (
            (np.radians(1.0), spans > _TURN),
            (np.degrees(1.0), np.degrees(spans) < _TURN),
        ):
            others = np.flatnonzero(fits).tolist()
            for joints in {(k,) for k in others} | ({(*others,)} if others else set()):
                factors = current.factors.copy()
                factors[[*joints]] *= factor
                yield current._replace(kind="units", joints=joints, factors=factors)
        for i, j in itertools.combinations(range(self.n), 2):
            if self.kinds[i] != self.kinds[j]:
                continue
            places = np.arange(self.n)
            places[[i, j]] = j, i
            swapped = current._replace(joints=(i, j))
            order, columns = current.order[places], current.columns[places]
            yield swapped._replace(kind="forces", columns=columns)
            yield swapped._replace(kind="positions", order=order)
            yield swapped._replace(kind="both", order=order, columns=columns)

    def _products(self, change: _Change) -> Float[np.ndarray, "n m m"]:
        """Products of the columns of each joint with its positions changed, once for each.

        The columns are the derivatives of its missing force, the recorded forces, and what the
        motion needs with the nominal values.
        """
        geometry = *change.factors, *change.order
        if (computed := self.products_by_geometry.get(geometry)) is not None:
            return computed
        centre = self.prior.centre
        changed = tuple(
            part._replace(
                **{
                    name: getattr(part, name)[:, change.order] * change.factors
                    for name in ("q", "v", "a")
                }
            )
            for part in self.parts
        )
        point = LinearCoordinates(self.space, self.space.to_values(centre))
        by_vector = point.derivatives * self.space.derivatives(centre)
        columns = LinearForces(self.problem.system, self.space, changed).columns(centre)
        products = 0.0
        for own, forces in zip(columns, self.forces, strict=True):
            every = np.broadcast_to(forces[:, None], (len(forces), self.n, self.n))
            rows = np.concatenate([own.slopes @ by_vector, every, own.needed[..., None]], axis=2)
            products = products + own.weight * np.einsum("tki,tkj->kij", rows, rows, optimize=True)
        self.products_by_geometry[geometry] = products = np.asarray(products)
        return products

    def _explain(self, change: _Change) -> _Outcome:
        """The missing forces under a change, with the parameters and the factor that suit it."""
        products, n, n_p = self._products(change), self.n, len(self.prior.centre)
        columns, is_free = change.columns, np.zeros(n, bool)
        is_free[[*change.free]] = True
        n_x = n_p + bool(change.free)
        # from parameters, the factor and 1 to what multiplies the columns of each joint
        used = np.zeros((n, n_p + n + 1, n_x + 1))
        used[:, range(n_p), range(n_p)] = used[:, -1, -1] = 1.0
        for k in range(n):
            used[k, n_p:-1, n_p if is_free[k] else -1] -= columns[k]
        by_joint = used.transpose(0, 2, 1) @ products @ used
        recorded = np.einsum("ki,ij,kj->k", columns, self.products, columns)
        # joints weigh by the actuators' forces, of an unknown factor by what the file says
        size = np.where(is_free | ~self.driven, products[:, -1, -1], recorded)
        matrix = np.einsum("k,kij->ij", self.weight / np.maximum(size, 1e-12), by_joint)
        curvature = matrix[:-1, :-1].copy()
        curvature[:n_p, :n_p] += self.prior.at(self.prior.centre)[2]
        lower, upper = (
            np.append(ends - self.prior.centre, [end] * (n_x - n_p))
            for ends, end in ((self.space.lower, -np.inf), (self.space.upper, np.inf))
        )
        x = solve_in_box(curvature, matrix[:-1, -1], lower, upper)
        gain = float(x[-1]) if change.free else 1.0
        point = np.append(x, 1.0)
        squares = np.maximum(np.einsum("i,kij,j->k", point, by_joint, point), 0.0)
        shares = np.sqrt(squares / np.maximum(recorded * np.where(is_free, gain**2, 1), 1e-300))
        return _Outcome(np.where(self.driven, shares, 0.0), gain)

    def _describe(
        self, best: _Change, alike: Sequence[_Change], before: _Outcome, after: _Outcome
    ) -> Finding:
        """A mistake, with what is missing before and after it is mended."""
        k = int(np.argmax(before.shares - after.shares))
        common = {
            "joints": [self.names[j] for j in best.joints],
            "at": self.names[k],
            "before": before.shares[k],
            "after": after.shares[k],
        }
        if best.kind in ("gain", "gains") and not 1 / _USUAL_GAIN < -after.gain < _USUAL_GAIN:
            cause = _unit_of(after.gain)
            return make_finding("forces by factor", **common, factor=after.gain, cause=cause)
        if best.kind == "units":
            is_wide = self.spans[best.joints[0]] > _TURN
            names = (
                {"unit": "degrees", "key": "deg"} if is_wide else {"unit": "radians", "key": "rad"}
            )
            return make_finding("position in other unit", **common, **names)
        if len(best.joints) > 1 and best.kind not in ("gains", "signs"):
            what = {"both": "positions and forces"}.get(best.kind, best.kind)
            return make_finding("columns exchanged", **common, what=what)
        meanings = {
            "gain": "the force",
            "gains": "the forces",
            "signs": "the forces",
            "positions": "the position",
            "both": "both position and force (or the axis in the file)",
        }
        what = dict.fromkeys(meanings[c.kind] for c in (best, *alike) if c.kind in meanings)
        return make_finding("column sign reversed", **common, what=[*what])


def take_busiest_part(record: Experiment, samples: int) -> Experiment:
    """The part of a record in which its joints move most: at rest any force may hold them."""
    moved = np.abs(np.diff(record.q, axis=0))
    moved = np.sum(moved / np.maximum(moved.mean(axis=0), 1e-300), axis=1)
    until, samples = np.concatenate([[0.0], np.cumsum(moved)]), min(samples, len(record))
    begin = int(np.argmax(until[samples - 1 :] - until[: len(until) - samples + 1]))
    return record[begin : begin + samples]


def _unit_of(gain: float) -> str:
    """The probable cause of a factor that a column of forces lacks."""
    unit = next(
        (text for factor, text in _UNITS.items() if abs(gain * factor - 1) < _SAME_UNIT), ""
    )
    if unit:
        return f"in {unit}?"
    if gain > 1:
        return "the torque of a motor before a gear, or a current?"
    return "another unit, or a gear?"
