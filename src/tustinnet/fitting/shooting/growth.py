"""How fast errors grow along records: over how long a stretch simulating them can be compared.

About an unstable equilibrium that a controller holds, an error in the state doubles again and
again: the logged input, which held the plant, does not know of the simulation's errors.
"""

from collections.abc import Sequence
from math import ceil, log2

import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.engine.runs import evaluate
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.space import Searched, Space
from tustinnet.models.lagrangian import LagrangianSystem

_GROWTH = 1000.0  # falls from upright stay below 50; about a held upright position it has no end
_SHORTEST = 4  # blocks: a swing can always be compared
_LARGEST = 1e15  # of a matrix that is looked at in earnest
_SMALL = 0.5  # of a matrix whose exponential four terms of the series give to 1e-3
_AT_ONCE = 50_000  # samples whose transitions are held in memory together


def horizons(
    system: LagrangianSystem,
    space: Space,
    vector: Searched,
    records: tuple[Sequence[Experiment], Int[np.ndarray, "n_r n_g"]],
    block: int,
) -> dict[str, int]:
    """Over how many steps records can be simulated before an error grows a thousandfold.

    The equations of motion are linearised at every measured state; products of the transitions say
    what becomes of an error of the state, velocities in units in which they spread as positions do.

    Args:
        system: the system.
        space: the parameters' coordinates.
        vector: the parameters.
        records: the records, and which of their values parameters per group have in them.
        block: steps of a quarter of a swing; what is found is a multiple of it.

    Returns:
        Steps by the record's name, at least a swing's; records are left out in which no error
        grows so much anywhere, and those whose input never changes.
    """
    experiments, picks = records
    equations, values = system_equations(system), space.values(vector)
    of = system.channels
    found = {}
    for e, pick in zip(experiments, picks, strict=True):
        if not e.forced:  # nothing holds it: what grows in the model grows in the record too
            continue
        known = e.measured_states()
        n_x = known.shape[1] + len(system.internal)
        parameters = equations.values(values, pick[None])
        moved, fast = (known[:, part].var(axis=0).sum() for part in (of.position, of.velocity))
        unit = np.ones(known.shape[1])
        unit[of.velocity] = np.sqrt(fast / moved) if fast and moved else 1.0
        a = np.empty((len(e) - 1, len(unit), len(unit)))
        for k in range(0, len(a), _AT_ONCE):
            part = slice(k, min(k + _AT_ONCE, len(a)))
            points = np.zeros((part.stop - k, n_x + e.u.shape[1] + parameters.shape[1]))
            points[:, : len(unit)] = known[part]  # internal states stay at zero
            points[:, n_x:] = np.concatenate(
                [e.u[part], np.broadcast_to(parameters, (len(points), parameters.shape[1]))], axis=1
            )
            slopes = evaluate(equations.slopes, points, derivatives=True).reshape(-1, n_x, n_x)
            a[part] = slopes[:, of.measured, of.measured] / unit[:, None] * unit
        if np.isfinite(a).all() and (steps := bounded(a, e.dt, block)):
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
    begins = range(0, blocks * block, max(1, _AT_ONCE // block) * block)
    parts = [a[k : min(k + begins.step, blocks * block)] for k in begins]
    over = np.concatenate([_across_blocks(part, dt, block) for part in parts])
    doubled = [over]  # from every block's beginning over 1, 2, 4, ... blocks
    while not _grown(doubled[-1]) and 2 ** len(doubled) <= blocks:
        reach = 2 ** (len(doubled) - 1)
        doubled.append(doubled[-1][reach:] @ doubled[-1][:-reach])
    # as many blocks as no error grows in, by bisection
    below = doubled[:-1] if _grown(doubled[-1]) else doubled
    length, error = 0, np.broadcast_to(np.eye(a.shape[1]), over.shape)
    for k in reversed(range(len(below))):
        further = below[k][length:]
        tried = further @ error[: len(further)]
        if len(tried) and not _grown(tried):
            length, error = length + 2**k, tried
    return None if length == blocks else max(length, _SHORTEST) * block


def _grown(errors: np.ndarray) -> bool:
    return not np.linalg.norm(errors, axis=(1, 2)).max() <= _GROWTH


def _across_blocks(a: np.ndarray, dt: float, block: int) -> np.ndarray:
    """The transition over each block of samples, (n / block, n_x, n_x)."""
    each = _transitions(a, dt).reshape(-1, block, *a.shape[1:])
    over = each[:, 0]
    for j in range(1, block):
        over = each[:, j] @ over
    return over


def _transitions(a: np.ndarray, dt: float) -> np.ndarray:
    """The exponentials of `A dt`, (n, n_x, n_x), by squaring those of a small part of it."""
    size = min(float(np.abs(a).sum(axis=2).max()) * dt, _LARGEST)
    halvings = max(0, ceil(log2(max(size, _SMALL) / _SMALL)))
    small, one = a * (dt / 2**halvings), np.eye(a.shape[1])
    found = one + small @ (one + small / 2 @ (one + small / 3 @ (one + small / 4)))
    for _ in range(halvings):
        found = found @ found
    return found
