"""The preparation of records for a fit: the same steps in the same order, whatever is fitted."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from tustinnet.data.dataset import DataSet
from tustinnet.finding import Finding, make_finding
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.fits.left_out import leave_out_unexplained, leave_out_visible
from tustinnet.fits.timing import determine_timing
from tustinnet.fitting.shooting.levenberg_marquardt import ShouldStopSearch, never_stop_search
from tustinnet.systems.files import AnySystem, SystemTemplate


@dataclass(frozen=True)
class PreparedRecords:
    """Records as fits use them, and what was done to them.

    Attributes:
        data: the records; their inputs have holds and delays, unless these are not to be found.
        timing: findings on holds and delays, with the evidence.
        left_out: findings on the parts of records that were left out.
        lags: names of the inputs whose actuators lag, or may lag.
    """

    data: DataSet
    timing: tuple[Finding, ...] = ()
    left_out: tuple[Finding, ...] = ()
    lags: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on all that was done."""
        return (*self.timing, *self.left_out)


@dataclass(frozen=True)
class PreparationOptions:
    """What is done to records before a fit.

    Attributes:
        system: the system that is given; where none is, or one that is made for the records, a
            mechanism tells what is not explained.
        finds_timing: whether holds and delays are found that no data card declares.
        keeps_unknown_delays: whether delays that the card calls unknown stay so.
        leaves_out_spoiled: whether parts of records that spoil fits are left out.
        budget: how long all that follows may take [s], None for no limit; a step takes its share.
        should_stop: asked often: whether steps end early, with what is known by then.
        on_message: called with sentences on what is being done, and on what was found.
        on_step: called with the name of each step at its end.
    """

    system: AnySystem | None = None
    finds_timing: bool = True
    keeps_unknown_delays: bool = False
    leaves_out_spoiled: bool = False
    budget: float | None = None
    should_stop: ShouldStopSearch = never_stop_search
    on_message: Callable[[str], None] = field(default=lambda sentence: None)
    on_step: Callable[[str], None] = field(default=lambda name: None)


@dataclass(frozen=True)
class PreparationStep:
    """A step of the preparation.

    Attributes:
        name: what the time that it takes is accounted to.
        share: the share of the budget that it may take.
        applies: whether it is taken, by the options.
        run: makes records of those before it, given the options and when it has to end.
    """

    name: str
    share: float
    applies: Callable[[PreparationOptions], bool]
    run: Callable[[PreparedRecords, PreparationOptions, ShouldStopSearch], PreparedRecords]


def prepare_records(data: DataSet, options: PreparationOptions) -> PreparedRecords:
    """Prepares records for fits: the steps of `STEPS` that apply, one after the other.

    Args:
        data: the records.
        options: what is done.
    """
    if isinstance(options.system, SystemTemplate):
        options = replace(options, system=None)
    records = PreparedRecords(data)
    for step in STEPS:
        if not step.applies(options):
            continue
        seconds = None if options.budget is None else step.share * options.budget
        deadline = NEVER if seconds is None else Deadline.after(seconds)

        def is_over(deadline: Deadline = deadline) -> bool:
            return deadline.has_passed() or options.should_stop()

        before = records.findings
        records = step.run(records, options, is_over)
        for finding in records.findings:
            if finding not in before:
                options.on_message(finding.text)
        options.on_step(step.name)
    return records


def _leave_out_visible(
    records: PreparedRecords, options: PreparationOptions, should_stop: ShouldStopSearch
) -> PreparedRecords:
    data, findings = leave_out_visible(records.data)
    return replace(records, data=data, left_out=(*records.left_out, *findings))


def _determine_timing(
    records: PreparedRecords, options: PreparationOptions, should_stop: ShouldStopSearch
) -> PreparedRecords:
    timing = determine_timing(
        records.data, options.system, keeps_unknown_delays=options.keeps_unknown_delays
    )
    return replace(records, data=timing.data, timing=timing.findings, lags=timing.lags)


def _leave_out_unexplained(
    records: PreparedRecords, options: PreparationOptions, should_stop: ShouldStopSearch
) -> PreparedRecords:
    data, findings = leave_out_unexplained(
        records.data, options.system, should_stop, options.on_message
    )
    if not findings and not records.left_out:
        findings = (make_finding("spoiled none"),)
    return replace(records, data=data, left_out=(*records.left_out, *findings))


# what shows without a model comes first, so that it does not disturb what follows; a model can tell
# what it does not explain only where it knows when inputs act
STEPS = (
    PreparationStep("parts left out", 0.0, lambda o: o.leaves_out_spoiled, _leave_out_visible),
    PreparationStep("holds and delays", 0.0, lambda o: o.finds_timing, _determine_timing),
    PreparationStep("parts left out", 0.2, lambda o: o.leaves_out_spoiled, _leave_out_unexplained),
)
