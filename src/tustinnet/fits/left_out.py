"""Parts of records that spoil fits, left out before anything is fitted.

What spoils one fit spoils all: folds, scores, committees and bands. So the parts are found once,
by the cheapest model that can tell: the system that is given, or a mechanism.
"""

from dataclasses import replace

from tustinnet.data.dataset import DataSet
from tustinnet.data.inspection import held_equilibrium
from tustinnet.data.spoiled import find_without_model, leave_out
from tustinnet.errors import error_message
from tustinnet.evaluate.spoiled import find_spoiled
from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.identify import UnfinishedSearchError, identify_task
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.roles import records_without_test
from tustinnet.fitting.task import Member, make_task
from tustinnet.systems.files import AnySystem


def leave_out_visible(data: DataSet) -> tuple[DataSet, tuple[Finding, ...]]:
    """Leaves out the parts that show to spoil a fit without a model, with a finding on each."""
    parts = [part for e in data for part in find_without_model(e, held_equilibrium(e))]
    return leave_out(data, parts)


def leave_out_unexplained(
    data: DataSet,
    system: AnySystem | None = None,
    listener: Listener = SILENT,
) -> tuple[DataSet, tuple[Finding, ...]]:
    """Leaves out the parts of records that a model does not explain, with a finding on each.

    Args:
        data: the records, whose holds and delays are known.
        system: the system that is given, or None for a mechanism.
        listener: gets a sentence on what is being done; asked often whether the search for them
            ends.
    """
    by = "a mechanism" if system is None else "the system"
    listener.on_message(f"parts of records that spoil fits: searched for by {by}")
    recipe = read_recipe("mechanism" if system is None else "best-grey", ("search.refine=none",))
    records = records_without_test(data)
    unsplit = replace(data, experiments=tuple(replace(e, split=None) for e in records))
    try:
        task = make_task(unsplit, recipe, system=system)
        fit = identify_task(task, Member(), Listener(should_stop=listener.should_stop))
    except UnfinishedSearchError:
        return data, (make_finding("spoiled no time"),)
    except Exception as error:  # of any kind: all records are fitted to
        return data, (make_finding("spoiled not searched", why=error_message(error)),)
    return leave_out(data, find_spoiled(fit.model, records))
