"""What every family of models answers; all that the rest of the package knows of it."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree
from pydantic import Field

from tustinnet.data.declaration import Declaration
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.errors import InputError
from tustinnet.families.shown import Arrays, Header
from tustinnet.models.blocks import Affine
from tustinnet.models.contract import Model
from tustinnet.models.integrate import FromContinuous
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.registry import FAMILIES, SHOWN

Vector = Float[np.ndarray, " _"]
Regulariser = Callable[[Model, Float[Array, " n_x"], Array], Float[Array, ""]]
Given = Literal["system", "physics"]

# far beyond what anybody needs; beyond them memory ends before any message
MOST_LAYERS, MOST_UNITS, MOST_STATES = 100, 10_000, 1000


class Hyper(Declaration):
    """The table `[model]` of a recipe.

    Attributes:
        kind: the family.
    """

    kind: str


class StageKeys(Declaration):
    """Keys of a training stage that only some families know."""


class Family(ABC):
    """A kind of model.

    Attributes:
        kind: its name in recipes and model files.
        spelt: its name in headings, where that is not `kind`.
        hyper: what the table `[model]` of a recipe may say.
        stage: keys of a training stage beside those that all families know.
        trains: whether it has weights that are trained; else parameters that are identified.
        instead: what to do instead of naming it in a recipe, of kinds whose models are made of
            others; empty where a recipe may name it.
        needs: what has to be given beside a recipe, a `system` or the `physics` to correct.
        correctable: whether a network may correct its models.
        model: the class of its models, or of what is stepped in them.
    """

    kind: ClassVar[str]
    spelt: ClassVar[str] = ""
    hyper: ClassVar[type[Hyper]]
    stage: ClassVar[type[StageKeys]] = StageKeys
    trains: ClassVar[bool] = True
    instead: ClassVar[str] = ""
    needs: ClassVar[frozenset[Given]] = frozenset()
    correctable: ClassVar[bool] = False
    model: ClassVar[type]

    def owns(self, model: Any) -> bool:
        """Whether a model is of this family."""
        core = model.continuous if isinstance(model, FromContinuous) else model
        return isinstance(core, self.model)

    def builder(
        self,
        hyper: Any,
        experiments: Sequence[Experiment],
        velocity: VelocitySource,
        physics: Model | None,
    ) -> Callable[[PRNGKeyArray], Model]:
        """How a model is made from a key, once what records say of it has been learnt.

        Args:
            hyper: the recipe's table `[model]`.
            experiments: the training records.
            velocity: which velocities to use.
            physics: the model to correct, for families that correct one.

        Raises:
            InputError: records that the family cannot be built for.
        """
        raise InputError(f"kind '{self.kind}'", "nothing to train", "a kind of model with weights")

    def check(self, hyper: Any, stage: Any) -> None:  # noqa: B027 (most have nothing to check)
        """Raises `ValueError` where a stage of a recipe does not fit the model it describes."""

    def trainable(self, model: Any, stage: Any) -> PyTree:
        """A tree like the model, True at the arrays that train in a stage; here all layers."""
        return mask_of(model, layers_in(model))

    def begun(self, built: Any, origin: Model) -> Model:
        """A model as a recipe builds it with the arrays of a trained one, to go on from there.

        Args:
            built: what the recipe makes of the records.
            origin: the trained model.

        Raises:
            InputError: the trained model is of another kind, or of other sizes.
        """
        self.require_own(origin)
        fresh, trained = built.simplify(), origin.simplify()
        (said, ours), (says, theirs) = self.describe(fresh), self.describe(trained)
        sizes = [{name: a.shape for name, a in of.items()} for of in (ours, theirs)]
        if said != says or sizes[0] != sizes[1]:
            raise InputError(
                "--from", f"a model with {_differing(says, said)}",
                f"{_differing(said, says)}, as the recipe has it",
                "leave --recipe and --set of [model] out: the model's own recipe is the usual one",
            )  # fmt: skip
        leaves, structure = jax.tree.flatten(fresh)
        arrays = zip(jax.tree.leaves(trained), leaves, strict=True)
        return jax.tree.unflatten(structure, [jnp.asarray(a, b.dtype) for a, b in arrays])

    def require_own(self, origin: Model) -> None:
        """Raises unless a model to begin with is of this family."""
        if not self.owns(origin):
            raise InputError(
                "--from", f"a model of kind '{family_of(origin).kind}'",
                f"one of kind '{self.kind}', which the recipe makes",
                "leave --recipe out to go on with the model's own recipe",
            )  # fmt: skip

    def beginning(self, hyper: Any, origin: Model, system: Any) -> Any:
        """The table `[model]` of an identification that begins where another one ended.

        Args:
            hyper: the table.
            origin: the identified model.
            system: the system whose parameters are identified.
        """
        raise InputError(f"kind '{self.kind}'", "no parameters", "a kind that is identified")

    def corrected(self, model: Any) -> Model | None:
        """The physics that a model corrects, None of most."""
        return None

    def stepped(
        self, hyper: Any, physics: Model | None, experiments: Sequence[Experiment]
    ) -> Model | None:
        """The physics as models of this family step it; here as it is given.

        Args:
            hyper: the recipe's table `[model]`.
            physics: the model that is corrected, if any.
            experiments: the training records.
        """
        return physics

    def regulariser(self, stage: Any) -> Regulariser | None:
        """What a stage adds to the loss at every step, from model, state and input; None for none.

        Two that are alike must be equal, so that one compiled program serves both.
        """
        return None

    @abstractmethod
    def describe(self, model: Any) -> tuple[Header, Arrays]:
        """What a model file says of a model, beside its channels, and its arrays by name."""

    @abstractmethod
    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> Model:
        """The model of a file; `system` is what the user gave for one of his own, `where` the file.

        A header that does not fit raises KeyError, TypeError or ValueError.
        """

    def parts(self, header: Header) -> Sequence[Header]:
        """The descriptions of other models in that of a model; most have none."""
        return ()

    def shown(self, header: Header, arrays: Arrays) -> list[tuple[str, str]]:
        """What `show` tells of a file beside what it tells of all, as words and what they say.

        Here from what the registry names in `SHOWN`.
        """
        return SHOWN[self.kind](header, arrays)

    def parameters(self, model: Any) -> Sequence[tuple[str, str, float]]:
        """Name, unit and value of its physical parameters; networks have none."""
        return ()

    def equations(self, model: Any) -> LagrangianModel | None:
        """The equations of motion that a model has in it, for its energy; networks have none."""
        return None

    def alternatives(self, model: Any, header: Header) -> Sequence[Model]:
        """Other models that its records allow as well; their differences say how sure it is.

        Args:
            model: the model.
            header: what its file says.

        Returns:
            At least two; none of a model that does not know its own errors.
        """
        return ()


def _differing(said: Header, other: Header) -> str:
    """What a description says that another one does not; its sizes where it says the same."""
    flat = [
        {
            key: x
            for k, of in header.items()
            for key, x in (of if isinstance(of, dict) else {k: of}).items()
        }
        for header in (said, other)
    ]
    told = [f"{key} {x}" for key, x in flat[0].items() if flat[1].get(key) != x]
    return ", ".join(told) or "other sizes"


def family_of(model: Any) -> Family:
    """The family of a model.

    Raises:
        InputError: none of the registry has it.
    """
    for kind in FAMILIES.names():
        if FAMILIES[kind].owns(model):
            return FAMILIES[kind]
    raise InputError(
        f"a {type(model).__name__}", "a model of no registered family",
        f"a model of one of the kinds {', '.join(FAMILIES.names())}",
    )  # fmt: skip


def systems_in(header: Header) -> tuple[str, ...]:
    """The names of the systems that a described model belongs to, or parts of it; none twice."""
    own = header.get("system")
    names = [str(own.get("name", ""))] if isinstance(own, dict) else []
    for part in FAMILIES[header["kind"]].parts(header):
        names += systems_in(part)
    return tuple(dict.fromkeys(names))


class LayeredStage(StageKeys):
    """Of networks with hidden layers.

    Attributes:
        frozen_layers: how many hidden layers, from the first on, do not train (a stem counts
            with the first). The output layer always trains.
    """

    frozen_layers: int = Field(default=0, ge=0, le=MOST_LAYERS)


def layers_in(tree: PyTree) -> list[Affine]:
    """The layers of a model."""
    leaves = jax.tree.leaves(tree, is_leaf=lambda node: isinstance(node, Affine))
    return [leaf for leaf in leaves if isinstance(leaf, Affine)]


def mask_of(model: Model, training: PyTree) -> PyTree:
    """A tree like the model, True at the arrays that also stand in `training`."""
    trained = {id(leaf) for leaf in jax.tree.leaves(training)}
    return jax.tree.map(lambda leaf: id(leaf) in trained, model)


def named_arrays(tree: PyTree, prefix: str = "") -> Arrays:
    """The arrays of a model by the names that they have in a file."""
    paths = jax.tree_util.tree_leaves_with_path(eqx.filter(tree, eqx.is_array))
    name = jax.tree_util.keystr
    return {
        prefix + name(path, simple=True, separator="."): np.asarray(leaf) for path, leaf in paths
    }


def filled(make: Callable[[], PyTree], arrays: Arrays, prefix: str = "") -> Any:
    """What `make` builds, with the arrays of a file in it; nothing is computed.

    Raises:
        KeyError: an array is missing.
        ValueError: an array of another shape or type, or with numbers that are not finite.
    """
    blank = eqx.filter_eval_shape(make)

    def fill(path: Any, leaf: Any) -> Any:
        if not isinstance(leaf, jax.ShapeDtypeStruct):
            return leaf
        name = prefix + jax.tree_util.keystr(path, simple=True, separator=".")
        if name not in arrays and 0 in leaf.shape:
            return jnp.zeros(leaf.shape, leaf.dtype)  # files from before there were any
        array = jnp.asarray(arrays[name])
        if array.shape != leaf.shape:
            raise ValueError(f"{name} of shape {array.shape}, expected {leaf.shape}")
        if array.dtype.kind != np.dtype(leaf.dtype).kind or not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} of type {array.dtype}, or not finite")
        return array

    return jax.tree_util.tree_map_with_path(fill, blank)
