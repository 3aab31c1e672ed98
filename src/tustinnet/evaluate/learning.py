"""How much must be recorded: accuracy on records left out, against the number of those fitted to.

In every draw one fold is left out and scored; of the other records, in an order drawn at random,
the first 2, 4, 8, ... are all that anything is made from: the model, the physics that a network
corrects, and the twin that a network is pre-trained on.
"""

import statistics
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.folds import (
    FOLDS,
    Question,
    Tell,
    dealt,
    fitted,
    make_question,
    taking_part,
)
from tustinnet.evaluate.scores import evaluate, rmse_by_record
from tustinnet.fitting.gradient.plan import groups_alike
from tustinnet.fitting.listener import SILENT
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import AnyRecipe, Fold, Member, Origin, Task
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.simulate.horizon import effective_horizon
from tustinnet.simulate.starts import default_start, start_named
from tustinnet.systems.files import SystemTemplate
from tustinnet.systems.twin import imitate_records

ENOUGH = 1.1  # times the error that the most records leave
FEWEST = 2  # records: one may have to choose the epoch that is kept
_CHOOSING = 4  # one in so many records chooses, where a recipe asks for that
_SIMULATED = 16  # records of a twin
_SUBSTEPS = 10  # integration steps in a period of a twin with nominal values
NETWORK, PHYSICS, HYBRID, PRETRAINED = "network", "grey box", "hybrid", "pre-trained"

Twin = Literal["identified", "nominal"]


@dataclass(frozen=True)
class CurveQuestion:
    """What a learning curve is asked.

    Attributes:
        network: the recipe of a network by itself.
        hybrid: the recipe of a network that corrects physics, with the recipe that identifies
            this and its system; None where no system is given.
        sizes: numbers of records, rising; () for 2, 4, 8, ... and all there are.
        draws: how often records are drawn; each has a seed of its own.
        twin: the values of the twin that networks are pre-trained on: those identified from the
            same records, or the system's nominal ones.
        start: where free runs start, None for the usual start.
    """

    network: Recipe
    hybrid: Question | None = None
    sizes: tuple[int, ...] = ()
    draws: int = 3
    twin: Twin = "identified"
    start: str | None = None


def make_curve_question(
    network: AnyRecipe,
    hybrid: Question | None = None,
    sizes: Sequence[int] = (),
    **asked: Any,
) -> CurveQuestion:
    """What a learning curve is asked, checked.

    Args:
        network: the recipe of a network by itself.
        hybrid: as `CurveQuestion` has it.
        sizes: numbers of records.
        asked: `draws`, `twin` and `start` of a `CurveQuestion`.

    Raises:
        InputError: a recipe that is no network's, sizes that do not rise, an unknown start.
    """
    chosen = read_recipe(network)
    if not chosen.family.trains or chosen.family.needs:
        raise InputError(
            f"recipe '{chosen.name}'", f"kind '{chosen.family.kind}'",
            "the recipe of a network by itself", "physics are drawn with --system",
        )  # fmt: skip
    make_question(chosen)  # checks its rates
    if sizes and (len(sizes) < 2 or sorted(set(sizes)) != list(sizes) or sizes[0] < FEWEST):
        raise InputError(
            "--records", ",".join(map(str, sizes)), f"two or more rising numbers from {FEWEST} on",
            "for instance --records 2,4,8",
        )  # fmt: skip
    if (start := asked.get("start")) is not None:
        start_named(start)
    question = CurveQuestion(chosen, hybrid, tuple(sizes), **asked)
    if question.twin == "nominal" and hybrid and isinstance(hybrid.system, SystemTemplate):
        raise InputError("--twin", f"'nominal', of which '{hybrid.system.name}' has none",
                         "'identified'")  # fmt: skip
    return question


@dataclass(frozen=True)
class Place:
    """A point of the curve: a draw of records, and how many of them something is made from.

    Attributes:
        draw: which draw, from 0; also the seed.
        size: how many records.
        records: the records.
        scored: the records that are left out.
    """

    draw: int
    size: int
    records: tuple[Experiment, ...]
    scored: tuple[Experiment, ...]

    def roles(self, recipe: Recipe) -> Roles:
        """What the records are for: where a recipe has validation choose, one in four does."""
        if not recipe.needs_validation:
            return Roles(self.records, ())
        chooses = max(1, self.size // _CHOOSING)
        return Roles(self.records[:-chooses], self.records[-chooses:])


@dataclass(frozen=True)
class Point:
    """How a way to a model did with so many records.

    Attributes:
        approach: the way.
        draw: the draw of the records.
        size: how many.
        rmse: mean free-run RMSE of the records left out [rad or m]; infinite where nothing came.
        outcome: why the fit ended.
    """

    approach: str
    draw: int
    size: int
    rmse: float
    outcome: str


@dataclass(frozen=True)
class Needed:
    """How many records are enough for a way to a model.

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
        points: of every way to a model, draw and size.
        scored: how many records were left out in each draw.
    """

    unit: str
    start: str
    sizes: tuple[int, ...]
    points: tuple[Point, ...]
    scored: tuple[int, ...]

    @property
    def approaches(self) -> tuple[str, ...]:
        """The ways to a model, in order."""
        return tuple(dict.fromkeys(p.approach for p in self.points))

    def by_draw(self, approach: str, size: int) -> list[float]:
        """RMSE of each draw [rad or m]."""
        mine = [p for p in self.points if (p.approach, p.size) == (approach, size)]
        return [p.rmse for p in sorted(mine, key=lambda p: p.draw)]

    def needed(self, approach: str) -> Needed:
        """From how many records on a draw is within 10 % of what the most records give."""
        each = list(zip(*(self.by_draw(approach, size) for size in self.sizes), strict=True))
        enough = []
        for errors in each:
            goal = ENOUGH * errors[-1] if errors[-1] < np.inf else -np.inf
            short = [k for k, error in enumerate(errors) if not error <= goal]
            enough.append(self.sizes[min(max(short, default=-1) + 1, len(errors) - 1)])
        gain = statistics.median(
            1 - of[-1] / of[-2] if 0 < of[-2] < np.inf else float(of[-1] < np.inf) for of in each
        )
        middle = statistics.median_high(enough)
        return Needed(None if middle == self.sizes[-1] else middle, tuple(enough), gain)

    def told(self, approach: str) -> str:
        """The same as a sentence."""
        found, most = self.needed(approach), self.sizes[-1]
        draws = f"{len(found.by_draw)} draws: {min(found.by_draw)} to {max(found.by_draw)}"
        if found.records is not None:
            return (
                f"{approach}: {found.records} records are enough ({draws}): the error is within "
                f"{100 * (ENOUGH - 1):.0f} % of what {most} leave"
            )
        last = f"from {self.sizes[-2]} to {most} records the error falls by {100 * found.gain:.0f}"
        return f"{approach}: {most} records are not known to be enough ({draws}): {last} %"

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values."""
        return {
            "unit": self.unit,
            "start": self.start,
            "sizes": list(self.sizes),
            "left_out": list(self.scored),
            "points": [vars(p) for p in self.points],
            "enough": {
                approach: {**vars(self.needed(approach)), "told": self.told(approach)}
                for approach in self.approaches
            },
        }


def places_of(data: DataSet, asked: CurveQuestion) -> list[Place]:
    """Every draw with every number of records; records of the split `test` take part in nothing.

    Raises:
        InputError: too few records.
    """
    known = len(taking_part(data))
    deals = dealt(data, FOLDS) if known >= FOLDS else []
    most = min((len(d.roles.all) for d in deals), default=0)
    sizes = asked.sizes or _doubled(most)
    if len(sizes) < 2 or sizes[-1] > most:
        wanted = sizes[-1] if len(sizes) > 1 else 2 * FEWEST
        raise InputError(
            data.name, f"{known} records, of which {most} are left in each draw",
            f"{wanted} that are left", "record more, or ask for fewer: --records 2,4",
        )  # fmt: skip
    found = []
    for draw in range(asked.draws):
        deal = deals[draw % len(deals)]
        order = np.random.default_rng(draw).permutation(len(deal.roles.all))
        records = [deal.roles.all[i] for i in order]
        found += [Place(draw, n, tuple(records[:n]), deal.scored) for n in sizes]
    return found


def _doubled(most: int) -> tuple[int, ...]:
    """2, 4, 8, ... and all there are."""
    sizes = [FEWEST]
    while 2 * sizes[-1] <= most:
        sizes.append(2 * sizes[-1])
    return tuple(dict.fromkeys([*sizes, most])) if most >= FEWEST else ()


def learning_curve(
    data: DataSet, asked: CurveQuestion, tell: Tell = lambda task: SILENT
) -> LearningCurve:
    """Fits models to more and more records and scores records that none of them has seen.

    Args:
        data: the records.
        asked: what to fit, how often.
        tell: given the plan of trainings that run together, or the task of an identification,
            returns who is told while it goes on.

    Raises:
        InputError: too few records; see also `fit`. A single identification that cannot be done
            with so few records is a point without a model, and its outcome says why.
    """
    places = places_of(data, asked)
    start = asked.start or default_start(list(data))
    points = scored(NETWORK, places, trained(places, asked.network, tell=tell), start)
    if asked.hybrid is not None:
        physics = identified(places, asked.hybrid, tell)
        points += scored(PHYSICS, places, physics, start)
        known = [p.model if isinstance(p, FitResult) else None for p in physics]
        hybrids = trained(places, asked.hybrid.recipe, physics=known, tell=tell)
        points += scored(HYBRID, places, hybrids, start)
        twins = _twins(places, known, asked)
        begun = [t and Origin(t) for t in _pretrained(twins, asked.network, tell)]
        after = trained(places, asked.network, origins=begun, tell=tell)
        points += scored(PRETRAINED, places, after, start)
    sizes = tuple(dict.fromkeys(p.size for p in places))
    left_out = tuple(len(p.scored) for p in places if p.size == sizes[0])
    return LearningCurve(data.channels.unit, start, sizes, tuple(points), left_out)


Maybe = FitResult | str  # or why there is none


def trained(
    places: Sequence[Place],
    recipe: Recipe,
    *,
    physics: Sequence[Model | None] = (),
    origins: Sequence[Origin | None] = (),
    tell: Tell = lambda task: SILENT,
) -> list[Maybe]:
    """A network for every place, those of as many records trained together where they can be.

    Those of fewer records have fewer windows, and what trains together has as many windows as the
    one with the fewest.

    Args:
        places: the records of each.
        recipe: how.
        physics: what each corrects; a place without has no model, where others have one.
        origins: what each begins with, likewise.
        tell: as for `learning_curve`.
    """
    given = physics or origins
    can = [i for i in range(len(places)) if not given or given[i] is not None]
    found: list[Maybe] = ["no physics to begin with"] * len(places)
    for size in dict.fromkeys(places[i].size for i in can):
        these = [i for i in can if places[i].size == size]
        folds = tuple(
            Fold(
                places[i].roles(recipe),
                physics[i] if physics else None,
                origins[i] if origins else None,
            )
            for i in these
        )
        members = tuple(Member(places[i].draw, fold=f) for f, i in enumerate(these))
        task = Task(recipe, folds, members)
        for group in groups_alike(task):
            for result in fitted(task.with_members(group), tell):
                found[these[result.member.fold]] = result
    return found


def identified(places: Sequence[Place], asked: Question, tell: Tell) -> list[Maybe]:
    """The physics of every place, by itself: where one cannot be found, others can."""
    assert asked.physics is not None
    found: list[Maybe] = []
    for place in places:
        fold = Fold(place.roles(asked.physics))
        task = Task(asked.physics, (fold,), system=asked.system)
        try:
            found += fitted(task, tell)
        except InputError as error:
            found.append(str(error))
    return found


def _twins(
    places: Sequence[Place], physics: Sequence[Model | None], asked: CurveQuestion
) -> list[Place | None]:
    """Records that the physics of every place simulates, as that place's own."""
    found: list[Place | None] = []
    for place, model in zip(places, physics, strict=True):
        twin = _nominal(asked, place) if asked.twin == "nominal" else model
        generator = np.random.default_rng([place.draw, place.size])
        records: tuple[Experiment, ...] = ()
        if twin is not None:
            assert isinstance(twin, Discretised)
            with suppress(InputError):  # a simulation that leaves all numbers
                records = imitate_records(twin, place.records, _SIMULATED, generator)
        known = len(records) >= FEWEST
        found.append(Place(place.draw, len(records), records, ()) if known else None)
    return found


def _nominal(asked: CurveQuestion, place: Place) -> Discretised:
    """The system with its nominal values."""
    assert asked.hybrid is not None
    system, like = asked.hybrid.system, place.records[0]
    assert isinstance(system, LagrangianSystem)  # of others it was refused
    values = {name: jnp.asarray(x, jnp.float64) for name, x in system.nominal().items()}
    return discretise(system.model(values), like.dt, _SUBSTEPS, inputs=like.inputs)


def _pretrained(twins: Sequence[Place | None], recipe: Recipe, tell: Tell) -> list[Model | None]:
    """Networks trained on the records of twins."""
    known = [i for i, twin in enumerate(twins) if twin is not None]
    results = trained([twin for twin in twins if twin is not None], recipe, tell=tell)
    found: list[Model | None] = [None] * len(twins)
    for i, result in zip(known, results, strict=True):
        found[i] = result.model if isinstance(result, FitResult) else None
    return found


def scored(
    approach: str, places: Sequence[Place], results: Sequence[Maybe], start: str
) -> list[Point]:
    """The points of a way to a model.

    Args:
        approach: what it is called.
        places: the records of each point.
        results: what came of each, a fit or why there is none.
        start: where free runs start.
    """
    points = []
    for place, result in zip(places, results, strict=True):
        if isinstance(result, str):
            points.append(Point(approach, place.draw, place.size, np.inf, result))
            continue
        of = score_place(result, place.scored, start)
        rmse = float(np.mean(list(of.values())))
        points.append(Point(approach, place.draw, place.size, rmse, result.outcome))
    return points


def score_place(result: FitResult, scored: Sequence[Experiment], start: str) -> dict[str, float]:
    """RMSE of each record's free run [rad or m]; a model with a warm-up starts with its own."""
    begin = default_start(list(scored), result.model) if result.model.warm_up else start
    horizon = effective_horizon(result.horizon, scored)
    return rmse_by_record(evaluate(result.model, scored, begin, horizon=horizon))
