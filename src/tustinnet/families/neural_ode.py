"""Neural ODE: a network for the derivative of the whole state, integrated by Runge-Kutta."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray
from pydantic import Field

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.families.descriptions import Description
from tustinnet.families.family import Arrays, Header, Lines, named_arrays
from tustinnet.families.networks import (
    NetworkEntries,
    NetworkFamily,
    NetworkHyper,
    describe_network,
    restore_network,
    summarise_network,
)
from tustinnet.models.blocks import Layers, Network, feature_count, random_network
from tustinnet.models.contract import ContinuousModel, InputVector, Model, State
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.models.sizes import MOST_UNROLLED
from tustinnet.registry import SCALINGS


class NeuralODE(ContinuousModel):
    """A neural ODE: `dx/dt = f(sin q, cos q, v, u)`, positions and velocities alike.

    The network has the inputs of a Tustin-Net. Its outputs are the derivatives of positions, in
    units of the velocities, and those of velocities, in units of the accelerations; that the first
    are the velocities is not built in.

    Attributes:
        network: `f`.
        channels: its coordinates and inputs, in continuous time.

    References:
        Chen, Rubanova, Bettencourt, Duvenaud (2018), Neural ordinary differential equations.
        Rahman, Drgoňa, Tuor, Strube (2022), Neural ordinary differential equations for nonlinear
        system identification.
    """

    network: Network
    channels: Channels = eqx.field(static=True)

    def derivative(self, x: State, u: InputVector) -> State:
        """The derivative of the state."""
        scaling = self.network.scaling
        unit = jnp.concatenate([scaling.velocity, scaling.acceleration])
        return unit * self.network(self.channels, x, u)


Substeps = Annotated[int, Field(gt=0, le=MOST_UNROLLED)]


class NeuralODEHyper(NetworkHyper):
    """The table `[model]` of a neural ODE.

    Attributes:
        substeps: Runge-Kutta steps in a period.

    The other keys are those of the network.
    """

    substeps: Substeps = 1


class NeuralODEDescription(Description):
    """The header of a neural ODE."""

    structure: NetworkEntries
    substeps: Substeps


class NeuralODEFamily(NetworkFamily):
    """The family of neural ODEs."""

    kind = "neural-ode"
    title = "neural ODE"
    hyper = NeuralODEHyper
    description = NeuralODEDescription
    correctable = True
    model = NeuralODE

    def builder(
        self,
        hyper: NeuralODEHyper,
        experiments: Sequence[Experiment],
        velocity: VelocitySource,
        physics: Model | None,
    ) -> Callable[[PRNGKeyArray], Discretised]:
        """A function that makes random weights; units come from the records."""
        channels = experiments[0].channels
        scaling = SCALINGS[hyper.scaling](experiments, velocity, ())
        layers, outputs = Layers(**hyper.layers), 2 * channels.n_q
        features = feature_count(channels, pairs=len(scaling.pairs))

        def build(key: PRNGKeyArray) -> Discretised:
            network = random_network(scaling, key, features, outputs, layers)
            return _make_discrete(network, channels, hyper.substeps)

        return build

    def network(self, model: Any) -> Network:
        """The network of the derivative."""
        return model.continuous.network

    def describe(self, model: Any) -> tuple[Header, Arrays]:
        """Structure and substeps for the header; arrays by their places in the network."""
        network = self.network(model)
        header = {"structure": describe_network(network), "substeps": model.substeps}
        return header, named_arrays(network)

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> Discretised:
        """The neural ODE of a file, from structure and arrays."""
        channels = Channels.from_header(header)
        network = restore_network(header["structure"], arrays, channels, 2 * channels.n_q)
        return _make_discrete(network, channels, header["substeps"])

    def summarise(self, header: Header, arrays: Arrays) -> Lines:
        """Layers, units and integration."""
        steps = ("integration", f"{header['substeps']} Runge-Kutta steps a period")
        return [*summarise_network(header["structure"], arrays), steps]


FAMILY = NeuralODEFamily()


def _make_discrete(network: Network, channels: Channels, substeps: int) -> Discretised:
    """The neural ODE of a network, integrated by Runge-Kutta steps that are unrolled."""
    return discretise(NeuralODE(network, channels), channels.dt, substeps, unrolled=True)
