"""Parts of records that spoil fits, left out before candidates are tried.

What spoils one fit spoils all: folds, scores, committees and bands. So the parts are found once,
before the rounds, by the cheapest model that can tell: the system that is given, or a mechanism.
"""

from collections.abc import Callable

from tustinnet.data.dataset import DataSet
from tustinnet.data.inspection import held_equilibrium
from tustinnet.data.spoiled import find_without_model, leave_out
from tustinnet.errors import error_message
from tustinnet.evaluate.spoiled import find_spoiled
from tustinnet.fitting.listener import SILENT
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.shooting.identify import UnfinishedSearchError, identify_task
from tustinnet.fitting.task import Fold, Member, Task, resolve_system
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.selection.deadline import NEVER, Deadline
from tustinnet.selection.folds import records_without_test
from tustinnet.systems.files import AnySystem, SystemTemplate


def leave_out_spoiled(
    data: DataSet,
    system: AnySystem | LagrangianSystem | SystemTemplate | None = None,
    deadline: Deadline = NEVER,
    on_message: Callable[[str], None] = lambda sentence: None,
) -> tuple[DataSet, tuple[str, ...]]:
    """Leaves out the parts of records that spoil a fit; returns a sentence on each, too.

    Args:
        data: the records, whose holds and delays are known.
        system: the system that is given, or None for a mechanism.
        deadline: when the search for them has to end.
        on_message: called with what is being done.
    """
    visible = [part for e in data for part in find_without_model(e, held_equilibrium(e))]
    data, sentences = leave_out(data, visible)
    by = "a mechanism" if system is None else "the system"
    on_message(f"parts of records that spoil fits: searched for by {by}")
    recipe = read_recipe("mechanism" if system is None else "best-grey", ("search.refine=none",))
    task = Task(
        recipe,
        (Fold(Roles(tuple(records_without_test(data)), ())),),
        (Member(),),
        resolve_system(recipe, system),
    )
    try:
        fit = identify_task(task, Member(), SILENT, deadline.has_passed)
    except UnfinishedSearchError:
        return data, (*sentences, "spoiled records: no time was left to search for them")
    except Exception as error:  # of any kind: candidates are tried with all records
        why = f"spoiled records: not searched for: {error_message(error)}"
        return data, (*sentences, why)
    data, more = leave_out(data, find_spoiled(fit.model, task.folds[0].roles.all))
    if not sentences and not more:
        return data, ("spoiled records: none found, nothing was left out",)
    return data, (*sentences, *more)
