"""Parts of records that a model does not explain though it explains the others.

Records are cut into short pieces. For each piece the state is sought with which the model follows
it best; what remains is the error of the forces alone, even where free runs of whole records
diverge. About the model's parameters these errors are linear in changes of the parameters: so the
parameters that suit all other records, and those that suit a record alone, are found without
another fit.

* A stretch with errors far above the usual ones, and above those of all pieces elsewhere, has a
  force that is not in the log. Where any other is as far off, the model lacks something; so it
  does where forces that only follow the sign of the velocity, or its sign at low speeds, explain
  them (friction), and where an input or a position is at an end of its range (a limit).
* A record that its own parameters explain far better than those of the other records was made
  under other conditions, such as another payload. Where the model lacks something, parameters
  depend on the kind of motion; so those of other single records must not explain it either.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.data.spoiled import SpoiledPart, spoiled_record, spoiled_stretch
from tustinnet.errors import InputError
from tustinnet.evaluate.reference import unseen
from tustinnet.models.contract import Model, with_dtype
from tustinnet.simulate.batches import map_in_batches
from tustinnet.simulate.input_signal import input_signals
from tustinnet.simulate.simulation import simulate_runs
from tustinnet.simulate.start_rules import FittedStart
from tustinnet.simulate.starts import start_states

_FEWEST_RECORDS = 4  # of which one can be unlike the others
_MOST_UNLIKE = 1 / 3  # of the records that are unlike the others
_STEPS = 3  # of Gauss-Newton to the best initial states
_STEP = 1e-4  # relative, for derivatives by parameters; of the spread of states by these


class MisfitLevels(NamedTuple):
    """Levels from which on a part of a record, or a whole one, is not explained by a model.

    All are set by hand, not measured.

    Attributes:
        usual: share of the pieces whose error is usual.
        far: error of a stretch that is far off, by the usual one.
        by_friction: share of the error of a stretch that friction of its own leaves.
        slow: speed by the usual one, at which friction turns.
        onset: speed by the usual one, at which friction falls.
        edge: error by the usual one, beside a stretch that is far off: a part of it.
        own: error by that with parameters of its own, of a record in other conditions.
        unlike: error by that of the median record, of one that is unlike the others.
    """

    usual: float = 0.9
    far: float = 2.5
    by_friction: float = 0.45
    slow: float = 0.02
    onset: float = 0.2
    edge: float = 1.4
    own: float = 2.7
    unlike: float = 1.5


MISFIT = MisfitLevels()


class _PieceErrors(NamedTuple):
    """Squared errors of a record's pieces as functions of changes of parameters.

    A piece's mean squared error is `constant - 2 gradient' s + s' curvature s`, each coordinate in
    units of its usual error.

    Attributes:
        curvature: (n, n_p, n_p).
        gradient: (n, n_p).
        constant: (n,).
    """

    curvature: Float[np.ndarray, "n n_p n_p"]
    gradient: Float[np.ndarray, "n n_p"]
    constant: Float[np.ndarray, " n"]

    def errors(self, change: Float[np.ndarray, " n_p"]) -> Float[np.ndarray, " n"]:
        """Root mean square errors of the pieces after a change of the parameters, (n,)."""
        second = np.einsum("kst,s,t->k", self.curvature, change, change)
        return np.sqrt(np.maximum(self.constant - 2 * self.gradient @ change + second, 1e-12))

    def part(self, pieces: slice) -> "_PieceErrors":
        """Some of the pieces."""
        return _PieceErrors(*(x[pieces] for x in self))


class _Pieces(NamedTuple):
    """Pieces of a record: residuals and what changes them, (n, samples, n_q, ...).

    Attributes:
        residual: measured less simulated positions, from the best initial states.
        by_state: derivatives of the simulation by the initial state, in units of its spread.
        by_parameter: derivatives by relative changes of the parameters.
    """

    residual: Float[np.ndarray, "n samples n_q"]
    by_state: Float[np.ndarray, "n samples n_q n_x"]
    by_parameter: Float[np.ndarray, "n samples n_q n_p"]


def find_spoiled(model: Model, records: Sequence[Experiment]) -> tuple[SpoiledPart, ...]:
    """The parts of records that a model does not explain; none where it cannot be judged by.

    A fit is not lost because its records cannot be judged, as where simulations diverge.

    Args:
        model: a model that was fitted to the records.
        records: the records.
    """
    try:
        with np.errstate(all="ignore"):
            return tuple(find_by_model(model, [e.with_timing(model.inputs) for e in records]))
    except (InputError, np.linalg.LinAlgError, FloatingPointError, ValueError):
        return ()


def find_by_model(model: Model, records: Sequence[Experiment]) -> list[SpoiledPart]:
    """The parts of records that a model does not explain though it explains the others.

    Args:
        model: a model that was fitted to the records.
        records: the records; those of fewer than three pieces are not judged.

    Returns:
        The parts, record by record; none where there are too few records to compare.
    """
    lengths = [len(e) for e in records]
    # in longer pieces a motion that depends much on its start is lost without a force
    samples = int(np.clip(np.median(lengths) // 48, 20, 50))
    records = [e for e in records if len(e) >= 3 * samples]
    if not records:
        return []
    pieces = _simulate_pieces(model, records, samples)
    errors = _make_errors(pieces, records)
    if not np.isfinite(np.concatenate([e.constant for e in errors])).all():
        return []
    unlike = _find_unlike(errors)
    alike = [i for i in range(len(records)) if i not in unlike]
    parts = [
        spoiled_record(
            records[i],
            "other conditions",
            f"short simulations are {ratio:.2g} times as far off with the parameters of other "
            "records as with its own: another payload, device or setting?",
        )
        for i, ratio in unlike.items()
    ]
    # most records have no stretch for which it is asked
    with_friction = cache(lambda: _make_errors(_with_friction(pieces, records, samples), records))
    parts += _find_stretches(
        [errors[i] for i in alike],
        lambda k: with_friction()[alike[k]],
        [records[i] for i in alike],
        samples,
    )
    order = {e.name: i for i, e in enumerate(records)}
    return sorted(parts, key=lambda part: order[part.record])


def _simulate_pieces(model: Model, records: Sequence[Experiment], samples: int) -> list[_Pieces]:
    """Residuals of all pieces from the best initial states, and their derivatives."""
    position, n_m = records[0].channels.position, records[0].channels.measured.stop

    def simulate_batch(shared: Model, batch: Sequence[Experiment]) -> list[_Pieces]:
        counts = [len(e) // samples for e in batch]
        flat = [
            e[k * samples : (k + 1) * samples]
            for e, n in zip(batch, counts, strict=True)
            for k in range(n)
        ]
        start = np.asarray(start_states(shared, flat, FittedStart(samples)))
        signal = input_signals(shared, flat)

        def positions(m: Model, x: np.ndarray) -> np.ndarray:
            return np.asarray(simulate_runs(m, x, signal))[..., position]

        # positions in a piece tell no more internal states
        n_x = start.shape[1] if start.shape[1] - n_m <= 4 else n_m
        measured = np.stack([e.q for e in flat])
        start, base, by_state = _best_starts(
            lambda x: positions(shared, x), start, start[:, :n_x].std(axis=0) + 1e-9, measured
        )
        changed = [(positions(m, start) - base) / _STEP for m in _changed_models(shared)]
        by_parameter = np.stack(changed, axis=-1) if changed else np.zeros((*measured.shape, 0))
        whole = (measured - base, by_state, by_parameter)
        by_record = (np.split(x, np.cumsum(counts)[:-1]) for x in whole)
        return [_Pieces(*arrays) for arrays in zip(*by_record, strict=True)]

    return map_in_batches(with_dtype(model, np.float64).simplify(), records, simulate_batch)


def _best_starts(
    simulate: Callable[[np.ndarray], np.ndarray],
    start: Float[np.ndarray, "n n_x"],
    spread: Float[np.ndarray, " free"],
    measured: Float[np.ndarray, "n samples n_q"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Initial states with the least squared errors, the positions, and their derivatives by these.

    Those of a free run's start stay near what is expected of internal states; what is left of
    that, squared, would be an error of a piece. Steps of Gauss-Newton, where they help.

    Args:
        simulate: positions from initial states, (n, samples, n_q).
        start: states at which the search begins.
        spread: units of the states that are sought, the first ones.
        measured: the positions.
    """
    n, free = len(start), len(spread)

    def derivatives(x: np.ndarray, base: np.ndarray) -> np.ndarray:
        moved = [x + _STEP * np.eye(x.shape[1])[j] * spread[j] for j in range(free)]
        return np.stack([(simulate(y) - base) / _STEP for y in moved], axis=-1)

    scale = np.sqrt(np.mean((measured - measured.mean(axis=1, keepdims=True)) ** 2, axis=(0, 1)))
    scale = np.maximum(scale, 1e-12)
    base = simulate(start)
    by_state = derivatives(start, base)
    for _ in range(_STEPS):
        error = ((measured - base) / scale).reshape(n, -1)
        matrix = (by_state / scale[:, None]).reshape(n, -1, free)
        if not (np.isfinite(error).all() and np.isfinite(matrix).all()):
            break
        step = np.einsum("kfi,ki->kf", np.linalg.pinv(matrix, rcond=1e-6), error)
        moved = start.copy()
        moved[:, :free] += step * spread
        runs = simulate(moved)
        is_better = np.sum(((measured - runs) / scale) ** 2, axis=(1, 2)) < np.sum(error**2, axis=1)
        start = np.where(is_better[:, None], moved, start)
        base = np.where(is_better[:, None, None], runs, base)
        by_state = derivatives(start, base)
    return start, base, by_state


def _changed_models(model: Model) -> list[Model]:
    """The model with each of its parameters changed a little; none of a model with weights."""
    arrays, static = eqx.partition(model, eqx.is_inexact_array)
    leaves, tree = jax.tree.flatten(arrays)
    # more numbers of a model are weights, no parameters
    if sum(leaf.size for leaf in leaves) > 60:
        return []
    models = []
    for i, leaf in enumerate(leaves):
        for k in np.flatnonzero(np.asarray(leaf)):
            changed = np.array(leaf, dtype=np.float64)
            changed.flat[k] *= 1 + _STEP
            others = [*leaves[:i], changed, *leaves[i + 1 :]]
            models.append(eqx.combine(jax.tree.unflatten(tree, others), static))
    return models


def _with_friction(
    pieces: Sequence[_Pieces], records: Sequence[Experiment], samples: int
) -> list[_Pieces]:
    """Pieces that also change with dry friction: alike at all speeds, and at low ones alone.

    A force is a change of the velocity at every sample; what follows is that of a change of the
    velocity at the beginning, as the equations hardly change within a piece.
    """
    n_q, velocity = records[0].channels.n_q, records[0].channels.velocity
    speeds = [e.velocities() for e in records]
    size = np.sqrt(np.mean(np.concatenate(speeds) ** 2, axis=0)) + 1e-12
    lags = np.subtract.outer(np.arange(samples), np.arange(samples))
    changes = []
    for p, v in zip(pieces, speeds, strict=True):
        n = len(p.residual)
        direction = np.tanh(v[: n * samples] / (MISFIT.slow * size)).reshape(n, samples, n_q)
        slow = np.exp(-((v[: n * samples] / (MISFIT.onset * size)) ** 2)).reshape(n, samples, n_q)
        columns = []
        for c in range(n_q):
            # by a unit of velocity: after one sample the position has moved by a period of it
            response = p.by_state[..., velocity.start + c]
            after = np.where(np.abs(unit := response[:, 1:2, c : c + 1]) > 1e-300, unit, np.inf)
            response = response / after
            for force in (direction[..., c], direction[..., c] * slow[..., c]):
                shifted = np.where(lags >= 0, force[:, np.maximum(lags, 0)], 0.0)
                columns.append(np.einsum("nts,nsq->ntq", shifted, response))
        changes.append(np.stack(columns, axis=-1))
    size_of_change = np.sqrt(np.mean(np.concatenate(changes) ** 2, axis=(0, 1, 2))) + 1e-300
    usual = np.sqrt(np.mean(np.concatenate([p.residual for p in pieces]) ** 2))
    return [
        p._replace(
            by_parameter=np.concatenate(
                [p.by_parameter, change * (usual / size_of_change)], axis=-1
            )
        )
        for p, change in zip(pieces, changes, strict=True)
    ]


def _make_errors(pieces: Sequence[_Pieces], records: Sequence[Experiment]) -> list[_PieceErrors]:
    """Squared errors of the pieces of each record, with initial states that follow the changes."""
    rms = np.sqrt(np.concatenate([np.mean(p.residual**2, axis=1) for p in pieces]))
    floor = np.median([unseen(e) for e in records], axis=0)
    spread = np.concatenate([e.q for e in records]).std(axis=0)
    usual = np.maximum(np.maximum(np.median(rms, axis=0), floor), 1e-6 * spread + 1e-12)
    result = []
    for p in pieces:
        n, samples, n_q = p.residual.shape
        size = samples * n_q
        residual = (p.residual / usual).reshape(n, size)
        by_state = (p.by_state / usual[:, None]).reshape(n, size, -1)
        by_parameter = (p.by_parameter / usual[:, None]).reshape(n, size, -1)
        largest = np.abs(by_state).max(axis=1, keepdims=True)
        basis = np.linalg.qr(by_state / np.maximum(largest, 1e-12))[0]
        residual = residual - np.einsum("kix,kjx,kj->ki", basis, basis, residual, optimize=True)
        by_parameter = by_parameter - np.einsum(
            "kix,kjx,kjp->kip", basis, basis, by_parameter, optimize=True
        )
        result.append(
            _PieceErrors(
                np.einsum("kip,kiq->kpq", by_parameter, by_parameter, optimize=True) / size,
                np.einsum("kip,ki->kp", by_parameter, residual) / size,
                np.mean(residual**2, axis=1),
            )
        )
    return result


def _best_change(errors: Sequence[_PieceErrors]) -> Float[np.ndarray, " n_p"]:
    """The change of the parameters that suits some records best, (n_p,).

    Pieces weigh the less, the larger their error (Cauchy).
    """
    together = _PieceErrors(*map(np.concatenate, zip(*errors, strict=True)))
    change = np.zeros(together.gradient.shape[1])
    for _ in range(8):
        squared = together.errors(change) ** 2
        weight = 1 / (1 + squared / (4 * np.median(squared)))
        total = np.einsum("k,kst->st", weight, together.curvature)
        # of a usual squared error, for a change of a parameter by itself
        ridge = 1e-3 * len(weight) + 1e-12 * np.trace(total)
        change = np.linalg.solve(total + ridge * np.eye(len(change)), weight @ together.gradient)
    return change


def _own_error(errors: _PieceErrors) -> float:
    """Median error of a record's pieces with parameters from its other pieces."""
    halves = [errors.part(slice(k, None, 2)) for k in (0, 1)]
    own = [a.errors(_best_change([b])) for a, b in (halves, halves[::-1])]
    return float(np.median(np.concatenate(own)))


def _find_unlike(errors: Sequence[_PieceErrors]) -> dict[int, float]:
    """Records that their own parameters explain far better than those of other records.

    Two records of other conditions explain one another: the parameters of single records count
    from the second best on.

    Returns:
        By the record's index, the ratio of the errors with the others' parameters and its own.
    """
    unlike: dict[int, float] = {}
    if len(errors) < _FEWEST_RECORDS:
        return unlike
    own = [_own_error(e) for e in errors]
    changes = [_best_change([e]) for e in errors]
    by_single = [
        sorted(float(np.median(e.errors(change))) for j, change in enumerate(changes) if j != i)[1]
        for i, e in enumerate(errors)
    ]
    while len(unlike) < int(_MOST_UNLIKE * len(errors)):
        alike = [i for i in range(len(errors)) if i not in unlike]
        by_others = {
            i: float(np.median(e.errors(_best_change([errors[j] for j in alike if j != i]))))
            for i, e in enumerate(errors)
            if i in alike
        }
        typical = float(np.median(list(by_others.values())))
        ratios = {
            i: min(error, by_single[i]) / own[i]
            for i, error in by_others.items()
            if error > MISFIT.unlike * typical
        }
        worst = max(ratios, key=lambda i: ratios[i], default=None)
        if worst is None or ratios[worst] < MISFIT.own:
            break
        unlike[worst] = ratios[worst]
    return unlike


def _find_stretches(
    errors: Sequence[_PieceErrors],
    with_friction: Callable[[int], _PieceErrors],
    records: Sequence[Experiment],
    samples: int,
) -> list[SpoiledPart]:
    """Stretches whose errors are far above the usual ones.

    A piece counts where one beside it is far off, too: single ones are chance.

    Args:
        errors: the errors of the pieces of each record.
        with_friction: returns those of a record, with friction as the last parameters.
        records: the records.
        samples: length of a piece.
    """
    if not errors:
        return []
    few = len(errors) < _FEWEST_RECORDS
    changes = [_best_change(errors if few else [x for x in errors if x is not e]) for e in errors]
    single = [e.errors(change) for e, change in zip(errors, changes, strict=True)]
    smooth = [_running_median(x) for x in single]
    usual = float(np.quantile(np.concatenate(smooth), MISFIT.usual))
    median = float(np.median(np.concatenate(single)))
    parts = []
    for i, record in enumerate(records):
        is_far_off = smooth[i] > MISFIT.far * usual
        is_part = np.maximum(single[i], smooth[i]) > MISFIT.edge * usual
        runs = np.flatnonzero(np.diff(is_part, prepend=False, append=False)).reshape(-1, 2)
        for a, b in runs.tolist():
            if not is_far_off[a:b].any():
                continue
            # where any other piece is as far off, the model lacks something, in more places
            others = [*single[:i], single[i][:a], single[i][b:], *single[i + 1 :]]
            if np.median(single[i][a:b]) <= np.concatenate(others).max(initial=0.0):
                continue
            is_far = single[i][a:b] > MISFIT.edge * usual
            if _is_friction(with_friction(i).part(slice(a, b)), is_far, changes[i]):
                continue
            first = max(0, a * samples - samples // 2)
            stop = min(len(record), b * samples + samples // 2)
            if _is_at_an_end(records, i, slice(first, stop)):
                continue
            reason = (
                f"short simulations are {single[i][a:b].max() / median:.2g} times as far off as "
                "usual: moved by a hand, a contact, or another force that is not in the log?"
            )
            parts.append(spoiled_stretch(record, first, stop, "unlogged force", reason))
    return parts


def _is_at_an_end(records: Sequence[Experiment], i: int, rows: slice) -> bool:
    """Whether an input, or its change, is beyond all others in some rows of a record.

    Or a position is at an end of its travel. What a model lacks of limits shows there alone.
    """
    columns = [np.column_stack([e.u, np.diff(e.u, axis=0, prepend=e.u[:1]), e.q]) for e in records]
    inside = columns[i][rows]
    columns[i] = np.delete(columns[i], rows, axis=0)
    outside, n = np.concatenate(columns), 2 * records[0].u.shape[1]
    beyond = np.abs(inside[:, :n]).max(axis=0) > np.abs(outside[:, :n]).max(axis=0)
    near = 0.01 * np.ptp(outside[:, n:], axis=0)
    ends = [np.abs(f(inside, axis=0) - f(outside, axis=0))[n:] <= near for f in (np.min, np.max)]
    return bool(beyond.any() or np.any(ends))


def _is_friction(
    errors: _PieceErrors, is_far: np.ndarray, change: Float[np.ndarray, " n_p"]
) -> bool:
    """Whether friction of its own explains most of what the parameters of all leave of a stretch.

    Args:
        errors: the errors of its pieces, with friction as the last parameters.
        is_far: the pieces that are far off.
        change: the change of the other parameters that suits all records.
    """
    n = len(change)
    whole = np.concatenate([change, np.zeros(errors.gradient.shape[1] - n)])
    matrix = errors.curvature[is_far][:, n:, n:].sum(axis=0)
    rest = errors.gradient[is_far] - errors.curvature[is_far] @ whole
    ridge = 1e-9 * np.trace(matrix) + 1e-300
    own = np.linalg.solve(matrix + ridge * np.eye(len(matrix)), rest[:, n:].sum(axis=0))
    before = errors.errors(whole)[is_far]
    after = errors.errors(np.concatenate([change, own]))[is_far]
    return bool(np.sum(after**2) < MISFIT.by_friction**2 * np.sum(before**2))


def _running_median(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Median of each value and those beside it, (n,)."""
    padded = np.pad(values, 1, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 3), axis=1)
