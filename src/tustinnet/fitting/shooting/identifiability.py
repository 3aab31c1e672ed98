"""Which parameters the records can tell apart."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.fitting.shooting.space import Searched, Space

_NULL = 1e-11  # of the largest eigenvalue, in units in which every parameter acts alike
_MEMBER = 1e-3  # of the largest share


@dataclass(frozen=True)
class Confounded:
    """Parameters that can change together without changing any simulation.

    Attributes:
        shares: relative change of each parameter (of its range where it is not positive), the
            suggested one's being 1.
        suggestion: the parameter to fix, of these the best known beforehand.
    """

    shares: dict[str, float]
    suggestion: str

    def __str__(self) -> str:
        if len(self.shares) == 1:
            return f"'{self.suggestion}' has no effect on these records; fix it"
        names = list(self.shares)
        listed = f"{', '.join(names[:-1])} and {names[-1]}"
        values = np.array(list(self.shares.values()))
        if np.allclose(values, 1.0, atol=1e-3):
            return (
                f"only ratios of {listed} can be identified: multiplied by one factor they give "
                f"the same simulation; fix one of them, '{self.suggestion}' is known best"
            )
        told = ", ".join(f"{n} {s:+.3g} %" for n, s in self.shares.items())
        return (
            f"{listed} cannot be told apart: changed together ({told}) they give the same "
            f"simulation; fix one of them, '{self.suggestion}' is known best"
        )


def confounded(
    space: Space, vector: Searched, products: Float[np.ndarray, "n_p n_p"]
) -> tuple[Confounded, ...]:
    """The null space of the derivatives by the parameters' logarithms, direction by direction.

    Every direction names one parameter that no other direction has, chosen among those whose
    range is narrowest; with these fixed, the others are identifiable.

    Args:
        space: the parameters' coordinates.
        vector: where the derivatives were taken.
        products: `J'J` by that vector, (n_p, n_p).
    """
    diagonal = np.sqrt(np.diag(products))
    strong = diagonal > 1e-12 * diagonal.max(initial=0.0)
    unit = np.where(strong, diagonal, 1.0)
    values, vectors = np.linalg.eigh(products / np.outer(unit, unit) + np.diag(1.0 * ~strong))
    null = (vectors[:, values < _NULL * values.max()] / unit[:, None]).T
    null /= np.maximum(np.abs(null).max(axis=1, keepdims=True), 1e-300)
    null = np.vstack([null, np.eye(len(vector))[~strong]])
    known = 1 / (space.upper - space.lower)
    suggested: list[int] = []
    for row in range(len(null)):
        weight = np.abs(null[row:]).max(axis=0) * known
        # of parameters that are about as well known, the one that matters most in the direction
        pivot = int(np.argmax(np.where(np.isin(np.arange(len(vector)), suggested), -1, weight)))
        best = row + int(np.argmax(np.abs(null[row:, pivot])))
        null[[row, best]] = null[[best, row]]
        null[row] /= null[row, pivot]
        others = np.arange(len(null)) != row
        null[others] -= np.outer(null[others, pivot], null[row])
        suggested.append(pivot)
    found = []
    for direction, pivot in zip(null, suggested, strict=True):
        members = np.flatnonzero(np.abs(direction) > _MEMBER * np.abs(direction).max())
        shares = {space.names[i]: float(direction[i]) for i in members}
        found.append(Confounded(shares, space.names[pivot]))
    return tuple(found)
