"""Committees: several models of the same channels, averaged in the acceleration at every step."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from operator import is_, or_
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
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


class Committee(Model):
    """A committee of several models, averaged at every step; `committee` makes it.

        (q_i, v_i, z_i[k+1]) = member_i(q[k], v[k], z_i[k], u[k])
        q[k+1] = sum_i w_i q_i,  v[k+1] = sum_i w_i v_i

    All members step from the same positions and velocities: their accelerations are averaged, and
    the trapezoidal rule holds as well as for each. Internal states belong to a member: the state is
    `[q, v, z_1, ..., z_m]`, in the order in which the members were given.

    Attributes:
        members: the models, in the order in which they were given.
        weights: the weight of each, (members,); the sum is 1.
        channels: the coordinates, inputs and period of all.
    """

    members: tuple[Model, ...]
    weights: Float[Array, " members"]
    channels: Channels = eqx.field(static=True)

    @property
    def internal(self) -> tuple[str, ...]:
        """The internal states of all members, with the member's number from 1: `cable 1`."""
        return tuple(f"{z} {n}" for n, model in enumerate(self.members, 1) for z in model.internal)

    @property
    def inner_models(self) -> tuple[Model, ...]:
        """The members."""
        return self.members

    @property
    def warm_up(self) -> int:
        """The longest warm-up of the members."""
        return max(member.warm_up for member in self.members)

    def for_record(self, experiment: Experiment) -> "Committee":
        """The committee with the members of the record."""
        members = tuple(member.for_record(experiment) for member in self.members)
        is_same = all(map(is_, members, self.members))
        return self if is_same else replace(self, members=members)

    def simplify(self) -> "Committee":
        """The committee with folded members."""
        return replace(self, members=tuple(member.simplify() for member in self.members))

    @property
    def step_layout(self) -> StepLayout:
        """The rows of all members."""
        return reduce(or_, (member.step_layout for member in self.members))

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
        channels, layout = self.channels, self.step_layout
        ends = np.cumsum([0, *(len(member.internal) for member in self.members)]).tolist()
        states = [
            move(
                member,
                jnp.concatenate([x[channels.measured], x[channels.internal][a:b]]),
                layout.select(u, member.step_layout),
            )
            for member, (a, b) in zip(self.members, pairwise(ends), strict=True)
        ]
        measured = jnp.stack([state[channels.measured] for state in states])
        # differences are averaged: what all agree on stays, however the weights are rounded
        mean = measured[0] + self.weights @ (measured - measured[0])
        return jnp.concatenate([mean, *(state[channels.internal] for state in states)])


def committee(models: Sequence[Model], weights: Weights | None = None) -> Committee:
    """Makes one model of several, whose accelerations are averaged at every step.

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
    return _average(models, shares / total)


def _require_member(model: Model, first: Model, where: str) -> None:
    """Raises unless a model can be averaged with the first one."""
    if not isinstance(model, Model):
        raise InputError(
            where,
            type(model).__name__,
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


def _average(members: Sequence[Model], weights: np.ndarray) -> Committee:
    """The committee of members of the same channels, its weights as precise as their arrays."""
    kind = jnp.result_type(jnp.float32, *map(jnp.asarray, jax.tree.leaves(members)))
    return Committee(tuple(members), jnp.asarray(weights, kind), members[0].channels)


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
        return _average(members, weights)

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
