"""Free runs over a horizon: records cut end to end into segments with a start of their own."""

from collections.abc import Sequence
from itertools import pairwise

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.simulate.start_rules import Start

FOLLOWED = 0.3  # of the standard deviation of a coordinate: an error that no longer follows it


def horizon_samples(
    horizon: float | None, experiments: Sequence[Experiment], start: Start, where: str = "horizon"
) -> int | None:
    """Samples of a horizon, None where there is none.

    Args:
        horizon: how long a free run lasts at most [s], or None for whole records.
        experiments: the records.
        start: where free runs start.
        where: the name of the horizon in messages.

    Raises:
        InputError: a horizon shorter than two samples or than the start needs, or longer than
            every record.
    """
    if horizon is None:
        return None
    dt, longest = experiments[0].dt, max(map(len, experiments))
    if not horizon > 0 or horizon > longest * dt:
        raise InputError(
            where,
            f"{horizon:g} s",
            f"more than 0 and at most the longest record's {(longest - 1) * dt:g} s",
            "leave it out for whole records",
        )
    samples, fewest = round(horizon / dt), _fewest_samples(start)
    if samples < fewest:
        needed = "two samples" if fewest == 2 else f"what the start '{start.name}' needs"
        raise InputError(
            where,
            f"{horizon:g} s, {samples} samples of {dt:g} s",
            f"at least {needed}, {fewest * dt:g} s",
            "take a longer one",
        )
    return samples


def pieces(experiment: Experiment, samples: int | None, start: Start) -> list[Experiment]:
    """Segments of a record end to end, each behind the samples that its warm-up needs.

    From the sample `start.first` on they share no sample and leave none out: free runs of all of
    them, one after the other, are as long as the record. A rest that is too short to start in
    belongs to the segment before.

    Args:
        experiment: the record.
        samples: of a segment, its warm-up not counted; None for the whole record.
        start: where the free runs start.
    """
    n, lead = len(experiment), start.first
    if samples is None or n - lead <= samples:
        return [experiment]
    edges = [*range(lead, n, samples), n]
    if edges[-1] - edges[-2] < _fewest_samples(start):
        del edges[-2]
    return [experiment[a - lead : b] for a, b in pairwise(edges)]


def effective_horizon(horizon: float | None, experiments: Sequence[Experiment]) -> float | None:
    """The horizon where some record is longer; else None: all are compared as a whole anyway."""
    is_reached = horizon and any(len(e) > round(horizon / e.dt) for e in experiments)
    return horizon if is_reached else None


def horizon_words(horizon: float | None) -> str:
    """The horizon as titles say it behind a comma; an empty text for whole records."""
    return "" if horizon is None else f", restarted every {horizon:.3g} s"


def _fewest_samples(start: Start) -> int:
    """The smallest number of samples of a segment."""
    return max(2, start.samples - start.first)
