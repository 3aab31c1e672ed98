"""Mistakes in the columns of records, found by what the forces along a motion leave unexplained.

A reversed sign, two columns that are exchanged, torques in another unit or before a gear: a fit by
inverse dynamics ends with most of the force missing, and says nothing of the cause. Here the forces
are compared once more under each such mistake, linearised about the nominal values of the system,
which the priors hold near the file. What explains the records clearly better is put into a
sentence.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.fitting.report import ForceError, Identification
from tustinnet.fitting.shooting.equations import SystemEquations, system_equations
from tustinnet.fitting.shooting.inverse_dynamics import (
    Prior,
    choose_cutoff,
    filter_record,
    force_slopes,
    forces_along,
    missing_forces,
    with_parameters,
    without_gains,
)
from tustinnet.fitting.shooting.problem import Problem, SearchState
from tustinnet.fitting.shooting.space import SearchSpace
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.lagrangian import LagrangianSystem

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
_MISTAKES = 3  # that are looked for one after the other
_RECORDS, _SECONDS = 4, 20.0  # that are enough to tell, and their length
_PASSES = 30  # of the search for parameters within their bounds


class _Geometry(NamedTuple):
    """Sums along the records whose positions have a change: what the forces there need.

    The missing force of joint k is `constant + derivatives by the parameters - columns of forces`.

    Attributes:
        matrices: products of derivatives of each joint, (n, n_p, n_p).
        by_constant: derivatives times the constant part, (n, n_p).
        by_column: derivatives times each column of forces, (n, n, n_p).
        constant: sums of squares of the constant part, (n,).
        cross: constant part times each column, (n, n).
    """

    matrices: Float[np.ndarray, "n n_p n_p"]
    by_constant: Float[np.ndarray, "n n_p"]
    by_column: Float[np.ndarray, "n n n_p"]
    constant: Float[np.ndarray, " n"]
    cross: Float[np.ndarray, "n n"]


@dataclass(frozen=True)
class _Change:
    """A change of the columns that would mend a mistake.

    Attributes:
        kind: `gain`, `gains`, `signs`, `degrees`, `positions`, `forces`, `both`: what is changed.
        joints: indices of the joints whose columns are changed.
        factors: factors of the position columns, (n,).
        order: of each joint the index of its position column, (n,).
        columns: of each joint the factor of each column of forces, (n, n).
        free: joints whose force has an unknown factor in common.
    """

    kind: str
    joints: tuple[int, ...]
    factors: tuple[float, ...]
    order: tuple[int, ...]
    columns: tuple[tuple[float, ...], ...]
    free: tuple[int, ...] = ()

    @property
    def geometry(self) -> tuple[tuple[float, ...], tuple[int, ...]]:
        """Changes of the positions: factors, and the order of the columns."""
        return self.factors, self.order


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


def with_column_mistakes(
    identification: Identification, problem: Problem, state: SearchState
) -> Identification:
    """An identification whose findings name columns that are probably mistaken.

    Nothing is added where forces are explained.

    Args:
        identification: the result of `identify_by_inverse_dynamics`.
        problem: the problem.
        state: the state before the search.
    """
    poor = [e for e in identification.force_errors if e.size and e.train > _MUCH * e.size]
    if not poor:
        return identification
    if _describe_far_positions(problem.plant.system, problem.plant.records):
        return identification  # which says it already
    state = without_gains(problem, state)
    comparison = _Comparison(problem.plant, state.space)
    sentences = comparison.find_mistakes()
    if not sentences:
        driven = {name for name, x in zip(comparison.names, comparison.driven, strict=True) if x}
        sentences = _describe_poor([e for e in poor if e.coordinate in driven])
    return replace(identification, findings=(*identification.findings, *sentences))


def describe_beyond_limits(
    system: LagrangianSystem, records: Sequence[Experiment]
) -> tuple[str, ...]:
    """Sentences on motions far beyond the limits that a robot's file says, and forces beyond them.

    Such are degrees taken for radians, the angle of a motor before its gear, and torques in mN m.

    Args:
        system: the system.
        records: records with its coordinates and inputs.
    """
    if system.source is None:
        return ()
    return (*_describe_far_positions(system, records), *_describe_large_forces(system, records))


def _describe_far_positions(system: LagrangianSystem, records: Sequence[Experiment]) -> list[str]:
    """Sentences on motions far beyond the limits that a robot's file says."""
    if system.source is None:
        return []
    sentences = []
    for k, (c, limits) in enumerate(zip(system.coordinates, system.limits, strict=True)):
        if limits.position is None:
            continue
        q = np.concatenate([e.q[:, k] for e in records])
        (low, high), (least, most) = (float(q.min()), float(q.max())), limits.position
        far = (_FAR_ANGLE if c.kind == "angular" else _FAR_LENGTH) * (most - least)
        if low < least - far or high > most + far:
            cause = "degrees taken for rad, the angle of a motor before its gear, "
            sentences.append(
                f"{c.name} moves from {low:.3g} to {high:.3g} {c.unit}, and from {least:g} to "
                f"{most:g} by {system.source.path.name}: "
                f"{cause if c.kind == 'angular' else 'another unit, '}or another column? `unit` "
                "and `scale` in the card"
            )
    return sentences


def _describe_large_forces(system: LagrangianSystem, records: Sequence[Experiment]) -> list[str]:
    """Sentences on forces beyond those that a robot's file allows."""
    system = rigid_system(system)
    assert system.input_map is not None
    assert system.source is not None
    nominal, sentences = system.nominal(), []
    still, none = jnp.zeros(len(system.coordinates)), jnp.zeros(len(system.inputs))
    rest = system.input_map(still, still, none, nominal)
    for j, i in enumerate(system.inputs):
        u = none.at[j].set(max(float(np.abs(e.u[:, j]).max()) for e in records))
        force = np.abs(np.asarray(system.input_map(still, still, u, nominal) - rest))
        k = int(np.argmax(force))
        most = system.limits[k].force
        if most is None or force[k] <= _NO_NOISE * most:
            continue
        unit = "N m" if system.coordinates[k].kind == "angular" else "N"
        cause = (
            "another unit, as mN m, or a motor constant or gear ratio too large? `scale` in the "
            "card"
        )
        if force[k] <= _USUAL_GAIN * most:
            cause = (
                "what a controller asked for is not what a motor gives at its limit; take the "
                "column of what it gave, or correct the file"
            )
        sentences.append(
            f"{i.name} is up to {force[k]:.3g} {unit}, and {system.coordinates[k].name} has "
            f"{most:g} {unit} by {system.source.path.name}: {cause}"
        )
    return sentences


def _describe_poor(poor: Sequence[ForceError]) -> list[str]:
    """Sentence on joints at which most of the force is missing, and nothing simple explains it."""
    names = [e.coordinate for e in poor if e.train > _MOST * e.size]
    if not names:
        return []
    return [
        f"most of the force at {', '.join(names)} is missing: look at the columns there (sign, "
        "unit, gear ratio, zero of the position, exchanged with those of another joint), and at "
        "the file: axes, masses, gravity"
    ]


class _Comparison:
    """Forces along the records, compared under changes of their columns.

    Args:
        problem: the problem of the system alone.
        space: the parameters.
    """

    def __init__(self, problem: Problem, space: SearchSpace) -> None:
        self.problem, self.space, self.prior = problem, space, Prior(space)
        self.names = [c.name for c in problem.system.coordinates]
        self.kinds = [c.kind for c in problem.system.coordinates]
        self.n = len(self.names)
        cutoff = problem.search.cutoff or choose_cutoff(problem.records)
        records = sorted(problem.records, key=len, reverse=True)[:_RECORDS]
        records = [e[: max(2, int(_SECONDS / len(records) / e.dt))] for e in records]
        self.parts = [filter_record(e, cutoff) for e in records]
        self.equations: SystemEquations = system_equations(problem.system, space.names)
        self.formula: Formula = missing_forces(self.equations)
        self.values = space.to_values(self.prior.centre)
        # what the recorded inputs put on the coordinates
        self.forces = [
            forces_along(self.formula, self.equations, [part], self.values).applied
            for part in self.parts
        ]
        products = [part.weight * f.T @ f for part, f in zip(self.parts, self.forces, strict=True)]
        self.products = np.sum(products, axis=0)
        self.weight = sum(
            part.weight * len(f) for part, f in zip(self.parts, self.forces, strict=True)
        )
        self.driven = np.diag(self.products) > 0
        self.spans = np.ptp(np.concatenate([e.q for e in records]), axis=0)
        self.geometries: dict[object, _Geometry] = {}

    def find_mistakes(self) -> list[str]:
        """Sentences on mistakes, one after the other as long as each explains clearly more."""
        identity = tuple(tuple(row) for row in np.eye(self.n).tolist())
        current = _Change("", (), (1.0,) * self.n, tuple(range(self.n)), identity)
        sentences: list[str] = []
        before = self._explain(current)
        while len(sentences) < _MISTAKES:
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
            sentences.append(self._describe(best, alike, before, after))
            gains = np.array(best.columns)
            gains[[*best.free]] *= after.gain
            current = replace(
                best, columns=tuple(tuple(row) for row in gains.tolist()), free=(), kind=""
            )
            before = after
        return sentences

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
        driven = [k for k in range(self.n) if self.driven[k]]
        for k in driven:
            yield replace(current, kind="gain", joints=(k,), free=(k,))
        if len(driven) > 1:
            yield replace(current, kind="gains", joints=tuple(driven), free=tuple(driven))
        columns = np.array(current.columns)
        for k in range(self.n):
            factors = tuple(-x if j == k else x for j, x in enumerate(current.factors))
            yield replace(current, kind="positions", joints=(k,), factors=factors)
            turned = _turned(current.columns, (k,))
            yield replace(current, kind="both", joints=(k,), factors=factors, columns=turned)
        for pair in itertools.combinations(driven, 2):
            yield replace(
                current, kind="signs", joints=pair, columns=_turned(current.columns, pair)
            )
        is_wide = [k for k in range(self.n) if self.kinds[k] == "angular" and self.spans[k] > _TURN]
        for joints in {(k,) for k in is_wide} | ({(*is_wide,)} if is_wide else set()):
            factors = tuple(
                np.radians(x) if j in joints else x for j, x in enumerate(current.factors)
            )
            yield replace(current, kind="degrees", joints=joints, factors=factors)
        for i, j in itertools.combinations(range(self.n), 2):
            if self.kinds[i] != self.kinds[j]:
                continue
            order, swapped = [*current.order], columns.copy()
            order[i], order[j] = order[j], order[i]
            swapped[[i, j]] = swapped[[j, i]]
            rows = tuple(tuple(row) for row in swapped.tolist())
            yield replace(current, kind="forces", joints=(i, j), columns=rows)
            yield replace(current, kind="positions", joints=(i, j), order=tuple(order))
            yield replace(current, kind="both", joints=(i, j), order=tuple(order), columns=rows)

    def _geometry(self, change: _Change) -> _Geometry:
        """The sums along the records with their positions changed, computed once for each."""
        if (computed := self.geometries.get(change.geometry)) is not None:
            return computed
        centre, n, n_p = self.prior.centre, self.n, len(self.prior.centre)
        sums = _Geometry(
            np.zeros((n, n_p, n_p)),
            np.zeros((n, n_p)),
            np.zeros((n, n, n_p)),
            np.zeros(n),
            np.zeros((n, n)),
        )
        for part, forces in zip(self.parts, self.forces, strict=True):
            moved = part.points.copy()
            for block in range(3):
                own = part.points[:, block * n : (block + 1) * n]
                moved[:, block * n : (block + 1) * n] = own[:, change.order] * change.factors
            changed = part._replace(points=moved)
            points = with_parameters(self.equations, changed, self.values)
            points[:, 3 * n : 3 * n + len(self.problem.system.inputs)] = 0.0
            constant, w = part.compare(evaluate(self.formula, points)), part.weight
            slopes = force_slopes(
                self.formula, self.equations, self.problem, self.space, part, points, centre
            )
            sums.matrices[:] += w * np.einsum("tkp,tkq->kpq", slopes, slopes, optimize=True)
            sums.by_constant[:] += w * np.einsum("tkp,tk->kp", slopes, constant)
            sums.by_column[:] += w * np.einsum("tkp,tj->kjp", slopes, forces, optimize=True)
            sums.constant[:] += w * np.sum(constant**2, axis=0)
            sums.cross[:] += w * constant.T @ forces
        self.geometries[change.geometry] = sums
        return sums

    def _explain(self, change: _Change) -> _Outcome:
        """The missing forces under a change, with the parameters and the factor that suit it."""
        sums, n_p = self._geometry(change), len(self.prior.centre)
        columns, free = np.array(change.columns), [*change.free]
        is_free = np.zeros(self.n, bool)
        is_free[free] = True
        # residual of joint k: constant + slopes x - own - gain factor
        own, factor = (np.where(mask[:, None], columns, 0.0) for mask in (~is_free, is_free))
        unit = self._units(sums, columns, is_free)
        gradient = np.concatenate(
            [
                np.einsum(
                    "k,kp->p", unit, sums.by_constant - np.einsum("kj,kjp->kp", own, sums.by_column)
                ),
                [-float(unit @ np.sum(factor * sums.cross, axis=1))] if free else [],
            ]
        )
        matrix = np.zeros((len(gradient), len(gradient)))
        matrix[:n_p, :n_p] = np.einsum("k,kpq->pq", unit, sums.matrices)
        matrix[:n_p, :n_p] += np.diag(1 / self.prior.spread**2)
        if free:
            edge = -np.einsum("k,kj,kjp->p", unit, factor, sums.by_column)
            matrix[:n_p, -1] = matrix[-1, :n_p] = edge
            matrix[-1, -1] = float(unit @ np.einsum("ki,ij,kj->k", factor, self.products, factor))
        lower, upper = (
            np.append(ends - self.prior.centre, [end] * (len(gradient) - n_p))
            for ends, end in ((self.space.lower, -np.inf), (self.space.upper, np.inf))
        )
        x = _solve_in_box(matrix, gradient, lower, upper)
        gain = float(x[-1]) if free else 1.0
        used, x = own + gain * factor, x[:n_p]
        squares = (
            sums.constant
            + 2 * sums.by_constant @ x
            + np.einsum("p,kpq,q->k", x, sums.matrices, x)
            - 2 * np.sum(used * (sums.cross + np.einsum("kjp,p->kj", sums.by_column, x)), axis=1)
            + np.einsum("ki,ij,kj->k", used, self.products, used)
        )
        sizes = np.einsum("ki,ij,kj->k", used, self.products, used)
        shares = np.sqrt(np.maximum(squares, 0.0) / np.maximum(sizes, 1e-300))
        return _Outcome(np.where(self.driven, shares, 0.0), gain)

    def _units(
        self, sums: _Geometry, columns: Float[np.ndarray, "n n"], is_free: np.ndarray
    ) -> Float[np.ndarray, " n"]:
        """Weights of the joints' squares: by the actuators' forces, of unknown ones by the file."""
        recorded = np.einsum("ki,ij,kj->k", columns, self.products, columns)
        size = np.where(is_free | ~self.driven, sums.constant, recorded)
        return self.weight / np.maximum(size, 1e-12)

    def _describe(
        self, best: _Change, alike: Sequence[_Change], before: _Outcome, after: _Outcome
    ) -> str:
        """Sentence on a mistake, with what is missing before and after it is mended."""
        joints = [*best.joints]
        names = " and ".join(f"'{self.names[k]}'" for k in joints)
        k = int(np.argmax(before.shares - after.shares))
        effect = (
            f"the force that is missing at '{self.names[k]}' then falls from "
            f"{100 * before.shares[k]:.3g} % to {100 * after.shares[k]:.3g} %"
        )
        if best.kind in ("gain", "gains") and not 1 / _USUAL_GAIN < -after.gain < _USUAL_GAIN:
            which = "all joints" if best.kind == "gains" else names
            return (
                f"the forces of {which} explain the motion as {after.gain:.3g} times what the "
                f"columns say: {_unit_of(after.gain)}; {effect}"
            )
        if best.kind == "degrees":
            return (
                f"the position{'s' * (len(joints) > 1)} of {names} explain the motion as degrees: "
                f'unit = "deg" in the card; {effect}'
            )
        if len(joints) > 1 and best.kind not in ("gains", "signs"):
            what = {"both": "positions and forces"}.get(best.kind, best.kind)
            return (
                f"the {what} of {names} are probably exchanged: look at the columns in the card; "
                f"{effect}"
            )
        meanings = {
            "gain": "the force",
            "gains": "the forces",
            "signs": "the forces",
            "positions": "the position",
            "both": "both position and force (or the axis in the file)",
        }
        what = " or of ".join(
            dict.fromkeys(
                meanings[change.kind] for change in (best, *alike) if change.kind in meanings
            )
        )
        return (
            f"the sign of {what} of {names} is probably reversed: sign = -1 in the card; {effect}"
        )


def _turned(
    columns: tuple[tuple[float, ...], ...], joints: Sequence[int]
) -> tuple[tuple[float, ...], ...]:
    """Factors of columns of forces, those of some joints with the other sign."""
    return tuple(tuple(-x if k in joints else x for x in row) for k, row in enumerate(columns))


def _unit_of(gain: float) -> str:
    """The probable cause of a factor that a column of forces lacks."""
    unit = next(
        (text for factor, text in _UNITS.items() if abs(gain * factor - 1) < _SAME_UNIT), ""
    )
    if unit:
        return f"in {unit}? `scale` in the card"
    if gain > 1:
        return "the torque of a motor before a gear, or a current? scale in the card"
    return "another unit, or a gear? scale in the card"


def _solve_in_box(
    matrix: Float[np.ndarray, "m m"],
    gradient: Float[np.ndarray, " m"],
    lower: Float[np.ndarray, " m"],
    upper: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """The least of a quadratic form within bounds, by active sets.

    Args:
        matrix: second derivatives, positive definite.
        gradient: first derivatives at 0.
        lower: lower bounds.
        upper: upper bounds.
    """
    x, at_bound = np.zeros(len(gradient)), np.zeros(len(gradient), bool)
    for _ in range(_PASSES):
        free = ~at_bound
        target = -gradient[free] - matrix[np.ix_(free, at_bound)] @ x[at_bound]
        x[free] = np.linalg.solve(matrix[np.ix_(free, free)], target)
        beyond = (x < lower) | (x > upper)
        x = np.clip(x, lower, upper)
        slope = matrix @ x + gradient
        inwards = at_bound & (((x <= lower) & (slope < 0)) | ((x >= upper) & (slope > 0)))
        if not beyond.any() and not inwards.any():
            break
        at_bound = (at_bound & ~inwards) | beyond
    return x
