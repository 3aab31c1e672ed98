"""Recipes: how a model is built and trained, as data."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from tustinnet.data.declaration import Declaration, packaged_names, read_packaged
from tustinnet.data.experiment import VelocitySource

_HOME = "tustinnet.training"

LossName = Literal["state", "position"]
Criterion = Literal["validation", "validation-loss", "training"]

Positive = Field(gt=0)


class ModelRecipe(Declaration):
    """The network.

    Attributes:
        hidden: units of each hidden layer.
        stem: units of an affine layer before them, trained unfolded, or none.
        activation: leaky_relu, relu, tanh, silu or softplus.
        output_bias: whether the output layer has a bias.
        scaling: `records` learns all units from the training records; `published` uses the
            scale of the paper's public code (angular coordinates with stored velocities).
        memory: relaxation times of internal states [s], none by default (see `TustinNet`).
        fades_at_rest: where a network corrects known physics, whether the correction fades at
            standstill without input (see `HybridModel`).
    """

    hidden: tuple[int, ...] = Field(default=(100, 100), min_length=1)
    stem: int | None = None
    activation: Literal["leaky_relu", "relu", "tanh", "silu", "softplus"] = "leaky_relu"
    output_bias: bool = False
    scaling: Literal["records", "published"] = "records"
    memory: tuple[Annotated[float, Positive], ...] = ()
    fades_at_rest: bool = False

    @model_validator(mode="after")
    def _scaled(self) -> "ModelRecipe":
        if self.memory and self.scaling == "published":
            raise ValueError("the published scaling has none for `memory`")
        return self


class WindowRecipe(Declaration):
    """Which windows of the records a stage is trained on.

    Attributes:
        draw: `strided` from the first row on, or `random`.
        length: steps in a window.
        adapt: whether `length` may change with the records: longer where the system moves
            slowly compared to the period, shorter where records are short.
        step: samples between two strided windows.
        count: number of windows; for strided ones the step is chosen so that there are about
            as many.
        part: share of the possible beginnings that strided windows use, from the first on.
        until: `k_bar` to begin windows only before the end of the transient.
    """

    draw: Literal["strided", "random"]
    length: int = Positive
    adapt: bool = False
    step: int | None = Field(default=None, gt=0)
    count: int | None = Field(default=None, gt=0)
    part: float = Field(default=1.0, gt=0, le=1)
    until: Literal["k_bar", "end"] = "end"

    @model_validator(mode="after")
    def _complete(self) -> "WindowRecipe":
        if self.draw == "random" and (self.count is None or self.step or self.part != 1.0):
            raise ValueError("random windows take `count`, not `step` or `part`")
        if self.draw == "strided" and (self.step is None) == (self.count is None):
            raise ValueError("strided windows take either `step` or `count`")
        return self


class PlateauRecipe(Declaration):
    """When the rate is reduced.

    A criterion is the mean RMSE of the `validation` free runs, the `validation-loss` over the
    windows that the stage's rule gives in the validation records, or the `training` loss.

    Attributes:
        factor: multiplies the rate.
        patience: epochs without improvement that are tolerated.
        watch: the criterion that should fall.
    """

    factor: float = Field(gt=0, lt=1)
    patience: int = Field(ge=0)
    watch: Criterion = "validation"


class StageRecipe(Declaration):
    """One stage of training.

    Attributes:
        name: what it is called.
        windows: what it is trained on.
        loss: `state` (positions and velocities) or `position`.
        rate: Adam's rate at the beginning.
        epochs: passes over the windows, at most.
        patience: epochs without a lower value of `keep` after which the stage ends, if ever.
        batch: windows in a step of the optimiser.
        plateau: when the rate is reduced, if ever.
        keep: the criterion whose lowest value marks the best weights (see `PlateauRecipe`).
        frozen_layers: how many hidden layers, from the first on, do not train (a stem counts
            with the first). The output layer always trains.
        mirror: whether the system behaves alike when all positions, velocities and inputs change
            their sign; in every epoch half of the windows are then mirrored, by chance.
        clip: largest norm of the gradient, if it is limited.
        penalty: weight of the mean squared correction, in the network's units, where a network
            corrects known physics: the physics explains what it can.
        averaging: share of the running average of the weights that a step of the optimiser
            leaves; the average is what is validated and kept. None keeps the weights themselves.
    """

    name: str
    windows: WindowRecipe
    loss: LossName = "state"
    rate: float = Positive
    epochs: int = Positive
    patience: int | None = Field(default=None, gt=0)
    batch: int = Positive
    plateau: PlateauRecipe | None = None
    keep: Criterion = "validation"
    frozen_layers: int = Field(default=0, ge=0)
    mirror: bool = False
    clip: float | None = Field(default=None, gt=0)
    penalty: float = Field(default=0.0, ge=0)
    averaging: float | None = Field(default=None, gt=0, lt=1)


class Recipe(Declaration):
    """How a model is built and trained.

    Attributes:
        name: what it is called.
        description: a sentence for people.
        velocity: where the training velocities come from (`Experiment.velocities`).
        start: where the validation free runs start; `file` where velocities are stored, else
            `derived-6`, when left out.
        model: the network.
        stages: at least one.
    """

    name: str
    description: str = ""
    velocity: VelocitySource = "auto"
    start: str | None = None
    model: ModelRecipe = ModelRecipe()
    stages: list[StageRecipe] = Field(min_length=1)

    @model_validator(mode="after")
    def _stages_fit(self) -> "Recipe":
        names = [stage.name for stage in self.stages]
        if len(set(names)) < len(names):
            raise ValueError("two stages have the same name")
        for stage in self.stages:
            if stage.frozen_layers > len(self.model.hidden):
                raise ValueError(
                    f"stage '{stage.name}' freezes {stage.frozen_layers} of "
                    f"{len(self.model.hidden)} hidden layers"
                )
        return self


def keeping(recipe: Recipe, criterion: Criterion) -> Recipe:
    """The same recipe with the best weights of every stage chosen by another criterion."""
    stages = [stage.model_copy(update={"keep": criterion}) for stage in recipe.stages]
    return recipe.model_copy(update={"stages": stages, "name": f"{recipe.name}, keep {criterion}"})


def packaged_recipes() -> list[str]:
    """Names of the recipes that come with the package."""
    return packaged_names(_HOME)


def read_recipe(name: str | Path) -> Recipe:
    """A packaged recipe by name, or a recipe from a TOML file.

    Raises:
        InputError: no such recipe; an unknown key or a wrong value in the file.
    """
    return read_packaged(name, _HOME, Recipe)
