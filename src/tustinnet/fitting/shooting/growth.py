"""How fast errors grow along records: over how long a stretch simulating them can be compared.

About an unstable equilibrium that a controller holds, an error in the state doubles again and
again: the logged input, which held the plant, does not know of the simulation's errors.
"""

from collections.abc import Sequence
from functools import partial
from math import ceil, log2
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.shooting.space import Searched, Space
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

_GROWTH = 1000.0  # falls from upright stay below 50; about a held upright position it has no end
_SHORTEST = 4  # blocks: a swing can always be compared
_LARGEST = 1e15  # of a matrix that is looked at in earnest
_SMALL = 0.5  # of a matrix whose exponential four terms of the series give to 1e-3


def horizons(
    system: LagrangianSystem,
    space: Space,
    vector: Searched,
    experiments: Sequence[Experiment],
    block: int,
    picks: Int[np.ndarray, "n_r n_g"] | None = None,
) -> dict[str, int]:
    """Over how many steps records can be simulated before an error grows a thousandfold.

    The equations of motion are linearised at every measured state; products of the transitions say
    what becomes of an error of the state, velocities in units in which they spread as positions do.

    Args:
        system: the system.
        space: the parameters' coordinates.
        vector: the parameters.
        experiments: the records.
        block: steps of a quarter of a swing; what is found is a multiple of it.
        picks: what each has of parameters per group, see `groups.picks`; none by default.

    Returns:
        Steps by the record's name, at least a swing's; records are left out in which no error
        grows so much anywhere, and those whose input never changes.
    """
    of, longest = system.channels, max(map(len, experiments))
    picks = np.zeros((len(experiments), 0), int) if picks is None else picks
    found = {}
    for e, pick in zip(experiments, picks, strict=True):
        if (
            not e.forced
        ):  # nothing holds it: what grows in the model grows in the record, or is wrong
            continue
        known = e.measured_states()
        # all as long as the longest, so that one program serves them; internal states at 0
        x = np.zeros((longest, known.shape[1] + len(system.internal)))
        u = np.zeros((longest, e.u.shape[1]))
        x[: len(e), of.measured], u[: len(e)] = known, e.u
        slopes = _slopes(system, space.searched, space.fixed_arrays, vector, (x, u, pick))
        a = np.asarray(slopes)[: len(e) - 1, of.measured, of.measured]
        moved, fast = (known[:, part].var(axis=0).sum() for part in (of.position, of.velocity))
        unit = np.ones(known.shape[1])
        unit[of.velocity] = np.sqrt(fast / moved) if fast and moved else 1.0
        if np.isfinite(a).all() and (steps := bounded(a / unit[:, None] * unit, e.dt, block)):
            found[e.name] = steps
    return found


@np.errstate(over="ignore", invalid="ignore")  # what overflows has grown
def bounded(a: Float[np.ndarray, "n n_x n_x"], dt: float, block: int) -> int | None:
    """Steps in which `dx/dt = A(t) dx` lets no error grow a thousandfold, wherever it begins.

    Args:
        a: A at every sample.
        dt: sampling period [s].
        block: steps between the places that are looked at.

    Returns:
        A multiple of the block, at least 4 of them; None where no error grows so much.
    """
    blocks = len(a) // block
    if blocks <= _SHORTEST:
        return None
    each = _transitions(a[: blocks * block], dt).reshape(blocks, block, *a.shape[1:])
    over = each[:, 0]
    for j in range(1, block):
        over = each[:, j] @ over
    error = over  # from every block's beginning, over 1, 2, ... blocks
    for k in range(1, blocks + 1):
        if not np.linalg.norm(error, axis=(1, 2)).max() <= _GROWTH:
            return max(k - 1, _SHORTEST) * block
        error = over[k:] @ error[:-1]
    return None


def _transitions(a: np.ndarray, dt: float) -> np.ndarray:
    """The exponentials of `A dt`, (n, n_x, n_x), by squaring those of a small part of it."""
    size = min(float(np.abs(a).sum(axis=2).max()) * dt, _LARGEST)
    halvings = max(0, ceil(log2(max(size, _SMALL) / _SMALL)))
    small, one = a * (dt / 2**halvings), np.eye(a.shape[1])
    found = one + small @ (one + small / 2 @ (one + small / 3 @ (one + small / 4)))
    for _ in range(halvings):
        found = found @ found
    return found


@partial(jax.jit, static_argnums=(0, 1))
def _slopes(
    system: LagrangianSystem,
    searched: tuple[Parameter, ...],
    fixed: dict[str, Array],
    vector: Array,
    along: tuple[Any, Any, Any],
) -> Float[Array, "n n_x n_x"]:
    """The derivatives of `dx/dt` by the state at every sample."""
    x, u, pick = along
    model = system.model(system.picked(Space(searched, fixed).values(vector), pick))
    return jax.vmap(jax.jacfwd(model.derivative))(x, u)
