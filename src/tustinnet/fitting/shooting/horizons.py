"""Horizons: over how many steps a record can be simulated before errors have grown too much.

About an unstable equilibrium that a controller holds, an error in the state doubles again and
again: the logged input, which held the plant, does not know of the simulation's errors. Such
records are compared over segments. `find_horizons` takes records, a system and its parameters and
returns a number of steps for each of these records. How much an error may grow is a matter of the
sensors: one as small as their noise must stay small beside the motion.

Only growth that goes on counts. Along a stiff plant that is stable, as two masses with a belt
between them, a small displacement of one mass soon becomes a large velocity, and grows no more.
"""

from collections.abc import Sequence
from math import ceil, log2

import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import evaluate
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.models.closed_loop import without_controller_states
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.signals.outliers import sensor_noise
from tustinnet.simulate.horizon import FOLLOWED

_GROWTH = 300.0  # of errors, with sensors without noise: forces that a model lacks grow, too
_LEAST_GROWTH = 10.0  # that of a fall which goes through upright once may be 50, of a held one any
_FEWEST_BLOCKS = 2  # blocks of the shortest horizon: half a swing
_SMALL = 0.5  # norm of a matrix whose exponential four terms of the series give to 1e-3
_AT_ONCE = 50_000  # samples whose transitions are in memory together


def find_horizons(
    system: LagrangianSystem,
    space: SearchSpace,
    vector: ParameterVector,
    experiments: Sequence[Experiment],
    group_indices: Int[np.ndarray, "n_r n_g"],
    block: int,
) -> dict[str, int]:
    """Finds the horizons of records: steps before an error of the start grows too much.

    The equations of motion are linearised at every measured state; products of the transitions give
    the growth of an error of the state, every position and velocity in units of its spread along
    the record. It is too much where it would take the noise of a sensor to the share of the motion
    from which on a free run follows no more.

    Args:
        system: the system.
        space: the search space.
        vector: the parameters.
        experiments: the records.
        group_indices: the values of parameters per group that apply in them, see
            `groups.group_indices`.
        block: steps of a quarter of a swing; a horizon is a multiple of it.

    Returns:
        Steps by the record's name, at least half a swing's. Records are not in it in which no error
        grows so much anywhere, nor those whose input never changes.
    """
    # a motor alone, its link held in place, would hide how an arm falls; what a controller
    # remembers is no part of the measured states
    system = rigid_system(without_controller_states(system))
    equations, values = system_equations(system), space.to_values(vector)
    horizons = {}
    for e, indices in zip(experiments, group_indices, strict=True):
        if not e.forced:  # nothing holds it: what grows in the model grows in the record too
            continue
        states = e.measured_states()
        n_m = states.shape[1]
        parameters = equations.parameter_rows(values, indices[None])
        spread = states.std(axis=0)
        unit = np.where(spread > 0, spread, 1.0)
        a = np.empty((len(e) - 1, n_m, n_m))
        for k in range(0, len(a), _AT_ONCE):
            part = slice(k, min(k + _AT_ONCE, len(a)))
            given = states[part], e.u[part], np.repeat(parameters, part.stop - k, axis=0)
            points = np.concatenate([np.zeros_like(given[0]), *given], axis=1)
            jacobian = evaluate(equations.measured_derivative, points, derivatives=True)
            a[part] = jacobian.reshape(-1, n_m, n_m) / unit[:, None] * unit
        growth = _bearable_growth(e, spread)
        if np.isfinite(a).all() and (steps := steps_before_growth(a, e.dt, block, growth)):
            horizons[e.name] = steps
    return horizons


def _bearable_growth(e: Experiment, spread: Float[np.ndarray, " n_x"]) -> Float[np.ndarray, " n_x"]:
    """Growth of an error of each measured state that leaves noise small beside the motion.

    An initial velocity is known as well as its position is, each in units of its spread.
    """
    noise = sensor_noise(e.q, e.channels.resolution)
    relative = spread[: len(noise)] / np.maximum(noise, np.finfo(float).tiny)
    growth = np.clip(FOLLOWED * relative, _LEAST_GROWTH, _GROWTH)
    return np.concatenate([growth, growth])


@np.errstate(over="ignore", invalid="ignore")  # an error that overflows has grown
def steps_before_growth(
    a: Float[np.ndarray, "n n_x n_x"],
    dt: float,
    block: int,
    growth: Float[np.ndarray, " n_x"] | float = _GROWTH,
) -> int | None:
    """Steps in which `dx/dt = A(t) dx` lets no error grow too much, wherever it begins.

    Growth is counted in multiples of the transient growth. Where an element of the transition grows
    to `C e^(rt)`, that is `C`, read from its growth along a stretch, along the next one and along
    both: over stretches of one block, of two, of four ... up to half of the record. It depends
    on the units of the states and on the stiffness of the plant, the rate `r` does not. Growth that
    only takes long, as the distance that a free mass goes with a wrong velocity, is transient, too.

    Args:
        a: A at every sample.
        dt: sampling period [s].
        block: steps between the beginnings that are tried.
        growth: of an error of each state, what is too much.

    Returns:
        A multiple of the block, at least 2 of them; None where no error grows so much.
    """
    blocks = len(a) // block
    if blocks <= _FEWEST_BLOCKS:
        return None
    begins = range(0, blocks * block, max(1, _AT_ONCE // block) * block)
    parts = [a[k : min(k + begins.step, blocks * block)] for k in begins]
    transitions, peaks = zip(
        *(_transitions_across_blocks(part, dt, block) for part in parts), strict=True
    )
    across_block, peak = np.concatenate(transitions), np.concatenate(peaks)
    doubled = [across_block]  # from every block's beginning over 1, 2, 4, ... blocks
    transient = np.ones(across_block.shape[1:])
    while 2 ** len(doubled) <= blocks:
        reach = 2 ** (len(doubled) - 1)
        doubled.append(doubled[-1][reach:] @ doubled[-1][:-reach])
        both, before, after = np.abs(doubled[-1]), peak[:-reach], peak[reach:]
        peak = np.maximum(np.maximum(before, after), both)
        transients = np.nan_to_num(before * after / peak, nan=1.0, posinf=1.0)
        # that of most stretches: a fall that a record goes through once is none
        transient = np.maximum(transient, np.median(transients, axis=0))

    def has_grown(errors: np.ndarray) -> bool:
        return not np.linalg.norm(errors / transient / growth, axis=(1, 2)).max() <= 1

    # as many blocks as no error grows in, by bisection
    length, error = 0, np.broadcast_to(np.eye(a.shape[1]), across_block.shape)
    for k in reversed(range(len(doubled))):
        further = doubled[k][length:]
        longer = further @ error[: len(further)]
        if len(longer) and not has_grown(longer):
            length, error = length + 2**k, longer
    return None if length == blocks else max(length, _FEWEST_BLOCKS) * block


def _transitions_across_blocks(
    a: np.ndarray, dt: float, block: int
) -> tuple[np.ndarray, np.ndarray]:
    """The transition over each block of samples, and the largest size of its elements within it.

    Returns:
        Transitions and sizes, each (n / block, n_x, n_x).
    """
    # exponentials of A dt, by squaring those of a small part of it
    # up to this norm exponentials are computed in earnest
    size = min(float(np.abs(a).sum(axis=2).max()) * dt, 1e15)
    halvings = max(0, ceil(log2(max(size, _SMALL) / _SMALL)))
    small, one = a * (dt / 2**halvings), np.eye(a.shape[1])
    transitions = one + small @ (one + small / 2 @ (one + small / 3 @ (one + small / 4)))
    for _ in range(halvings):
        transitions = transitions @ transitions
    transitions = transitions.reshape(-1, block, *a.shape[1:])
    across_block = np.broadcast_to(one, transitions[:, 0].shape)
    peak = np.zeros_like(across_block)
    for j in range(block):
        across_block = transitions[:, j] @ across_block
        peak = np.maximum(peak, np.abs(across_block))
    return across_block, peak
