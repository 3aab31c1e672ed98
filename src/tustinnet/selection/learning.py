"""Learning curves: accuracy on records left out, against the number of those fitted to.

In every draw one fold is left out and scored; of the other records, in an order drawn at random,
the first 2, 4, 8, ... are all that anything is made from: the model, the physics that a network
corrects, and the twin that a network is pre-trained on.
"""

import statistics
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.fits.preparation import PreparationOptions, prepare_records
from tustinnet.fitting.fit import MakeListener
from tustinnet.fitting.listener import SILENT
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.recipe_reading import is_published, read_recipe
from tustinnet.fitting.roles import Roles, records_without_test
from tustinnet.fitting.task import AnyRecipe
from tustinnet.models.contract import Model, require_float64
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.selection.cross_validation import (
    CrossValidationOptions,
    make_cross_validation_options,
)
from tustinnet.selection.folds import FOLDS, FoldSplit, split_into_folds
from tustinnet.selection.jobs import Job, JobResult, RunContext, perform_jobs
from tustinnet.selection.scoring import RecipeScorer
from tustinnet.simulate.starts import default_start, start_named
from tustinnet.systems.files import AnySystem, SystemTemplate
from tustinnet.systems.twin import imitate_records

ENOUGH = 1.1  # times the error that the most records leave
FEWEST = 2  # records: one may have to choose the epoch that is kept
_CHOOSING = 4  # one in so many records chooses, where a recipe asks for that
_SIMULATED = 16  # records of a twin
_SUBSTEPS = 10  # integration steps in a period of a twin with nominal values
NETWORK, PHYSICS, HYBRID, PRETRAINED = "network", "grey box", "hybrid", "pre-trained"

Twin = Literal["identified", "nominal"]


@dataclass(frozen=True)
class LearningCurveOptions:
    """Recipes, numbers of records and draws of a learning curve.

    Attributes:
        network: the recipe of a network by itself.
        hybrid: the recipe of a network that corrects physics, with the recipe that identifies
            this and its system; None where no system is given.
        sizes: numbers of records, rising; () for 2, 4, 8, ... and all there are.
        draws: how often records are drawn; each has a seed of its own.
        twin: the values of the twin that networks are pre-trained on: those identified from the
            same records, or the system's nominal ones.
        start: where free runs start, None for the default start.
    """

    network: Recipe
    hybrid: CrossValidationOptions | None = None
    sizes: tuple[int, ...] = ()
    draws: int = 3
    twin: Twin = "identified"
    start: str | None = None


def make_learning_curve_options(
    network: AnyRecipe,
    hybrid: CrossValidationOptions | None = None,
    sizes: Sequence[int] = (),
    *,
    draws: int = 3,
    twin: Twin = "identified",
    start: str | None = None,
) -> LearningCurveOptions:
    """Options of a learning curve, checked.

    Args:
        network: the recipe of a network by itself.
        hybrid: the recipes of a hybrid and its physics, and the system.
        sizes: numbers of records.
        draws: how often records are drawn.
        twin: the values of the twin that networks are pre-trained on.
        start: where free runs start.

    Raises:
        InputError: a recipe that is no network's, sizes that do not rise, an unknown start.
    """
    network = read_recipe(network)
    if network.family.needs:
        raise InputError(
            f"recipe '{network.name}'",
            f"kind '{network.family.kind}'",
            "the recipe of a network by itself",
            "physics are drawn with `system=`",
        )
    make_cross_validation_options(network)  # checks its rates
    if sizes and (len(sizes) < 2 or sorted(set(sizes)) != list(sizes) or sizes[0] < FEWEST):
        raise InputError(
            "`records=`",
            ",".join(map(str, sizes)),
            f"two or more rising numbers from {FEWEST} on",
            "for instance `records=` 2,4,8",
        )
    if start is not None:
        start_named(start)
    if twin == "nominal" and hybrid and isinstance(hybrid.system, SystemTemplate):
        raise InputError(
            "`twin=`", f"'nominal', of which '{hybrid.system.name}' has none", "'identified'"
        )
    return LearningCurveOptions(network, hybrid, tuple(sizes), draws, twin, start)


@dataclass(frozen=True)
class Draw:
    """Some records of a draw, which models are made from.

    Attributes:
        number: which draw, from 0; also the seed.
        size: how many records.
        records: the records.
        scored: the records that are left out.
    """

    number: int
    size: int
    records: tuple[Experiment, ...]
    scored: tuple[Experiment, ...]

    @property
    def split(self) -> FoldSplit:
        """The split of the records: where a recipe has validation choose, one in four does."""
        chooses = max(1, self.size // _CHOOSING)
        return FoldSplit(self.scored, Roles(self.records[:-chooses], self.records[-chooses:]))


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


def draw_records(data: DataSet, options: LearningCurveOptions) -> list[Draw]:
    """Every draw with every number of records; records of the split `test` take part in nothing.

    Raises:
        InputError: too few records.
    """
    count = len(records_without_test(data))
    splits = split_into_folds(data, FOLDS) if count >= FOLDS else []
    most = min((len(s.roles.all) for s in splits), default=0)
    sizes = options.sizes
    if not sizes and most >= FEWEST:  # 2, 4, 8, ... and all there are
        doubled = [FEWEST]
        while 2 * doubled[-1] <= most:
            doubled.append(2 * doubled[-1])
        sizes = tuple(dict.fromkeys([*doubled, most]))
    if len(sizes) < 2 or sizes[-1] > most:
        needed = sizes[-1] if len(sizes) > 1 else 2 * FEWEST
        raise InputError(
            data.name,
            f"{count} records, of which {most} remain in each draw",
            f"{needed} that remain",
            "record more, or request fewer: `records=` 2,4",
        )
    draws = []
    for number in range(options.draws):
        split = splits[number % len(splits)]
        order = np.random.default_rng(number).permutation(len(split.roles.all))
        records = [split.roles.all[i] for i in order]
        draws += [Draw(number, n, tuple(records[:n]), split.scored) for n in sizes]
    return draws


@dataclass(frozen=True)
class DrawResult:
    """The model of a draw.

    Attributes:
        model: the model, None where there is none.
        outcome: why the fit ended, or why there is no model.
        rmse: RMSE of the free run of each record that was left out [rad or m].
    """

    model: Model | None
    outcome: str
    rmse: dict[str, float]


class DrawFitter:
    """Fits recipes to draws of records, and scores the records that were left out.

    Args:
        data: the records.
        start: where free runs start; a model with a warm-up starts with its own.
        make_listener: given the plan of trainings that run together, or the task of an
            identification, returns the listener of its progress.
    """

    def __init__(
        self,
        data: DataSet,
        start: str,
        make_listener: MakeListener = lambda prepared: SILENT,
    ) -> None:
        self._data, self._make_listener = data, make_listener
        self._scoring = RecipeScorer(0, start, names=(start,), warm_up=True)

    def train(
        self,
        draws: Sequence[Draw],
        recipe: Recipe,
        *,
        physics: Sequence[Model | None] | None = None,
        origins: Sequence[Model | None] | None = None,
    ) -> list[DrawResult]:
        """Trains a network for every draw, those of as many records together where they can be.

        Those of fewer records have fewer windows, and what trains together has as many windows as
        the one with the fewest.

        Args:
            draws: the records of each.
            recipe: the recipe.
            physics: the model that each corrects; a draw without has no model, where others have
                one.
            origins: the model that each begins with, likewise.
        """
        results = [DrawResult(None, "no physics to begin with", {})] * len(draws)
        for size in dict.fromkeys(draw.size for draw in draws):
            rows = [
                i
                for i, draw in enumerate(draws)
                if draw.size == size
                and all(models is None or models[i] is not None for models in (physics, origins))
            ]
            part = self._fit(
                [draws[i] for i in rows],
                recipe,
                together=True,
                physics=None if physics is None else [physics[i] for i in rows],
                origins=None if origins is None else [origins[i] for i in rows],
            )
            for i, result in zip(rows, part, strict=True):
                results[i] = result
        return results

    def identify(
        self, draws: Sequence[Draw], recipe: Recipe, system: AnySystem | SystemTemplate | None
    ) -> list[DrawResult]:
        """Identifies the physics of every draw, by itself: where one fails, others need not."""
        return self._fit(draws, recipe, together=False, system=system)

    def _fit(
        self,
        draws: Sequence[Draw],
        recipe: Recipe,
        *,
        together: bool,
        physics: Sequence[Model | None] | None = None,
        origins: Sequence[Model | None] | None = None,
        system: AnySystem | SystemTemplate | None = None,
    ) -> list[DrawResult]:
        models: dict[str, Model] = {}
        jobs = []
        for i, draw in enumerate(draws):
            names: dict[str, str] = {}
            for role, given in (("physics", physics), ("origin", origins)):
                model = None if given is None else given[i]
                if model is not None:
                    names[role] = f"{role} {i}"
                    models[names[role]] = model
            seeds = (draw.number,) if together else (0,)
            jobs.append(
                Job(
                    recipe.name,
                    recipe,
                    i,
                    seeds,
                    physics=names.get("physics"),
                    origin=names.get("origin"),
                )
            )
        context = RunContext(
            self._data,
            self._scoring,
            models=models,
            system=system,
            drawn=tuple(draw.split for draw in draws),
        )

        def perform(jobs: Sequence[Job]) -> list[JobResult]:
            return perform_jobs(jobs, context, self._make_listener, raises=together)

        done = perform(jobs) if together and jobs else [r for job in jobs for r in perform([job])]
        results = []
        for result in done:
            if not result.scores:
                results.append(DrawResult(None, result.why, {}))
                continue
            (score,) = result.scores
            rmse = next(iter(score.rmse.values()), {})
            results.append(DrawResult(models[score.model], score.outcome, rmse))
        return results


def learning_curve(
    data: DataSet,
    options: LearningCurveOptions,
    make_listener: MakeListener = lambda prepared: SILENT,
    on_message: Callable[[str], None] = lambda sentence: None,
) -> LearningCurve:
    """Fits models to more and more records and scores records that none of them has seen.

    Args:
        data: the records.
        options: the recipes, the draws.
        make_listener: given the plan of trainings that run together, or the task of an
            identification, returns the listener of its progress.
        on_message: called with sentences on the holds and delays of inputs, which are searched for
            once where the data card does not declare them.

    Raises:
        InputError: too few records; see also `fit`. A single identification that cannot be done
            with so few records is a point without a model, and its outcome says why.
    """
    require_float64("learning_curve")
    draw_records(data, options)  # raises before time is spent on the preparation
    preparation = PreparationOptions(
        system=None if options.hybrid is None else options.hybrid.system,
        finds_timing=not is_published(options.network),
        on_message=on_message,
    )
    data = prepare_records(data, preparation).data
    draws = draw_records(data, options)
    start = options.start or default_start(list(data))
    fitter = DrawFitter(data, start, make_listener)
    points = make_points(NETWORK, draws, fitter.train(draws, options.network))
    if options.hybrid is not None:
        assert options.hybrid.physics is not None
        results = fitter.identify(draws, options.hybrid.physics, options.hybrid.system)
        points += make_points(PHYSICS, draws, results)
        physics = [result.model for result in results]
        hybrids = fitter.train(draws, options.hybrid.recipe, physics=physics)
        points += make_points(HYBRID, draws, hybrids)
        twins = _simulate_twins(draws, physics, options)
        pretrained = fitter.train([t for t in twins if t is not None], options.network)
        models = iter(pretrained)
        origins = [None if twin is None else next(models).model for twin in twins]
        results = fitter.train(draws, options.network, origins=origins)
        points += make_points(PRETRAINED, draws, results)
    sizes = tuple(dict.fromkeys(draw.size for draw in draws))
    scored = tuple(len(draw.scored) for draw in draws if draw.size == sizes[0])
    return LearningCurve(data.channels.unit, start, sizes, tuple(points), scored)


def _simulate_twins(
    draws: Sequence[Draw], physics: Sequence[Model | None], options: LearningCurveOptions
) -> list[Draw | None]:
    """Records that the physics of every draw simulates, in place of the draw's own."""
    twins: list[Draw | None] = []
    for draw, identified in zip(draws, physics, strict=True):
        model = identified
        if options.twin == "nominal":
            assert options.hybrid is not None
            system, like = options.hybrid.system, draw.records[0]
            assert isinstance(system, LagrangianSystem)  # others were refused
            values = {name: jnp.asarray(x, jnp.float64) for name, x in system.nominal().items()}
            model = discretise(system.model(values), like.dt, _SUBSTEPS, inputs=like.inputs)
        generator = np.random.default_rng([draw.number, draw.size])
        records: tuple[Experiment, ...] = ()
        if model is not None:
            assert isinstance(model, Discretised)
            with suppress(InputError):  # a simulation that diverges
                records = imitate_records(model, draw.records, _SIMULATED, generator)
        enough = len(records) >= FEWEST
        twins.append(Draw(draw.number, len(records), records, ()) if enough else None)
    return twins


def make_points(
    approach: str, draws: Sequence[Draw], results: Sequence[DrawResult]
) -> list[LearningPoint]:
    """The points of an approach.

    Args:
        approach: its name.
        draws: the records of each point.
        results: the model of each point.
    """
    return [
        LearningPoint(
            approach,
            draw.number,
            draw.size,
            float(np.mean(list(result.rmse.values()))) if result.model is not None else np.inf,
            result.outcome,
        )
        for draw, result in zip(draws, results, strict=True)
    ]
