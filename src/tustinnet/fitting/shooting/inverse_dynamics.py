"""First values of parameters: the equations of motion on measured motion, without simulation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Any, cast

import numpy as np
import scipy.optimize
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.engine.runs import evaluate
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.space import Searched, Space
from tustinnet.models.lagrangian import LagrangianSystem

_SHORTEST, _LONGEST = 8, 200  # samples of a window
_AT_ONCE = 50_000  # samples whose derivatives are held in memory together
_TELLING = 0.7  # a reversal is likely when it leaves less than this part of the residual
_MOST_FLIPPED = 2
_WELL_EXPLAINED = 0.1


@dataclass(frozen=True)
class Motion:
    """Measured motion, records one after the other.

    Attributes:
        q: positions, (n, n_q).
        v: velocities, (n, n_q).
        u: inputs, (n, n_u).
        pick: which of their values parameters per group have, see `groups.picks`, (n, n_g).
        begins: first sample of every window, (n_w,).
        record: index of the record each window is of, (n_w,).
        length: samples of a window.
        dt: sampling period [s].
    """

    q: Float[np.ndarray, "n n_q"]
    v: Float[np.ndarray, "n n_q"]
    u: Float[np.ndarray, "n n_u"]
    pick: Int[np.ndarray, "n n_g"]
    begins: Int[np.ndarray, " n_w"]
    record: Int[np.ndarray, " n_w"]
    length: int
    dt: float


def measured_motion(
    experiments: Sequence[Experiment], picks: Int[np.ndarray, "n_r n_g"] | None = None
) -> Motion:
    """Positions, velocities and inputs of records, and windows of a quarter of a swing.

    Args:
        experiments: the records.
        picks: what each has of parameters per group, see `groups.picks`; none by default.
    """
    velocities = [e.velocities() for e in experiments]
    length = min(_quarter_swing(velocities), *(len(e) for e in experiments))
    begins, record, offset = [], [], 0
    for i, e in enumerate(experiments):
        added = range(offset, offset + len(e) - length + 1, max(1, length // 2))
        begins += added
        record += [i] * len(added)
        offset += len(e)
    # an input held over the period acts, on average, where the period's middle is
    inputs = [np.vstack([e.held_inputs, e.held_inputs[-1:]]) for e in experiments]
    delayed = [np.vstack([u[:1], (u[1:] + u[:-1]) / 2]) for u in inputs]
    return Motion(
        np.concatenate([e.q for e in experiments]),
        np.concatenate(velocities),
        np.concatenate(delayed),
        np.repeat(
            np.zeros((len(experiments), 0), int) if picks is None else picks,
            [len(e) for e in experiments],
            axis=0,
        ),
        np.array(begins),
        np.array(record),
        length,
        experiments[0].dt,
    )


def first_values(
    system: LagrangianSystem, space: Space, vector: Searched, motion: Motion
) -> tuple[Searched, Float[np.ndarray, " n_r"]]:
    """Least squares on the equations of motion.

    With the momentum `P = dT/dv`, `dP/dt = dT/dq - dV/dq + Q - D` is multiplied by a smooth bump
    that is 0 at the ends of a window and integrated, the left side by parts. So no acceleration is
    needed, and the residuals are linear in the base parameters. Forces with memory are left out.

    Args:
        system: the system.
        space: the parameters' coordinates.
        vector: where to start.
        motion: what was measured.

    Returns:
        The vector, and per record what is left of the change of momentum: 0 explains all of it,
        1 nothing, (n_r,).

    References:
        Atkeson, An, Hollerbach (1986), Estimation of inertial parameters of manipulator loads
        and links (linear least squares). Preisig, Rippin (1993), modulating functions.
    """
    s = np.linspace(-1, 1, motion.length)
    bump = (1 - s**2) ** 3
    slope = -6 * s * (1 - s**2) ** 2 * 2 / ((motion.length - 1) * motion.dt)
    equations = system_equations(system, space.names)
    base = equations.base(space)
    per_group = max(1, _AT_ONCE // motion.length)
    groups = [motion.begins[k : k + per_group] for k in range(0, len(motion.begins), per_group)]

    def at(point: Searched) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        residuals, jacobians, changes = [], [], []
        for begins in groups:
            part = slice(begins[0], begins[-1] + motion.length)
            parameters = equations.values(space.values(point), motion.pick[part])
            samples = np.concatenate(
                [motion.q[part], motion.v[part], motion.u[part], parameters], axis=1
            )
            momentum, force = np.split(evaluate(equations.momenta, samples), 2, axis=1)
            slopes = evaluate(equations.momenta, samples, derivatives=True)
            by_momentum, by_force = np.split(slopes, 2, axis=1)
            windows = (begins - begins[0])[:, None] + np.arange(motion.length)
            lifted = _weighted(momentum, windows, slope)
            residuals.append(lifted + _weighted(force, windows, bump))
            jacobian = _weighted(by_momentum, windows, slope) + _weighted(by_force, windows, bump)
            jacobian = jacobian.reshape(len(begins), motion.q.shape[1], -1)[:, :, base]
            chain = equations.chain(space, point, motion.pick[begins])
            jacobians.append(jacobian * chain[:, None])
            changes.append(lifted)
        return np.concatenate(residuals), np.concatenate(jacobians), np.concatenate(changes)

    # each equation in units of its own momentum at the start
    unit = np.sqrt(np.mean(at(vector)[2] ** 2, axis=0))
    unit = np.where(unit > 0, unit, 1.0) * np.sqrt(len(motion.begins))
    # residuals and their derivatives are asked for one after the other, at the same point
    answer = lru_cache(1)(lambda point: at(np.frombuffer(point)))

    margin = 1e-9 * (space.upper - space.lower)
    found = scipy.optimize.least_squares(
        lambda point: (answer(point.tobytes())[0] / unit).ravel(),
        np.clip(vector, space.lower + margin, space.upper - margin),
        cast(
            Any, lambda point: (answer(point.tobytes())[1] / unit[:, None]).reshape(-1, len(vector))
        ),
        bounds=(space.lower, space.upper),
        max_nfev=60,
    )
    residual, _, lifted = at(found.x)
    return space.clipped(found.x), _left(motion.record, residual / unit, lifted / unit)


def _weighted(
    signal: Float[np.ndarray, "n m"],
    windows: Int[np.ndarray, "n_w length"],
    weight: Float[np.ndarray, " length"],
) -> Float[np.ndarray, "n_w m"]:
    """Weighted sums of a signal over windows, which are given by the indices of their samples."""
    return np.einsum("wlm,l->wm", signal[windows], weight)


def _left(
    record: Int[np.ndarray, " n_w"],
    residual: Float[np.ndarray, "n_w n_q"],
    lifted: Float[np.ndarray, "n_w n_q"],
) -> Float[np.ndarray, " n_r"]:
    """Per record what is left of the change of momentum, from the windows' residuals."""
    left, moved = (np.bincount(record, np.sum(x**2, axis=1)) for x in (residual, lifted))
    windows = np.bincount(record)
    usual = windows * moved.sum() / windows.sum()  # a record that hardly moves says little
    return left / np.maximum(np.maximum(moved, usual / 10), 1e-300)


def likely_reversals(
    system: LagrangianSystem, space: Space, vector: Searched, motion: Motion
) -> tuple[tuple[str, ...], ...]:
    """Coordinates or inputs whose sign explains the motion clearly better when it is reversed.

    Args:
        system: the system.
        space: the parameters' coordinates.
        vector: where to start.
        motion: what was measured.

    Returns:
        Alternatives, each the names to reverse together, as few as possible; a symmetric system
        may have several. Empty where the signs are right.
    """
    names = [c.name for c in system.coordinates] + [i.name for i in system.inputs]
    n_q = len(system.coordinates)

    def left(flipped: tuple[int, ...]) -> np.ndarray:
        signs = np.ones(len(names))
        signs[list(flipped)] = -1.0
        q, v, u = motion.q * signs[:n_q], motion.v * signs[:n_q], motion.u * signs[n_q:]
        turned = replace(motion, q=q, v=v, u=u)
        return first_values(system, space, vector, turned)[1]

    before = left(())
    for count in range(1, _MOST_FLIPPED + 1):
        tried = {flipped: left(flipped) for flipped in combinations(range(len(names)), count)}
        # the record that is explained worst tells: others may not move what is reversed, but
        # none that was explained well may suffer
        allowed = np.maximum(before, _WELL_EXPLAINED)
        found = {f: shares.max() for f, shares in tried.items() if np.all(shares <= allowed)}
        best = min(found.values(), default=np.inf)
        if best < _TELLING * before.max():
            alike = [f for f, value in found.items() if value < 1.1 * best]
            return tuple(tuple(names[i] for i in flipped) for flipped in alike)
    return ()


def _quarter_swing(velocities: Sequence[np.ndarray]) -> int:
    """Samples in which the fastest coordinate's velocity forgets itself: a quarter of a swing."""
    shortest = _LONGEST
    for v in velocities:
        for column in v.T:
            if not np.ptp(column):
                continue
            centred = column - column.mean()
            spectrum = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
            correlation = np.fft.irfft(spectrum)[: len(centred)]
            below = np.flatnonzero(correlation <= 0)
            if len(below):
                shortest = min(shortest, int(below[0]))
    return max(_SHORTEST, shortest)
