"""The frequency up to which forces along records are compared.

It is that up to which a fit explains half of the power of the actuators' forces in records that it
was not fitted to. Statistics of positions alone are fooled by stamps that jitter, whose noise is
not white.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.inverse_dynamics.along import FILTER, filter_record
from tustinnet.fitting.inverse_dynamics.linear_forces import LinearForces
from tustinnet.fitting.inverse_dynamics.solver import Prior, coordinates_of, solve
from tustinnet.fitting.inverse_dynamics.sums import fold_pieces, sum_up
from tustinnet.fitting.shooting.groups import expand_parameters
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace, make_search_space
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.signals.low_pass import HIGHEST_CUTOFF


class CutoffSearch(NamedTuple):
    """Settings of the search for the cut-off frequency.

    All are set by hand, not measured.

    Attributes:
        power: share of the power of the positions that is within the band of the motion.
        first: first cut-off frequency that is tried, by the band of the motion.
        further: times the cut-off frequency so far, up to which each round looks.
        bins: pieces of the spectrum in which the explained share is computed.
        explained: share of the power of the forces that a fit must explain below the
            cut-off frequency.
        designed: cut-off frequency of a designed motion, by its highest frequency.
    """

    power: float = 0.99
    first: float = 10.0
    further: float = 4.0
    bins: int = 24
    explained: float = 0.5
    designed: float = 3.0


CUTOFF = CutoffSearch()


def choose_cutoff(
    system: LagrangianSystem,
    records: Sequence[Experiment],
    space: SearchSpace | None = None,
    vector: ParameterVector | None = None,
) -> float:
    """The frequency up to which forces along records are compared [Hz].

    Args:
        system: the system, without a controller in the loop.
        records: the records.
        space: the search space; by default that of all parameters that are not fixed.
        vector: values about which forces are linear; by default the nominal ones.
    """
    if space is None:
        space = make_search_space(system, {}, {}, expand_parameters(system, records))
    if vector is None:
        vector = space.to_vector(space.nominal)
    cutoff, limit = CUTOFF.first * _motion_band(records), HIGHEST_CUTOFF / records[0].dt
    explained = cache(lambda highest: _explained_band(system, space, vector, records, highest))
    for _ in range(3):
        cutoff = max(explained(min(CUTOFF.further * cutoff, limit)), cutoff / 2)
    return min(cutoff, limit)


def cutoff_for(band: float, dt: float) -> float:
    """The frequency up to which forces of a designed motion can be compared [Hz].

    Args:
        band: highest frequency of the motion [Hz].
        dt: sampling period [s].
    """
    return min(CUTOFF.designed * band, HIGHEST_CUTOFF / dt)


def compared_samples(seconds: float, cutoff: float) -> float:
    """The number of nearly independent samples of forces that a record has.

    Args:
        seconds: length of the record [s].
        cutoff: frequency up to which forces are compared [Hz].
    """
    return FILTER.compared * cutoff * seconds


def _explained_band(
    system: LagrangianSystem,
    space: SearchSpace,
    vector: ParameterVector,
    records: Sequence[Experiment],
    highest: float,
) -> float:
    """Frequency up to which a fit to one half of the records explains forces of the other [Hz].

    Args:
        system: the system, without a controller in the loop.
        space: the search space.
        vector: values about which forces are linear.
        records: the records.
        highest: frequency up to which it is looked for [Hz].
    """
    parts, prior = tuple(filter_record(e, highest) for e in records), Prior(space)
    columns = LinearForces(system, space, parts).columns(vector)
    pieces = [
        (own[piece], part.step * part.dt)
        for own, part in zip(columns, parts, strict=True)
        for piece in fold_pieces(own, len(columns))
    ]
    edges = np.linspace(0.0, highest, CUTOFF.bins + 1)
    power = np.zeros((2, len(system.coordinates), CUTOFF.bins))
    for half in (0, 1):
        sums = sum_up([piece for piece, _ in pieces[1 - half :: 2]])
        found = coordinates_of(space, solve(sums, prior, vector).vector)
        for piece, period in pieces[half::2]:
            missing = piece.slopes @ found + piece.rest
            power = power + _power(np.stack([missing, piece.applied]), period, edges)
    missing, applied = power
    is_driven = applied.any(axis=1)
    if not is_driven.any():
        return float(edges[1])
    share = np.median(missing[is_driven] / np.maximum(applied[is_driven], 1e-300), axis=0)
    smooth = np.convolve(share, np.ones(3) / 3, mode="valid")
    beyond = np.flatnonzero(smooth > 1 - CUTOFF.explained) + 1
    return float(edges[beyond[0]]) if len(beyond) else highest


def _motion_band(records: Sequence[Experiment]) -> float:
    """The frequency below which positions have most of their power, in the middle of joints [Hz].

    Of records of several lengths the highest counts.
    """
    bands = []
    for e in records:
        spread = e.q.std(axis=0)
        moving = spread > 0
        if not moving.any():
            continue
        scaled = (e.q[:, moving] - e.q[:, moving].mean(axis=0)) / spread[moving]
        power = np.cumsum(np.abs(np.fft.rfft(scaled, axis=0)) ** 2, axis=0)
        bins = [np.searchsorted(p, CUTOFF.power * p[-1]) for p in power.T]
        bands.append(float(np.median(bins)) / (len(e) * e.dt))
    return max(bands)


def _power(
    signals: Float[np.ndarray, "2 k n_q"], dt: float, edges: Float[np.ndarray, " e"]
) -> Float[np.ndarray, "2 n_q b"]:
    """Power of signals by bands of frequency."""
    window = np.hanning(signals.shape[1])[:, None]
    spectrum = np.abs(np.fft.rfft(window * (signals - signals.mean(axis=1, keepdims=True)), axis=1))
    bins = np.digitize(np.fft.rfftfreq(signals.shape[1], dt), edges) - 1
    power = np.zeros((2, signals.shape[2], len(edges)))
    for b in range(len(edges)):
        power[:, :, b] = np.sum(spectrum[:, bins == b] ** 2, axis=1)
    return power[..., :-1]
