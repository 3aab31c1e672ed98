"""Equilibria of models under the limits of their inputs, and the modes about them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Bool, Complex, Float

from tustinnet.control.dynamics import (
    ControlledModel,
    InputLimits,
    Limits,
    controlled,
    input_limits,
    require_known,
)
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.simulate.linearise import value_and_jacobian
from tustinnet.wording import join_words

_TURNS = np.pi / 4 * np.arange(-4, 5)  # rad, where other equilibria are searched for
_ON_CIRCLE = 1e-4  # 1/s, rates of growth or decay that count as none
_SINGULAR = 1e-10  # of the largest direction, in which rates change with the states and inputs
_NO_EFFECT = 1e-7  # of the effect of inputs on a mode, or of a mode on the encoders


class Prices(NamedTuple):
    """Prices of a deviation of 1 in the search for an equilibrium.

    All are set by hand, not measured: each is a hundred times the next, at least.

    Attributes:
        named: of positions that are named.
        velocity: of velocities.
        other: of other positions.
        input: of inputs, in halves of their range.
        internal: of internal states.
    """

    named: float = 1e6
    velocity: float = 1e4
    other: float = 1e2
    input: float = 1e-2
    internal: float = 1e-4


PRICES = Prices()


@dataclass(frozen=True)
class Mode:
    """A mode of a linearised model.

    Attributes:
        eigenvalue: of the discrete model.
        rate: of growth, or negative of decay [1/s]; -inf of a mode that ends in one step.
        frequency: [rad/s].
        states: names of the states that move in it, the most first.
        controllable: whether the inputs act on it.
        observable: whether the encoders show it.
    """

    eigenvalue: complex
    rate: float
    frequency: float
    states: tuple[str, ...]
    controllable: bool
    observable: bool

    @property
    def is_stable(self) -> bool:
        """Whether it decays."""
        return self.rate < -_ON_CIRCLE

    def __str__(self) -> str:
        value = self.eigenvalue
        number = f"{value.real:.4g}" if not value.imag else f"{value.real:.4g}+-{value.imag:.4g}j"
        return f"the mode of {' and '.join(self.states)} with the eigenvalue {number}"


@dataclass(frozen=True)
class OperatingPoint:
    """An equilibrium of a model, and what is known of it there.

    Attributes:
        x: the state, (n_x,).
        u: the inputs, (n_u,).
        names: names of the states.
        modes: modes of the model about it, those that grow fastest first; of a pair of complex
            ones the one above.
    """

    x: Float[np.ndarray, " n_x"]
    u: Float[np.ndarray, " n_u"]
    names: tuple[str, ...]
    modes: tuple[Mode, ...]

    @property
    def is_unstable(self) -> bool:
        """Whether a mode grows."""
        return any(mode.rate > _ON_CIRCLE for mode in self.modes)

    @property
    def stability(self) -> str:
        """Stability of the equilibrium in words."""
        if self.is_unstable:
            worst = self.modes[0]  # that grows fastest
            times = f"doubles in {np.log(2) / worst.rate:.3g} s"
            return f"unstable: {worst.states[0]} {times}"
        idle = [m for m in self.modes if not m.is_stable]
        if idle:
            return f"marginally stable: {idle[0].states[0]} stays where it is put"
        slowest = self.modes[0]
        half = -np.log(2) / slowest.rate
        return f"stable: {slowest.states[0]} is the slowest, halves in {half:.3g} s"

    @property
    def controllable(self) -> str:
        """Controllability of the equilibrium from the inputs in words."""
        missing = [m for m in self.modes if not m.controllable]
        return _in_words("controllable", "not controllable from the inputs", missing)

    @property
    def observable(self) -> str:
        """Observability of the equilibrium from the encoders in words."""
        missing = [m for m in self.modes if not m.observable]
        return _in_words("observable", "not observable from the encoders", missing)


def _in_words(positive: str, negative: str, missing: list[Mode]) -> str:
    if not missing:
        return positive
    kinds = [f"{mode} ({'stable' if mode.is_stable else 'not stable'})" for mode in missing]
    return f"{negative}: {', '.join(kinds)}"


def find_equilibrium(
    model: Model,
    at: Mapping[str, float],
    limits: Limits | None = None,
    tolerance: float = 0.1,
    speeds: Float[np.ndarray, " n_q"] | None = None,
    sizes: Float[np.ndarray, " n_q"] | None = None,
) -> OperatingPoint:
    """An equilibrium of a model at named positions, with inputs within their limits.

    Positions that are not named are as near to 0 as an equilibrium allows, and inputs as small. A
    fitted model may have its equilibrium beside the position that is named: `x` says where.

    Args:
        model: a model that steps from sample to sample.
        at: positions by name [rad or m].
        limits: limits of inputs by name, instead of those that the model declares.
        tolerance: how far an equilibrium may be from the named positions, by `sizes`.
        speeds: usual speeds about it for which the modes are found [rad/s or m/s], (n_q,); by
            default the model is linearised at rest, where dry friction holds it.
        sizes: usual sizes of the coordinates' motion [rad or m], (n_q,), where they are below 1,
            which is the default.

    Returns:
        The equilibrium, its modes, and in words its stability, controllability, observability.

    Raises:
        InputError: no equilibrium there (the nearest is named), a name that is no coordinate, an
            input without limits.
    """
    system, bounds = controlled(model), input_limits(model, limits)
    channels = model.channels
    positions = [c.name for c in channels.coordinates]
    require_known(at, positions, "equilibrium", "coordinates")
    for name, value in at.items():
        if not np.isfinite(value):
            raise InputError("equilibrium", f"{name} = {value}", "a finite position")
    n_x = system.n_x
    target = np.zeros(n_x)
    target[channels.position] = [at.get(name, 0.0) for name in positions]
    size = np.ones(channels.n_q) if sizes is None else np.where(sizes > 0, sizes, 1.0).clip(max=1.0)
    price = np.full(n_x, PRICES.internal)
    price[channels.position] = [PRICES.named if name in at else PRICES.other for name in positions]
    price[channels.velocity] = PRICES.velocity
    price[channels.position] /= size**2
    price[channels.velocity] /= size**2
    search = _EquilibriumSearch(system, bounds, target, price)

    def distance(point: Float[np.ndarray, " n_xu"] | None) -> float:
        """The largest distance from a named position, by the sizes; inf of no point."""
        if point is None:
            return np.inf
        off = np.abs(point[channels.position] - target[channels.position]) / size
        off = [d for d, name in zip(off.tolist(), positions, strict=True) if name in at]
        return max(off, default=0.0)

    # friction that holds a part of the load today holds another one tomorrow
    nearest = search.settle(target, is_relaxed=True) if search.internal.any() else None
    if distance(nearest) > tolerance:
        nearest = search.settle(target)
    if distance(nearest) > 1e-6:
        # nothing changes with inputs inside their dead zones
        others = [search.settle(target, share) for share in (-0.9, 0.9)]
        nearest = min([nearest, *others], key=distance)
    if distance(nearest) > tolerance:
        starts = _other_starts(target, channels.angular, positions, at)
        nearest = min([nearest, *(search.settle(first) for first in starts)], key=distance)
    if nearest is None or distance(nearest) > tolerance:
        raise _no_equilibrium(at, nearest, positions, bounds, channels.inputs)
    x, u = nearest[:n_x], bounds.clip(nearest[n_x:])
    return OperatingPoint(x, u, system.names, find_modes(system, x, u, speeds))


@dataclass(frozen=True)
class _EquilibriumSearch:
    """Search for an equilibrium near a state.

    Attributes:
        system: the model.
        bounds: the limits of the inputs.
        target: the state, (n_x,).
        price: of a squared distance from each state, (n_x,).
    """

    system: ControlledModel
    bounds: InputLimits
    target: Float[np.ndarray, " n_x"]
    price: Float[np.ndarray, " n_x"]

    @property
    def internal(self) -> Bool[np.ndarray, " n_x"]:
        """Whether a state is an internal one."""
        internal = np.zeros(self.system.n_x, bool)
        internal[self.system.model.channels.internal] = True
        return internal

    def settle(
        self, first: Float[np.ndarray, " n_x"], inputs: float = 0.0, *, is_relaxed: bool = False
    ) -> Float[np.ndarray, " n_xu"] | None:
        """The equilibrium nearest to the named positions that is reached from a state.

        Args:
            first: the state.
            inputs: the inputs, all as a share of half of their ranges.
            is_relaxed: whether internal states are 0, as of dry friction that holds nothing.
        """
        system, n_x, bounds, target = self.system, self.system.n_x, self.bounds, self.target
        half = (bounds.upper - bounds.lower) / 2
        unit = np.concatenate([1 / np.sqrt(self.price), half / np.sqrt(PRICES.input)])
        centre = np.concatenate([target, bounds.clip(np.zeros(system.n_u))])
        free = np.where(self.internal & is_relaxed, 0.0, np.inf)
        lower, upper = (
            np.concatenate([end, (own - centre[n_x:]) / unit[n_x:]])
            for end, own in zip((-free, free), bounds, strict=True)
        )

        def change(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            point = centre + unit * y
            value, jacobian = value_and_jacobian(system.held_formula, point)
            jacobian = jacobian - np.eye(n_x, len(point))
            return (value - point[:n_x]) / system.dt, jacobian * unit / system.dt

        commands = np.full(system.n_u, inputs * np.sqrt(PRICES.input))
        y = np.concatenate([(first - target) / unit[:n_x], commands])
        with np.errstate(all="ignore"):
            # rates that depend on one another, as of dry friction with a memory, count once
            axes, sizes, _ = np.linalg.svd(np.nan_to_num(change(y)[1]), full_matrices=False)
            independent = axes[:, sizes > _SINGULAR * sizes[0]].T
            result = scipy.optimize.minimize(
                lambda y: (y @ y / 2, y),
                y,
                jac=True,
                method="SLSQP",
                bounds=[*zip(lower.tolist(), upper.tolist(), strict=True)],
                constraints={
                    "type": "eq",
                    "fun": lambda y: independent @ change(y)[0],
                    "jac": lambda y: independent @ change(y)[1],
                },
                options={"maxiter": 200, "ftol": 1e-14},
            )
            nearby = result.x
            for _ in range(5):  # from where all of them are nearly 0
                rate, slopes = change(nearby)
                if not np.isfinite(slopes).all():
                    break
                nearby = np.clip(nearby - np.linalg.pinv(slopes, _SINGULAR) @ rate, lower, upper)
            point, rate = centre + unit * nearby, change(nearby)[0]
        is_settled = np.isfinite(rate).all() and np.all(
            # largest change in a second, of the sizes of 1 + state
            np.abs(rate) <= 1e-6 * (1 + np.abs(point[:n_x]))
        )
        # only rounding keeps smaller ones from 0
        return np.where(np.abs(point) < 1e-12, 0.0, point) if is_settled else None


def _other_starts(
    target: Float[np.ndarray, " n_x"],
    angular: np.ndarray,
    positions: list[str],
    at: Mapping[str, float],
) -> list[Float[np.ndarray, " n_x"]]:
    """States whose named angles are turned, one at a time."""
    starts = []
    for i, name in enumerate(positions):
        if name in at and angular[i]:
            for turn in _TURNS[_TURNS != 0]:
                start = target.copy()
                start[i] += turn
                starts.append(start)
    return starts


def _no_equilibrium(
    at: Mapping[str, float],
    nearest: np.ndarray | None,
    positions: list[str],
    bounds: object,
    inputs: tuple,
) -> InputError:
    place = ", ".join(f"{name} = {value:g}" for name, value in at.items())
    if nearest is None:
        return InputError(
            "equilibrium",
            f"none at {place} under the limits of the inputs, nor near it",
            "positions at which the model can stand still",
            "name others, or widen the limits",
        )
    n_u = len(inputs)
    stands = ", ".join(
        f"{name} = {nearest[i]:.4g}" for i, name in enumerate(positions) if name in at
    )
    forces = ", ".join(
        f"{i.name} = {value:.4g}" for i, value in zip(inputs, nearest[-n_u:], strict=True)
    )
    return InputError(
        "equilibrium",
        f"none at {place} under the limits of the inputs",
        f"the nearest one, {stands} (with {forces})",
        "name its positions, or widen the limits",
    )


def find_modes(
    system: ControlledModel,
    x: Float[np.ndarray, " n_x"],
    u: Float[np.ndarray, " n_u"],
    speeds: Float[np.ndarray, " n_q"] | None = None,
) -> tuple[Mode, ...]:
    """The modes of a model about a point, those that grow fastest first.

    Controllability and observability are tested mode by mode (Popov, Belevitch and Hautus), in
    units in which velocities and inputs have sizes like those of positions.

    Args:
        system: the model.
        x: the state, (n_x,).
        u: the inputs, (n_u,).
        speeds: usual speeds about the point, (n_q,), see `ControlledModel.tangent`.

    References:
        Hautus (1969), Controllability and observability conditions of linear autonomous systems.
    """
    n_x = system.n_x
    a, b = tangent_of_held_inputs(system, x, u, speeds)
    a, units = scipy.linalg.matrix_balance(a, permute=False, separate=True)
    scale = units[0]
    b = b / scale[:, None]
    c = np.eye(n_x)[system.model.channels.position] * scale
    b = b / (np.linalg.norm(b, axis=0) + 1e-300)
    c = c / np.linalg.norm(c, axis=1)[:, None]
    values, vectors = np.linalg.eig(a)
    order = np.argsort(-np.abs(values), kind="stable")
    modes = []
    for i in order:
        value = complex(values[i])
        if value.imag < 0:
            continue
        shifted = a - value * np.eye(n_x)
        is_controllable = _smallest(np.hstack([shifted, b])) > _NO_EFFECT
        is_observable = _smallest(np.vstack([shifted, c])) > _NO_EFFECT
        size = np.abs(value)
        rate = np.log(size) / system.dt if size else -np.inf
        modes.append(
            Mode(
                value,
                float(rate),
                float(np.angle(value) / system.dt),
                _moving_states(vectors[:, i], system),
                bool(is_controllable),
                bool(is_observable),
            )
        )
    return tuple(modes)


def tangent_of_held_inputs(
    system: ControlledModel,
    x: Float[np.ndarray, " n_x"],
    u: Float[np.ndarray, " n_u"],
    speeds: Float[np.ndarray, " n_q"] | None,
) -> tuple[Float[np.ndarray, "n_x n_x"], Float[np.ndarray, "n_x n_u"]]:
    """The linear model of the step, where every command of the past is that of now."""
    n_x = system.n_x
    a, b = system.tangent(x, u, speeds)
    b = b + a[:, n_x:].reshape(len(a), -1, system.n_u).sum(axis=1)
    return a[:n_x, :n_x], b[:n_x]


def _smallest(matrix: Complex[np.ndarray, "n m"] | Float[np.ndarray, "n m"]) -> float:
    """The smallest singular value, which is 0 where the rank is not full."""
    return float(np.linalg.svd(matrix, compute_uv=False)[-1])


def _moving_states(vector: np.ndarray, system: ControlledModel) -> tuple[str, ...]:
    """Names of the coordinates and internal states with a large part in a mode.

    A velocity counts for its coordinate.
    """
    share = np.abs(vector)
    channels = system.model.channels
    share[channels.position] = np.maximum(share[channels.position], share[channels.velocity])
    share[channels.velocity] = 0.0
    order = np.argsort(-share, kind="stable")
    return tuple(system.names[i] for i in order if share[i] >= share.max() / 3)


def require_stabilisable(
    system: ControlledModel,
    x: Float[np.ndarray, " n_x"],
    u: Float[np.ndarray, " n_u"],
    speeds: Float[np.ndarray, " n_q"] | None,
) -> None:
    """Raises where the inputs move nothing, or not a mode that does not decay.

    Raises:
        InputError: inputs without effect, or such a mode, by its coordinates and its eigenvalue.
    """
    _, b = tangent_of_held_inputs(system, x, u, speeds)
    if not b.any():
        inputs = zip(system.model.channels.inputs, u, strict=True)
        idle = [f"{i.name} at {value:.4g} {i.unit}".rstrip() for i, value in inputs]
        raise InputError(
            "lqr",
            f"the gain of {join_words(idle)} is 0, as inside a dead zone: linear feedback moves "
            "nothing",
            "inputs that act at the equilibrium",
            "hold a point whose inputs are beyond the dead zone; or fit a model to commands less "
            "their dead zone, and add its width to those of the controller",
        )
    for mode in find_modes(system, x, u, speeds):
        if not mode.controllable and not mode.is_stable:
            raise InputError(
                "lqr",
                f"{mode} is not controllable from the inputs and does not decay",
                "inputs that move it",
                "choose another point, or another model",
            )
