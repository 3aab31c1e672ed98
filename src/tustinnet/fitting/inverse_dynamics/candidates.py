"""Forces that a system may lack, of which folds that were left out decide.

Each is fitted together with all that is there already. It is kept where the forces of folds that
were left out are explained clearly better.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.inspection import rotating_coordinates
from tustinnet.fitting.inverse_dynamics.linear_forces import (
    LinearForces,
    levels_of,
    parse_candidates,
)
from tustinnet.fitting.inverse_dynamics.solver import (
    coordinates_of,
    folds_to_leave_out,
    left_out_squares,
    solve,
)
from tustinnet.fitting.inverse_dynamics.sums import Columns, sum_up
from tustinnet.fitting.shooting.added_forces import force_parameters
from tustinnet.fitting.shooting.space import ParameterVector
from tustinnet.models.added import PlacedForce
from tustinnet.models.forces import LAWS, AddedInertia, ForceWithMemory, Friction

_GAIN = 0.01  # least fall of the left-out forces for which one is kept
_COUPLED = 0.1  # fall at both joints for which a motor that turns with both is kept
_OF_MOTORS = ("armature", "viscous")  # of a motor at two joints, beside the frictions of others


class Trial(NamedTuple):
    """A force that was tried.

    Attributes:
        name: its name, or that of a motor that turns with two coordinates.
        before: forces of left-out folds that were missing without it, by those of the actuators,
            the mean of the joints.
        after: the same with it.
        is_kept: whether it is kept.
    """

    name: str
    before: float
    after: float
    is_kept: bool


@dataclass(frozen=True)
class Choice:
    """Forces, and how well they explain those of held-out folds (records, or pieces of them).

    Attributes:
        forces: the forces.
        vector: the parameters that explain all folds best.
        columns: the forces of each record, linear about these parameters.
        folds: the folds that were held out, one after the other.
        squares: sums of squares of the forces that are missing at each joint in each of these,
            (f, n_q).
        sizes: sums of squares of the sizes of the forces at each joint in all of these.
        trials: the forces that were tried so far, and the motors that were kept.
    """

    forces: LinearForces
    vector: ParameterVector
    columns: list[Columns]
    folds: Sequence[int]
    squares: Float[np.ndarray, "f n_q"]
    sizes: Float[np.ndarray, " n_q"]
    trials: tuple[Trial, ...] = ()

    @property
    def share(self) -> float:
        """Left-out forces that are missing by those of the actuators, the mean of the joints."""
        shares = np.sqrt(self.squares.sum(axis=0) / self.sizes)
        return float(np.mean(shares[self.is_driven]))

    @property
    def is_driven(self) -> Bool[np.ndarray, " n_q"]:
        """Which joints have actuators; all where none has."""
        driven = np.any(np.stack([own.applied.any(axis=0) for own in self.columns]), axis=0)
        return driven if driven.any() else ~driven

    def fall_from(self, before: "Choice") -> Float[np.ndarray, " n_q"]:
        """Share by which the forces that are missing at each joint fall from another choice."""
        return 1 - np.sqrt(self.squares.sum(axis=0) / before.squares.sum(axis=0))

    def is_clearly_better(self, before: "Choice") -> bool:
        """Whether left-out forces fall on the mean of the joints, by more than folds disagree."""
        falls = -np.mean(np.log(self.squares / before.squares)[:, self.is_driven], axis=1) / 2
        return bool(falls.mean() > max(_GAIN, falls.std(ddof=1) / np.sqrt(len(falls))))


def choose_forces(
    forces: LinearForces,
    vector: ParameterVector,
    columns: list[Columns],
    names: Sequence[str],
    should_stop: Callable[[], bool],
) -> Choice:
    """Adds the forces of some names that left-out folds ask for.

    Args:
        forces: the forces so far.
        vector: the parameters that explain them best.
        columns: the forces of each record, linear about these.
        names: names of forces, `LAW` for all coordinates that move, see `parse_candidates`. The law
            `armature` is tried as a motor that turns with two coordinates.
        should_stop: asked before each trial.
    """
    choice = _evaluate(forces, vector, columns)
    offers = _Offers(forces, names)
    for name, places in offers.by_name.items():
        if should_stop():
            break
        if not places:
            choice = _try_motors(choice, offers, should_stop)
            continue
        trial = offers.added_to(choice, places)
        choice = _noted(choice, trial, name, is_kept=trial.is_clearly_better(choice))
    return choice


class _Offers:
    """Forces that may be added, with their parameters.

    Attributes:
        by_name: the forces of each name; none of a motor at two coordinates.
    """

    def __init__(self, forces: LinearForces, names: Sequence[str]) -> None:
        system, records = forces.system, [part.record for part in forces.parts]
        moves = np.any([np.ptp(part.q, axis=0) > 0 for part in forces.parts], axis=0)
        moving = [c for c, does in zip(system.coordinates, moves, strict=True) if does]
        around, self.by_name = rotating_coordinates(records), dict[str, list[PlacedForce]]()
        for name in names:
            (first, *_) = parse_candidates(system, [name])
            law = first.law
            if isinstance(law, AddedInertia) and ":" not in name:
                self.by_name[name] = []
                continue
            if isinstance(law, Friction) and law.needs_load and system.potential is None:
                continue
            free = [c.name for c in moving if not (law.needs_limited_travel and c.name in around)]
            places = [name] if ":" in name else [f"{law.name}:{place}" for place in free]
            if new := [f for f in parse_candidates(system, places) if _is_new(f, forces)]:
                self.by_name[name] = new
        alike = [(a, b) for a, b in itertools.combinations(moving, 2) if a.kind == b.kind]
        pairs = alike if "armature" in self.by_name else ()
        frictions = [name for name in self.by_name if name in LAWS and _is_of_motors(name)]
        self.motors = {
            f"{a.name}{sign}{b.name}": parse_candidates(
                system, [f"{law}:{a.name}{sign}{b.name}" for law in (*_OF_MOTORS, *frictions)]
            )
            for a, b in pairs
            for sign in "+-"
        }
        every = [f for group in (*self.by_name.values(), *self.motors.values()) for f in group]
        self.parameters = {p.name: p for p in force_parameters(system, every, records, {})}

    def motor(self, channel: str, choice: Choice) -> list[PlacedForce]:
        """A motor at two coordinates, with the frictions that were kept at single ones."""
        kept = {t.name for t in choice.trials if t.is_kept} | {*_OF_MOTORS}
        return [f for f in self.motors[channel] if f.law.name in kept]

    def beside(self, choice: Choice, added: Sequence[PlacedForce]) -> LinearForces:
        """The forces of a choice with further ones."""
        space = choice.forces.space
        known = {*space.names, *space.fixed_values}
        brought = dict.fromkeys(name for force in added for name in force.brought)
        parameters = [self.parameters[name] for name in brought if name not in known]
        return choice.forces.with_forces(added, parameters)

    def added_to(self, choice: Choice, added: Sequence[PlacedForce]) -> Choice:
        """A choice with further forces; those that it has are not evaluated again."""
        forces = self.beside(choice, added)
        vector = _longer(choice, forces)
        further = forces.columns_beside(vector, added)
        columns = [own.followed_by(more) for own, more in zip(choice.columns, further, strict=True)]
        trial = _evaluate(forces, vector, columns, choice.folds)
        return replace(trial, trials=choice.trials)


def _longer(choice: Choice, forces: LinearForces) -> ParameterVector:
    """The parameters of a choice, then the nominal values of further ones."""
    return forces.space.to_vector(
        forces.space.nominal | choice.forces.space.to_values(choice.vector)
    )


def _evaluate(
    forces: LinearForces,
    vector: ParameterVector,
    columns: list[Columns],
    folds: Sequence[int] = (),
) -> Choice:
    """Forces fitted to all folds, and to all but each of some, by default of those that can be."""
    sums, prior = sum_up(columns), forces.prior
    solution = solve(sums, prior, vector)
    if not folds:
        folds = folds_to_leave_out(sums, prior, solution)
        # two tell whether folds disagree
        folds = folds if len(folds) > 1 else range(len(sums.counts))
    squares = left_out_squares(sums, prior, solution.vector, folds)
    sizes = sums.of_folds(folds).sizes.sum(axis=(0, 2))
    return Choice(forces, solution.vector, columns, folds, squares, sizes)


def _noted(before: Choice, after: Choice, name: str, *, is_kept: bool) -> Choice:
    """The choice after a trial."""
    trial = Trial(name, before.share, after.share, is_kept)
    return replace(after if is_kept else before, trials=(*before.trials, trial))


def _try_motors(choice: Choice, offers: _Offers, should_stop: Callable[[], bool]) -> Choice:
    """The choice with motors that turn with two coordinates, one after the other."""
    while not should_stop():
        kept: list[tuple[str, Choice]] = []
        for channel in _propose_motors(choice, offers):
            added = offers.motor(channel, choice)
            trial = offers.added_to(choice, added)
            both = [i for i, _ in added[0].places]
            if min(trial.fall_from(choice)[both]) > _COUPLED:
                kept.append((channel, trial))
        if not kept:
            break
        channel, best = min(kept, key=lambda pair: pair[1].share)
        choice = _noted(choice, best, f"armature:{channel}", is_kept=True)
    return choice


def _propose_motors(choice: Choice, offers: _Offers) -> list[str]:
    """The three pairs of coordinates whose missing forces motors of theirs explain best."""
    import scipy.optimize  # takes half a second, and what is not identified needs none of it

    coordinates = coordinates_of(choice.forces.space, choice.vector)
    missing = [own.slopes @ coordinates + own.rest for own in choice.columns]
    size, left = np.sqrt(np.mean(np.concatenate(missing) ** 2, axis=0)), dict[str, float]()
    for channel in offers.motors:
        added = offers.motor(channel, choice)
        if not all(_is_new(force, choice.forces) for force in added):
            continue
        forces = offers.beside(choice, added)
        columns = forces.columns_beside(_longer(choice, forces), added)
        rows = [
            np.c_[more[:, k], own[:, k]] / size[k]
            for more, own in zip(columns, missing, strict=True)
            for k, _ in added[0].places
        ]
        triangle: Any = np.linalg.qr(np.concatenate(rows), mode="r")
        left[channel] = scipy.optimize.nnls(triangle[:, :-1], -triangle[:, -1])[1]
    return sorted(left, key=lambda channel: left[channel])[:3]


def _is_of_motors(name: str) -> bool:
    """Whether a force is a friction that a motor at two coordinates may have as well."""
    law = LAWS[name]
    return isinstance(law, ForceWithMemory) or (isinstance(law, Friction) and not law.needs_load)


def _is_new(force: PlacedForce, forces: LinearForces) -> bool:
    """Whether forces have nothing of the levels of a further one."""
    return not {*levels_of(force)} & {*forces.system.nominal(), *forces.space.names}
