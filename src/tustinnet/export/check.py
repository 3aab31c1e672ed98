"""Whether what was exported computes what the model does."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError
from tustinnet.export.source import Source
from tustinnet.export.target import Stepper, Target

STEPS = 200  # random ones
_MOST = 20  # that may leave the floating-point range where nobody knows the range of the records


@dataclass(frozen=True)
class CheckResult:
    """How an export compares with its model.

    Attributes:
        steps: how many random steps were compared.
        difference: the largest difference, relative to 1 + the state.
        note: where the consumer is not on this machine, that and what was compared instead; or "".
    """

    steps: int
    difference: float
    note: str = ""


def check_export(source: Source, target: Target, stepper: Stepper) -> CheckResult:
    """Compares a step with what the target says it should be, at random states and inputs.

    Raises:
        InputError: they differ by more than the target's bound, or the model itself steps to
            numbers that are not finite.
    """
    states, inputs = source.samples(STEPS)
    # compiled, which takes half of the time that it takes without
    steps = jax.jit(jax.vmap(target.expected(source)))
    expected = np.asarray(steps(*map(jnp.asarray, (states, inputs))))
    finite = np.isfinite(expected).all(axis=1)
    if not finite.all() and (source.range is not None or np.sum(~finite) > _MOST):
        first = int(np.argmin(finite))
        raise InputError(
            f"--to {target.name}", f"the model steps from {_told(states[first])} to numbers that "
            "are not finite", "finite states within the range of its records",
        )  # fmt: skip
    found = np.stack([stepper(*of) for of in zip(states[finite], inputs[finite], strict=True)])
    expected = expected[finite]
    difference = float(np.max(np.abs(found - expected) / (1 + np.abs(expected)), initial=0.0))
    if not difference <= target.bound:
        raise InputError(
            f"--to {target.name}", f"a step differs from the model's by {difference:.1e}",
            f"at most {target.bound:.0e}", "nothing was written",
        )  # fmt: skip
    return CheckResult(len(found), difference)


def _told(state: Float[np.ndarray, " n_x"]) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in state) + ")"
