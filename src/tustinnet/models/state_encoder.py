"""A network that estimates a state from the samples before it."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.models.blocks import Affine


class StateEncoder(eqx.Module):
    """Estimates the state at the last of N samples from the positions and inputs of all N.

        x[k] = [q[k], 0, 0] + unit (W phi + b + U tanh(V phi + c))

    `phi` are the angles `q[k]` by sine and cosine, linear positions as they are, the distances
    `q[k-i] - q[k]` and what acts between the samples, all scaled. So nothing depends on how often
    an angle has turned.

    Attributes:
        linear: `W` and `b`.
        hidden: `V` and `c`.
        output: `U`.
        offset: subtracted from what it sees, (n_phi,). Never trained.
        scale: divides what it sees, (n_phi,). Never trained.
        unit: multiplies what it says, (n_x,). Never trained.
        samples: N.

    References:
        Beintema, Schoukens, Tóth (2023), Deep subspace encoders for nonlinear system
        identification, Automatica 156. Other than there, positions are those measured plus a
        correction, and a linear map found by least squares stands beside the network.
    """

    linear: Affine
    hidden: Affine
    output: Affine
    offset: Float[Array, " n_phi"]
    scale: Float[Array, " n_phi"]
    unit: Float[Array, " n_x"]
    samples: int = eqx.field(static=True)

    def __call__(
        self,
        channels: Channels,
        q: Float[Array, "samples n_q"],
        u: Float[Array, "steps *between n_u"],
    ) -> Float[Array, " n_x"]:
        """The state at the last sample.

        Args:
            channels: the coordinates of the model.
            q: measured positions, (N, n_q) [rad or m].
            u: what acts from each sample to the next, (N - 1, ...), see `Model.seen`.
        """
        phi = (encoder_features(channels, q, u) - self.offset) / self.scale
        said = self.linear(phi) + self.output(jnp.tanh(self.hidden(phi)))
        return jnp.pad(q[-1], (0, len(self.unit) - channels.n_q)) + self.unit * said

    @property
    def layers(self) -> Sequence[Affine]:
        """What trains."""
        return self.linear, self.hidden, self.output


def encoder_features(
    channels: Channels,
    q: Float[Array, "samples n_q"],
    u: Float[Array, "steps *between n_u"],
) -> Float[Array, " n_phi"]:
    """What an encoder sees of positions and inputs, not scaled; see `StateEncoder`."""
    last = q[-1]
    angular = np.asarray(channels.angular)
    angle, length = last[angular], last[~angular]
    distances = (q[:-1] - last).ravel()
    return jnp.concatenate([jnp.sin(angle), jnp.cos(angle), length, distances, u.ravel()])
