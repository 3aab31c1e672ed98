"""The preparation of records before folds and roles: corrupted parts, and when inputs act."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from tustinnet.data.dataset import DataSet
from tustinnet.finding import Finding, make_finding
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.fits.left_out import leave_out_unexplained, leave_out_visible
from tustinnet.fits.timing import determine_timing
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.systems.files import AnySystem, SystemTemplate

_SHARE = 0.2  # of the budget of a selection, for what no model explains
_LEFT_OUT = "parts left out"


@dataclass(frozen=True)
class PreparedRecords:
    """Records as fits use them, and what was done to them.

    Attributes:
        data: the records; their inputs have holds and delays, unless these are not to be found.
        timing: findings on holds and delays, with the evidence.
        left_out: findings on the parts of records that were left out.
        lags: names of the inputs whose actuators lag, or may lag.
        delays: names of the inputs whose delays an identification refines.
    """

    data: DataSet
    timing: tuple[Finding, ...] = ()
    left_out: tuple[Finding, ...] = ()
    lags: tuple[str, ...] = ()
    delays: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on all that was done."""
        return (*self.timing, *self.left_out)


@dataclass(frozen=True)
class PreparationOptions:
    """The preparation of records before a fit.

    Attributes:
        system: the system that is given; where none is, or one that is made for the records, a
            mechanism tells what is not explained.
        finds_timing: whether holds and delays are found that no data card declares.
        leaves_out_spoiled: whether parts of records that spoil fits are left out.
        selection_budget: how long the whole selection may take [s], of which the search for parts
            that no model explains takes a fifth at most; None for no limit.
        listener: gets sentences on what is being done; asked often in that search whether it ends
            early.
        on_step: called with the name of each step at its end.
    """

    system: AnySystem | None = None
    finds_timing: bool = True
    leaves_out_spoiled: bool = False
    selection_budget: float | None = None
    listener: Listener = SILENT
    on_step: Callable[[str], None] = field(default=lambda name: None)


def prepare_records(data: DataSet, options: PreparationOptions) -> PreparedRecords:
    """Prepares records for fits: corrupted parts are left out, holds and delays are found.

    What shows without a model comes first, so that it does not disturb what follows. A model can
    tell what it does not explain only where it knows when inputs act.

    Args:
        data: the records.
        options: what is done.
    """
    system = None if isinstance(options.system, SystemTemplate) else options.system
    records = PreparedRecords(data)

    if options.leaves_out_spoiled:
        data, visible = leave_out_visible(data)
        records = replace(records, data=data, left_out=visible)
        options.on_step(_LEFT_OUT)
    if options.finds_timing:
        timing = determine_timing(records.data, system)
        records = replace(
            records,
            data=timing.data,
            timing=timing.findings,
            lags=timing.lags,
            delays=timing.delays,
        )
        options.on_step("holds and delays")
    if options.leaves_out_spoiled:
        budget = options.selection_budget
        deadline = NEVER if budget is None else Deadline.after(_SHARE * budget)
        listener = options.listener

        def should_stop(seconds: float) -> bool:
            return deadline.comes_within(seconds) or listener.should_stop(seconds)

        data, unexplained = leave_out_unexplained(
            records.data, system, replace(listener, should_stop=should_stop)
        )
        if not unexplained and not records.left_out:
            unexplained = (make_finding("spoiled none"),)
        records = replace(records, data=data, left_out=(*records.left_out, *unexplained))
        options.on_step(_LEFT_OUT)
    return records
