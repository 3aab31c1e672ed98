"""Lasting disturbances that an estimator finds and a controller takes from its inputs."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.control.dynamics import InputLimits
from tustinnet.control.lqr import Feedback, Recovery, Tracking
from tustinnet.models.contract import Directions, Internal, Model, State, StepAlong
from tustinnet.models.step_layout import StepInput, StepLayout
from tustinnet.simulate.range import Range


class DisturbedModel(Model):
    """A model with a constant disturbance beside each input, for an estimator to find.

    `disturbance_<input>`, the last internal states, are in the unit of the input. A filter finds
    them by what the inner model misses: loads, friction that grew, a wrong offset.

    Attributes:
        inner: the model.
        spread: expected standard deviations of the disturbances, (n_u,).
        channels: those of the inner model.
    """

    inner: Model
    spread: Float[Array, " n_u"]
    channels: Channels = eqx.field(static=True)

    @property
    def internal(self) -> tuple[str, ...]:
        """Internal states of the inner model, then the disturbances."""
        more = (f"disturbance_{i.name}" for i in self.channels.inputs)
        return (*self.inner.internal, *more)

    @property
    def internal_spread(self) -> Internal:
        """Spreads of the inner model's states, then those of the disturbances."""
        return jnp.concatenate([self.inner.internal_spread, self.spread])

    @property
    def initial_needs_inputs(self) -> bool:
        """Whether the expected internal states of the inner model depend on inputs."""
        return self.inner.initial_needs_inputs

    def initial_internal(
        self, measured: Float[Array, " n_measured"], u: Array | None = None
    ) -> Internal:
        """Expected internal states of the inner model, and no disturbance."""
        return jnp.concatenate(
            [self.inner.initial_internal(measured, u), jnp.zeros_like(self.spread)]
        )

    @property
    def step_layout(self) -> StepLayout:
        """The layout of the inner model's steps."""
        return self.inner.step_layout

    def simplify(self) -> "DisturbedModel":
        """The model about a cheaper inner model."""
        return replace(self, inner=self.inner.simplify())

    def step(self, x: State, u: StepInput) -> State:
        """The step of the inner model under inputs and disturbances, which stay."""
        own, disturbance = jnp.split(x, [self.inner.state_size])
        # of a polynomial of the time in the period its constant changes
        is_polynomial = self.step_layout.polynomial and u.ndim > 1
        u = u.at[0].add(disturbance) if is_polynomial else u + disturbance
        return jnp.concatenate([self.inner.step(own, u), disturbance])

    @property
    def step_along(self) -> StepAlong | None:
        """The step with derivatives, where the inner model has it: disturbances are inputs."""
        inner, n_x = self.inner.step_along, self.inner.state_size
        if inner is None:
            return None

        def step(x: State, u: Array, dx: Directions, du: Directions) -> Array:
            own, disturbance = jnp.split(x, [n_x])
            columns = inner(own, u + disturbance, dx[:n_x], du + dx[n_x:])
            kept = jnp.concatenate([disturbance[:, None], dx[n_x:]], axis=1)
            return jnp.concatenate([columns, kept])

        return step

    def extend_range(self, inner: Range) -> Range:
        """A range of the inner model with that of the expected disturbances."""
        spread = np.outer(np.asarray(self.spread), (-1.0, 1.0))
        return replace(inner, states=np.concatenate([inner.states, spread]))


def observe_disturbances(model: Model, limits: InputLimits) -> DisturbedModel:
    """A model whose disturbances are expected to take a tenth of the inputs' range."""
    spread = jnp.asarray(0.1 * (limits.upper - limits.lower))
    return DisturbedModel(model, spread, model.channels)


def cancel_disturbances(gains: Feedback | Tracking) -> Feedback | Tracking:
    """Feedback on a model, as feedback on the `DisturbedModel` of it that takes them away."""
    if isinstance(gains, Feedback):
        none = np.zeros(len(gains.u0))
        gain = _add_columns(gains.gain, len(gains.x0), gains.previous)
        return replace(gains, gain=gain, x0=np.concatenate([gains.x0, none]))
    plan, recovery, none = gains.plan, gains.recovery, np.zeros(gains.plan.u.shape[1])
    if recovery is not None:
        settle = cancel_disturbances(recovery.feedback)
        assert isinstance(settle, Feedback)
        # no disturbance counts as a fall
        recovery = Recovery(
            settle,
            np.concatenate([recovery.fallen_beyond, none]),
            np.concatenate([recovery.settled_within, none]),
        )
    final = cancel_disturbances(gains.final)
    assert isinstance(final, Feedback)
    n_x, previous = len(plan.goal), gains.final.previous
    return Tracking(
        replace(
            plan,
            x=np.hstack([plan.x, np.zeros((len(plan.x), len(none)))]),
            goal=np.concatenate([plan.goal, none]),
        ),
        np.stack([_add_columns(gain, n_x, previous) for gain in gains.gains]),
        final,
        recovery,
    )


def _add_columns(
    gain: Float[np.ndarray, "n_u n_z"], n_x: int, previous: int
) -> Float[np.ndarray, "n_u more"]:
    """A gain that also takes disturbances away, which follow the states.

    Where inputs act late, earlier commands have taken them away, too: that is no error of theirs.
    """
    n_u = len(gain)
    earlier = gain[:, gain.shape[1] - previous * n_u :].reshape(n_u, previous, n_u)
    return np.hstack([gain[:, :n_x], np.eye(n_u) + earlier.sum(axis=1), gain[:, n_x:]])
