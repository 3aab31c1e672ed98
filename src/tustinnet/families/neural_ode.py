"""Neural ODE: a network for the derivative of the whole state, integrated by Runge-Kutta."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray, PyTree
from pydantic import Field

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.families.family import (
    Arrays,
    Family,
    Header,
    LayeredStage,
    mask_of,
    named_arrays,
)
from tustinnet.families.networks import (
    NetworkHyper,
    check_stage,
    network_from,
    structure_of,
)
from tustinnet.models.blocks import Layers, Network, feature_count, random_network
from tustinnet.models.contract import ContinuousModel, InputVector, Model, State
from tustinnet.models.integrate import MOST_UNROLLED, Discretised, discretise
from tustinnet.registry import SCALINGS


class NeuralODE(ContinuousModel):
    """`dx/dt = f(sin q, cos q, v, u)`, positions and velocities alike.

    The network sees what a Tustin-Net sees. It says the derivatives of positions, in units of the
    velocities, and those of velocities, in units of the accelerations; nothing tells it that the
    first are the velocities.

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


class NeuralODEHyper(NetworkHyper):
    """A neural ODE.

    Attributes:
        substeps: Runge-Kutta steps in a period.

    The others are those of the network.
    """

    substeps: int = Field(default=1, gt=0, le=MOST_UNROLLED)


class NeuralODEFamily(Family):
    """Neural ODEs."""

    kind = "neural-ode"
    spelt = "neural ODE"
    hyper = NeuralODEHyper
    stage = LayeredStage
    correctable = True
    model = NeuralODE

    def builder(
        self,
        hyper: NeuralODEHyper,
        experiments: Sequence[Experiment],
        velocity: VelocitySource,
        physics: Model | None,
    ) -> Callable[[PRNGKeyArray], Discretised]:
        """Random weights, units from the records."""
        channels = experiments[0].channels
        scaling = SCALINGS[hyper.scaling](experiments, velocity, ())
        seen, said = feature_count(channels), 2 * channels.n_q

        def build(key: PRNGKeyArray) -> Discretised:
            network = random_network(scaling, key, seen, said, Layers(**hyper.layers))
            return _discrete(network, channels, hyper.substeps)

        return build

    def check(self, hyper: NeuralODEHyper, stage: LayeredStage) -> None:
        """Frozen layers exist, and windows are not mirrored for an odd network."""
        check_stage(hyper, stage)

    def trainable(self, model: Any, stage: LayeredStage) -> PyTree:
        """The layers that are not frozen."""
        return mask_of(model, model.continuous.network.trainable_layers(stage.frozen_layers))

    def describe(self, model: Any) -> tuple[Header, Arrays]:
        """The structure of the network; arrays by their places in it."""
        network = model.continuous.network
        header = {"structure": structure_of(network), "substeps": model.substeps}
        return header, named_arrays(network)

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> Discretised:
        """From structure and arrays."""
        channels = Channels.from_header(header)
        network = network_from(header["structure"], arrays, channels, 2 * channels.n_q)
        return _discrete(network, channels, header["substeps"])


FAMILY = NeuralODEFamily()


def _discrete(network: Network, channels: Channels, substeps: int) -> Discretised:
    return discretise(NeuralODE(network, channels), channels.dt, substeps, unrolled=True)
