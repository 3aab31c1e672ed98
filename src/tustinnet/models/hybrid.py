"""Known physics plus a network for what it leaves."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Coordinate, Experiment, Input
from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel, State
from tustinnet.models.tustin import TustinNet

_REST = 0.01  # a mean square of scaled velocities and inputs: a tenth of what is usual


class HybridModel(DiscreteModel):
    """A model and a Tustin-Net's network that corrects its accelerations.

        (q_p, v_p, z) = physics(q[k], v[k], z[k], u[k])
        v[k+1] = v_p + dt f(q[k], v[k], u[k])
        q[k+1] = q_p + dt^2 f(q[k], v[k], u[k]) / 2

    The correction enters as in a Tustin-Net, so that positions hold the trapezoidal rule as well
    as they do in the physics. With an output layer of zeros it is the physics.

    Where it fades at rest, `f` is multiplied by `s / (s + 0.01)`, `s` the mean square of the
    scaled velocities and inputs: at standstill without input the physics alone decides. What the
    network makes of standstill in the records then cannot drive off a coordinate that nothing
    holds (a free integrator), and equilibria stay where the physics has them.

    Attributes:
        physics: the model that is corrected, as a rule a discretised Lagrangian system.
        residual: whose network the correction is; its own trapezoidal step is not used.
        coordinates: those of the physics.
        inputs: those of the physics.
        dt: sampling period of the physics [s].
        fades_at_rest: whether the correction does.
    """

    physics: DiscreteModel
    residual: TustinNet
    coordinates: tuple[Coordinate, ...] = eqx.field(static=True)
    inputs: tuple[Input, ...] = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    fades_at_rest: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        ours, theirs = self.residual, self.physics
        if [c.name for c in ours.coordinates] != [c.name for c in theirs.coordinates] or [
            i.name for i in ours.inputs
        ] != [i.name for i in theirs.inputs]:
            raise InputError("hybrid", "a network of another system", "the physics' coordinates")

    @property
    def memory(self) -> tuple[str, ...]:
        """The internal states of the physics, then those of the network."""
        return (*self.physics.memory, *self.residual.memory)

    def drive(self, experiment: Experiment) -> Float[np.ndarray, "steps *drive"]:
        """What the physics is driven by."""
        return self.physics.drive(experiment)

    def step(self, x: State, u: Array) -> State:
        """One period: the physics, then the correction."""
        n_q, n_p = len(self.coordinates), self.physics.state_size
        change = self.dt * self.correction(x, u)
        following = self.physics.step(x[:n_p], u)
        v_next = following[n_q : 2 * n_q] + change
        return jnp.concatenate(
            [
                following[:n_q] + self.dt / 2 * change,
                v_next,
                following[2 * n_q :],
                self.residual.relaxed(x[n_p:], (x[n_q : 2 * n_q] + v_next) / 2),
            ]
        )

    def correction(self, x: State, u: Array) -> Float[Array, " n_q"]:
        """`f`, what the network adds to the accelerations, (n_q,) [rad/s^2 or m/s^2]."""
        begin = u if u.ndim == 1 else u[0]
        seen = jnp.concatenate([x[: 2 * len(self.coordinates)], x[self.physics.state_size :]])
        f = self.residual.acceleration(seen, begin)
        if not self.fades_at_rest:
            return f
        n_q, unit = len(self.coordinates), self.residual.scaling
        motion = jnp.concatenate([x[n_q : 2 * n_q] / unit.velocity, begin / unit.input])
        level = jnp.mean(motion**2)
        return f * level / (level + _REST)

    def effort(self, x: State, u: Array) -> Float[Array, ""]:
        """The squared correction in the network's units."""
        return jnp.sum((self.correction(x, u) / self.residual.scaling.acceleration) ** 2)

    def folded(self) -> "HybridModel":
        """The same with folded parts."""
        return replace(self, physics=self.physics.folded(), residual=self.residual.folded())


def hybrid(
    physics: DiscreteModel, residual: TustinNet, *, fades_at_rest: bool = False
) -> HybridModel:
    """A model whose accelerations a network corrects.

    Args:
        physics: the model.
        residual: whose network the correction is.
        fades_at_rest: whether the correction fades at standstill without input.

    Raises:
        InputError: they are not of the same system.
    """
    return HybridModel(
        physics=physics, residual=residual, coordinates=physics.coordinates,
        inputs=physics.inputs, dt=physics.dt, fades_at_rest=fades_at_rest,
    )  # fmt: skip


def uncorrected(
    physics: DiscreteModel, residual: TustinNet, *, fades_at_rest: bool = False
) -> HybridModel:
    """A hybrid that does not correct anything yet: the network's output layer is set to zero."""
    silent = eqx.tree_at(lambda net: net.output.weight, residual, residual.output.weight * 0)
    if silent.output.bias is not None:
        silent = eqx.tree_at(lambda net: net.output.bias, silent, silent.output.bias * 0)
    return hybrid(physics, silent, fades_at_rest=fades_at_rest)
