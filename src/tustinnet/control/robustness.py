"""Robustness of a controller: closed loops over variants of the model and many starts."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.control.closed_loop import Goal, Outcome, closed_loop
from tustinnet.control.controller import Controller
from tustinnet.control.estimator import Estimator
from tustinnet.control.variants import NOMINAL, VariantKind
from tustinnet.errors import InputError

Vector = Float[np.ndarray, " _"]


@dataclass(frozen=True)
class RobustnessRow:
    """Closed loops over the plants of one kind.

    Attributes:
        kind: the kind of variant.
        help: in which way its plants differ from the model.
        outcomes: what became of the goal from each start.
        allowed: whether the records allow its plants as well as the model.
    """

    kind: str
    help: str
    outcomes: tuple[Outcome, ...]
    allowed: bool = False

    @property
    def successes(self) -> int:
        """The number of runs that met the goal."""
        return sum(outcome.is_success for outcome in self.outcomes)

    @property
    def share(self) -> float:
        """The share of runs that met the goal, 0..1."""
        return self.successes / len(self.outcomes)

    @property
    def worst(self) -> Mapping[str, float]:
        """Largest distance from each position that is held, over all runs [rad or m]."""
        names = self.outcomes[0].worst
        return {name: max(outcome.worst[name] for outcome in self.outcomes) for name in names}

    @property
    def energy(self) -> float:
        """Mean over the runs of the energy of the inputs, see `Outcome.energy`."""
        return float(np.mean([outcome.energy for outcome in self.outcomes]))

    @property
    def time_to_reach(self) -> float | None:
        """Median over the successful runs of the time from which the goal is held [s]."""
        times = [o.time_to_reach for o in self.outcomes if o.time_to_reach is not None]
        return float(np.median(times)) if times else None

    def as_plain(self) -> dict[str, Any]:
        """The row as plain values, for JSON."""
        return {
            "kind": self.kind,
            "help": self.help,
            "runs": len(self.outcomes),
            "successes": self.successes,
            "worst": dict(self.worst),
            "energy": self.energy,
            "time_to_reach": self.time_to_reach,
            "failures": self.failures,
        }

    @property
    def failures(self) -> str:
        """The ways in which runs failed, the first in a sentence; "" where all met the goal."""
        failed = [outcome for outcome in self.outcomes if not outcome.is_success]
        if not failed:
            return ""
        counts = Counter(outcome.end for outcome in failed).most_common()
        return ", ".join(f"{n} {end}" for end, n in counts) + f" (first: {failed[0].sentence})"


@dataclass(frozen=True)
class Robustness:
    """The outcomes of a controller on plants that differ from its model.

    Attributes:
        goal: what it was to reach.
        rows: a row for each kind of variant.
        without: the same on the model with the inputs held instead, None where that is not known.
        doubt: why the records that judged the model speak against it, "" where they do not.
    """

    goal: Goal
    rows: tuple[RobustnessRow, ...]
    without: RobustnessRow | None = None
    doubt: str = ""

    def __getitem__(self, kind: str) -> RobustnessRow:
        """The row of a kind."""
        return next(row for row in self.rows if row.kind == kind)

    @property
    def share(self) -> float:
        """The share of all runs that met the goal, 0..1."""
        return float(np.mean([row.share for row in self.rows]))

    @property
    def worst_kind(self) -> RobustnessRow:
        """The row of which fewest runs met the goal."""
        return min(self.rows, key=lambda row: row.share)

    @property
    def problem(self) -> str:
        """Why nothing can be promised of the controller; "" where nothing speaks against it.

        That is where its model is worse than none, and where it fails on its own model, or on most
        of the plants that the records allow as well: it may hold nothing else than its model.
        """
        if self.doubt:
            return self.doubt
        for row in self.rows:
            # shares of runs that meet the goal, of which on the model itself only starts differ
            least = 0.9 if row.kind == NOMINAL else 0.5 if row.allowed else 0.0
            if row.share < least:
                return (
                    f"meets the goal in {row.successes} of {len(row.outcomes)} runs on {row.help}: "
                    f"{row.failures}"
                )
        return ""

    @property
    def sentence(self) -> str:
        """The verdict in a sentence."""
        worst, without = self.worst_kind, ""
        runs = sum(len(row.outcomes) for row in self.rows)
        if self.without is not None:
            held, count = self.without.successes, len(self.without.outcomes)
            without = (
                f"; without feedback, its inputs held, the model alone does in {held} of {count}"
                f"{', so that the runs say little of the feedback' if held == count else ''}"
            )
        if worst.share == 1:
            return f"all {runs} runs on plants of {len(self.rows)} kinds meet the goal{without}"
        return (
            f"{sum(row.successes for row in self.rows)} of {runs} runs meet the goal{without}; "
            f"fewest on plants of the kind '{worst.kind}' ({worst.help}): {worst.successes} of "
            f"{len(worst.outcomes)}, {worst.failures}"
        )


def draw_starts(
    centre: Sequence[float] | Vector,
    spread: float | Sequence[float] | Vector,
    count: int = 20,
    seed: int = 0,
) -> Float[np.ndarray, "count n_q"]:
    """Positions at rest, drawn evenly about a centre, from which runs start, (count, n_q).

    Args:
        centre: the centre, (n_q,) [rad or m].
        spread: the largest distance from it, (n_q,) or one for all.
        count: how many.
        seed: of the draw.
    """
    middle = np.asarray(centre, np.float64)
    return middle + spread * np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(middle)))


def assess_robustness(
    variants: Sequence[VariantKind],
    controller: Controller,
    estimator: Estimator,
    starts: Float[np.ndarray, "count n_q"],
    goal: Goal,
    steps: int,
    seed: int = 0,
) -> Robustness:
    """Plays a controller on all plants of all kinds, one from each start.

    Args:
        variants: the kinds of plants, as `make_variants` makes them.
        controller: the controller.
        estimator: the estimator.
        starts: positions at rest, (count, n_q), as many as there are plants of a kind.
        goal: what is to be reached and held.
        steps: periods of a run, see `closed_loop`.
        seed: of encoders and noise; each run has its own, the same one in every kind.

    Raises:
        InputError: another number of starts than of plants, or a goal of other coordinates.
    """
    rows = []
    for kind in variants:
        if len(kind.plants) != len(starts):
            raise InputError(
                "assess_robustness",
                f"{len(starts)} starts",
                f"as many as there are plants of the kind '{kind.name}', {len(kind.plants)}",
            )
        runs = (
            closed_loop(plant, controller, estimator, steps, start, seed + i, goal).outcome
            for i, (plant, start) in enumerate(zip(kind.plants, starts, strict=True))
        )
        outcomes = tuple(o for o in runs if o is not None)
        rows.append(RobustnessRow(kind.name, kind.help, outcomes, kind.allowed))
    return Robustness(goal, tuple(rows))
