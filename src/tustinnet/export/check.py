"""The check of an export: its steps compared with those of the model."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.errors import InputError
from tustinnet.export.source import Source
from tustinnet.export.target import Stepper, Target

STEPS = 200  # random ones
_MOST_DIVERGING = 20  # steps that may diverge where the range of the records is unknown


@dataclass(frozen=True)
class CheckResult:
    """The comparison of an export with its model.

    Attributes:
        steps: number of random steps that were compared.
        difference: the largest difference, relative to 1 + the state.
        note: a message where the consumer is not on this machine, with what was compared instead;
            else empty.
    """

    steps: int
    difference: float
    note: str = ""


def check_export(source: Source, target: Target, stepper: Stepper) -> CheckResult:
    """Compares a step with the one that the target expects, at random states and inputs.

    Raises:
        InputError: they differ by more than the target's bound, or the model itself steps to
            numbers that are not finite.
    """
    states, inputs = source.samples(STEPS)
    # compiled, which takes half of the time that it takes without
    steps = jax.jit(jax.vmap(target.expected(source)))
    expected = np.asarray(steps(*map(jnp.asarray, (states, inputs))))
    finite = np.isfinite(expected).all(axis=1)
    if not finite.all() and (source.range is not None or np.sum(~finite) > _MOST_DIVERGING):
        first = int(np.argmin(finite))
        state = ", ".join(f"{x:.3g}" for x in states[first])
        raise InputError(
            f"`to=` {target.name}",
            f"the model steps from ({state}) to numbers that are not finite",
            "finite states within the range of its records",
        )
    exported = np.stack(
        [stepper(x, u) for x, u in zip(states[finite], inputs[finite], strict=True)]
    )
    expected = expected[finite]
    difference = float(np.max(np.abs(exported - expected) / (1 + np.abs(expected)), initial=0.0))
    if not difference <= target.bound:
        raise InputError(
            f"`to=` {target.name}",
            f"a step differs from the model's by {difference:.1e}",
            f"at most {target.bound:.0e}",
            "nothing was written",
        )
    return CheckResult(len(exported), difference)
