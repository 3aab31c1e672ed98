"""Several models of the same channels, averaged in the acceleration at every step."""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.families.family import (
    Arrays,
    Family,
    Header,
    Hyper,
    family_of,
    systems_in,
)
from tustinnet.families.shown import MEMBERS, WEIGHT, below
from tustinnet.models.contract import Internal, Model, State, StepInput, StepInputs
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.registry import FAMILIES
from tustinnet.signals.excitation import Excitation
from tustinnet.systems.files import load_system

Weights = Sequence[float | int] | Float[np.ndarray | Array, " members"]

_ROUNDING = 1e-5  # that weights may be off a sum of 1: they may be in single precision


class Alike(eqx.Module):
    """Members of one structure, their arrays side by side: one program steps them all.

    Attributes:
        arrays: the arrays of the members, each (members, ...).
        weights: what each member counts, (members,).
        numbers: their places in the committee, from 0.
        structure: what becomes a model with the arrays of a member in it.
    """

    arrays: tuple[Array, ...]
    weights: Float[Array, " members"]
    numbers: tuple[int, ...] = eqx.field(static=True)
    structure: Any = eqx.field(static=True)

    def member(self, i: int = 0) -> Model:
        """One of them; what it says beside numbers, all say."""
        return jax.tree.unflatten(self.structure, [a[i] for a in self.arrays])

    def moved(
        self, shared: Array, own: Float[Array, "members n_z"], move: Callable[[Model, State], State]
    ) -> Float[Array, "members n_x"]:
        """Their states after a step.

        Args:
            shared: positions and velocities, (2 n_q,).
            own: the internal states of each.
            move: steps a member.
        """

        def one(arrays: tuple[Array, ...], z: Array) -> State:
            member = jax.tree.unflatten(self.structure, arrays)
            return move(member, jnp.concatenate([shared, z]))

        return jax.vmap(one)(self.arrays, own)


class Committee(Model):
    """Several models, averaged at every step; `committee` makes it.

        (q_i, v_i, z_i[k+1]) = member_i(q[k], v[k], z_i[k], u[k])
        q[k+1] = sum_i w_i q_i,  v[k+1] = sum_i w_i v_i

    All members step from the same positions and velocities: their accelerations are averaged, and
    the trapezoidal rule holds as well as for each. Internal states are a member's own: the state is
    `[q, v, z_1, ..., z_m]`, in the order in which the members were given.

    Attributes:
        alike: the members, those together that one program can step.
        channels: the coordinates, inputs and period of all.
    """

    alike: tuple[Alike, ...]
    channels: Channels = eqx.field(static=True)

    @property
    def members(self) -> tuple[Model, ...]:
        """The models, in the order in which they were given."""
        each = ([of.member(i) for i in range(len(of.numbers))] for of in self.alike)
        return tuple(self._in_order(each))

    @property
    def weights(self) -> Float[Array, " members"]:
        """What each member counts, in their order; the sum is 1."""
        return jnp.stack(self._in_order(of.weights for of in self.alike))

    @property
    def internal(self) -> tuple[str, ...]:
        """The internal states of all members, with the member's number from 1: `cable 1`."""
        return tuple(f"{z} {n}" for n, names in enumerate(self._internal, 1) for z in names)

    def initial_internal(self, measured: Float[Array, " n_measured"]) -> Internal:
        """Those of all members, one member after the other."""
        return jnp.concatenate([member.initial_internal(measured) for member in self.members])

    @property
    def internal_spread(self) -> Internal:
        """That of all members, one member after the other."""
        return jnp.concatenate([member.internal_spread for member in self.members])

    @property
    def warm_up(self) -> int:
        """The longest of all."""
        return max(of.member().warm_up for of in self.alike)

    @property
    def _internal(self) -> list[tuple[str, ...]]:
        """What each member calls its internal states."""
        return self._in_order([of.member().internal] * len(of.numbers) for of in self.alike)

    def _in_order(self, each: Iterable[Any]) -> list[Any]:
        """What those alike have one each of, in the order of the members."""
        numbers = [number for of in self.alike for number in of.numbers]
        things = [thing for of in each for thing in of]
        return [things[numbers.index(number)] for number in range(len(numbers))]

    def for_record(self, experiment: Experiment) -> "Committee":
        """The same with the members of the record."""
        members = self.members
        chosen = [member.for_record(experiment) for member in members]
        if all(one is member for one, member in zip(chosen, members, strict=True)):
            return self
        return _together(chosen, self.weights)

    def simplify(self) -> "Committee":
        """The same with folded members."""
        return _together([member.simplify() for member in self.members], self.weights)

    def step_inputs(self, inputs: Excitation) -> StepInputs:
        """What the members are given; where not all are alike, the rows of each kind of them."""
        each = [of.member().step_inputs(inputs) for of in self.alike]
        if len(each) == 1:
            return each[0]
        rows = [s.reshape(len(s), math.prod(s.shape[1:-1]), s.shape[-1]) for s in each]
        return np.concatenate(rows, axis=1)

    def _parted(self, u: StepInput) -> list[Array]:
        """What drives each kind of members; a vector acts on all."""
        if u.ndim == 1 or len(self.alike) == 1:
            return [u] * len(self.alike)
        for order in range(1, len(u) + 1):  # of the polynomials that inputs follow
            shapes = self._shapes(order)
            ends = np.cumsum([0, *(math.prod(shape[:-1]) for shape in shapes)]).tolist()
            if ends[-1] == len(u):
                parts = zip(pairwise(ends), shapes, strict=True)
                return [u[a:b].reshape(shape) for (a, b), shape in parts]
        raise ValueError(f"{len(u)} rows of inputs in a period, not what `seen` makes of them")

    def _shapes(self, order: int) -> list[tuple[int, ...]]:
        """Of what drives each kind of members in a period of inputs with so many coefficients."""
        n_u = self.channels.n_u
        inputs = Excitation(np.zeros((2, n_u)), np.zeros((1, order, n_u)))
        return [of.member().step_inputs(inputs).shape[1:] for of in self.alike]

    def step(self, x: State, u: StepInput) -> State:
        """One period: the mean of the members' positions and velocities, internal states of all."""
        return self._moved(x, u, lambda member, own, acting: member.step(own, acting))

    def advance(self, x: State, u: StepInput, period: Array | float) -> State:
        """The same after a period [s], where all members can step by any."""
        return self._moved(x, u, lambda member, own, acting: member.advance(own, acting, period))

    def _moved(self, x: State, u: StepInput, move: Callable[[Model, State, Array], State]) -> State:
        of = self.channels
        ends = np.cumsum([0, *map(len, self._internal)]).tolist()
        own = [x[of.internal][a:b] for a, b in pairwise(ends)]
        moved = [
            alike.moved(
                x[of.measured],
                jnp.stack([own[n] for n in alike.numbers]),
                lambda member, at, acting=acting: move(member, at, acting),
            )
            for alike, acting in zip(self.alike, self._parted(u), strict=True)
        ]
        said = jnp.concatenate([states[:, of.measured] for states in moved])
        weights = jnp.concatenate([alike.weights for alike in self.alike])
        # differences are averaged: what all agree on stays, however the weights are rounded
        mean = said[0] + jnp.sum(weights[:, None] * (said - said[0]), axis=0)
        following = self._in_order(states[:, of.internal] for states in moved)
        return jnp.concatenate([mean, *following])


def committee(models: Sequence[Model], weights: Weights | None = None) -> Committee:
    """One model of several: they step together, and their accelerations are averaged every step.

    Models that are alike, as those of several folds and seeds of one recipe, run as one program.

    Args:
        models: models of the same coordinates, inputs and period, of any families; encoders are
            left out, because each tells the state of its own model only.
        weights: what each counts, numbers from 0 on; they are divided by their sum. By default all
            count the same.

    Raises:
        InputError: no models, one that is a committee itself, or of other channels; weights of
            which there are not as many, that are negative, not finite or all 0.
    """
    for i, model in enumerate(models, 1):
        _require_member(model, models[0], f"model {i} of the committee")
    models = [model.dynamics for model in models]
    given = np.ones(len(models)) if weights is None else np.asarray(weights, np.float64)
    with np.errstate(over="ignore"):
        total = given.sum()
    fit = given.shape == (len(models),) and (given >= 0).all() and 0 < total < np.inf
    if not fit:
        raise InputError(
            "committee", f"{len(models)} models, weights {given.tolist()}",
            "one model or more, each with a weight; finite weights from 0 on, not all 0",
        )  # fmt: skip
    return _together(models, given / total)


def _require_member(model: Model, first: Model, where: str) -> None:
    """Raises unless a model can be averaged with the first one."""
    if not isinstance(model, Model):
        raise InputError(
            where, f"a {type(model).__name__}", "a model that steps from sample to sample",
            "make it discrete (discretise)",
        )  # fmt: skip
    if isinstance(model, Committee):
        raise InputError(where, "a committee", "a single model", "give its members instead")
    first.channels.require_same(model.channels, where, "the first model", open_holds=False)
    delays, wanted = ([i.delay for i in of.inputs] for of in (model, first))
    if delays != wanted:
        raise InputError(
            where, f"delays of the inputs of {delays} s", f"{wanted} s as in the first model",
            "members share the inputs of a record",
        )  # fmt: skip


def _together(members: Sequence[Model], weights: Any) -> Committee:
    """Members of the same channels, the arrays of those alike side by side."""
    kinds: dict[Any, list[tuple[int, list[Array]]]] = {}
    for number, member in enumerate(members):
        leaves, structure = jax.tree.flatten(member)
        arrays = [jnp.asarray(leaf) for leaf in leaves]
        kind = structure, tuple((a.shape, a.dtype) for a in arrays)
        kinds.setdefault(kind, []).append((number, arrays))
    every = [a for of in kinds.values() for _, arrays in of for a in arrays]
    shares = jnp.asarray(weights, jnp.result_type(jnp.float32, *every))
    alike = []
    for (structure, _), of in kinds.items():
        numbers = tuple(number for number, _ in of)
        stacked = tuple(jnp.stack(a) for a in zip(*(arrays for _, arrays in of), strict=True))
        alike.append(Alike(stacked, shares[np.array(numbers)], numbers, structure))
    return Committee(tuple(alike), members[0].channels)


class CommitteeFamily(Family):
    """Committees. No recipe makes one."""

    kind = "committee"
    hyper = Hyper
    instead = "fit models of other kinds, then put them together with `tustinnet committee`"
    model = Committee

    def parts(self, header: Header) -> Sequence[Header]:
        """The members."""
        return header[MEMBERS]

    def describe(self, model: Committee) -> tuple[Header, Arrays]:
        """Each member as its family describes it, with its weight; all of one system."""
        members: list[Header] = []
        arrays: Arrays = {}
        for i, (member, weight) in enumerate(
            zip(model.members, np.asarray(model.weights).tolist(), strict=True), 1
        ):
            family = family_of(member)
            described, own = family.describe(member)
            channels = member.channels.as_header()
            members.append({"kind": family.kind, WEIGHT: weight, **described, **channels})
            arrays |= {f"{i}.{name}": a for name, a in own.items()}
        systems = dict.fromkeys(name for part in members for name in systems_in(part))
        if len(systems) > 1:
            raise InputError(
                "committee", f"members of the systems {', '.join(systems)}",
                "members of one system", "a model file is of one system at most",
            )  # fmt: skip
        return {MEMBERS: members}, arrays

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> Committee:
        """All members, with one system for those that have any: equal ones run as one program."""
        found = None if system is None else load_system(system)
        members = [
            FAMILIES[part["kind"]].restore(
                part, below(f"{i}.", arrays), found if systems_in(part) else None, where
            )
            for i, part in enumerate(header[MEMBERS], 1)
        ]
        weights = np.array([part[WEIGHT] for part in header[MEMBERS]])
        if not (weights >= 0).all() or abs(weights.sum() - 1) > _ROUNDING:
            raise ValueError(f"weights {weights.tolist()}")
        return _together(members, weights)

    def equations(self, model: Committee) -> LagrangianModel | None:
        """Those of the first member that has some."""
        found = (family_of(member).equations(member) for member in model.members)
        return next((of for of in found if of is not None), None)

    def alternatives(self, model: Committee, header: Header) -> Sequence[Model]:
        """The members."""
        return model.members if len(model.members) > 1 else ()


FAMILY = CommitteeFamily()
