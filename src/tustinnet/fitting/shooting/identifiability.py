"""Identifiability: which parameters cannot be told apart by the records (confounded parameters).

`find_confounded` takes the products of derivatives `J'J` and returns sets of parameters that can
change together without changing any simulation, each with the parameter to fix.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace

# squared derivatives: a change in the last digit moves the simulation by 1
_DIVERGED_SQUARES = 1e30


@dataclass(frozen=True)
class ConfoundedParameters:
    """Parameters that can change together without changing any simulation.

    Attributes:
        shares: relative change of each parameter (of its range where it is not positive), the
            suggested one's being 1.
        suggestion: the parameter to fix, of these the best known beforehand.
        spread: change of the others [in units of the search] where the suggested one is off by a
            standard deviation of what is known of it beforehand.
    """

    shares: dict[str, float]
    suggestion: str
    spread: dict[str, float] = field(default_factory=dict)

    @property
    def finding(self) -> Finding:
        """The finding: the parameters have no effect, only their ratios have, or other changes."""
        if len(self.shares) == 1:
            return make_finding("no effect", fixed=self.suggestion)
        is_ratio = np.allclose([*self.shares.values()], 1.0, atol=1e-3)
        return make_finding(
            "only ratios" if is_ratio else "not separate",
            parameters=[*self.shares],
            fixed=self.suggestion,
            changes=self.shares,
        )


def describe_confounded(confounded: Sequence[ConfoundedParameters], total: int) -> list[Finding]:
    """Parameters that are fixed, as they are not identifiable from the records.

    Args:
        confounded: the sets that are not identifiable, one finding each where they are few.
        total: how many parameters were free.
    """
    if len(confounded) <= 5:  # each has a sentence of its own
        return [one.finding for one in confounded]
    names = list(dict.fromkeys(one.suggestion for one in confounded))
    return [
        make_finding("combinations without effect", count=len(confounded), total=total, fixed=names)
    ]


def has_diverged(products: Float[np.ndarray, "n_p n_p"]) -> bool:
    """Whether the simulations diverge, or nearly do, so that their derivatives say nothing.

    Args:
        products: `J'J` by the parameters, (n_p, n_p).
    """
    return bool(
        not np.isfinite(products).all() or np.diag(products).max(initial=0.0) > _DIVERGED_SQUARES
    )


def find_confounded(
    space: SearchSpace, vector: ParameterVector, products: Float[np.ndarray, "n_p n_p"]
) -> tuple[ConfoundedParameters, ...]:
    """Finds the null space of the derivatives by the parameters' logarithms.

    Every direction of it names one parameter that no other direction has, chosen among those whose
    prior or range is narrowest; with these fixed, the others are identifiable.

    Args:
        space: the search space.
        vector: the parameters at which the derivatives were taken.
        products: `J'J` by that vector, (n_p, n_p).
    """
    diagonal = np.sqrt(np.diag(products))
    strong = diagonal > 1e-12 * diagonal.max(initial=0.0)
    unit = np.where(strong, diagonal, 1.0)
    values, vectors = np.linalg.eigh(products / np.outer(unit, unit) + np.diag(1.0 * ~strong))
    # in units in which every parameter acts alike, directions without effect
    null = (vectors[:, values < 1e-11 * values.max()] / unit[:, None]).T
    null /= np.maximum(np.abs(null).max(axis=1, keepdims=True), 1e-300)
    null = np.vstack([null, np.eye(len(vector))[~strong]])
    # a standard deviation that is known beforehand counts as half a range
    priors = np.array([p.prior or np.inf for p in space.free_parameters])
    ranges = np.minimum(2 * priors / space.derivatives(vector), space.upper - space.lower)
    prior_precision = 1 / ranges
    # Gauss-Jordan elimination: the pivots are the parameters to fix
    pivots: list[int] = []
    for row in range(len(null)):
        weight = np.abs(null[row:]).max(axis=0) * prior_precision
        # of parameters that are about as well known, the one that matters most in the direction
        pivot = int(np.argmax(np.where(np.isin(np.arange(len(vector)), pivots), -1, weight)))
        best = row + int(np.argmax(np.abs(null[row:, pivot])))
        null[[row, best]] = null[[best, row]]
        null[row] /= null[row, pivot]
        others = np.arange(len(null)) != row
        null[others] -= np.outer(null[others, pivot], null[row])
        pivots.append(pivot)
    confounded = []
    for direction, pivot in zip(null, pivots, strict=True):
        members = np.flatnonzero(np.abs(direction) > 1e-3 * np.abs(direction).max())
        shares = {space.names[i]: float(direction[i]) for i in members}
        spread = {
            name: abs(x) * float(ranges[pivot]) / 2
            for name, x in shares.items()
            if name != space.names[pivot]
        }
        confounded.append(ConfoundedParameters(shares, space.names[pivot], spread))
    return tuple(confounded)
