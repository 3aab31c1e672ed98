"""Inputs between their samples: a polynomial for every period."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

DeclaredHold = Literal["zero-order", "first-order", "band-limited"]

HALF = 16  # samples on either side that a band-limited value is computed from
_COEFFICIENTS = 8  # coefficients a period: errs by 2e-6 at 0.42 of the sampling rate
_KAISER = 8.0  # the window leaves 1e-4 up to 0.42 of the sampling rate


class Excitation(NamedTuple):
    """The inputs of a record, at its samples and between them.

    Attributes:
        samples: values at the samples, (n, n_u).
        pieces: coefficients of the polynomial that each input follows over each period, of
            0, 1, 2, ... powers of the part of the period, (n - 1, order, n_u). One where all
            inputs are held and change at samples, two where some follow straight lines or change
            between samples, eight where some are band-limited.
    """

    samples: Float[np.ndarray, "n n_u"]
    pieces: Float[np.ndarray, "steps order n_u"]

    @property
    def mean(self) -> Float[np.ndarray, "steps n_u"]:
        """The mean over each period, (n - 1, n_u)."""
        shares = 1 / np.arange(1, self.pieces.shape[1] + 1)
        return np.einsum("koi,o->ki", self.pieces, shares)

    def with_order(self, order: int) -> "Excitation":
        """The inputs with at least so many coefficients a period."""
        missing = max(0, order - self.pieces.shape[1])
        return self._replace(pieces=np.pad(self.pieces, ((0, 0), (0, missing), (0, 0))))


def excitation(
    u: Float[np.ndarray, "n n_u"], holds: Sequence[DeclaredHold], delays: Sequence[float]
) -> Excitation:
    """Inputs at and between their samples.

    Held inputs keep their sample, those of first order follow straight lines, band-limited ones
    are interpolated by a windowed sinc, whose polynomial over a period is a filter of fixed
    coefficients (Farrow). A held input that changes within a period, as it is delayed, acts by the
    straight line of the same mean and first moment there: it moves a mass as far and makes it as
    fast as the input does. A delayed straight line acts by those through its values at the samples.
    Before
    the first sample an input is taken to be that sample; a band-limited one goes on beyond both
    ends as linear prediction has it, learnt from the record itself.

    Args:
        u: samples, (n, n_u); more than `HALF` of them where an input is band-limited.
        holds: hold of each input.
        delays: delay of each input [periods].

    References:
        Farrow (1988), A continuously variable digital delay element, IEEE ISCAS.
        Kaiser (1974), Nonrecursive digital filter design using the I0-sinh window function.
        Makhoul (1975), Linear prediction: a tutorial review, Proceedings of the IEEE 63.
    """
    columns = []
    for column, hold, delay in zip(u.T, holds, delays, strict=True):
        if hold == "band-limited":
            columns.append(_interpolate_band_limited(column, delay))
            continue
        # between samples m and m + 1 periods before; for a held input its mean over the period
        samples = _delayed(column, delay)
        if hold == "first-order":
            powers = [samples[:-1], np.diff(samples)]
        elif part := delay % 1.0:  # of the period, after which a held input changes
            whole = float(math.floor(delay))
            change = _delayed(column, whole) - _delayed(column, whole + 1)
            slope = 6 * part * (1 - part) * change[:-1]
            powers = [samples[:-1] - slope / 2, slope]
        else:
            powers = [samples[:-1]]
        columns.append((samples, np.stack(powers)))
    order = max((len(pieces) for _, pieces in columns), default=1)
    all_samples = np.zeros(u.shape)
    all_pieces = np.zeros((len(u) - 1, order, u.shape[1]))
    for i, (samples, pieces) in enumerate(columns):
        all_samples[:, i] = samples
        all_pieces[:, : len(pieces), i] = pieces.T
    return Excitation(all_samples, all_pieces)


def _delayed(u: Float[np.ndarray, " n"], delay: float) -> Float[np.ndarray, " n"]:
    """Samples so many periods later, on straight lines between them; the first one goes on."""
    at = np.arange(len(u))
    return np.interp(at - delay, at, u) if delay else u


def _interpolate_band_limited(
    u: Float[np.ndarray, " n"], delay: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "order steps"]]:
    n, reach = len(u), HALF + math.ceil(abs(delay)) + 1
    extended = np.concatenate([_predict_back(u, reach), u, _predict_back(u[::-1], reach)[::-1]])
    nodes = (
        1 - np.cos(np.pi * np.arange(_COEFFICIENTS) / (_COEFFICIENTS - 1))
    ) / 2  # both ends among them
    values = []
    for node in nodes:
        whole, part = divmod(node - delay, 1.0)
        distance = part - np.arange(1 - HALF, HALF + 1)
        window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (distance / HALF) ** 2, 0.0)))
        weights = np.sinc(distance) * window / np.i0(_KAISER)
        first = reach + int(whole) + 1 - HALF
        near = extended[first : first + n + 2 * HALF - 1]
        values.append(np.convolve(near, weights[::-1], "valid"))
    pieces = np.linalg.solve(np.vander(nodes, increasing=True), np.stack(values))
    return values[0], pieces[:, :-1]


def _predict_back(u: Float[np.ndarray, " n"], count: int) -> Float[np.ndarray, " count"]:
    """Samples before the first one, by linear prediction back in time."""
    mean, peak = u.mean(), np.abs(u - u.mean()).max()
    if not peak:
        return np.full(count, mean)
    reverse = (u - mean)[::-1] / peak
    order = min(16, len(u) // 3)
    # a copy: products of views that overlap take twice as long
    past = np.lib.stride_tricks.sliding_window_view(reverse[:-1], order).copy()
    products = past.T @ past
    # as much as a converter rounds
    products += 1e-9 * np.trace(products) * np.eye(order)
    weights = np.linalg.solve(products, past.T @ reverse[order:])
    predicted = np.concatenate([reverse[-order:], np.zeros(count)])
    for k in range(order, order + count):
        # a predictor may be unstable; it must not run away
        predicted[k] = np.clip(predicted[k - order : k] @ weights, -1.0, 1.0)
    return mean + peak * predicted[order:][::-1]
