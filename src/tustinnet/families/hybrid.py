"""Hybrids: identified physics, and a network that corrects its accelerations."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
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
from tustinnet.data.experiment import Experiment, VelocitySource, moving_coordinates
from tustinnet.errors import InputError
from tustinnet.families.descriptions import Description
from tustinnet.families.euler_lagrange import without_ranges
from tustinnet.families.family import (
    Arrays,
    Header,
    Hyper,
    LayeredStage,
    Lines,
    TrainedFamily,
    describe_part,
    family_of,
    restore_part,
    summarise_part,
)
from tustinnet.models.blocks import root_mean_square
from tustinnet.models.contract import (
    AccelerationModel,
    Model,
    State,
    require_fit,
)
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.models.sizes import MOST_SUBSTEPS
from tustinnet.models.step_layout import StepInput, StepLayout
from tustinnet.registry import DEFAULT_FAMILY, FAMILIES
from tustinnet.signals.stacking import stack_padded
from tustinnet.simulate.along import predictions_along
from tustinnet.simulate.input_signal import input_signals
from tustinnet.simulate.substeps import fewest_substeps

_PARTS = ("physics", "correction")  # keys of headers
_INTEGRATION_SHARE = 0.1  # of the physics' error: what its integration may add
_REST_LEVEL = 0.01  # a mean square of scaled velocities and inputs: a tenth of what is usual


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
            fewer integration steps than the original model, see `HybridHyper`.
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

    # a property in the place of a field of the base class: nobody assigns it
    @property
    def channels(self) -> Channels:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The channels of the physics."""
        return self.physics.channels

    @property
    def inner_models(self) -> tuple[Model, ...]:
        """The physics, then the correction."""
        return self.physics, self.correction

    @property
    def warm_up(self) -> int:
        """The longer warm-up of both parts."""
        return max(self.physics.warm_up, self.correction.warm_up)

    def for_record(self, experiment: Experiment) -> "HybridModel":
        """The hybrid with the physics of the record."""
        physics = self.physics.for_record(experiment)
        return self if physics is self.physics else replace(self, physics=physics)

    @property
    def step_layout(self) -> StepLayout:
        """The rows of the physics, and those that the correction takes."""
        return self.physics.step_layout | self._correction_layout

    @property
    def _correction_layout(self) -> StepLayout:
        """Rows of the correction; instead of the mean it takes the first row of the physics."""
        layout = self.correction.step_layout
        return StepLayout() if layout == StepLayout(mean=True) else layout

    def step(self, x: State, u: StepInput) -> State:
        """The state after one period: the physics, then the correction."""
        channels, n_p, layout = self.channels, self.physics.state_size, self.step_layout
        for_physics = layout.select(u, self.physics.step_layout)
        u_begin = for_physics if for_physics.ndim == 1 else for_physics[0]
        rows = self._correction_layout
        f, update_internal = self.correction.accelerate(
            jnp.concatenate([x[channels.measured], x[n_p:]]),
            u_begin if rows == StepLayout() else layout.select(u, rows),
        )
        if self.fades_at_rest:
            unit = self.correction.scaling
            motion = jnp.concatenate([x[channels.velocity] / unit.velocity, u_begin / unit.input])
            level = jnp.mean(motion**2)
            f = f * level / (level + _REST_LEVEL)
        change = self.dt * f
        physics_next = self.physics.step(x[:n_p], for_physics)
        v_next = physics_next[channels.velocity] + change
        return jnp.concatenate(
            [
                physics_next[channels.position] + self.dt / 2 * change,
                v_next,
                physics_next[channels.internal],
                update_internal((x[channels.velocity] + v_next) / 2),
            ]
        )

    def simplify(self) -> "HybridModel":
        """The hybrid with folded parts."""
        correction = cast(AccelerationModel, self.correction.simplify())
        return HybridModel(self.physics.simplify(), correction, self.fades_at_rest)


class HybridHyper(Hyper):
    """The table `[model]` of a network that corrects physics.

    Attributes:
        correction: the network: the table `[model]` of a kind that computes accelerations.
        fades_at_rest: whether the correction fades at standstill without input.
        substeps: Runge-Kutta steps of the physics in a period; none for as few as change its free
            runs by less than a tenth of what they miss.
    """

    correction: SerializeAsAny[Hyper] = Field(default_factory=lambda: _read_correction({}))
    fades_at_rest: bool = False
    substeps: int | None = Field(default=None, gt=0, le=MOST_SUBSTEPS)

    @field_validator("correction", mode="before")
    @classmethod
    def _check_correction(cls, content: Any) -> Any:
        return content if isinstance(content, Hyper) else _read_correction(content)


def _read_correction(content: Any) -> Hyper:
    """The table of a correction, checked by its family."""
    if not isinstance(content, dict):
        raise InputError("correction", f"{content!r}", "a table of a kind of network")
    family = FAMILIES[content.get("kind", DEFAULT_FAMILY)]
    if not (isinstance(family, TrainedFamily) and issubclass(family.model, AccelerationModel)):
        raise InputError(
            "correction", f"kind '{family.kind}'", "a kind that computes accelerations"
        )
    return declare({"kind": family.kind, **content}, family.hyper, "correction")


class HybridDescription(Description):
    """The header of a hybrid; the descriptions of its parts are checked by their families."""

    fades_at_rest: bool
    physics: dict[str, Any]
    correction: dict[str, Any]


class HybridFamily(TrainedFamily):
    """The family of hybrids."""

    kind = "hybrid"
    hyper = HybridHyper
    description = HybridDescription
    stage = LayeredStage
    needs = frozenset({"physics"})
    has_feedback = True
    model = HybridModel

    def builder(
        self,
        hyper: HybridHyper,
        experiments: Sequence[Experiment],
        velocity: VelocitySource,
        physics: Model | None,
    ) -> Callable[[PRNGKeyArray], HybridModel]:
        """A function that makes a correction of 0, in units of what the physics leaves."""
        physics = self.physics_for_training(hyper, physics, experiments)
        # holds that only the physics knows are those of the correction, too
        driven = [e.with_timing(physics.inputs) for e in experiments]
        family = FAMILIES[hyper.correction.kind]
        build_correction = family.builder(hyper.correction, driven, velocity, None)
        unit = _remaining_acceleration(physics, experiments, velocity)

        def build(key: PRNGKeyArray) -> HybridModel:
            correction = eqx.tree_at(lambda m: m.scaling.acceleration, build_correction(key), unit)
            return HybridModel(physics, correction.with_zero_output(), hyper.fades_at_rest)

        return build

    def check(self, hyper: HybridHyper, stage: LayeredStage) -> None:
        """Checks the stage by the family of the correction."""
        family = FAMILIES[hyper.correction.kind]
        if issubclass(family.stage, LayeredStage):
            family.check(hyper.correction, stage)
        elif stage.frozen_layers:
            raise ValueError(f"`frozen_layers` is not applicable to kind '{family.kind}'")

    def trainable_mask(self, model: HybridModel, stage: LayeredStage) -> PyTree:
        """A tree like the model, True at what trains of the correction; the physics does not."""
        family = cast(TrainedFamily, family_of(model.correction))
        mask = jax.tree.map(lambda _: False, model)
        trainable = family.trainable_mask(model.correction, stage)
        return eqx.tree_at(lambda m: m.correction, mask, trainable)

    def with_weights_from(self, model: HybridModel, origin: Model) -> HybridModel:
        """The hybrid with the correction of the trained one; its physics stays."""
        self.require_own(origin)
        trained = cast(HybridModel, origin)
        if model.fades_at_rest != trained.fades_at_rest:
            raise InputError(
                "`origin=`",
                f"a correction with fades_at_rest = {trained.fades_at_rest}",
                f"{model.fades_at_rest}, as the recipe has it",
                "leave `recipe=` and `changes=` out",
            )
        family = cast(TrainedFamily, family_of(model.correction))
        correction = family.with_weights_from(model.correction, trained.correction)
        return replace(model, correction=cast(AccelerationModel, correction))

    def physics_for_training(
        self, hyper: HybridHyper, physics: Model | None, experiments: Sequence[Experiment]
    ) -> Model:
        """The physics without ranges, with no more integration steps than its errors are worth."""
        if physics is None:
            raise InputError(f"a recipe of kind '{self.kind}'", "no physics", "physics to correct")
        for e in experiments:
            require_fit(physics, e)
        if isinstance(physics, Discretised):
            substeps = hyper.substeps or fewest_substeps(physics, experiments, _INTEGRATION_SHARE)
            return replace(without_ranges(physics), substeps=substeps)
        if hyper.substeps is not None:
            raise InputError("model.substeps", "physics that is not integrated", "no `substeps`")
        return physics

    def without_correction(self, model: HybridModel) -> HybridModel:
        """The hybrid with a correction of 0."""
        return replace(model, correction=model.correction.with_zero_output())

    def physics_in(self, model: HybridModel) -> Model:
        """The physics that the network corrects."""
        return model.physics

    def describe(self, model: HybridModel) -> tuple[Header, Arrays]:
        """Physics and correction as their families describe them."""
        header: Header = {"fades_at_rest": model.fades_at_rest}
        arrays: Arrays = {}
        for name in _PARTS:
            header[name], part_arrays = describe_part(getattr(model, name), f"{name}.")
            arrays |= part_arrays
        return header, arrays

    def parts(self, header: Header) -> Mapping[str, Header]:
        """The descriptions of physics and correction."""
        return {name: header[name] for name in _PARTS}

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> HybridModel:
        """The hybrid of a file, from its parts."""
        physics, correction = (
            restore_part(header[name], arrays, f"{name}.", system, where) for name in _PARTS
        )
        if not isinstance(correction, AccelerationModel):
            raise ValueError(f"a correction of kind '{header['correction']['kind']}'")
        return HybridModel(physics, correction, header["fades_at_rest"])

    def summarise(self, header: Header, arrays: Arrays) -> Lines:
        """The kinds of physics and correction, and their own lines."""
        fades = ", fading at rest" if header["fades_at_rest"] else ""
        lines = []
        for name, remark in zip(_PARTS, ("", fades), strict=True):
            lines.append((name, header[name]["kind"] + remark))
            lines += summarise_part(header[name], arrays, f"{name}.")
        return lines

    def equations(self, model: HybridModel) -> LagrangianModel | None:
        """The equations of motion of the physics."""
        return family_of(model.physics).equations(model.physics)


FAMILY = HybridFamily()


def _remaining_acceleration(
    physics: Model, experiments: Sequence[Experiment], velocity: VelocitySource
) -> Float[Array, " n_q"]:
    """Root mean square of what physics leaves of the accelerations, the unit of a correction.

    1 for a coordinate that never moves.
    """
    measured = [e.measured_states(velocity) for e in experiments]
    drive = input_signals(physics, experiments)
    predicted = np.asarray(predictions_along(physics, jnp.asarray(stack_padded(measured)), drive))
    at = physics.channels.velocity
    errors = [x[1:, at] - run[1 : len(x), at] for x, run in zip(measured, predicted, strict=True)]
    remaining = root_mean_square(np.concatenate(errors) / physics.dt)
    return jnp.asarray(np.where(moving_coordinates(experiments), remaining, 1.0), jnp.float32)
