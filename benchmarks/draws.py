"""Models of several draws of records, each with physics or a model to begin with of its own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.roles import Roles
from tustinnet.models.contract import Model
from tustinnet.selection.folds import FoldSplit
from tustinnet.selection.jobs import Job, JobResult, RunContext, perform_jobs
from tustinnet.selection.learning import LearningPoint
from tustinnet.selection.scoring import RecipeScorer
from tustinnet.systems.files import AnySystem, SystemTemplate

_CHOOSING = 4  # one in so many records chooses, where a recipe asks for that


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
        listener: functions that are called while fits go on.
    """

    def __init__(
        self,
        data: DataSet,
        start: str,
        listener: Listener = SILENT,
    ) -> None:
        self._data, self._listener = data, listener
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
            return perform_jobs(jobs, context, self._listener, raises=together)

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
