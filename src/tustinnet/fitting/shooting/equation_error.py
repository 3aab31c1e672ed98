"""Equation-error estimate: parameters by least squares on the equations of motion.

Nothing is simulated: the balance of momentum along the measured motion is integrated over short
windows, and the parameters are those that leave least of it. The estimate is where a search by
simulation starts. `collect_motion` takes the records, `estimate_by_equation_error` returns the
parameters, and `find_reversed_signs` the signs that are probably wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import smooth_velocities
from tustinnet.engine.engines import evaluate
from tustinnet.fitting.report import SignAlternatives
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.models.lagrangian import LagrangianSystem

_REVERSED = 0.7  # a reversal is likely when it leaves less than this part of the residual
# unexplained share of the momentum: right signs leave a few hundredths, wrong ones over a half
WELL_EXPLAINED = 0.1


@dataclass(frozen=True)
class MeasuredMotion:
    """Measured motion, records one after the other, and windows of it.

    Attributes:
        q: positions, (n, n_q).
        v: velocities, (n, n_q).
        u: inputs, (n, n_u).
        group_indices: the values of parameters per group that apply, see `groups.group_indices`,
            (n, n_g).
        window_begins: first sample of every window, (n_w,).
        window_records: index of the record each window is of, (n_w,).
        quarter_swing: samples of a quarter of a swing, or of the shortest record; every window
            has so many.
        dt: sampling period [s].
    """

    q: Float[np.ndarray, "n n_q"]
    v: Float[np.ndarray, "n n_q"]
    u: Float[np.ndarray, "n n_u"]
    group_indices: Int[np.ndarray, "n n_g"]
    window_begins: Int[np.ndarray, " n_w"]
    window_records: Int[np.ndarray, " n_w"]
    quarter_swing: int
    dt: float


class EquationErrorEstimate(NamedTuple):
    """Parameters by least squares on the equations of motion.

    Attributes:
        vector: the parameters, (n_p,).
        unexplained: share of the change of momentum that they leave of every record: 0 where they
            explain all of it, 1 where nothing, (n_r,).
    """

    vector: ParameterVector
    unexplained: Float[np.ndarray, " n_r"]


def collect_motion(
    experiments: Sequence[Experiment], group_indices: Int[np.ndarray, "n_r n_g"] | None = None
) -> MeasuredMotion:
    """Collects positions, velocities and inputs of records, and windows of a quarter of a swing.

    Args:
        experiments: the records.
        group_indices: the values of parameters per group that apply in each, see
            `groups.group_indices`; no parameter per group by default.
    """
    velocities = [smooth_velocities(e) for e in experiments]
    length = min(_quarter_swing(velocities), *(len(e) for e in experiments))
    begins, record, offset = [], [], 0
    for i, e in enumerate(experiments):
        added = range(offset, offset + len(e) - length + 1, max(1, length // 2))
        begins += added
        record += [i] * len(added)
        offset += len(e)
    # an input held over the period acts, on average, where the period's middle is
    held_inputs = [np.vstack([e.held_inputs, e.held_inputs[-1:]]) for e in experiments]
    inputs = [np.vstack([u[:1], (u[1:] + u[:-1]) / 2]) for u in held_inputs]
    if group_indices is None:
        group_indices = np.zeros((len(experiments), 0), int)
    return MeasuredMotion(
        q=np.concatenate([e.q for e in experiments]),
        v=np.concatenate(velocities),
        u=np.concatenate(inputs),
        group_indices=np.repeat(group_indices, [len(e) for e in experiments], axis=0),
        window_begins=np.array(begins),
        window_records=np.array(record),
        quarter_swing=length,
        dt=experiments[0].dt,
    )


def estimate_by_equation_error(
    system: LagrangianSystem, space: SearchSpace, vector: ParameterVector, motion: MeasuredMotion
) -> EquationErrorEstimate:
    """Estimates parameters by least squares on the equations of motion.

    With the momentum `P = dT/dv`, `dP/dt = dT/dq - dV/dq + Q - D` is multiplied by a smooth bump
    that is 0 at the ends of a window and integrated, the left side by parts. So no acceleration is
    needed, and the residuals are linear in the base parameters. Forces with memory are left out.

    Args:
        system: the system.
        space: the search space.
        vector: the parameters to start from.
        motion: the measured motion.

    References:
        Atkeson, An, Hollerbach (1986), Estimation of inertial parameters of manipulator loads
        and links (linear least squares). Preisig, Rippin (1993), modulating functions.
    """
    length = motion.quarter_swing
    s = np.linspace(-1, 1, length)
    bump = (1 - s**2) ** 3
    bump_rate = -6 * s * (1 - s**2) ** 2 * 2 / ((length - 1) * motion.dt)
    equations = system_equations(system, space.names)
    columns = equations.free_columns(space)
    # as many samples have their derivatives in memory together
    per_batch = max(1, 50_000 // length)
    batches = [
        motion.window_begins[k : k + per_batch]
        for k in range(0, len(motion.window_begins), per_batch)
    ]

    def balance(point: ParameterVector) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals of all windows, their derivatives, and the changes of momentum."""
        residuals, jacobians, changes = [], [], []
        for begins in batches:
            part = slice(begins[0], begins[-1] + length)
            parameters = equations.parameter_rows(
                space.to_values(point), motion.group_indices[part]
            )
            samples = np.concatenate(
                [motion.q[part], motion.v[part], motion.u[part], parameters], axis=1
            )
            formula = equations.momentum_and_force
            momentum, force = np.split(evaluate(formula, samples), 2, axis=1)
            derivatives = evaluate(formula, samples, derivatives=True)
            by_momentum, by_force = np.split(derivatives, 2, axis=1)
            window_sums, rate_sums = (
                _sums_over_windows(begins - begins[0], weight) for weight in (bump, bump_rate)
            )
            change = rate_sums @ momentum
            residuals.append(change + window_sums @ force)
            jacobian = rate_sums @ by_momentum + window_sums @ by_force
            jacobian = jacobian.reshape(len(begins), motion.q.shape[1], -1)[:, :, columns]
            chain = equations.coordinate_derivatives(space, point, motion.group_indices[begins])
            jacobians.append(jacobian * chain[:, None])
            changes.append(change)
        return np.concatenate(residuals), np.concatenate(jacobians), np.concatenate(changes)

    # each equation in units of its own momentum at the start
    unit = np.sqrt(np.mean(balance(vector)[2] ** 2, axis=0))
    unit = np.where(unit > 0, unit, 1.0) * np.sqrt(len(motion.window_begins))
    # residuals and their derivatives are called for one after the other, at the same point
    cached = lru_cache(1)(lambda point: balance(np.frombuffer(point)))

    import scipy.optimize  # takes half a second, and what is not identified needs none of it

    solution = scipy.optimize.least_squares(
        lambda point: (cached(point.tobytes())[0] / unit).ravel(),
        space.clip(vector),
        cast(
            Any, lambda point: (cached(point.tobytes())[1] / unit[:, None]).reshape(-1, len(vector))
        ),
        bounds=(space.lower, space.upper),
        method="dogbox",  # "trf" stays off the bounds, and takes tiny steps beside them
        max_nfev=60,
    )
    residual, _, change = balance(solution.x)
    residual_squares, change_squares = (
        np.bincount(motion.window_records, np.sum(x**2, axis=1))
        for x in (residual / unit, change / unit)
    )
    windows = np.bincount(motion.window_records)
    # a record that hardly moves says little: its change counts as a tenth of the usual at least
    usual = windows * change_squares.sum() / windows.sum()
    return EquationErrorEstimate(
        space.clip(solution.x),
        residual_squares / np.maximum(np.maximum(change_squares, usual / 10), 1e-300),
    )


def _sums_over_windows(
    begins: Int[np.ndarray, " n_w"], weight: Float[np.ndarray, " length"]
) -> Any:
    """Sparse matrix whose product with a signal is its weighted sums over windows, (n_w, n).

    Args:
        begins: first sample of each window; the last one ends where the signal does.
        weight: weights of the samples of a window.
    """
    import scipy.sparse  # takes time to load

    columns = (begins[:, None] + np.arange(len(weight))).ravel()
    rows = np.arange(len(begins) + 1) * len(weight)
    shape = len(begins), begins[-1] + len(weight)
    return scipy.sparse.csr_array((np.tile(weight, len(begins)), columns, rows), shape=shape)


def find_reversed_signs(
    system: LagrangianSystem, space: SearchSpace, vector: ParameterVector, motion: MeasuredMotion
) -> SignAlternatives:
    """Coordinates or inputs whose sign explains the motion clearly better when it is reversed.

    Args:
        system: the system.
        space: the search space.
        vector: the parameters to start from.
        motion: the measured motion.

    Returns:
        Alternatives, each the names to reverse together, as few as possible; a symmetric system
        may have several. Empty where the signs are right, as those of a system that explains most
        records well.
    """
    names = [c.name for c in system.coordinates] + [i.name for i in system.inputs]
    n_q = len(system.coordinates)

    def unexplained(flipped: tuple[int, ...]) -> np.ndarray:
        signs = np.ones(len(names))
        signs[list(flipped)] = -1.0
        q, v, u = motion.q * signs[:n_q], motion.v * signs[:n_q], motion.u * signs[n_q:]
        flipped_motion = replace(motion, q=q, v=v, u=u)
        return estimate_by_equation_error(system, space, vector, flipped_motion).unexplained

    before = unexplained(())

    def concerns_most(after: np.ndarray) -> bool:
        """Whether most records that change with the sign are explained poorly as they are."""
        changed = before[np.abs(after - before) > 0.01 * before.max()]
        return bool(len(changed) and np.median(changed) >= WELL_EXPLAINED * before.max())

    for count in (1, 2):
        shares = {
            flipped: unexplained(flipped) for flipped in combinations(range(len(names)), count)
        }
        # the record that is explained worst decides: others may not move what is reversed, but
        # none that was explained well may suffer
        allowed = np.maximum(before, WELL_EXPLAINED)
        worst = {
            flipped: x.max()
            for flipped, x in shares.items()
            if np.all(x <= allowed) and concerns_most(x)
        }
        best = min(worst.values(), default=np.inf)
        if best < _REVERSED * before.max():
            alike = [flipped for flipped, value in worst.items() if value < 1.1 * best]
            return tuple(tuple(names[i] for i in flipped) for flipped in alike)
    return ()


def _quarter_swing(velocities: Sequence[np.ndarray]) -> int:
    """Samples after which the fastest velocity is no longer correlated: a quarter of a swing."""
    shortest = 200
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
    return max(8, shortest)
