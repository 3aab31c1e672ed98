"""Known physics plus a network for what it leaves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree
from pydantic import Field, SerializeAsAny, field_validator

from tustinnet.channels import Channels
from tustinnet.data.declaration import declare
from tustinnet.data.experiment import Experiment, VelocitySource, moves_in
from tustinnet.errors import InputError
from tustinnet.families.family import (
    Arrays,
    Family,
    Header,
    Hyper,
    LayeredStage,
    Regulariser,
    family_of,
)
from tustinnet.families.shown import CORRECTION, PHYSICS, below, hybrid_as_now
from tustinnet.models.blocks import root_mean_square
from tustinnet.models.contract import (
    AccelerationModel,
    Internal,
    Model,
    State,
    StepInput,
    StepInputs,
    require_fit,
)
from tustinnet.models.integrate import MOST_SUBSTEPS, Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.registry import FAMILIES, USUAL
from tustinnet.signals.excitation import Excitation
from tustinnet.signals.stacking import stacked
from tustinnet.simulate.along import followed
from tustinnet.simulate.drive import drives_of
from tustinnet.simulate.substeps import fewest_substeps

_HIDDEN = 0.1  # of the physics' error: what its integration may add
_REST = 0.01  # a mean square of scaled velocities and inputs: a tenth of what is usual


class HybridModel(Model):
    """A model and a network that corrects its accelerations.

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
        physics: the model that is corrected, as a rule a discretised Lagrangian system; often with
            fewer integration steps than the model that was given, see `HybridHyper`.
        correction: whose accelerations correct it; its own trapezoidal step is not used.
        fades_at_rest: whether the correction does.
    """

    physics: Model
    correction: AccelerationModel
    fades_at_rest: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        ours, theirs = self.correction, self.physics
        if [c.name for c in ours.coordinates] != [c.name for c in theirs.coordinates] or [
            i.name for i in ours.inputs
        ] != [i.name for i in theirs.inputs]:
            raise InputError("hybrid", "a network of another system", "the physics' coordinates")

    @property
    def channels(self) -> Channels:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Those of the physics."""
        return self.physics.channels

    @property
    def internal(self) -> tuple[str, ...]:
        """The internal states of the physics, then those of the correction."""
        return (*self.physics.internal, *self.correction.internal)

    @property
    def warm_up(self) -> int:
        """The longer of both."""
        return max(self.physics.warm_up, self.correction.warm_up)

    def initial_internal(self, measured: Float[Array, " n_measured"]) -> Internal:
        """Those of the physics, then those of the correction."""
        each = (of.initial_internal(measured) for of in (self.physics, self.correction))
        return jnp.concatenate(list(each))

    @property
    def internal_spread(self) -> Internal:
        """That of the physics, then that of the correction."""
        return jnp.concatenate([self.physics.internal_spread, self.correction.internal_spread])

    def for_record(self, experiment: Experiment) -> "HybridModel":
        """The same with the physics of the record."""
        physics = self.physics.for_record(experiment)
        return self if physics is self.physics else replace(self, physics=physics)

    def step_inputs(self, inputs: Excitation) -> StepInputs:
        """What the physics is driven by, and behind it the samples that the correction sees."""
        of_physics = self.physics.step_inputs(inputs)
        if not self.correction.taps:
            return of_physics
        rows = of_physics[:, None] if of_physics.ndim == 2 else of_physics
        return np.concatenate([rows, self.correction.step_inputs(inputs)], axis=1)

    def _parted(self, u: StepInput) -> tuple[Array, Array]:
        """What the physics is driven by, and what the correction sees; without taps the sample."""
        taps = len(self.correction.taps)
        if u.ndim == 1:
            return u, u
        if not taps:
            return u, u[0]
        of_physics = u[:-taps]
        return of_physics[0] if len(of_physics) == 1 else of_physics, u[-taps:]

    def step(self, x: State, u: StepInput) -> State:
        """One period: the physics, then the correction."""
        of, n_p = self.channels, self.physics.state_size
        acting, _ = self._parted(u)
        f, remember = self._corrected(x, u)
        change = self.dt * f
        following = self.physics.step(x[:n_p], acting)
        v_next = following[of.velocity] + change
        return jnp.concatenate(
            [
                following[of.position] + self.dt / 2 * change,
                v_next,
                following[of.internal],
                remember((x[of.velocity] + v_next) / 2),
            ]
        )

    def corrected_by(self, x: State, u: StepInput) -> Float[Array, " n_q"]:
        """`f`, what the network adds to the accelerations, (n_q,) [rad/s^2 or m/s^2]."""
        return self._corrected(x, u)[0]

    def _corrected(self, x: State, u: StepInput) -> tuple[Array, Callable[[Array], Array]]:
        acting, told = self._parted(u)
        begin = acting if acting.ndim == 1 else acting[0]
        of, unit = self.channels, self.correction.scaling
        seen = jnp.concatenate([x[of.measured], x[self.physics.state_size :]])
        f, remember = self.correction.accelerate(seen, told)
        if not self.fades_at_rest:
            return f, remember
        motion = jnp.concatenate([x[of.velocity] / unit.velocity, begin / unit.input])
        level = jnp.mean(motion**2)
        return f * level / (level + _REST), remember

    def effort(self, x: State, u: StepInput) -> Float[Array, ""]:
        """The squared correction in the network's units."""
        return jnp.sum((self.corrected_by(x, u) / self.correction.scaling.acceleration) ** 2)

    def simplify(self) -> "HybridModel":
        """The same with folded parts."""
        correction = cast(AccelerationModel, self.correction.simplify())
        return HybridModel(self.physics.simplify(), correction, self.fades_at_rest)


class HybridHyper(Hyper):
    """A network that corrects physics.

    Attributes:
        correction: the network: the table `[model]` of a kind that says accelerations.
        fades_at_rest: whether the correction fades at standstill without input.
        substeps: Runge-Kutta steps of the physics in a period; none for as few as change its free
            runs by less than a tenth of what they miss.
    """

    correction: SerializeAsAny[Hyper] = Field(default_factory=lambda: _hyper({}))
    fades_at_rest: bool = False
    substeps: int | None = Field(default=None, gt=0, le=MOST_SUBSTEPS)

    @field_validator("correction", mode="before")
    @classmethod
    def _of_its_kind(cls, content: Any) -> Any:
        return content if isinstance(content, Hyper) else _hyper(content)


def _hyper(content: Any) -> Hyper:
    if not isinstance(content, dict):
        raise InputError("correction", f"{content!r}", "a table of a kind of network")
    family = FAMILIES[content.get("kind", USUAL)]
    if not issubclass(family.model, AccelerationModel):
        raise InputError("correction", f"kind '{family.kind}'", "a kind that says accelerations")
    return declare({"kind": family.kind, **content}, family.hyper, "correction")


class HybridStage(LayeredStage):
    """Stages of hybrids.

    Attributes:
        frozen_layers: of the correction, if it has layers that can be frozen.
        penalty: weight of the mean squared correction, in the network's units: the physics
            explains what it can.
    """

    penalty: float = Field(default=0.0, ge=0, le=1e6)


@dataclass(frozen=True)
class Effort:
    """The squared correction times a weight, added to the loss."""

    weight: float

    def __call__(self, model: Any, x: Float[Array, " n_x"], u: Array) -> Float[Array, ""]:
        """At a state under an input."""
        return self.weight * model.effort(x, u)


class HybridFamily(Family):
    """Hybrids."""

    kind = "hybrid"
    hyper = HybridHyper
    stage = HybridStage
    needs = frozenset({"physics"})
    model = HybridModel

    def builder(
        self,
        hyper: HybridHyper,
        experiments: Sequence[Experiment],
        velocity: VelocitySource,
        physics: Model | None,
    ) -> Callable[[PRNGKeyArray], HybridModel]:
        """A correction that does not correct anything yet, in units of what the physics leaves."""
        physics = self.stepped(hyper, physics, experiments)
        assert physics is not None
        # holds that only the physics knows are those of the correction, too
        known = [e.driving(physics.inputs) for e in experiments]
        make = FAMILIES[hyper.correction.kind].builder(hyper.correction, known, velocity, None)
        left = _left_by(physics, experiments, velocity)

        def build(key: PRNGKeyArray) -> HybridModel:
            correction = eqx.tree_at(lambda m: m.scaling.acceleration, make(key), left)
            return HybridModel(physics, correction.with_zero_output(), hyper.fades_at_rest)

        return build

    def check(self, hyper: HybridHyper, stage: HybridStage) -> None:
        """What the correction's family says of the stage."""
        family = FAMILIES[hyper.correction.kind]
        if issubclass(family.stage, LayeredStage):
            family.check(hyper.correction, stage)
        elif stage.frozen_layers:
            raise ValueError(f"`frozen_layers` means nothing to kind '{family.kind}'")

    def trainable(self, model: HybridModel, stage: HybridStage) -> PyTree:
        """What trains of the correction; the physics does not."""
        of_correction = family_of(model.correction).trainable(model.correction, stage)
        nothing = jax.tree.map(lambda _: False, model)
        return eqx.tree_at(lambda m: m.correction, nothing, of_correction)

    def begun(self, built: HybridModel, origin: Model) -> HybridModel:
        """The physics that is given, with the correction of the trained model."""
        self.require_own(origin)
        assert isinstance(origin, HybridModel)
        if built.fades_at_rest != origin.fades_at_rest:
            raise InputError(
                "--from", f"a correction with fades_at_rest = {origin.fades_at_rest}",
                f"{built.fades_at_rest}, as the recipe has it", "leave --recipe and --set out",
            )  # fmt: skip
        correction = family_of(built.correction).begun(built.correction, origin.correction)
        return replace(built, correction=cast(AccelerationModel, correction))

    def stepped(
        self, hyper: HybridHyper, physics: Model | None, experiments: Sequence[Experiment]
    ) -> Model | None:
        """With as many integration steps as a correction is worth."""
        assert physics is not None
        for e in experiments:
            require_fit(physics, e)
        if isinstance(physics, Discretised):
            few = hyper.substeps or fewest_substeps(physics, experiments, _HIDDEN)
            return replace(physics, substeps=few)
        if hyper.substeps is not None:
            raise InputError("model.substeps", "physics that is not integrated", "no `substeps`")
        return physics

    def corrected(self, model: HybridModel) -> Model:
        """The physics."""
        return model.physics

    def regulariser(self, stage: HybridStage) -> Regulariser | None:
        """The penalty on the correction."""
        return Effort(stage.penalty) if stage.penalty else None

    def describe(self, model: HybridModel) -> tuple[Header, Arrays]:
        """Both parts as their families describe them."""
        header: Header = {"fades_at_rest": model.fades_at_rest}
        arrays: Arrays = {}
        for name in (PHYSICS, CORRECTION):
            part = getattr(model, name)
            family = family_of(part)
            described, own = family.describe(part)
            header[name] = {"kind": family.kind, **described, **part.channels.as_header()}
            arrays |= {f"{name}.{n}": a for n, a in own.items()}
        return header, arrays

    def parts(self, header: Header) -> Sequence[Header]:
        """Both; files of format 1 have the system beside them."""
        return [header[name] for name in (PHYSICS, CORRECTION) if name in header]

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> HybridModel:
        """Both parts; files of format 1 have them side by side in the header."""
        header, arrays = hybrid_as_now(header, arrays)
        physics, correction = (
            FAMILIES[header[name]["kind"]].restore(
                header[name], below(f"{name}.", arrays), system, where
            )
            for name in (PHYSICS, CORRECTION)
        )
        return HybridModel(physics, correction, bool(header["fades_at_rest"]))

    def parameters(self, model: HybridModel) -> Sequence[tuple[str, str, float]]:
        """Those of the physics."""
        return family_of(model.physics).parameters(model.physics)

    def equations(self, model: HybridModel) -> LagrangianModel | None:
        """Those of the physics."""
        return family_of(model.physics).equations(model.physics)


FAMILY = HybridFamily()


def _left_by(
    physics: Model, experiments: Sequence[Experiment], velocity: VelocitySource
) -> Float[Array, " n_q"]:
    """Root mean square of what physics leaves of the accelerations, the unit of a correction.

    1 for a coordinate that never moves.
    """
    measured = [e.measured_states(velocity) for e in experiments]
    drive = drives_of(physics, experiments)
    said = np.asarray(followed(physics, jnp.asarray(stacked(measured)), drive))
    at = physics.channels.velocity
    left = [
        x[1:, at] - run[1 : len(x), at] for x, run in zip(measured, said, strict=True)
    ]  # fmt: skip
    left = root_mean_square(np.concatenate(left) / physics.dt)
    return jnp.asarray(np.where(moves_in(experiments), left, 1.0), jnp.float32)
