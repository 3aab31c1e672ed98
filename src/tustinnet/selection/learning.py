"""Learning curves: accuracy on records left out, against the number of those fitted to.

In every draw one fold is left out and scored; of the other records, in an order drawn at random,
the first 2, 4, 8, ... are all that anything is made from: the model, and the physics that it
corrects.
"""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.roles import Roles, records_without_test
from tustinnet.models.contract import require_float64
from tustinnet.selection.cross_validation import (
    RECIPE,
    CrossValidationOptions,
    fit_splits,
    prepare_for_validation,
)
from tustinnet.selection.folds import FoldSplit, split_into_folds, usual_folds
from tustinnet.selection.jobs import Job, RunContext
from tustinnet.selection.runner import Workplace
from tustinnet.selection.scoring import RecipeScorer
from tustinnet.simulate.starts import default_start

ENOUGH = 1.1  # times the error that the most records leave
FEWEST = 2  # records: one may have to choose the epoch that is kept
_CHOOSING = 4  # one in so many records chooses, where a recipe asks for that
DRAWS = 3  # by default


@dataclass(frozen=True)
class LearningPoint:
    """The accuracy of an approach with some records.

    Attributes:
        approach: the way to a model.
        draw: the draw of the records.
        size: how many.
        rmse: mean free-run RMSE of the records left out [rad or m]; infinite without a model.
        outcome: why the fit ended.
    """

    approach: str
    draw: int
    size: int
    rmse: float
    outcome: str


@dataclass(frozen=True)
class EnoughRecords:
    """The number of records that are enough for an approach.

    Attributes:
        records: the median over the draws; None where the error still falls at the most records.
        by_draw: of each draw.
        gain: what the last step of the curve took from the error, 0..1, median over the draws.
    """

    records: int | None
    by_draw: tuple[int, ...]
    gain: float


@dataclass(frozen=True)
class LearningCurve:
    """Accuracy against the number of records.

    Attributes:
        unit: of the RMSE.
        start: where the free runs started.
        sizes: the numbers of records.
        points: of every approach, draw and size.
        scored: how many records were left out in each draw.
    """

    unit: str
    start: str
    sizes: tuple[int, ...]
    points: tuple[LearningPoint, ...]
    scored: tuple[int, ...]

    @property
    def approaches(self) -> tuple[str, ...]:
        """The approaches, in order."""
        return tuple(dict.fromkeys(p.approach for p in self.points))

    def by_draw(self, approach: str, size: int) -> list[float]:
        """RMSE of each draw [rad or m]."""
        points = [p for p in self.points if (p.approach, p.size) == (approach, size)]
        return [p.rmse for p in sorted(points, key=lambda p: p.draw)]

    def find_enough(self, approach: str) -> EnoughRecords:
        """From how many records on a draw is within 10 % of what the most records give."""
        draws = list(zip(*(self.by_draw(approach, size) for size in self.sizes), strict=True))
        enough, gains = [], []
        for errors in draws:
            goal = ENOUGH * errors[-1] if errors[-1] < np.inf else -np.inf
            short = [k for k, error in enumerate(errors) if not error <= goal]
            enough.append(self.sizes[min(max(short, default=-1) + 1, len(errors) - 1)])
            before, last = errors[-2:]
            gains.append(1 - last / before if 0 < before < np.inf else float(last < np.inf))
        middle = statistics.median_high(enough)
        records = None if middle == self.sizes[-1] else middle
        return EnoughRecords(records, tuple(enough), statistics.median(gains))

    def sentence(self, approach: str) -> str:
        """A sentence on the number of records that are enough for an approach."""
        enough, most = self.find_enough(approach), self.sizes[-1]
        draws = f"{len(enough.by_draw)} draws: {min(enough.by_draw)} to {max(enough.by_draw)}"
        if enough.records is not None:
            return (
                f"{approach}: {enough.records} records are enough ({draws}): the error is within "
                f"{100 * (ENOUGH - 1):.0f} % of what {most} leave"
            )
        gain = f"from {self.sizes[-2]} to {most} records the error falls by {100 * enough.gain:.0f}"
        return f"{approach}: {most} records are not known to be enough ({draws}): {gain} %"

    def as_plain(self) -> dict[str, Any]:
        """The curve as plain values."""
        return {
            "unit": self.unit,
            "start": self.start,
            "sizes": list(self.sizes),
            "left_out": list(self.scored),
            "points": [vars(p) for p in self.points],
            "enough": {
                approach: {**vars(self.find_enough(approach)), "told": self.sentence(approach)}
                for approach in self.approaches
            },
        }


def draw_records(
    data: DataSet, sizes: Sequence[int], draws: int, folds: int | None
) -> dict[int, list[FoldSplit]]:
    """The draws of every number of records; records of the split `test` take part in nothing.

    Where a recipe has validation choose, one record in four does.

    Args:
        data: the records.
        sizes: numbers of records, rising; none for 2, 4, 8, ... and all there are.
        draws: how often records are drawn.
        folds: of which each draw leaves one out; by default 5, or as many as there are records.

    Raises:
        InputError: numbers that do not rise, or too few records.
    """
    if sizes and (len(sizes) < 2 or sorted(set(sizes)) != list(sizes) or sizes[0] < FEWEST):
        raise InputError(
            "`records=`",
            ",".join(map(str, sizes)),
            f"two or more rising numbers from {FEWEST} on",
            "for instance `records=` 2,4,8",
        )
    count = len(records_without_test(data))
    folds = folds or usual_folds(count)
    splits = split_into_folds(data, folds) if count >= folds else []
    most = min((len(s.roles.all) for s in splits), default=0)
    if not sizes and most >= FEWEST:
        doubled = (FEWEST * 2**k for k in range(most.bit_length()))
        sizes = [*(size for size in doubled if size < most), most]
    if len(sizes) < 2 or sizes[-1] > most:
        needed = sizes[-1] if len(sizes) > 1 else 2 * FEWEST
        raise InputError(
            data.name,
            f"{count} records, of which {most} remain in each draw",
            f"{needed} that remain",
            "record more, or request fewer: `records=` 2,4",
        )
    drawn: dict[int, list[FoldSplit]] = {size: [] for size in sizes}
    for number in range(draws):
        split = splits[number % len(splits)]
        order = np.random.default_rng(number).permutation(len(split.roles.all))
        records = [split.roles.all[i] for i in order]
        for size, of_size in drawn.items():
            train = size - max(1, size // _CHOOSING)
            roles = Roles(tuple(records[:train]), tuple(records[train:size]))
            of_size.append(FoldSplit(split.scored, roles))
    return drawn


def learning_curve(
    data: DataSet,
    options: CrossValidationOptions,
    sizes: Sequence[int] = (),
    draws: int = DRAWS,
    listener: Listener = SILENT,
) -> LearningCurve:
    """Fits a recipe to more and more records and scores records that no model has seen.

    Models of as many records train together. The seed is that of the draw.

    Args:
        data: the records.
        options: the recipe, the folds of which one is left out, and where free runs start.
        sizes: numbers of records; by default 2, 4, 8, ... and all there are.
        draws: how often records are drawn.
        listener: as for `cross_validate`.

    Raises:
        InputError: too few records, or no fit has a model. A single one that cannot be done with
            so few records is a point without a model, and its outcome says why.
    """
    require_float64("learning_curve")
    draw_records(data, sizes, draws, options.folds)  # raises before time is spent
    data = prepare_for_validation(data, options, listener)
    start = next(iter(options.starts), None) or default_start(list(data))
    recipe, points = options.recipe, list[LearningPoint]()
    drawn = draw_records(data, sizes, draws, options.folds)
    for size, splits in drawn.items():
        context = RunContext(
            data,
            RecipeScorer(0, start, names=(start,), warm_up=True),
            models={},
            system=options.system,
            drawn=tuple(splits),
        )
        jobs = [Job(RECIPE, recipe, i, recipe.family.select_seeds([i])) for i in range(draws)]
        results = fit_splits(options, jobs, context, Workplace(None, lambda job: listener))
        for i in range(draws):
            result = [r for r in results if r.fold == i][-1]  # of the physics where that failed
            rmse, outcome = np.inf, result.why
            if result.scores and result.candidate == RECIPE:
                (score,) = result.scores
                (by_record,) = score.rmse.values()
                rmse, outcome = float(np.mean([*by_record.values()])), score.outcome
            points.append(LearningPoint(recipe.name, i, size, rmse, outcome))
    if not any(point.rmse < np.inf for point in points):
        raise InputError(recipe.name, f"no model of any draw: {points[-1].outcome}", "a fit")
    scored = tuple(len(split.scored) for split in next(iter(drawn.values())))
    return LearningCurve(data.channels.unit, start, tuple(drawn), tuple(points), scored)
