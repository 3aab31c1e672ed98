"""`fit`: a model by one call; without a recipe the best of several, with its progress printed."""

import math
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar, overload

from rich.console import Console

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.fits.fit import fit_request
from tustinnet.fits.request import FitRequest
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.roles import require_data_set
from tustinnet.fitting.task import AnyRecipe, Member
from tustinnet.models.contract import Model, warn_of_single_precision
from tustinnet.report.progress import FitProgress
from tustinnet.report.selection import write_table
from tustinnet.selection.choice import Choice
from tustinnet.selection.select import USUAL_BUDGET, Reporter, SelectionOptions, select_model
from tustinnet.systems.files import AnySystem

ResultType = TypeVar("ResultType", FitResult, Choice)


@overload
def fit(
    data: DataSet,
    recipe: None = None,
    *,
    system: AnySystem | None = None,
    budget: float | None = None,
    folder: str | Path | None = None,
    quiet: bool = False,
) -> Choice: ...
@overload
def fit(
    data: DataSet,
    recipe: AnyRecipe,
    seed: int | None = None,
    *,
    physics: Model | None = None,
    system: AnySystem | None = None,
    listener: Listener | None = None,
    quiet: bool = False,
) -> FitResult: ...
@overload
def fit(
    data: DataSet,
    recipe: None = None,
    seed: int | None = None,
    *,
    physics: Model,
    listener: Listener | None = None,
    quiet: bool = False,
) -> FitResult: ...
def fit(
    data: DataSet,
    recipe: AnyRecipe | None = None,
    seed: int | None = None,
    *,
    physics: Model | None = None,
    system: AnySystem | None = None,
    listener: Listener | None = None,
    budget: float | None = None,
    folder: str | Path | None = None,
    quiet: bool = False,
) -> FitResult | Choice:
    """Fits a model to a data set, as a recipe says, or the best of several recipes without one.

    Holds and delays of inputs that the records do not declare are searched for first. Without a
    recipe and without `physics`, `select_model` tries the usual plan, as the command `fit` does,
    and Ctrl-C ends with the best model so far, twice at once. The progress is printed, in notebooks
    as one line that changes, and what was found.

    Args:
        data: records; with a recipe those of the splits `train` and, if free runs are to choose,
            `validation`.
        recipe: a packaged recipe's name, a TOML file, its content as a mapping, or a `Recipe`; with
            `physics` by default `best-hybrid`.
        seed: with a recipe: initial weights, windows and shuffling follow from it, 0 by default; an
            identification has none.
        physics: a model to correct, as an identification gives it; it stays as it is.
        system: the system whose parameters are identified, its name or its file.
        listener: with a recipe: functions that are called while the fit goes on, see `Listener`;
            nothing is printed then.
        budget: without a recipe: how long it may take [s], 240 by default, infinite for no limit.
        folder: without a recipe: where all models, the table and logs are kept; by default nowhere.
        quiet: whether nothing is printed.

    Returns:
        The model and how it came about: `model`, and what was found (`findings`). A training that
        diverged returns the best weights it had and says so in `outcome`.

    Raises:
        InputError: records too short for a window, no training split, a recipe that does not fit,
            an argument that is not applicable; see also `identify` and `select_model`.
    """
    require_data_set(data)
    if recipe is not None or physics is not None:
        needless = {"budget": budget, "folder": folder}
        remedy = "tn.read_recipe(NAME, ['stages.*.epochs=100']) limits a training"
        _refuse(needless, "to a single recipe", "neither recipe nor physics", remedy)
        warn_of_single_precision("fit")
        members = (Member(seed or 0),)
        request = FitRequest(data, recipe, members, physics=physics, system=system)
        if listener or quiet:
            return fit_request(request, listener or SILENT)[0]
        console = _make_console()
        with FitProgress(console) as progress:
            result = fit_request(request, progress.listener())[0]
        return _print_findings(console, result)
    _refuse({"seed": seed, "listener": listener}, "without a recipe", "a recipe")
    limit = USUAL_BUDGET if budget is None else budget
    if not limit > 0:
        raise InputError("`budget=`", f"{limit:g}", "seconds above 0, or infinity")
    options = SelectionOptions(system=system, budget=None if limit == math.inf else limit)
    if folder is None:
        with TemporaryDirectory(prefix="tustinnet-") as place:
            return _select(data, Path(place), options, quiet=quiet)
    choice = _select(data, Path(folder), options, quiet=quiet)
    write_table(choice)
    return choice


def _select(data: DataSet, folder: Path, options: SelectionOptions, *, quiet: bool) -> Choice:
    """Chooses a model, and prints its progress unless quiet."""
    if quiet:
        return select_model(data, folder, options)
    console = _make_console()
    with FitProgress(console) as progress:
        reporter = make_reporter(progress, console.print)
        choice = select_model(data, folder, options, reporter=reporter)
    return _print_findings(console, choice)


def _print_findings(console: Console, result: ResultType) -> ResultType:
    """The result, whose findings are printed, a line each; a notebook shows them with it."""
    for finding in () if isinstance(console.file, _LastLine) else result.findings:
        console.print(f"* {finding}")
    return result


def _make_console() -> Console:
    """The place of progress: standard error, in a notebook an output of the cell that changes."""
    style: Any = {"highlight": False, "soft_wrap": True, "markup": False}
    console = Console(stderr=True, **style)
    if not console.is_jupyter:
        return console
    return Console(file=_LastLine(), force_jupyter=False, force_terminal=False, **style)


class _LastLine(StringIO):
    """An output of a notebook's cell that shows the last line written."""

    def __init__(self) -> None:
        from IPython.display import DisplayHandle  # notebooks have it, terminals need not

        super().__init__()
        self._output = DisplayHandle()
        self._output.display({"text/plain": ""}, raw=True)

    def write(self, text: str) -> int:
        self._output.update({"text/plain": text.rstrip()}, raw=True)
        return len(text)


def make_reporter(progress: FitProgress, on_message: Callable[[str], None]) -> Reporter:
    """Makes the reporter of a selection: bars or lines for fits, and sentences."""
    return Reporter(on_message, lambda job: progress.listener(job.label))


def _refuse(
    given: dict[str, object], case: str, expected: str, remedy: str = "leave it out"
) -> None:
    """Raises an error for the first argument that was given where it does nothing."""
    for name, value in given.items():
        if value is not None:
            raise InputError(f"`{name}=`", f"not applicable {case}", expected, remedy)
