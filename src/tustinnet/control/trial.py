"""Trials of a design: closed loops on plants that differ from its model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.control.closed_loop import ClosedLoopResult, closed_loop
from tustinnet.control.design import ControlDesign
from tustinnet.control.export.compiled import compile_loop
from tustinnet.control.mpc import make_controller
from tustinnet.control.robustness import Robustness, assess_robustness, draw_starts
from tustinnet.control.sampled_plant import PlantOptions, SampledPlant
from tustinnet.control.variants import VariantKind, make_variants
from tustinnet.models.contract import Model
from tustinnet.simulate.range import Range
from tustinnet.store.header import doubt_in_header

_START_SPREAD = 0.05  # of the places where runs begin: share of the range; of an angle at most rad
_START_WINDOWS = 2.0  # of these places in windows of the goal, where its point is not unstable


@dataclass(frozen=True)
class Trial:
    """Closed loops of a design.

    Attributes:
        robustness: what became of the goal on plants of every kind.
        runs: a whole run on a plant of each kind, by its name; where runs fail the first of these,
            else along a reference one that begins where that does.
        main_runs: the runs on the model and on other plants among them.
    """

    robustness: Robustness
    runs: Mapping[str, ClosedLoopResult]
    main_runs: Mapping[str, ClosedLoopResult]


def try_design(
    design: ControlDesign,
    header: Mapping[str, Any] | None = None,
    *,
    plants: Mapping[str, SampledPlant] | None = None,
    candidates: Sequence[Model] = (),
    variants: bool = True,
    count: int = 20,
    seed: int = 0,
) -> Trial:
    """Plays a controller on variants of its model, and on other plants.

    Controller and estimator are played by their code in C, which is what drives the machine later;
    in Python, which takes longer, where no compiler is there.

    The delay of the task is in the variants, and known to the estimator; other plants have their
    own.

    Args:
        design: the controller.
        header: the header of the model's file, with the errors of its parameters.
        plants: other plants by name.
        candidates: other models of the same records, see `make_variants`.
        variants: whether variants of the model are played.
        count: runs on the plants of each kind.
        seed: of all draws.
    """
    kinds = list(
        make_variants(
            design.model,
            design.noise,
            header,
            count=count,
            seed=seed,
            options=PlantOptions(delay=design.task.delay),
            candidates=candidates,
            has_records=design.consistency is not None,
        )
        if variants
        else ()
    )
    others = {f"plant {name}": plant for name, plant in (plants or {}).items()}
    kinds += [
        VariantKind(name, "another plant than the model", (plant,) * count, allowed=True)
        for name, plant in others.items()
    ]
    training_range = None if header is None else Range.from_header(dict(header), design.model)
    places = draw_starts(design.first_positions, _spread(design, training_range), count, seed)
    places = _within_limits(design, places)
    controller, estimator = compile_loop(design.controller, design.estimated, design.noise)
    robustness = assess_robustness(
        kinds, controller, estimator, places, design.goal, design.steps, seed
    )
    if variants and design.plan is None:
        held = replace(design.feedback, gain=np.zeros_like(design.feedback.gain))
        (row,) = assess_robustness(
            kinds[:1], make_controller(held), estimator, places, design.goal, design.steps, seed
        ).rows
        robustness = replace(robustness, without=row)
    robustness = replace(robustness, doubt=doubt_in_header(header or {}))
    runs = {}
    for kind, row in zip(kinds, robustness.rows, strict=True):
        failed = [i for i, outcome in enumerate(row.outcomes) if not outcome.is_success]
        i = failed[0] if failed else 0
        follows = design.task.reference is not None and not failed
        runs[kind.name] = closed_loop(
            kind.plants[i],
            controller,
            estimator,
            design.steps,
            design.first_positions if follows else places[i],
            seed + i,
            design.goal,
            design.model.channels,
        )
    main = ([kinds[0].name] if variants else []) + [*others]
    return Trial(robustness, runs, {name: runs[name] for name in main})


def _spread(design: ControlDesign, training_range: Range | None) -> Float[np.ndarray, " n_q"]:
    """Largest distances of a run's beginning from where it is designed for, by coordinate."""
    channels = design.model.channels
    spread = (
        np.full(channels.n_q, _START_SPREAD)
        if training_range is None
        else training_range.share_of_spans(_START_SPREAD, channels, _START_SPREAD)
    )
    if design.plan is None and not design.point.is_unstable:
        # within its window such a point needs no feedback to be held
        windows = [design.goal.window.get(c.name, 0.0) for c in channels.coordinates]
        spread = np.maximum(spread, _START_WINDOWS * np.array(windows))
    return spread


def _within_limits(
    design: ControlDesign, places: Float[np.ndarray, "count n_q"]
) -> Float[np.ndarray, "count n_q"]:
    """Positions, those beyond the limits of the goal moved onto these."""
    free = (-np.inf, np.inf)
    names = [c.name for c in design.model.channels.coordinates]
    low, high = np.transpose([design.goal.limits.get(name, free) for name in names])
    return np.clip(places, low, high)
