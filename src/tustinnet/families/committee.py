"""Committees: several models of the same channels, averaged in the acceleration at every step."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from itertools import pairwise
from operator import or_
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from pydantic import Field

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.families.descriptions import Description, Entries
from tustinnet.families.family import (
    Arrays,
    Family,
    Header,
    Hyper,
    Lines,
    describe_part,
    family_of,
    restore_part,
    summarise_part,
    systems_in,
)
from tustinnet.models.contract import Model, State
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.models.sizes import MOST_MEMBERS
from tustinnet.models.step_layout import StepInput, StepLayout
from tustinnet.systems.loading import load_system

Weights = Sequence[float | int] | Float[np.ndarray | Array, " members"]

_MEMBERS, _WEIGHT = "members", "weight"  # keys of headers


class MemberGroup(eqx.Module):
    """Members of one structure, their arrays side by side: one program steps them all.

    Attributes:
        arrays: the arrays of the members, each (members, ...).
        weights: the weight of each member, (members,).
        numbers: their places in the committee, from 0.
        structure: the tree of a member, without its arrays.
        internal: the names of a member's internal states.
        warm_up: the warm-up of a member, in samples.
        step_layout: the rows of inputs that a member's step takes.
    """

    arrays: tuple[Array, ...]
    weights: Float[Array, " members"]
    numbers: tuple[int, ...] = eqx.field(static=True)
    structure: Any = eqx.field(static=True)
    internal: tuple[str, ...] = eqx.field(static=True)
    warm_up: int = eqx.field(static=True)
    step_layout: StepLayout = eqx.field(static=True)

    def member(self, i: int) -> Model:
        """Member of the committee by its index; members differ in nothing but arrays."""
        return jax.tree.unflatten(self.structure, [_row(a, i) for a in self.arrays])

    def step_members(
        self, shared: Array, own: Float[Array, "members n_z"], move: Callable[[Model, State], State]
    ) -> Float[Array, "members n_x"]:
        """The states of all members after a step.

        Args:
            shared: positions and velocities, (2 n_q,).
            own: the internal states of each.
            move: steps a member.
        """

        def one(arrays: tuple[Array, ...], z: Array) -> State:
            member = jax.tree.unflatten(self.structure, arrays)
            return move(member, jnp.concatenate([shared, z]))

        return jax.vmap(one)(self.arrays, own)


def _row(array: Array, i: int) -> Array:
    """A row of an array; of one with values by numpy, which takes a tenth of JAX's time."""
    if isinstance(array, Tracer) or array.weak_type:
        return array[i]
    return jnp.asarray(np.asarray(array)[i])


class Committee(Model):
    """A committee of several models, averaged at every step; `committee` makes it.

        (q_i, v_i, z_i[k+1]) = member_i(q[k], v[k], z_i[k], u[k])
        q[k+1] = sum_i w_i q_i,  v[k+1] = sum_i w_i v_i

    All members step from the same positions and velocities: their accelerations are averaged, and
    the trapezoidal rule holds as well as for each. Internal states belong to a member: the state is
    `[q, v, z_1, ..., z_m]`, in the order in which the members were given.

    Attributes:
        groups: the members, in groups that one program can step.
        channels: the coordinates, inputs and period of all.
    """

    groups: tuple[MemberGroup, ...]
    channels: Channels = eqx.field(static=True)

    @property
    def members(self) -> tuple[Model, ...]:
        """The models, in the order in which they were given."""
        members = ([group.member(i) for i in range(len(group.numbers))] for group in self.groups)
        return tuple(self._in_order(members))

    @property
    def weights(self) -> Float[Array, " members"]:
        """The weights of the members, in their order; the sum is 1."""
        return jnp.stack(self._in_order(group.weights for group in self.groups))

    @property
    def internal(self) -> tuple[str, ...]:
        """The internal states of all members, with the member's number from 1: `cable 1`."""
        return tuple(f"{z} {n}" for n, names in enumerate(self._internal_names, 1) for z in names)

    @property
    def inner_models(self) -> tuple[Model, ...]:
        """The members."""
        return self.members

    @property
    def warm_up(self) -> int:
        """The longest warm-up of the members."""
        return max(group.warm_up for group in self.groups)

    @property
    def _internal_names(self) -> list[tuple[str, ...]]:
        """The names of each member's internal states."""
        return self._in_order([g.internal] * len(g.numbers) for g in self.groups)

    def _in_order(self, by_group: Iterable[Any]) -> list[Any]:
        """Values of members, given group by group, in the order of the members."""
        numbers = [number for group in self.groups for number in group.numbers]
        values = [value for group in by_group for value in group]
        return [values[numbers.index(number)] for number in range(len(numbers))]

    def for_record(self, experiment: Experiment) -> "Committee":
        """The committee with the members of the record."""
        members = self.members
        for_record = [member.for_record(experiment) for member in members]
        if all(own is member for own, member in zip(for_record, members, strict=True)):
            return self
        return _group_members(for_record, self.weights)

    def simplify(self) -> "Committee":
        """The committee with folded members."""
        return _group_members([member.simplify() for member in self.members], self.weights)

    @property
    def step_layout(self) -> StepLayout:
        """The rows of all members."""
        return reduce(or_, (group.step_layout for group in self.groups))

    def step(self, x: State, u: StepInput) -> State:
        """The state after one period: mean positions and velocities, internal states of all."""
        return self._step_all(x, u, lambda member, own, inputs: member.step(own, inputs))

    def advance(self, x: State, u: StepInput, period: Array | float) -> State:
        """The state after a period [s], where all members can step by any."""
        return self._step_all(x, u, lambda member, own, inputs: member.advance(own, inputs, period))

    def _step_all(
        self, x: State, u: StepInput, move: Callable[[Model, State, Array], State]
    ) -> State:
        """The state after `move` has stepped every member."""
        channels = self.channels
        ends = np.cumsum([0, *map(len, self._internal_names)]).tolist()
        internal = [x[channels.internal][a:b] for a, b in pairwise(ends)]
        layout = self.step_layout
        states = [
            group.step_members(
                x[channels.measured],
                jnp.stack([internal[n] for n in group.numbers]),
                lambda member, own: move(member, own, layout.select(u, member.step_layout)),
            )
            for group in self.groups
        ]
        measured = jnp.concatenate([s[:, channels.measured] for s in states])
        weights = jnp.concatenate([group.weights for group in self.groups])
        # differences are averaged: what all agree on stays, however the weights are rounded
        mean = measured[0] + jnp.sum(weights[:, None] * (measured - measured[0]), axis=0)
        internal_next = self._in_order(s[:, channels.internal] for s in states)
        return jnp.concatenate([mean, *internal_next])


def committee(models: Sequence[Model], weights: Weights | None = None) -> Committee:
    """Makes one model of several, whose accelerations are averaged at every step.

    Models that are alike, as those of several folds and seeds of one recipe, run as one program.

    Args:
        models: models of the same coordinates, inputs and period, of any families.
        weights: one for each model, from 0 on; they are divided by their sum. By default all are
            equal.

    Raises:
        InputError: no models, one that is a committee itself, or of other channels; weights of
            which there are not as many, that are negative, not finite or all 0.
    """
    for i, model in enumerate(models, 1):
        _require_member(model, models[0], f"model {i} of the committee")
    shares = np.ones(len(models)) if weights is None else np.asarray(weights, np.float64)
    with np.errstate(over="ignore"):
        total = shares.sum()
    if shares.shape != (len(models),) or not (shares >= 0).all() or not 0 < total < np.inf:
        raise InputError(
            "committee",
            f"{len(models)} models, weights {shares.tolist()}",
            "one model or more, each with a weight; finite weights from 0 on, not all 0",
        )
    return _group_members(models, shares / total)


def _require_member(model: Model, first: Model, where: str) -> None:
    """Raises unless a model can be averaged with the first one."""
    if not isinstance(model, Model):
        raise InputError(
            where,
            f"a {type(model).__name__}",
            "a model that steps from sample to sample",
            "make it discrete (discretise)",
        )
    if isinstance(model, Committee):
        raise InputError(where, "a committee", "a single model", "give its members instead")
    first.channels.require_same(model.channels, where, "the first model", open_holds=False)
    delays, first_delays = ([i.delay for i in m.inputs] for m in (model, first))
    if delays != first_delays:
        raise InputError(
            where,
            f"delays of the inputs of {delays} s",
            f"{first_delays} s as in the first model",
            "members share the inputs of a record",
        )


def _group_members(members: Sequence[Model], weights: Any) -> Committee:
    """The committee of members of the same channels, in groups of one structure."""
    kinds: dict[Any, list[tuple[int, list[Array]]]] = {}
    for number, member in enumerate(members):
        leaves, structure = jax.tree.flatten(member)
        arrays = [jnp.asarray(leaf) for leaf in leaves]
        kind = structure, tuple((a.shape, a.dtype) for a in arrays)
        kinds.setdefault(kind, []).append((number, arrays))
    all_arrays = [a for numbered in kinds.values() for _, arrays in numbered for a in arrays]
    shares = jnp.asarray(weights, jnp.result_type(jnp.float32, *all_arrays))
    groups = []
    for (structure, _), numbered in kinds.items():
        numbers = tuple(number for number, _ in numbered)
        stacked = tuple(jnp.stack(a) for a in zip(*(arrays for _, arrays in numbered), strict=True))
        first = members[numbers[0]]
        static = structure, first.internal, first.warm_up, first.step_layout
        groups.append(MemberGroup(stacked, shares[np.array(numbers)], numbers, *static))
    return Committee(tuple(groups), members[0].channels)


class MemberEntries(Entries):
    """The weight of a member; its description is checked by its family."""

    weight: float = Field(ge=0, le=1)


class CommitteeDescription(Description):
    """The header of a committee."""

    members: list[MemberEntries] = Field(min_length=1, max_length=MOST_MEMBERS)


class CommitteeFamily(Family):
    """The family of committees. No recipe makes one."""

    kind = "committee"
    hyper = Hyper
    description = CommitteeDescription
    remedy = "fit models of other kinds, then combine them, in Python: tn.save_committee"
    model = Committee

    def parts(self, header: Header) -> Mapping[str, Header]:
        """The descriptions of the members."""
        return {f"{_MEMBERS}.{i}": member for i, member in enumerate(header[_MEMBERS])}

    def describe(self, model: Committee) -> tuple[Header, Arrays]:
        """The description of each member by its family, with its weight; all of one system."""
        members: list[Header] = []
        arrays: Arrays = {}
        for i, (member, weight) in enumerate(
            zip(model.members, np.asarray(model.weights).tolist(), strict=True), 1
        ):
            part, part_arrays = describe_part(member, f"{i}.")
            members.append({"kind": part["kind"], _WEIGHT: weight, **part})
            arrays |= part_arrays
        systems = dict.fromkeys(name for part in members for name in systems_in(part))
        if len(systems) > 1:
            raise InputError(
                "committee",
                f"members of the systems {', '.join(systems)}",
                "members of one system",
                "a model file is of one system at most",
            )
        return {_MEMBERS: members}, arrays

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> Committee:
        """The committee of a file, with one system for all members that have any."""
        loaded = None if system is None else load_system(system)
        members = [
            restore_part(part, arrays, f"{i}.", loaded if systems_in(part) else None, where)
            for i, part in enumerate(header[_MEMBERS], 1)
        ]
        for i, member in enumerate(members):
            _require_member(member, members[0], f"{where}, members.{i}")
        weights = np.array([part[_WEIGHT] for part in header[_MEMBERS]])
        # weights may be in single precision
        if not (weights >= 0).all() or abs(weights.sum() - 1) > 1e-5:
            raise ValueError(f"weights {weights.tolist()}")
        return _group_members(members, weights)

    def summarise(self, header: Header, arrays: Arrays) -> Lines:
        """The weights, and the lines that members of one structure have in common."""
        kinds: dict[str, list[int]] = {}
        for i, part in enumerate(header[_MEMBERS]):
            structure = {key: x for key, x in part.items() if key != _WEIGHT}
            kinds.setdefault(repr(structure), []).append(i)
        lines = []
        for indices in kinds.values():
            parts = [header[_MEMBERS][i] for i in indices]
            numbers = ", ".join(str(i + 1) for i in indices)
            weights = [f"{part[_WEIGHT]:.4g}" for part in parts]
            weight = ", ".join(weights if len(set(weights)) > 1 else weights[:1])
            lines.append(("members", f"{parts[0]['kind']}: {numbers}; weight {weight}"))
            summaries = [
                summarise_part(part, arrays, f"{i + 1}.")
                for i, part in zip(indices, parts, strict=True)
            ]
            lines += [line for line in summaries[0] if all(line in other for other in summaries)]
        return lines

    def equations(self, model: Committee) -> LagrangianModel | None:
        """The equations of motion of the first member that has some."""
        equations = (family_of(member).equations(member) for member in model.members)
        return next((e for e in equations if e is not None), None)

    def alternatives(self, model: Committee, header: Header) -> Sequence[Model]:
        """The members, if there are several."""
        return model.members if len(model.members) > 1 else ()


FAMILY = CommitteeFamily()
