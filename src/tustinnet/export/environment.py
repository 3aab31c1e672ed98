"""Models as environments of Gymnasium: one, and many that step at once.

The states of a model are observed. Actions are in -1..1 and stand for the range of the inputs that
the training records have. An episode ends where a state leaves the range of the records.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from tustinnet.engine.runs import evaluate
from tustinnet.errors import InputError
from tustinnet.export.source import Source
from tustinnet.simulate.range import Range

STATE = "x"  # of the options of `reset`: the state to start from

Vector = Float[np.ndarray, " _"]
Rows = Float[np.ndarray, "count _"]
OneReward = Callable[[Vector, Vector, Vector], float]
Rewards = Callable[[Rows, Rows, Rows], Vector]


@dataclass(frozen=True)
class Rules:
    """What an environment simulates, where it starts and ends, and what it rewards.

    Attributes:
        source: the model, whose records' range is known.
        reward: `hold`, `swing-up`, or a function of the state, the inputs and the state after them,
            (n_x,), (n_u,), (n_x,). `hold` is the product over all coordinates of how near each is
            to the target, `swing-up` how near the last angle is: `(1 + cos d) / 2` of an angle,
            `max(0, 1 - (d / w)^2)` of a linear coordinate, w the width of its range. None of them
            is negative, so that it never pays to end an episode.
        target: positions, (n_q,) [rad or m]; by default 0, of `hold` those of a given `start`.
        start: positions and velocities, internal states may follow, (2 n_q,) or (n_x,); None for
            anywhere in the range. Internal states that nobody gives start as the model expects.
        noise: what is added to a given start, a share of the widths of the range.
        margin: how far beyond the range an episode goes on, a share of its widths.

    Raises:
        InputError: nobody knows where the training records lie, or no input moves in them; a start
            of another size or out of the range, shares that are none.
    """

    source: Source
    reward: str | OneReward = "hold"
    target: ArrayLike | None = None
    start: ArrayLike | None = None
    noise: float = 0.01
    margin: float = 0.1

    def __post_init__(self) -> None:
        if not (0 <= self.noise < np.inf and 0 < self.margin < np.inf):
            raise InputError(
                "environment", f"noise {self.noise}, margin {self.margin}",
                "shares of the range's width, the noise from 0 on, the margin above 0",
            )  # fmt: skip
        if not (self.inputs[:, 1] > self.inputs[:, 0]).any():
            raise InputError(
                "environment", "no input that the training records move", "one to act with"
            )
        if self.start is not None:
            self.stated(self.start, "start")

    @property
    def range(self) -> Range:
        """Where states and inputs lie."""
        if self.source.range is None:
            raise InputError(
                "environment", "the model does not say where its training records lie", "a range",
                'give range={"states": [[low, high], ...], "inputs": [[low, high], ...]}',
            )  # fmt: skip
        return self.source.range

    @property
    def width(self) -> Vector:
        """Of the range of the states, (n_x,); 1 of one that is always the same."""
        low, high = self.range.states.T
        return np.where(high > low, high - low, 1.0)

    @cached_property
    def bounds(self) -> Float[np.ndarray, "n_x 2"]:
        """Beyond which an episode ends."""
        beyond = self.margin * self.width
        return self.range.states + np.stack([-beyond, beyond], axis=1)

    @cached_property
    def inputs(self) -> Float[np.ndarray, "n_u 2"]:
        """What actions of -1 and 1 stand for: the range of the inputs, within their limits."""
        declared = [i.limits or (-np.inf, np.inf) for i in self.source.channels.inputs]
        limits = np.reshape(declared, (-1, 2))
        return np.clip(self.range.inputs, limits[:, :1], limits[:, 1:])

    @property
    def observation_space(self) -> Box:
        """Of the states [q, v, z]."""
        return Box(*self.bounds.T, dtype=np.float64)

    @property
    def action_space(self) -> Box:
        """-1..1 of every input."""
        return Box(-1.0, 1.0, (len(self.inputs),), np.float64)

    def acting(self, action: ArrayLike) -> Float[np.ndarray, "*many n_u"]:
        """The inputs that actions stand for."""
        low, high = self.inputs.T
        return low + (np.clip(np.asarray(action, float), -1.0, 1.0) + 1) / 2 * (high - low)

    def stated(self, given: ArrayLike, where: str) -> Vector:
        """A whole state, internal states as the model expects where they are not given.

        Raises:
            InputError: another number of states, or one out of bounds.
        """
        of, x = self.source.channels, np.zeros(self.source.n_x)
        known = np.asarray(given, float)
        if known.shape not in (x.shape, x[of.measured].shape):
            raise InputError(
                where, f"{known.size} numbers", f"positions and velocities of {of.n_q} coordinates"
            )
        x[: known.size] = known
        if known.size < len(x):
            x = self.begun(x[None])[0]
        inside = (self.bounds[:, 0] <= x) & (x <= self.bounds[:, 1])
        if not inside[: known.size].all():
            first = int(np.argmin(inside))
            low, high = self.bounds[first]
            raise InputError(
                where, f"{self.source.states[first]} = {x[first]:g}", f"{low:g} to {high:g}"
            )
        return x

    def begun(self, x: Rows) -> Rows:
        """States with the internal ones with which the model expects a record to begin."""
        measured = jnp.asarray(x[:, self.source.channels.measured])
        return np.asarray(jax.vmap(self.source.model.initial_state)(measured), float)

    def starts(
        self, count: int, generator: np.random.Generator, options: Mapping[str, Any] | None = None
    ) -> Rows:
        """States to start from, (count, n_x); that of the options of `reset`, if it is there."""
        given = (options or {}).get(STATE)
        if given is not None:
            return np.tile(self.stated(given, STATE), (count, 1))
        low, high = self.range.states.T
        share = generator.uniform(0.0, 1.0, (count, self.source.n_x))
        if self.start is None:
            x = self.begun(low + share * (high - low))
        else:
            x = self.stated(self.start, "start") + self.noise * self.width * (2 * share - 1)
        return np.clip(x, *self.bounds.T)

    def entered(self, x: Rows, following: Rows) -> tuple[Rows, Bool[np.ndarray, " count"]]:
        """The states that are observed after a step, and which episodes end there."""
        low, high = self.bounds.T
        finite = np.where(np.isfinite(following), following, x)
        return np.clip(finite, low, high), ~((low <= following) & (following <= high)).all(axis=1)

    def rewards(self) -> Rewards:
        """What rewards many steps at once.

        Raises:
            InputError: a rule that is not known or needs an angle; a target of another size.
        """
        if callable(self.reward):
            one = self.reward
            return lambda x, u, following: np.array(
                [float(one(*of)) for of in zip(x, u, following, strict=True)]
            )
        of = self.source.channels
        judged = {"hold": np.arange(of.n_q), "swing-up": np.flatnonzero(of.angular)[-1:]}
        if self.reward not in judged:
            raise InputError(
                "reward", f"'{self.reward}'", f"a function, or one of {', '.join(judged)}"
            )
        where = judged[self.reward]
        if not len(where):
            raise InputError("reward", f"'{self.reward}'", "a model that has an angle")
        target, width, angular = self._target, self.width[of.position], of.angular

        def near(x: Rows, u: Rows, following: Rows) -> Vector:
            off = following[:, of.position] - target
            each = np.where(angular, (1 + np.cos(off)) / 2, np.maximum(0, 1 - (off / width) ** 2))
            return np.prod(each[:, where], axis=1)

        return near

    @property
    def _target(self) -> Vector:
        of = self.source.channels
        given = self.target
        if given is None:
            held = self.reward == "hold" and self.start is not None
            return np.asarray(self.start, float)[of.position] if held else np.zeros(of.n_q)
        target = np.asarray(given, float)
        if target.shape != (of.n_q,):
            raise InputError("target", f"{target.size} numbers", f"{of.n_q} positions")
        return target


class _Bodies:
    """Simulations side by side: states, the inputs before, and one step for all."""

    def __init__(self, rules: Rules, count: int) -> None:
        source, one = rules.source, (count, rules.source.n_x)
        self.rules, self._rewards = rules, rules.rewards()
        self.x = np.zeros(one)
        offsets = source.input_layout.offsets
        self._before = np.full((count, max(0, -min(offsets)), len(rules.inputs)), np.nan)
        # where in [the inputs now, those before] each of the samples seen stands
        self._places = np.array([0 if offset >= 0 else -offset for offset in offsets])

    def restart(self, which: Bool[np.ndarray, " count"], x: Float[np.ndarray, "some n_x"]) -> None:
        """Puts some of them into new states, without a past."""
        self.x[which], self._before[which] = x, np.nan

    def step(self, action: ArrayLike) -> tuple[Vector, Bool[np.ndarray, " count"]]:
        """Steps all; the rewards, and which of them leave the bounds.

        Inputs at samples to come are those of now, held. Before the first sample an input is taken
        to be that sample, as along records.
        """
        u = self.rules.acting(action)
        before = np.where(np.isnan(self._before), u[:, None], self._before)
        samples = np.concatenate([u[:, None], before], axis=1)
        self._before = samples[:, :-1]
        w = samples[:, self._places].reshape(len(u), -1)
        # the environment computes in double precision, whatever else JAX is used for
        with jax.enable_x64(True):
            following = evaluate(self.rules.source.batched_step, np.concatenate([self.x, w], axis=1))
        x, (self.x, left) = self.x, self.rules.entered(self.x, following)
        return self._rewards(x, u, self.x), left


class ModelEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A model as an environment.

    Args:
        rules: the model, and what is rewarded.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (as Gymnasium has it)

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.observation_space, self.action_space = rules.observation_space, rules.action_space
        self._bodies = _Bodies(rules, 1)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """A new episode; `options={"x": state}` names the state that it starts from."""
        super().reset(seed=seed)
        self._bodies.restart(np.array([True]), self.rules.starts(1, self.np_random, options))
        return self._bodies.x[0].copy(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One sampling period."""
        (reward,), (left,) = self._bodies.step(np.reshape(action, (1, -1)))
        return self._bodies.x[0].copy(), float(reward), bool(left), False, {}


class ModelVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many environments of one model that step at once; each starts anew the step after its end.

    Args:
        rules: the model, and what is rewarded.
        num_envs: how many.
        max_episode_steps: after how many steps episodes are cut, None for never.
    """

    metadata = {  # noqa: RUF012 (as Gymnasium has it)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, rules: Rules, num_envs: int, max_episode_steps: int | None = None) -> None:
        self.rules, self.num_envs, self.max_episode_steps = rules, num_envs, max_episode_steps
        self.single_observation_space = rules.observation_space
        self.single_action_space = rules.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._bodies = _Bodies(rules, num_envs)
        self._ended = np.zeros(num_envs, bool)
        self._steps = np.zeros(num_envs, int)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """New episodes of all; `options={"x": state}` names the state that they start from."""
        super().reset(seed=seed)
        starts = self.rules.starts(self.num_envs, self.np_random, options)
        self._bodies.restart(np.ones(self.num_envs, bool), starts)
        self._ended[:], self._steps[:] = False, 0
        return self._bodies.x.copy(), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One sampling period of all; those that have ended start anew instead."""
        fresh = self._ended
        rewards, left = self._bodies.step(actions)
        self._steps = np.where(fresh, 0, self._steps + 1)
        if fresh.any():
            self._bodies.restart(fresh, self.rules.starts(int(fresh.sum()), self.np_random))
            rewards, left = np.where(fresh, 0.0, rewards), left & ~fresh
        most = np.inf if self.max_episode_steps is None else self.max_episode_steps
        cut = self._steps >= most
        self._ended = left | cut
        return self._bodies.x.copy(), rewards, left, cut, {}
