"""Recipes: how a model is built and fitted, as data.

The table `[model]` names the kind of model. With it goes what other keys there may be: `stages`
for kinds with weights, `search` for kinds with parameters.
"""

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, SerializeAsAny, create_model, field_validator, model_validator

from tustinnet.data.declaration import Declaration, Name, Sentence, declare
from tustinnet.data.experiment import VelocitySource
from tustinnet.errors import InputError
from tustinnet.families.family import (
    Family,
    Hyper,
    IdentifiedFamily,
    IdentifiedHyper,
    SolvedFamily,
    TrainedFamily,
)
from tustinnet.models.contract import Model
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.sizes import MOST_SUBSTEPS
from tustinnet.registry import DEFAULT_FAMILY, FAMILIES
from tustinnet.simulate.starts import start_named

Compared = Literal["position", "state"]
Criterion = Literal["validation", "validation-loss", "training"]
Kept = Literal[Criterion, "last"]
Robust = Literal["none", "huber", "student"]
Initial = Literal["choose", "anchored", "unanchored"]

# larger values exhaust memory or patience before any message
_MANY = 10**6  # epochs, samples, windows in a step
_WINDOWS = 10**7
_STAGES = 100
Count = Annotated[int, Field(gt=0, le=_MANY)]
Horizon = Annotated[float, Field(gt=0, le=_MANY)]  # s


class WindowRecipe(Declaration):
    """The windows of the records that a stage is trained on.

    Attributes:
        draw: `strided` from the first row on, or `random`.
        length: steps in a window; or
        span: the length of a window in correlation times of the slowest velocity.
        adapt: whether `length` may change with the records: longer where the system moves
            slowly compared to the period, shorter where records are short.
        step: samples between two strided windows.
        count: number of windows; for strided ones the step is chosen so that there are about
            as many.
        part: share of the possible beginnings that strided windows use, from the first on.
        until: `k_bar` to begin windows only before the end of the transient.
    """

    draw: Literal["strided", "random"]
    length: Count | None = None
    span: float | None = Field(default=None, gt=0, le=1e3)
    adapt: bool = False
    step: Count | None = None
    count: int | None = Field(default=None, gt=0, le=_WINDOWS)
    part: float = Field(default=1.0, gt=0, le=1)
    until: Literal["k_bar", "end"] = "end"

    @model_validator(mode="after")
    def _check_draw(self) -> "WindowRecipe":
        if (self.length is None) == (self.span is None):
            raise ValueError("windows take either `length` or `span`")
        if self.span is not None and self.adapt:
            raise ValueError("`adapt` changes a `length`; a `span` follows the records anyway")
        if self.draw == "random" and (self.count is None or self.step or self.part != 1.0):
            raise ValueError("random windows take `count`, not `step` or `part`")
        if self.draw == "strided" and (self.step is None) == (self.count is None):
            raise ValueError("strided windows take either `step` or `count`")
        return self


class PlateauRecipe(Declaration):
    """The rule by which the rate is reduced.

    A criterion is the mean RMSE of the `validation` free runs, the `validation-loss` over the
    windows that the stage's rule gives in the validation records, or the `training` loss.

    Attributes:
        factor: multiplies the rate.
        patience: epochs without improvement that are tolerated.
        watch: the criterion that should fall.
    """

    factor: float = Field(gt=0, lt=1)
    patience: int = Field(ge=0, le=_MANY)
    watch: Criterion = "validation"


class StageRecipe(Declaration):
    """A stage of training; kinds of models may have further keys.

    Attributes:
        name: what it is called.
        windows: what it is trained on.
        loss: what is compared, `state` (positions and velocities) or `position`.
        periodic: whether angles are compared by the periodic distance `2 (1 - cos e)`.
        scaled: whether velocities count in units in which they spread as their positions do, see
            `Residual`.
        rate: Adam's rate at the beginning.
        epochs: passes over the windows, at most.
        patience: epochs without a lower value of `keep` after which the stage ends, if ever.
        batch: windows in a step of the optimiser.
        plateau: when the rate is reduced, if ever.
        decay: `cosine` to let the rate fall to nothing over the stage's epochs, by half a period
            of a cosine (Loshchilov and Hutter, 2017, without restarts).
        keep: the criterion whose lowest value marks the best weights (see `PlateauRecipe`), or
            `last` for the weights of the last epoch.
        mirror: whether the system behaves alike when all positions, velocities and inputs change
            their sign; in every epoch half of the windows are then mirrored, by chance.
        clip: largest norm of the gradient, if it is limited.
        averaging: share of the running average of the weights that a step of the optimiser
            keeps; the average is what is validated and saved. None saves the weights themselves.
    """

    name: Name
    windows: WindowRecipe
    loss: Compared = "state"
    periodic: bool = True
    scaled: bool = False
    rate: float = Field(gt=0, le=1e3)
    epochs: Count
    patience: Count | None = None
    batch: Count
    plateau: PlateauRecipe | None = None
    decay: Literal["cosine"] | None = None
    keep: Kept = "validation"
    mirror: bool = False
    clip: float | None = Field(default=None, gt=0, le=1e6)
    averaging: float | None = Field(default=None, gt=0, lt=1)

    @model_validator(mode="after")
    def _check_rate_and_keep(self) -> "StageRecipe":
        if self.decay and self.plateau:
            raise ValueError("`decay` says the rate of every epoch: leave out `plateau`")
        if self.keep == "last" and self.patience:
            raise ValueError("`patience` is not applicable where the last epoch is kept")
        if self.decay and self.patience:
            raise ValueError("`decay` takes all `epochs`: leave out `patience`")
        return self

    @property
    def needs_validation(self) -> bool:
        """Whether validation records decide over the weights that are kept, or the rate."""
        watch = self.plateau.watch if self.plateau else "training"
        return self.keep.startswith("validation") or watch.startswith("validation")


# keys of what is simulated, which inverse dynamics has no use for
_SIMULATED = (*("initial", "periodic", "scaled", "robust", "refine", "tolerance", "iterations"),)


class SearchRecipe(Declaration):
    """The table `[search]`: how parameters are identified.

    Attributes:
        initial: what is done with every record's initial state while identifying. `anchored`:
            searched for, positions kept near the encoder's reading; `unanchored`: searched for
            freely, which lets a model with missing physics start where it fits; `choose`: both,
            and the better free run on the validation records decides (`anchored` without them); or
            a start without a model (`file`, `derived-6`), which is then not searched for.
        loss: what is compared, `position` (the paper) or `state`, velocities too.
        periodic: whether angles are compared by the periodic distance `2 (1 - cos e)`.
        scaled: whether velocities count in units in which they spread as their positions do, see
            `Residual`.
        robust: how residuals that are much larger than most are weighed: `none` as all others,
            `huber` less, `student` far less (t with 4 degrees of freedom), see `robust_weights`.
        part: `whole` records, or `transients`: up to `k_bar`, without the standstill after it.
        method: `levenberg-marquardt`, by simulation, or `inverse-dynamics`, by the forces that the
            measured motion needs.
        cutoff: of inverse dynamics, frequency above which records are filtered out [Hz]; none for
            that up to which a fit explains half of the power of forces that were left out.
        candidates: of inverse dynamics, forces beside `model.forces` that are added where they
            explain forces that were left out clearly better, one after the other; `armature` is the
            motor that turns with two coordinates.
        tolerance: converged when the next step promises less than this part of the cost.
        iterations: allowed in the last stage.
        horizon: longest segment that is simulated at once [s], also of validation records; none
            for whole records, but for those along which errors grow without end.
        substeps: integration steps in a period; none to choose them from the error target, a
            quarter of an encoder count within 2 s.
        refine: start of free runs to which the parameters are fitted once more after the search,
            as `model-20`; `none` for the parameters as the search ends.
    """

    initial: Initial | str = "choose"
    periodic: bool = False
    scaled: bool = True
    robust: Robust = "none"
    part: Literal["whole", "transients"] = "whole"
    method: Literal["levenberg-marquardt", "inverse-dynamics"] = "levenberg-marquardt"
    cutoff: float | None = Field(default=None, gt=0, le=1e6)
    candidates: tuple[str, ...] = ()
    tolerance: float = Field(default=1e-5, gt=0, le=1)
    iterations: Count = 200
    horizon: Horizon | None = None
    substeps: int | None = Field(default=None, gt=0, le=MOST_SUBSTEPS)
    refine: str = "none"

    @field_validator("initial")
    @classmethod
    def _check_initial(cls, initial: str) -> str:
        if initial in get_args(Initial):
            return initial
        start = start_named(initial, "")
        expected = "expected choose, anchored, unanchored, file or derived-6"
        if start.first:
            raise ValueError(f"a start after the first sample; {expected}")
        if start.needs_model:
            raise ValueError(
                f"a start that is fitted through the model; {expected}; `refine` fits the "
                "parameters to free runs from it"
            )
        return start.name

    @field_validator("refine")
    @classmethod
    def _check_refine(cls, refine: str) -> str:
        if refine == "none":
            return refine
        start = start_named(refine, "")
        if start.first:
            raise ValueError(
                "a start after the first sample; expected none, model-20, file or derived-6"
            )
        return start.name

    @model_validator(mode="after")
    def _check_method(self) -> "SearchRecipe":
        unused = _SIMULATED if self.is_by_forces else ("cutoff", "candidates")
        defaults = type(self).model_fields
        for name in unused:
            if getattr(self, name) != defaults[name].default:
                raise ValueError(f"`{name}` does nothing with method '{self.method}'")
        return self

    @property
    def is_by_forces(self) -> bool:
        """Whether it compares forces along the measured motion, and simulates nothing."""
        return self.method == "inverse-dynamics"


class Recipe(Declaration):
    """A recipe: how a model is built and fitted.

    Attributes:
        name: what it is called.
        description: a sentence for people.
        model: the table `[model]`, the kind of model and its keys.
    """

    name: Name
    description: Sentence = ""
    model: SerializeAsAny[Hyper]

    @property
    def family(self) -> Family:
        """The family of its models."""
        return FAMILIES[self.model.kind]

    @property
    @abstractmethod
    def needs_validation(self) -> bool:
        """Whether validation records decide over anything while a model is fitted."""

    @property
    @abstractmethod
    def longest_run(self) -> float | None:
        """Length of the longest free run that is compared [s], None for whole records."""

    @property
    @abstractmethod
    def usual_seconds(self) -> float:
        """Roughly how long a fit takes, by which a selection orders what it has not tried [s]."""

    @property
    def is_by_forces(self) -> bool:
        """Whether it compares forces along the measured motion, and simulates nothing."""
        return False

    def from_model(self, model: Model, system: LagrangianSystem | None) -> "Recipe":
        """The recipe of a fit that begins with a fitted model of its kind.

        Args:
            model: the fitted model.
            system: the system whose parameters are identified, if any.

        Raises:
            InputError: a model of another kind.
        """
        self.family.require_own(model)
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as data: the class of a recipe is made where it is first needed."""
        return declare_recipe, (self.content, f"recipe '{self.name}'")

    @property
    def content(self) -> dict[str, Any]:
        """The content of its file: without keys that were left out, lists instead of tuples."""
        return self.model_dump(mode="json", exclude_unset=True)


class FreeRunRecipe(Recipe):
    """The recipe of a model without equations of motion, which free runs judge while it is fitted.

    Attributes:
        velocity: where the velocities come from (`Experiment.velocities`).
        start: where these free runs start; when left out, the model's warm-up if it needs one, else
            `file` where a sensor measured velocities, else `model-20` (short records: `derived-6`).
        horizon: how long such a free run lasts at most [s]: longer records are cut end to end into
            segments with a start each; none for whole records.
    """

    velocity: VelocitySource = "auto"
    start: str | None = None
    horizon: Horizon | None = None

    @field_validator("start")
    @classmethod
    def _check_start(cls, start: str | None) -> str | None:
        return start and start_named(start, "").name

    @property
    def longest_run(self) -> float | None:
        """Length of the longest of these free runs [s], None for whole records."""
        return self.horizon


class TrainingRecipe(FreeRunRecipe):
    """The recipe of a model with weights, which are trained.

    Attributes:
        stages: at least one.
    """

    stages: list[SerializeAsAny[StageRecipe]] = Field(min_length=1, max_length=_STAGES)

    @property
    def family(self) -> TrainedFamily:
        """The family of its models."""
        return FAMILIES[self.model.kind]

    @model_validator(mode="after")
    def _check_stages(self) -> "TrainingRecipe":
        names = [stage.name for stage in self.stages]
        if len(set(names)) < len(names):
            raise ValueError("two stages have the same name")
        for stage in self.stages:
            try:
                self.family.check(self.model, stage)
            except ValueError as error:
                raise ValueError(f"stage '{stage.name}' {error}") from None
        return self

    @property
    def needs_validation(self) -> bool:
        """Whether validation records choose the epochs or the rate of a stage."""
        return any(stage.needs_validation for stage in self.stages)

    @property
    def usual_seconds(self) -> float:
        """Programs are compiled, then hundreds of thousands of steps are taken."""
        return 40.0

    def with_stages(self, **changes: Any) -> "TrainingRecipe":
        """Copy of the recipe with other values in every stage."""
        stages = [stage.model_copy(update=changes) for stage in self.stages]
        return self.model_copy(update={"stages": stages})


class SolvedRecipe(FreeRunRecipe):
    """The recipe of a model that least squares find."""

    @property
    def family(self) -> SolvedFamily:
        """The family of its models."""
        return FAMILIES[self.model.kind]

    @property
    def needs_validation(self) -> bool:
        """Whether validation records choose between the stages of the search."""
        return True

    @property
    def usual_seconds(self) -> float:
        """Nothing is compiled, a few dozen steps are taken."""
        return 1.0


class IdentificationRecipe(Recipe):
    """The recipe of a system whose parameters are identified.

    Attributes:
        search: how to search.
    """

    # narrower than in the base class: recipes are frozen
    model: SerializeAsAny[IdentifiedHyper]  # pyright: ignore[reportIncompatibleVariableOverride]
    search: SearchRecipe = SearchRecipe()

    @property
    def family(self) -> IdentifiedFamily:
        """The family of its models."""
        return FAMILIES[self.model.kind]

    @property
    def needs_validation(self) -> bool:
        """Whether validation records choose how initial states are treated."""
        return not self.search.is_by_forces and self.search.initial == "choose"

    @property
    def longest_run(self) -> float | None:
        """Length of the longest segment that is compared [s], None for whole records."""
        return self.search.horizon

    @property
    def usual_seconds(self) -> float:
        """Forces take a moment, simulations of all records a few."""
        return 2.0 if self.is_by_forces else 10.0

    @property
    def is_by_forces(self) -> bool:
        """Whether it compares forces along the measured motion, and simulates nothing."""
        return self.search.is_by_forces

    def from_model(self, model: Model, system: LagrangianSystem | None) -> "IdentificationRecipe":
        """The recipe of an identification that begins at the values of an identified model."""
        table = self.family.with_initial_values(self.model, model, system)
        return self.model_copy(update={"model": table})

    def with_free(self, names: Iterable[str]) -> "IdentificationRecipe":
        """The recipe in which further parameters are free, as delays `NAME.delay`."""
        free = tuple(dict.fromkeys((*self.model.free, *names)))
        return self.model_copy(update={"model": self.model.model_copy(update={"free": free})})

    def with_begin(self, begin: Mapping[str, float]) -> "IdentificationRecipe":
        """The recipe of an identification that begins at other values, by parameter."""
        table = self.model.model_copy(update={"begin": dict(begin)})
        return self.model_copy(update={"model": table})


@cache
def recipe_type(family: TrainedFamily | SolvedFamily | IdentifiedFamily) -> type[Recipe]:
    """The type of the recipes of a family, with its keys of `[model]` and of stages."""
    if not isinstance(family, TrainedFamily):
        base = SolvedRecipe if isinstance(family, SolvedFamily) else IdentificationRecipe
        return create_model(base.__name__, __base__=base, model=(family.hyper, ...))
    stage = create_model("StageRecipe", __base__=(StageRecipe, family.stage))
    return create_model(
        "TrainingRecipe",
        __base__=TrainingRecipe,
        model=(family.hyper, ...),
        # the type is made while the program runs
        stages=(list[stage], Field(min_length=1, max_length=_STAGES)),  # pyright: ignore[reportInvalidTypeForm]
    )


def declare_recipe(content: Mapping[str, Any], where: object) -> Recipe:
    """The recipe that a mapping declares; of the family `tustin-net` where it names no `kind`.

    Args:
        content: the content of a file of a recipe.
        where: what is declared, for messages.

    Raises:
        InputError: no such kind of model, an unknown key or a wrong value.
    """
    table = content.get("model", {})
    if not isinstance(table, dict):
        raise InputError(f"{where}, model", f"{table!r}", 'a table with `kind = "..."`')
    kind = str(table.get("kind", DEFAULT_FAMILY))
    kinds = [name for name in FAMILIES.names() if not FAMILIES[name].remedy]
    if kind not in kinds:
        problem, remedy = f"no kind of model '{kind}'", ""
        if kind in FAMILIES:
            problem, remedy = f"kind '{kind}', made of other models", FAMILIES[kind].remedy
        raise InputError(f"{where}, model.kind", problem, f"one of {', '.join(kinds)}", remedy)
    complete = {**content, "model": {"kind": kind, **table}}
    return declare(complete, recipe_type(FAMILIES[kind]), where)
