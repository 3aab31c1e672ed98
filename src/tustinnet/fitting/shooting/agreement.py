"""Whether records agree about the parameters: those of a group, and each with the others."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy.special
from jaxtyping import Float

from tustinnet.fitting.report import Disagreement, Side
from tustinnet.fitting.residual import TO_DEVIATION
from tustinnet.fitting.shooting.least_squares import Fitted, eliminated, prior_deviation
from tustinnet.fitting.shooting.problem import Problem, State, prior
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.fitting.shooting.stages import refitted
from tustinnet.fitting.shooting.uncertainty import (
    FEWEST_RECORDS,
    lag_correlation,
    uncertainty,
)

_LEVEL = 0.01  # of all comparisons of a kind together that find something by chance
_LEAST = 0.01  # of a value, or of a range: less is no disagreement that matters
_SUSPECT = 5.0  # robust standard deviations from the median of all records
_MOST_SUSPECTS = 1 / 3  # of the records
_NOTHING = 1e-6  # of the information of all records: so little determines no parameter
_MANY = 1000.0  # degrees of freedom of errors from J'J


@dataclass(frozen=True)
class _Part:
    """What some of the records say by themselves, in the coordinates of the search.

    Attributes:
        name: what they are.
        records: how many.
        vector: the parameters.
        variance: of their errors, infinite where these records say nothing.
        freedom: degrees of freedom of the variance.
    """

    name: str
    records: int
    vector: Float[np.ndarray, " n_p"]
    variance: Float[np.ndarray, " n_p"]
    freedom: float


@dataclass(frozen=True)
class Agreement:
    """Asks whether the records of an identification agree.

    Attributes:
        problem: what was identified.
        state: where the search ended.
        whole: the records' segments in the last stage.
    """

    problem: Problem
    state: State
    whole: Segments

    def disagreements(self) -> tuple[Disagreement, ...]:
        """Of groups that no parameter is per, then of single records with all others."""
        return (*self._of_groups(), *self._of_records())

    def _of_groups(self) -> list[Disagreement]:
        """Parameters on which the records of two values of a group disagree, clearest first."""
        records, found = self.problem.records, []
        taken = {p.per for p in self.problem.system.grouped}
        for group in sorted({name for e in records for name, _ in e.groups} - taken):
            values = sorted({value for e in records if (value := e.group(group)) is not None})
            parts = [
                self._part(
                    f"{group}={value}",
                    [i for i, e in enumerate(records) if e.group(group) == value],
                )
                for value in values
            ]
            pairs = list(combinations([part for part in parts if part is not None], 2))
            for one, other in pairs:
                spread = one.variance + other.variance
                freedom = min(one.freedom, other.freedom)
                found += self._beyond(one, other, spread, freedom, len(pairs), group)
        return sorted(found, key=lambda d: d.chance)

    def _of_records(self) -> list[Disagreement]:
        """Parameters on which a record contradicts the others, beyond how these scatter.

        The scatter of the others is that of their estimates, so that what a model lacks in every
        record makes none of them stand out.
        """
        records = self.problem.records
        suspects = self._suspects()
        if not suspects:
            return []
        others = [i for i in range(len(records)) if i not in suspects]
        rest = self._part(f"the {len(others)} others", others)
        found: list[Disagreement] = []
        for i in suspects:
            alone = self._part(records[i].name, [i])
            if rest is None or alone is None:
                continue
            # one record scatters by sqrt(n) more than the estimate from n of them
            scatter = rest.variance * len(others) if rest.freedom < _MANY else 0.0
            spread = np.maximum(alone.variance, scatter) + rest.variance
            found += self._beyond(alone, rest, spread, rest.freedom, len(records))
        return sorted(found, key=lambda d: d.chance)

    def _suspects(self) -> list[int]:
        """Records whose own estimate, to first order, is far from the median of all."""
        fitted, n = self.state.fitted, len(self.problem.records)
        if fitted is None or n < FEWEST_RECORDS:
            return []
        of_segments = eliminated(fitted.normal)[:2]
        matrices, gradients = (np.add.reduceat(of, self.whole.begins) for of in of_segments)
        matrices = matrices + 0.01 * matrices.mean(axis=0)  # where a record says nothing: as all
        unit = np.sqrt(np.maximum(np.einsum("spp->sp", matrices), 1e-300))
        scaled = np.linalg.pinv(
            matrices / unit[:, :, None] / unit[:, None, :], rcond=1e-10, hermitian=True
        )
        own = -np.einsum("spq,sq->sp", scaled, gradients / unit) / unit
        off = np.abs(own - np.median(own, axis=0))
        usual = TO_DEVIATION * np.median(off, axis=0)
        far = np.max(off / np.maximum(usual, _LEAST / _SUSPECT), axis=1, initial=0.0)
        worst = np.argsort(-far)[: int(n * _MOST_SUSPECTS)]
        return [int(i) for i in worst if far[i] > _SUSPECT]

    def _part(self, name: str, rows: Sequence[int]) -> _Part | None:
        """The estimate from some of the records, None where it diverges."""
        segments = self.whole.of(rows)
        fitted = refitted(self.problem, self.state, segments)
        if fitted.why == "diverged" or not np.isfinite(fitted.normal.cost).all():
            return None
        space = self.state.space
        known = prior(self.problem, self.state)
        curvature = known.weight * prior_deviation(known, space, fitted.vector)[1] ** 2
        bounds = space.at_bounds(fitted.vector)
        free = np.array([name not in bounds for name in space.names])
        told = self._informed(fitted) & free
        certain = uncertainty(fitted.normal, segments, curvature, told)
        variance, freedom = np.diag(certain.trusted).copy(), float(len(rows) - 1)
        if certain.clustered is None:
            lag = lag_correlation(fitted.normal.error)
            alike = float(np.clip(np.max(np.abs(lag)), 0.0, 0.999))
            variance, freedom = variance * (1 + alike) / (1 - alike), _MANY
        return _Part(name, len(rows), fitted.vector, np.where(told, variance, np.inf), freedom)

    def _informed(self, fitted: Fitted) -> np.ndarray:
        """Which parameters the records of a fit say something of."""
        assert self.state.fitted is not None
        some, every = (
            np.einsum("spp->p", eliminated(of.normal)[0]) for of in (fitted, self.state.fitted)
        )
        return some > _NOTHING * every

    def _beyond(
        self,
        one: _Part,
        other: _Part,
        spread: Float[np.ndarray, " n_p"],
        freedom: float,
        comparisons: int,
        group: str = "",
    ) -> list[Disagreement]:
        """The parameters on which two parts differ by more than chance, Bonferroni's way."""
        off = np.abs(one.vector - other.vector)
        found, space = [], self.state.space
        for j, p in enumerate(space.searched):
            if not (np.isfinite(spread[j]) and spread[j] > 0 and off[j] > _LEAST):
                continue
            single = 2 * float(scipy.special.stdtr(freedom, -off[j] / np.sqrt(spread[j])))
            chance = min(1.0, single * comparisons * len(space.searched))
            if chance < _LEVEL:
                sides = (self._side(one, j), self._side(other, j))
                found.append(Disagreement(p.name, p.unit, group, sides, chance))
        return found

    def _side(self, part: _Part, j: int) -> Side:
        space = self.state.space
        name, slope = space.names[j], abs(float(space.slopes(part.vector)[j]))
        value = space.numbers(part.vector)[name]
        return Side(part.name, value, float(np.sqrt(part.variance[j])) * slope)
