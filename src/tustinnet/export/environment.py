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

from tustinnet.engine.engines import evaluate
from tustinnet.errors import InputError
from tustinnet.export.source import Source
from tustinnet.families.euler_lagrange import draw_values
from tustinnet.simulate.range import Range

STATE = "x"  # of the options of `reset`: the state to start from

Vector = Float[np.ndarray, " _"]
Rows = Float[np.ndarray, "count _"]
OneReward = Callable[[Vector, Vector, Vector], float]
Rewards = Callable[[Rows, Rows, Rows], Vector]


@dataclass(frozen=True)
class Rules:
    """The model, starts, ends and rewards of an environment.

    Attributes:
        source: the model, with the range of its records.
        reward: `hold`, `swing-up`, or a function of the state, the inputs and the state after them,
            (n_x,), (n_u,), (n_x,). `hold` is the product over all coordinates of how near each is
            to the target, `swing-up` how near the last angle is: `(1 + cos d) / 2` of an angle,
            `max(0, 1 - (d / w)^2)` of a linear coordinate, w the width of its range. None of them
            is negative, so that it never pays to end an episode.
        target: positions, (n_q,) [rad or m]; by default 0, for `hold` those of `start` if given.
        start: positions and velocities, internal states may follow, (2 n_q,) or (n_x,); None for a
            random state of the records, or for anywhere in the range where none is known. Internal
            states that are not given start as the model expects.
        noise: the largest noise on `start`, as a share of the widths of the range: of positions and
            velocities a share of the difference of two random states of the records, if known.
        margin: how far beyond the range an episode goes on, as a share of its widths.
        randomise: whether each episode has physical parameters of its own: `True` for draws from
            the errors of their identification, a share for uniform ones of up to so much of their
            values. Initial internal states are those of the model's own values.

    Raises:
        InputError: the range of the training records is unknown, or no input moves in them; a
            start of another size or out of range, shares out of range; `randomise` of a model
            without physical parameters, or `True` where its file does not have their errors.
    """

    source: Source
    reward: str | OneReward = "hold"
    target: ArrayLike | None = None
    start: ArrayLike | None = None
    noise: float = 0.01
    margin: float = 0.1
    randomise: bool | float = False

    def __post_init__(self) -> None:
        self._require_random_values()
        if not (0 <= self.noise < np.inf and 0 < self.margin < np.inf):
            raise InputError(
                "environment",
                f"noise {self.noise}, margin {self.margin}",
                "shares of the range's width, the noise from 0 on, the margin above 0",
            )
        if not (self.inputs[:, 1] > self.inputs[:, 0]).any():
            raise InputError(
                "environment", "no input that the training records move", "one to act with"
            )
        if self.start is not None:
            self.complete_state(self.start, "start")

    def _require_random_values(self) -> None:
        """Raises where parameters are to be drawn that nobody knows."""
        if self.randomise is False:
            return
        if self.randomise is not True and not 0 < self.randomise < 1:
            raise InputError("randomise", f"{self.randomise}", "True, False or a share below 1")
        source = self.source
        if not source.physical_values:
            raise InputError(
                "randomise",
                "a model without physical parameters",
                "a grey box, or a hybrid",
                "leave it out",
            )
        if self.randomise is True and not draw_values(source.model, source.about, 1):
            raise InputError(
                "randomise",
                "the file of the model has no errors of its parameters",
                "a model that was identified",
                "give a share, as randomise=0.2",
            )

    def draw_values(
        self, count: int, generator: np.random.Generator
    ) -> Float[np.ndarray, "count n_p"]:
        """Random values of the physical parameters, in the order of their names."""
        source, nominal = self.source, self.source.physical_values
        if self.randomise is True:
            seed = int(generator.integers(2**31))
            drawn = draw_values(source.model, source.about, count, seed)
            return np.array([[v.get(name, x) for name, x in nominal.items()] for v in drawn])
        spread = float(self.randomise) * generator.uniform(-1.0, 1.0, (count, len(nominal)))
        return np.array([*nominal.values()]) * (1 + spread)

    @property
    def range(self) -> Range:
        """The range of states and inputs."""
        if self.source.range is None:
            raise InputError(
                "environment",
                "the range of the model's training records is unknown",
                "a range",
                'give range={"states": [[low, high], ...], "inputs": [[low, high], ...]}',
            )
        return self.source.range

    @property
    def width(self) -> Vector:
        """The widths of the range of the states, (n_x,); 1 for a constant state."""
        low, high = self.range.states.T
        return np.where(high > low, high - low, 1.0)

    @cached_property
    def bounds(self) -> Float[np.ndarray, "n_x 2"]:
        """Lower and upper bounds of the states, beyond which an episode ends."""
        beyond = self.margin * self.width
        return self.range.states + np.stack([-beyond, beyond], axis=1)

    @cached_property
    def inputs(self) -> Float[np.ndarray, "n_u 2"]:
        """The inputs at actions of -1 and 1: the range of the inputs, within their limits."""
        declared = [i.limits or (-np.inf, np.inf) for i in self.source.channels.inputs]
        limits = np.reshape(declared, (-1, 2))
        return np.clip(self.range.inputs, limits[:, :1], limits[:, 1:])

    @property
    def observation_space(self) -> Box:
        """The space of the states [q, v, z]."""
        return Box(*self.bounds.T, dtype=np.float64)

    @property
    def action_space(self) -> Box:
        """The space of the actions, -1..1 for every input."""
        return Box(-1.0, 1.0, (len(self.inputs),), np.float64)

    def inputs_of(self, action: ArrayLike) -> Float[np.ndarray, "*batch n_u"]:
        """The inputs of actions."""
        low, high = self.inputs.T
        return low + (np.clip(np.asarray(action, float), -1.0, 1.0) + 1) / 2 * (high - low)

    def complete_state(self, state: ArrayLike, where: str) -> Vector:
        """A state with internal states as the model expects, where they are missing.

        Args:
            state: positions and velocities, internal states may follow, (2 n_q,) or (n_x,).
            where: what the state is called, for messages.

        Raises:
            InputError: another number of states, or one out of bounds.
        """
        channels, x = self.source.channels, np.zeros(self.source.n_x)
        given = np.asarray(state, float)
        if given.shape not in (x.shape, x[channels.measured].shape):
            raise InputError(
                where,
                f"{given.size} numbers",
                f"positions and velocities of {channels.n_q} coordinates",
            )
        x[: given.size] = given
        if given.size < len(x):
            x = self.with_expected_internal(x[None])[0]
        inside = (self.bounds[:, 0] <= x) & (x <= self.bounds[:, 1])
        if not inside[: given.size].all():
            first = int(np.argmin(inside))
            low, high = self.bounds[first]
            raise InputError(
                where, f"{self.source.states[first]} = {x[first]:g}", f"{low:g} to {high:g}"
            )
        return x

    def with_expected_internal(self, x: Rows) -> Rows:
        """States with internal states as the model expects them at the beginning of a record."""
        measured = jnp.asarray(x[:, self.source.channels.measured])
        return np.asarray(jax.vmap(self.source.model.initial_state)(measured), float)

    def draw_starts(
        self, count: int, generator: np.random.Generator, options: Mapping[str, Any] | None = None
    ) -> Rows:
        """Random initial states, (count, n_x); the state in the options of `reset`, if any.

        Coordinates may be coupled by stiff springs, which independent random positions would
        stretch far. So positions and velocities are those of the records, and noise on a given
        start is along differences of them.
        """
        state = (options or {}).get(STATE)
        if state is not None:
            return np.tile(self.complete_state(state, STATE), (count, 1))
        low, high = self.range.states.T
        share = generator.uniform(0.0, 1.0, (count, self.source.n_x))
        recorded, measured = self.range.recorded_states, self.source.channels.measured
        if self.start is None:
            x = low + share * (high - low)
            if recorded is not None:
                x[:, measured] = generator.choice(recorded, count)
            x = self.with_expected_internal(x)
        else:
            noise = self.noise * self.width * (2 * share - 1)
            if recorded is not None:
                first, second = generator.choice(recorded, (2, count))
                noise[:, measured] = self.noise * (first - second)
            x = self.complete_state(self.start, "start") + noise
        return np.clip(x, *self.bounds.T)

    def observe(self, x: Rows, following: Rows) -> tuple[Rows, Bool[np.ndarray, " count"]]:
        """The observed states after a step, and whether each episode ends there."""
        low, high = self.bounds.T
        finite = np.where(np.isfinite(following), following, x)
        return np.clip(finite, low, high), ~((low <= following) & (following <= high)).all(axis=1)

    def reward_function(self) -> Rewards:
        """The function that rewards many steps at once.

        Raises:
            InputError: an unknown reward, or one that needs an angle; a target of another size.
        """
        if callable(self.reward):
            one = self.reward
            return lambda x, u, following: np.array(
                [float(one(*step)) for step in zip(x, u, following, strict=True)]
            )
        channels = self.source.channels
        position, n_q, angular = channels.position, channels.n_q, channels.angular
        rewarded = {"hold": np.arange(n_q), "swing-up": np.flatnonzero(angular)[-1:]}
        if self.reward not in rewarded:
            raise InputError(
                "reward", f"'{self.reward}'", f"a function, or one of {', '.join(rewarded)}"
            )
        coordinates = rewarded[self.reward]
        if not len(coordinates):
            raise InputError("reward", f"'{self.reward}'", "a model that has an angle")
        target = np.zeros(n_q)
        if self.target is not None:
            target = np.asarray(self.target, float)
        elif self.reward == "hold" and self.start is not None:
            target = np.asarray(self.start, float)[position]
        if target.shape != (n_q,):
            raise InputError("target", f"{target.size} numbers", f"{n_q} positions")
        width = self.width[position]

        def closeness(x: Rows, u: Rows, following: Rows) -> Vector:
            off = following[:, position] - target
            close = np.where(angular, (1 + np.cos(off)) / 2, np.maximum(0, 1 - (off / width) ** 2))
            return np.prod(close[:, coordinates], axis=1)

        return closeness


class _Simulations:
    """Simulations side by side: their states, past inputs, and one step for all."""

    def __init__(self, rules: Rules, count: int) -> None:
        self.rules, self._rewards = rules, rules.reward_function()
        self.x = np.zeros((count, rules.source.n_x))
        offsets = rules.source.input_layout.offsets
        self._before = np.full((count, max(0, -min(offsets)), len(rules.inputs)), np.nan)
        # the places in [the inputs now, those before] of the samples that a step takes
        self._places = np.array([0 if offset >= 0 else -offset for offset in offsets])
        self._values = np.tile([*rules.source.physical_values.values()], (count, 1))

    def restart(
        self,
        which: Bool[np.ndarray, " count"],
        generator: np.random.Generator,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Starts episodes of some of them, without past inputs."""
        some = int(which.sum())
        self.x[which] = self.rules.draw_starts(some, generator, options)
        self._before[which] = np.nan
        if self.rules.randomise is not False:
            self._values[which] = self.rules.draw_values(some, generator)

    def values(self, i: int) -> dict[str, float]:
        """The physical parameters of one by name, where they are drawn."""
        if self.rules.randomise is False:
            return {}
        names = self.rules.source.physical_values
        return dict(zip(names, self._values[i].tolist(), strict=True))

    def step(self, action: ArrayLike) -> tuple[Vector, Bool[np.ndarray, " count"]]:
        """Steps all, and returns the rewards and which of them leave the bounds.

        Inputs at samples to come are those of now, held. Before the first sample an input is taken
        to be that sample, as along records.
        """
        u = self.rules.inputs_of(action)
        before = np.where(np.isnan(self._before), u[:, None], self._before)
        samples = np.concatenate([u[:, None], before], axis=1)
        self._before = samples[:, :-1]
        w = samples[:, self._places].reshape(len(u), -1)
        # the environment computes in double precision, whatever else JAX is used for
        source = self.rules.source
        with jax.enable_x64(True):
            if self.rules.randomise is False:
                following = evaluate(source.batched_step, np.concatenate([self.x, w], axis=1))
            else:
                points = np.concatenate([self.x, w, self._values], axis=1)
                following = evaluate(source.batched_step_of_values, points)
        x, (self.x, is_out) = self.x, self.rules.observe(self.x, following)
        return self._rewards(x, u, self.x), is_out


class ModelEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A model as an environment.

    Args:
        rules: the model, and its rewards.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (as Gymnasium has it)

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.observation_space, self.action_space = rules.observation_space, rules.action_space
        self._simulations = _Simulations(rules, 1)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts a new episode, from the state `options={"x": state}` if given.

        The parameters of the episode are in `info`, where they are drawn.
        """
        super().reset(seed=seed)
        self._simulations.restart(np.array([True]), self.np_random, options)
        return self._simulations.x[0].copy(), dict(self._simulations.values(0))

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Steps by one sampling period."""
        (reward,), (is_out,) = self._simulations.step(np.reshape(action, (1, -1)))
        return self._simulations.x[0].copy(), float(reward), bool(is_out), False, {}


class ModelVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many environments of one model that step at once; each starts anew the step after its end.

    Args:
        rules: the model, and its rewards.
        num_envs: number of environments.
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
        self._simulations = _Simulations(rules, num_envs)
        self._ended = np.zeros(num_envs, bool)
        self._steps = np.zeros(num_envs, int)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts new episodes of all, from the state `options={"x": state}` if given."""
        super().reset(seed=seed)
        self._simulations.restart(np.ones(self.num_envs, bool), self.np_random, options)
        self._ended[:], self._steps[:] = False, 0
        return self._simulations.x.copy(), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Steps all by one sampling period; those that have ended start anew instead."""
        is_new = self._ended
        rewards, is_out = self._simulations.step(actions)
        self._steps = np.where(is_new, 0, self._steps + 1)
        if is_new.any():
            self._simulations.restart(is_new, self.np_random)
            rewards, is_out = np.where(is_new, 0.0, rewards), is_out & ~is_new
        most = np.inf if self.max_episode_steps is None else self.max_episode_steps
        is_cut = self._steps >= most
        self._ended = is_out | is_cut
        return self._simulations.x.copy(), rewards, is_out, is_cut, {}
