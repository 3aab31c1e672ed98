"""The interface of every family of models; the rest of the package knows nothing else of one."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray, PyTree
from pydantic import Field, field_validator

from tustinnet.data.declaration import Declaration
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.errors import InputError
from tustinnet.families.descriptions import Description
from tustinnet.models.blocks import is_layer
from tustinnet.models.contract import Model
from tustinnet.models.integrate import FromContinuous
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.models.sizes import MOST_LAYERS
from tustinnet.old_names import FAMILY_METHODS, refuse_old_names
from tustinnet.registry import FAMILIES, SYSTEMS

Requirement = Literal["system", "physics"]
Header = dict[str, Any]
Arrays = dict[str, np.ndarray]
Lines = list[tuple[str, str]]  # words, and values


class Hyper(Declaration):
    """The table `[model]` of a recipe.

    Attributes:
        kind: the family.
    """

    kind: str


class IdentifiedHyper(Hyper):
    """The table `[model]` of a recipe whose system is identified.

    Attributes:
        system: a packaged system by name, where none is given beside the recipe. Not a file: a
            recipe runs no code.
        fixed: parameters to hold, at a value or at their `nominal` one.
        begin: where the search for a parameter starts.
        free: what sensors and actuators may be off by, as parameters that are searched for:
            `CHANNEL.bias` and `CHANNEL.gain`.
        forces: forces of the library that are added, `LAW` at every coordinate (or input) or
            `LAW:COORDINATE` (or `LAW:INPUT`), see `models.added`.
    """

    system: str | None = None
    fixed: dict[str, float | Literal["nominal"]] = Field(default_factory=dict)
    begin: dict[str, float] = Field(default_factory=dict)
    free: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()

    @field_validator("fixed", "begin", mode="before")
    @classmethod
    def _join_names(cls, content: Any) -> Any:
        """`alpha.bias = 0.1` is a table in a table for TOML, and a parameter here."""
        if not isinstance(content, dict):
            return content
        flat = {}
        for name, value in content.items():
            if isinstance(value, dict):
                flat |= {f"{name}.{part}": x for part, x in value.items()}
            else:
                flat[name] = value
        return flat

    @field_validator("system")
    @classmethod
    def _check_system(cls, system: str | None) -> str | None:
        if system is not None and system not in SYSTEMS:
            names = ", ".join(SYSTEMS.names())
            raise ValueError(f"no system of that name; one of {names}, a file goes with `system=`")
        return system


class StageKeys(Declaration):
    """Keys of a training stage that only some families know."""


class LayeredStage(StageKeys):
    """Keys of a training stage of networks with hidden layers.

    Attributes:
        frozen_layers: how many hidden layers, from the first on, do not train (a stem counts
            with the first). The output layer always trains.
    """

    frozen_layers: int = Field(default=0, ge=0, le=MOST_LAYERS)


class Family(ABC):
    """A kind of model.

    Kinds that a recipe may name are a `TrainedFamily`, a `SolvedFamily` or an `IdentifiedFamily`.

    Attributes:
        kind: its name in recipes and model files.
        title: its name in headings, where that is not `kind`.
        hyper: the keys of the table `[model]` of a recipe.
        description: the keys of a model file's header; those that are not declared are allowed.
        has_seeds: whether its fits begin at random, with a seed each; then each has a name and a
            folder of its own.
        resumable: whether an interrupted fit goes on from its checkpoint.
        averages_folds: whether a selection keeps the average of the models of all folds; else it
            fits the chosen kind once more, to all records.
        remedy: what to do instead of naming it in a recipe, of kinds whose models are made of
            others; empty where a recipe may name it.
        needs: what has to be given beside a recipe, a `system` or the `physics` to correct.
        correctable: whether a network may correct its models.
        has_feedback: whether a controller in the loop of records is a part of its models.
        model: the class of its models, or of what is stepped in them.
    """

    kind: ClassVar[str]
    title: ClassVar[str] = ""
    hyper: ClassVar[type[Hyper]]
    description: ClassVar[type[Description]] = Description
    has_seeds: ClassVar[bool] = False
    resumable: ClassVar[bool] = False
    averages_folds: ClassVar[bool] = False
    remedy: ClassVar[str] = ""
    needs: ClassVar[frozenset[Requirement]] = frozenset()
    correctable: ClassVar[bool] = False
    has_feedback: ClassVar[bool] = False
    model: ClassVar[type]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        where = f"class {cls.__module__}.{cls.__qualname__}"
        refuse_old_names(where, vars(cls), FAMILY_METHODS)
        if "kind" in vars(cls) and not (
            cls.remedy or issubclass(cls, TrainedFamily | SolvedFamily | IdentifiedFamily)
        ):
            expected = "TrainedFamily, SolvedFamily or IdentifiedFamily"
            raise InputError(where, "a class Family", expected)

    def select_seeds(self, seeds: Iterable[int]) -> tuple[int, ...]:
        """The seeds of fits: those given, or 0 alone where a fit does not depend on one."""
        return tuple(seeds) if self.has_seeds else (0,)

    def owns(self, model: Any) -> bool:
        """Whether a model is of this family."""
        core = model.continuous if isinstance(model, FromContinuous) else model
        return isinstance(core, self.model)

    def require_own(self, model: Model) -> None:
        """Raises unless a model to begin with is of this family."""
        if not self.owns(model):
            raise InputError(
                "`origin=`",
                f"a model of kind '{family_of(model).kind}'",
                f"one of kind '{self.kind}', which the recipe makes",
                "leave `recipe=` out to go on with the model's own recipe",
            )

    @abstractmethod
    def describe(self, model: Any) -> tuple[Header, Arrays]:
        """The entries of a model file's header beside the channels, and its arrays by name."""

    @abstractmethod
    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> Model:
        """The model of a file.

        A header that does not fit raises KeyError, TypeError or ValueError.

        Args:
            header: as `describe` made it, with the channels.
            arrays: as `describe` made them.
            system: the system that the user has given, or None.
            where: the file, for messages.
        """

    def parts(self, header: Header) -> Mapping[str, Header]:
        """The descriptions of other models in that of a model, by their places; most have none."""
        return {}

    def summarise(self, header: Header, arrays: Arrays) -> Lines:
        """The lines on the structure of a model file that `show` prints."""
        return []

    def equations(self, model: Any) -> LagrangianModel | None:
        """The equations of motion that a model has in it, for its energy; networks have none."""
        return None

    def physics_in(self, model: Any) -> Model | None:
        """The physics that a model corrects, None of most."""
        return None

    def without_correction(self, model: Any) -> Model | None:
        """The physics alone, as a model of the same structure; None of one that corrects none."""
        return None

    def alternatives(self, model: Any, header: Header) -> Sequence[Model]:
        """Other models that the records of a model allow; their differences show how sure it is.

        Args:
            model: the model.
            header: the header of its file.

        Returns:
            At least two; none of a model that does not know its own errors.
        """
        return ()


class TrainedFamily(Family):
    """A kind of model whose weights are trained, by a `TrainingRecipe`.

    Attributes:
        stage: keys of a training stage beside those that all families know.
    """

    stage: ClassVar[type[StageKeys]] = StageKeys
    has_seeds = True
    resumable = True
    averages_folds = True

    @abstractmethod
    def builder(
        self,
        hyper: Any,
        experiments: Sequence[Experiment],
        velocity: VelocitySource,
        physics: Model | None,
    ) -> Callable[[PRNGKeyArray], Model]:
        """A function that makes a model from a key, with units and the like from records.

        Args:
            hyper: the recipe's table `[model]`.
            experiments: the training records.
            velocity: which velocities to use.
            physics: the model to correct, for families that correct one.

        Raises:
            InputError: records that the family cannot be built for.
        """

    def check(self, hyper: Any, stage: Any) -> None:
        """Raises `ValueError` where a stage of a recipe does not fit the model it describes."""

    def trainable_mask(self, model: Any, stage: Any) -> PyTree:
        """A tree like the model, True at the arrays that train in a stage; by default layers."""
        parts = jax.tree.leaves(model, is_leaf=is_layer)
        return make_mask(model, [part for part in parts if is_layer(part)])

    def with_weights_from(self, model: Any, origin: Model) -> Model:
        """A model as a recipe builds it with the arrays of a trained one, to go on from there.

        Args:
            model: the model that the recipe builds for the records.
            origin: the trained model.

        Raises:
            InputError: the trained model is of another kind, or of other sizes.
        """
        self.require_own(origin)
        fresh, trained = model.simplify(), origin.simplify()
        (header, arrays), (trained_header, trained_arrays) = (
            self.describe(fresh),
            self.describe(trained),
        )
        shapes = {name: a.shape for name, a in arrays.items()}
        if header != trained_header or shapes != {n: a.shape for n, a in trained_arrays.items()}:
            raise InputError(
                "`origin=`",
                f"a model with {_differences(trained_header, header)}",
                f"{_differences(header, trained_header)}, as the recipe has it",
                "leave `recipe=` and `changes=` of [model] out for the model's own recipe",
            )
        leaves, structure = jax.tree.flatten(fresh)
        pairs = zip(jax.tree.leaves(trained), leaves, strict=True)
        return jax.tree.unflatten(structure, [jnp.asarray(a, b.dtype) for a, b in pairs])

    def physics_for_training(
        self, hyper: Any, physics: Model | None, experiments: Sequence[Experiment]
    ) -> Model | None:
        """The physics as models of this family step it; by default as it is given.

        Args:
            hyper: the recipe's table `[model]`.
            physics: the model that is corrected, if any.
            experiments: the training records.
        """
        return physics


@dataclass(frozen=True)
class SolvedRecords:
    """The records of a fit by least squares.

    Attributes:
        train: the model is fitted to them.
        validation: their free runs choose between the stages of the search; may be none.
        velocity: which velocities are used.
        horizon: how long a free run lasts at most [s], None for whole records.
    """

    train: Sequence[Experiment]
    validation: Sequence[Experiment]
    velocity: VelocitySource
    horizon: float | None


class SolvedFamily(Family):
    """A kind of model that least squares find in seconds, by a `SolvedRecipe`; without seeds."""

    @abstractmethod
    def solve(
        self,
        hyper: Any,
        records: SolvedRecords,
        origin: Model | None,
        should_stop: Callable[[], bool],
    ) -> tuple[Model, bool]:
        """The model of records, and whether there was time for the whole search.

        Args:
            hyper: the recipe's table `[model]`.
            records: the records.
            origin: a model of this family to begin with, or None.
            should_stop: asked often: whether the search ends early.

        Raises:
            InputError: records that the family cannot be fitted to, or an origin of other sizes.
        """


class IdentifiedFamily(Family):
    """A kind of model whose parameters are identified, by an `IdentificationRecipe`."""

    hyper = IdentifiedHyper
    needs = frozenset({"system"})

    @abstractmethod
    def with_initial_values(
        self, hyper: Any, origin: Model, system: LagrangianSystem | None
    ) -> IdentifiedHyper:
        """The table `[model]` of an identification that begins at the values of another one.

        Args:
            hyper: the table.
            origin: the identified model.
            system: the system whose parameters are identified.

        Raises:
            InputError: a model of another kind.
        """


def _differences(header: Header, other: Header) -> str:
    """The entries of a description that another one does not have; its sizes where it has all."""

    def flat(header: Header) -> Header:
        entries: Header = {}
        for key, value in header.items():
            entries |= value if isinstance(value, dict) else {key: value}
        return entries

    other_entries = flat(other)
    differing = [f"{key} {x}" for key, x in flat(header).items() if other_entries.get(key) != x]
    return ", ".join(differing) or "other sizes"


def family_of(model: Any) -> Family:
    """The family of a model.

    Raises:
        InputError: none of the registry has it.
    """
    for kind in FAMILIES.names():
        if FAMILIES[kind].owns(model):
            return FAMILIES[kind]
    raise InputError(
        type(model).__name__,
        "a model of no registered family",
        f"a model of one of the kinds {', '.join(FAMILIES.names())}",
        "`model` of this result is one" if hasattr(model, "model") else "",
    )


def describe_part(part: Model, prefix: str) -> tuple[Header, Arrays]:
    """Kind, channels and description of a part of a model; names of its arrays with a prefix."""
    family = family_of(part)
    header, arrays = family.describe(part)
    header = {"kind": family.kind, **header, **part.channels.as_header()}
    return header, {prefix + name: a for name, a in arrays.items()}


def restore_part(header: Header, arrays: Arrays, prefix: str, system: Any, where: Path) -> Any:
    """The part of a model that `describe_part` described."""
    family = FAMILIES[header["kind"]]
    return family.restore(header, _arrays_below(prefix, arrays), system, where)


def summarise_part(header: Header, arrays: Arrays, prefix: str) -> Lines:
    """The lines on a part of a model that `describe_part` described."""
    return FAMILIES[header["kind"]].summarise(header, _arrays_below(prefix, arrays))


def _arrays_below(prefix: str, arrays: Arrays) -> Arrays:
    """The arrays whose names begin with a prefix, without it."""
    return {n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)}


def systems_in(header: Header) -> tuple[str, ...]:
    """The names of the systems that a described model belongs to, or parts of it; none twice."""
    own = header.get("system")
    names = [str(own.get("name", ""))] if isinstance(own, dict) else []
    for part in FAMILIES[header["kind"]].parts(header).values():
        names += systems_in(part)
    return tuple(dict.fromkeys(names))


def make_mask(model: Model, training: PyTree) -> PyTree:
    """A tree like the model, True at the arrays that are also in `training`."""
    trained = {id(leaf) for leaf in jax.tree.leaves(training)}
    return jax.tree.map(lambda leaf: id(leaf) in trained, model)


def named_arrays(tree: PyTree, prefix: str = "") -> Arrays:
    """The arrays of a model by the names that they have in a file."""
    paths = jax.tree_util.tree_leaves_with_path(eqx.filter(tree, eqx.is_array))
    name = jax.tree_util.keystr
    return {
        prefix + name(path, simple=True, separator="."): np.asarray(leaf) for path, leaf in paths
    }


def restore_arrays(make: Callable[[], PyTree], arrays: Arrays, prefix: str = "") -> Any:
    """The tree that `make` builds, with the arrays of a file in it; nothing is computed.

    Raises:
        KeyError: an array is missing.
        ValueError: an array of another shape or type, or with numbers that are not finite.
    """
    blank = eqx.filter_eval_shape(make)

    def fill(path: Any, leaf: Any) -> Any:
        if not isinstance(leaf, jax.ShapeDtypeStruct):
            return leaf
        name = prefix + jax.tree_util.keystr(path, simple=True, separator=".")
        array = jnp.asarray(arrays[name])
        if array.shape != leaf.shape:
            raise ValueError(f"{name} of shape {array.shape}, expected {leaf.shape}")
        if array.dtype.kind != np.dtype(leaf.dtype).kind or not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} of type {array.dtype}, or not finite")
        return array

    return jax.tree_util.tree_map_with_path(fill, blank)
