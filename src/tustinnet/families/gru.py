"""A gated recurrent unit whose hidden state is the model's internal state."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, PRNGKeyArray
from pydantic import Field

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.families.descriptions import Description, Entries
from tustinnet.families.family import (
    Arrays,
    Header,
    Hyper,
    Lines,
    TrainedFamily,
    named_arrays,
    restore_arrays,
)
from tustinnet.families.networks import InputTaps, Units, blank_scaling, summarise_units
from tustinnet.models.blocks import Affine, Scaling, feature_count, learn_scaling, random_affine
from tustinnet.models.contract import (
    AccelerationModel,
    Coordinates,
    Internal,
    Model,
    State,
)
from tustinnet.models.sizes import LONGEST_WARM_UP
from tustinnet.models.step_layout import StepInput


class GRU(AccelerationModel):
    """A gated recurrent unit with its own positions and velocities among the features.

        r = s(W_r phi + U_r h + b_r),  g = s(W_g phi + U_g h + b_g),  s the logistic function
        h[k+1] = g h + (1 - g) tanh(W_n phi + r (U_n h + c_n) + b_n)
        q[k+1] = q[k] + dt (v[k] + y_q),  v[k+1] = v[k] + dt y_v,  [y_q, y_v] = W_y h[k+1] + b_y

    `phi` are the scaled features of a Tustin-Net. No rule binds positions to velocities: the
    difference to a Tustin-Net shows what the trapezoidal rule is worth. The hidden state `h`
    begins at 0 and is valid only after it has followed `warm_up` samples of a record. As a
    correction of another model only its accelerations `y_v` count.

    Attributes:
        by_features: `[W_r, W_g, W_n]` and their biases.
        by_hidden: `[U_r, U_g, U_n]`, and `c_n` behind zeros.
        output: `W_y`, `b_y`, in units of the velocities and accelerations.
        scaling: units of inputs and outputs.
        channels: its coordinates, inputs and period.
        needed: samples of a record that the hidden state needs.
        taps: the samples of the inputs that it takes, see `AccelerationModel`.

    References:
        Cho et al. (2014), Learning phrase representations using RNN encoder-decoder for
        statistical machine translation, arXiv 1406.1078.
        Bonassi, Farina, Xie, Scattolini (2022), On recurrent neural networks for learning-based
        control, Journal of Process Control 114.
    """

    by_features: Affine
    by_hidden: Affine
    output: Affine
    scaling: Scaling
    channels: Channels = eqx.field(static=True)
    needed: int = eqx.field(static=True)
    # a field in the place of a property of the base class
    taps: tuple[int, ...] = eqx.field(static=True, default=())  # pyright: ignore[reportIncompatibleMethodOverride]

    @property
    def warm_up(self) -> int:
        """Samples of a record that the hidden state follows before a free run."""
        return self.needed

    @property
    def internal(self) -> tuple[str, ...]:
        """The names of the hidden units."""
        return tuple(f"hidden {i}" for i in range(self.by_hidden.weight.shape[1]))

    def with_zero_output(self) -> "GRU":
        """The model with an output layer of zeros."""
        return eqx.tree_at(lambda m: m.output, self, self.output.zeros())

    def _rates(self, x: State, u: StepInput) -> tuple[Array, Array]:
        """The rates of positions and velocities, in SI units, and the new hidden state."""
        h = x[self.channels.internal]
        phi = self.by_features(self.scaling.features(self.channels, x, self.input_at_taps(u)))
        n = len(h)
        recurrent = self.by_hidden(h)
        reset, gate = jax.nn.sigmoid(phi[: 2 * n] + recurrent[: 2 * n]).reshape(2, n)
        new = jnp.tanh(phi[2 * n :] + reset * recurrent[2 * n :])
        h = gate * h + (1 - gate) * new
        unit = jnp.concatenate([self.scaling.velocity, self.scaling.acceleration])
        return unit * self.output(h), h

    def accelerate(
        self, x: State, u: StepInput
    ) -> tuple[Coordinates, Callable[[Coordinates], Internal]]:
        """The accelerations; the hidden state does not depend on the mean velocity."""
        rates, h = self._rates(x, u)
        return rates[self.channels.velocity], lambda mean: h

    def step(self, x: State, u: StepInput) -> State:
        """The state after one period, by the rates of positions and velocities."""
        channels = self.channels
        rates, h = self._rates(x, u)
        drift = jnp.concatenate([x[channels.velocity], jnp.zeros(channels.n_q, x.dtype)])
        return jnp.concatenate([x[channels.measured] + self.dt * (drift + rates), h])


class GRUHyper(Hyper):
    """The table `[model]` of a gated recurrent unit.

    Attributes:
        hidden: its hidden units.
        warm_up: samples of a record that its hidden state follows before a free run.
        input_taps: samples of the inputs that it takes in every period, as `[-1, 0, 1]`, counted
            from the period's beginning; those above 0 look ahead. None: the period's mean.
    """

    hidden: Units = 32
    warm_up: int = Field(default=20, ge=6, le=LONGEST_WARM_UP)
    input_taps: InputTaps = ()


class GRUEntries(Entries):
    """The sizes of a GRU."""

    hidden: Units
    warm_up: int = Field(ge=0, le=LONGEST_WARM_UP)
    input_taps: InputTaps


class GRUDescription(Description):
    """The header of a gated recurrent unit."""

    structure: GRUEntries


class GRUFamily(TrainedFamily):
    """The family of gated recurrent units."""

    kind = "gru"
    title = "GRU"
    hyper = GRUHyper
    description = GRUDescription
    model = GRU

    def builder(
        self,
        hyper: GRUHyper,
        experiments: Sequence[Experiment],
        velocity: VelocitySource,
        physics: Model | None,
    ) -> Callable[[PRNGKeyArray], GRU]:
        """A function that makes random weights; units come from the records."""
        channels, scaling = experiments[0].channels, learn_scaling(experiments, velocity)
        sizes = hyper.hidden, hyper.warm_up, hyper.input_taps
        return lambda key: random_gru(channels, scaling, key, *sizes)

    def describe(self, model: GRU) -> tuple[Header, Arrays]:
        """Hidden units, warm-up and taps for the header; all arrays."""
        structure = {
            "hidden": len(model.internal),
            "warm_up": model.warm_up,
            "input_taps": list(model.taps),
        }
        return {"structure": structure}, named_arrays(model)

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> GRU:
        """The GRU of a file, from structure and arrays."""
        channels, s = Channels.from_header(header), header["structure"]
        blank = blank_scaling(channels)
        key = jax.random.key(0)
        sizes = s["hidden"], s["warm_up"], tuple(s["input_taps"])
        return restore_arrays(lambda: random_gru(channels, blank, key, *sizes), arrays)

    def summarise(self, header: Header, arrays: Arrays) -> Lines:
        """Size, warm-up and units."""
        s = header["structure"]
        sizes = f"{s['hidden']} hidden units, warm-up of {s['warm_up']} samples"
        return [("network", sizes), summarise_units(arrays)]


FAMILY = GRUFamily()


def random_gru(
    channels: Channels,
    scaling: Scaling,
    key: PRNGKeyArray,
    hidden: int,
    warm_up: int,
    taps: tuple[int, ...] = (),
) -> GRU:
    """A gated recurrent unit with random float32 weights, uniform within 1/sqrt(n_in) of 0."""
    first, second, third = jax.random.split(key, 3)
    return GRU(
        by_features=random_affine(feature_count(channels, 0, len(taps) or 1), 3 * hidden, first),
        by_hidden=random_affine(hidden, 3 * hidden, second),
        output=random_affine(hidden, 2 * channels.n_q, third),
        scaling=scaling,
        channels=channels,
        needed=warm_up,
        taps=taps,
    )
