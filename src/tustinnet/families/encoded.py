"""A trained model with a network that estimates where its free runs start."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.errors import InputError
from tustinnet.families.family import (
    Arrays,
    Family,
    Header,
    Hyper,
    family_of,
    filled,
    named_arrays,
)
from tustinnet.families.shown import DYNAMICS, ENCODER, below
from tustinnet.models.blocks import Affine, random_affine, root_mean_square
from tustinnet.models.contract import Internal, Model, State, StepInput, StepInputs
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.models.state_encoder import StateEncoder, encoder_features
from tustinnet.registry import FAMILIES
from tustinnet.signals.excitation import Excitation
from tustinnet.simulate.along import states_along
from tustinnet.simulate.drive import drive_of
from tustinnet.simulate.state_fits import FEWEST

_HIDDEN = 32  # units
_EXAMPLES = 5000  # samples at which the linear map is found, at most
_REDUNDANT = 1e-6  # neighbouring samples say nearly the same


class EncodedModel(Model):
    """A model and the encoder that was trained along with it.

    It steps as the model does. The encoder gives the state in which a free run starts
    (`encoder-N`).

    Attributes:
        model: the model.
        network: the encoder.
    """

    model: Model
    network: StateEncoder

    @property
    def dynamics(self) -> Model:
        """The model."""
        return self.model

    @property
    def encoder(self) -> StateEncoder:
        """The encoder."""
        return self.network

    @property
    def channels(self) -> Channels:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Those of the model."""
        return self.model.channels

    @property
    def internal(self) -> tuple[str, ...]:
        """Those of the model."""
        return self.model.internal

    def initial_internal(self, measured: Float[Array, " n_measured"]) -> Internal:
        """Those of the model."""
        return self.model.initial_internal(measured)

    @property
    def internal_spread(self) -> Internal:
        """That of the model."""
        return self.model.internal_spread

    @property
    def warm_up(self) -> int:
        """That of the model, for starts that do without the encoder."""
        return self.model.warm_up

    def step_inputs(self, inputs: Excitation) -> StepInputs:
        """What the model is given."""
        return self.model.step_inputs(inputs)

    def for_record(self, experiment: Experiment) -> "EncodedModel":
        """The same with the model of the record."""
        chosen = self.model.for_record(experiment)
        return self if chosen is self.model else EncodedModel(chosen, self.network)

    def step(self, x: State, u: StepInput) -> State:
        """One period of the model."""
        return self.model.step(x, u)

    def advance(self, x: State, u: StepInput, period: Array | float) -> State:
        """The model after a period [s]."""
        return self.model.advance(x, u, period)

    def simplify(self) -> "EncodedModel":
        """The same with the folded model."""
        return EncodedModel(self.model.simplify(), self.network)


def with_encoder(
    model: Model,
    experiments: Sequence[Experiment],
    velocity: VelocitySource,
    samples: int,
    key: PRNGKeyArray,
) -> EncodedModel:
    """A model with an encoder that has seen records, but is not trained yet.

    Its linear map is the least-squares map to the states along the records: velocities as
    `velocity` has them, internal states as they follow the record. Its network says nothing yet.

    Args:
        model: the model.
        experiments: the training records.
        velocity: where their velocities come from.
        samples: how many samples the encoder sees.
        key: the source of the network's weights.

    Raises:
        InputError: fewer than 3 samples, or more than every record has.
    """
    of, longest = model.channels, max(map(len, experiments))
    if not FEWEST <= samples < longest:
        raise InputError(
            "start", f"'encoder-{samples}'",
            f"at least {FEWEST} samples, and fewer than the longest record's {longest}",
        )  # fmt: skip
    phi, x = _examples(model, experiments, velocity, samples)
    offset, scale = phi.mean(axis=0), phi.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    unit = root_mean_square(x)
    unit[of.position] = of.dt * unit[of.velocity]
    said = x / unit
    said[:, of.position] = 0.0  # at first, positions are those measured
    affine = np.column_stack([(phi - offset) / scale, np.ones(len(phi))])
    found = np.linalg.lstsq(affine, said, rcond=_REDUNDANT)[0]
    weight, bias, offset, scale, unit = (
        jnp.asarray(a, jnp.float32) for a in (found[:-1].T, found[-1], offset, scale, unit)
    )
    for_hidden, for_output = jax.random.split(key)
    encoder = StateEncoder(
        linear=Affine(weight, bias),
        hidden=random_affine(phi.shape[1], _HIDDEN, for_hidden),
        output=random_affine(_HIDDEN, len(unit), for_output, bias=False).zeros(),
        offset=offset,
        scale=scale,
        unit=unit,
        samples=samples,
    )
    return EncodedModel(model, encoder)


def _examples(
    model: Model, experiments: Sequence[Experiment], velocity: VelocitySource, samples: int
) -> tuple[Float[np.ndarray, "examples n_phi"], Float[np.ndarray, "examples n_x"]]:
    """What an encoder sees along records, and the states that it should say."""
    long = [e for e in experiments if len(e) >= samples]
    every = max(1, sum(len(e) - samples + 1 for e in long) // _EXAMPLES)
    look = jax.vmap(lambda q, u: encoder_features(model.channels, q, u))
    seen, wanted = [], []
    for e, x in zip(long, states_along(model, long, velocity), strict=True):
        last = np.arange(samples - 1, len(e), every)
        rows = last[:, None] + np.arange(1 - samples, 1)
        u = np.asarray(drive_of(model, e).u)
        seen.append(np.asarray(look(e.q[rows], u[rows[:, :-1]])))
        wanted.append(x[last])
    return np.concatenate(seen), np.concatenate(wanted)


class EncodedFamily(Family):
    """Models with an encoder."""

    kind = "encoded"
    hyper = Hyper
    instead = 'say `start = "encoder-20"` in the recipe of another kind'
    model = EncodedModel

    def trainable(self, model: EncodedModel, stage: Any) -> PyTree:
        """What trains of the model, and the layers of the encoder."""
        of_dynamics = family_of(model.dynamics).trainable(model.dynamics, stage)
        nothing = jax.tree.map(lambda _: False, model)
        mask = eqx.tree_at(lambda m: m.model, nothing, of_dynamics)
        trains = jax.tree.map(lambda _: True, model.encoder.layers)
        return eqx.tree_at(lambda m: m.network.layers, mask, trains)

    def describe(self, model: EncodedModel) -> tuple[Header, Arrays]:
        """The model as its family describes it, and the sizes of the encoder."""
        family = family_of(model.dynamics)
        described, own = family.describe(model.dynamics)
        header: Header = {
            DYNAMICS: {"kind": family.kind, **described, **model.channels.as_header()},
            ENCODER: {
                "samples": model.encoder.samples,
                "hidden": len(model.encoder.hidden.weight),
                "features": len(model.encoder.offset),
            },
        }
        arrays = {f"{DYNAMICS}.{name}": a for name, a in own.items()}
        return header, arrays | named_arrays(model.encoder, f"{ENCODER}.")

    def parts(self, header: Header) -> Sequence[Header]:
        """The model."""
        return [header[DYNAMICS]]

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> EncodedModel:
        """Both parts."""
        part, sizes = header[DYNAMICS], header[ENCODER]
        own = below(f"{DYNAMICS}.", arrays)
        dynamics = FAMILIES[part["kind"]].restore(part, own, system, where)
        n_phi, n_h, n_x = sizes["features"], sizes["hidden"], dynamics.state_size

        def blank() -> StateEncoder:
            return StateEncoder(
                Affine(jnp.zeros((n_x, n_phi)), jnp.zeros(n_x)),
                Affine(jnp.zeros((n_h, n_phi)), jnp.zeros(n_h)),
                Affine(jnp.zeros((n_x, n_h)), None),
                jnp.zeros(n_phi), jnp.zeros(n_phi), jnp.zeros(n_x), sizes["samples"],
            )  # fmt: skip

        return EncodedModel(dynamics, filled(blank, arrays, f"{ENCODER}."))

    def parameters(self, model: EncodedModel) -> Sequence[tuple[str, str, float]]:
        """Those of the model."""
        return family_of(model.dynamics).parameters(model.dynamics)

    def equations(self, model: EncodedModel) -> LagrangianModel | None:
        """Those of the model."""
        return family_of(model.dynamics).equations(model.dynamics)


FAMILY = EncodedFamily()
