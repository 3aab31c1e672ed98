"""The interface of all controllers."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float


@runtime_checkable
class Controller(Protocol):
    """A controller that is asked for the inputs at every sample."""

    def reset(self) -> None:
        """Forgets what it remembers of an earlier run: integrals, previous inputs, plans."""
        ...

    def inputs(self, k: int, x: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_u"]:
        """The inputs that the motors get from sample k to sample k + 1, (n_u,).

        Args:
            k: the sample, from 0 on; called once for each, in their order.
            x: the estimated state at the sample, (n_x,); NaN where the estimator has lost it. What
                is safe is commanded then.
        """
        ...
