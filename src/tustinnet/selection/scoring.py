"""Free runs of the records that a model was not fitted to, and how they are compared."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.scores import rmse_by_record, score_runs
from tustinnet.fitting.roles import records_without_test
from tustinnet.models.contract import Model
from tustinnet.selection.folds import FoldSplit, names_of
from tustinnet.simulate.horizon import effective_horizon
from tustinnet.simulate.starts import default_start

RmseByStart = dict[str, dict[str, float]]  # of records by start, the one that decides first


@dataclass(frozen=True)
class Scorer:
    """Scores of free runs from a common start, over a common horizon, for candidates of any kind.

    Attributes:
        folds: number of folds that the records are split into.
        start: where the free runs start that decide; models that need a warm-up start with theirs.
        horizon: how long a free run lasts at most [s], None for whole records.
    """

    folds: int
    start: str
    horizon: float | None = None

    def as_plain(self) -> dict[str, Any]:
        """The options as files have them."""
        return asdict(self)

    def starts(self, model: Model, data: DataSet) -> tuple[str, ...]:
        """The starts of a model's free runs: the one that decides, or the model's warm-up."""
        return (default_start(list(data), model) if model.warm_up else self.start,)

    def score(
        self, model: Model, fit_horizon: float | None, split: FoldSplit, data: DataSet
    ) -> RmseByStart:
        """RMSE of the records that a fold leaves out, by start.

        Args:
            model: a model that was not fitted to them.
            fit_horizon: over how long its fit compared [s], None for whole records.
            split: the fold.
            data: all records.
        """
        records, horizon = self._records(split, data), self.used_horizon(fit_horizon, split)
        result: RmseByStart = {}
        for start in self.starts(model, data):
            rmse = rmse_by_record(score_runs(model, records, start, horizon=horizon))
            result[start] = {name: rmse[name] for name in names_of(split.scored)}
        return result

    def used_horizon(self, fit_horizon: float | None, split: FoldSplit) -> float | None:
        """The horizon over which a model's free runs are scored [s], None for whole records.

        Args:
            fit_horizon: over how long its fit compared [s], None for whole records.
            split: the fold.
        """
        return self.horizon

    def _records(self, split: FoldSplit, data: DataSet) -> Sequence[Experiment]:
        """The records that are simulated.

        Every record, whichever are scored, so that models that are alike share a program.
        """
        return records_without_test(data)


@dataclass(frozen=True)
class RecipeScorer(Scorer):
    """Free runs over the horizon of the recipe, from any starts: one recipe is scored by itself.

    Attributes:
        names: where the free runs start; () for the model's default start.
        warm_up: whether models that need a warm-up start with theirs instead.
    """

    names: tuple[str, ...] = ()
    warm_up: bool = False

    def starts(self, model: Model, data: DataSet) -> tuple[str, ...]:
        """The starts of a model's free runs."""
        if not self.names or (self.warm_up and model.warm_up):
            return (default_start(list(data), model),)
        return self.names

    def used_horizon(self, fit_horizon: float | None, split: FoldSplit) -> float | None:
        """The horizon of the fit [s]; None for whole records, where no scored record is longer."""
        return effective_horizon(fit_horizon, split.scored)

    def _records(self, split: FoldSplit, data: DataSet) -> Sequence[Experiment]:
        """The scored records."""
        return split.scored
