"""Fingerprints of records: short texts by which a record is recognised in another file.

A fingerprint has the smallest keys of all stretches of a record in which its speeds change
(A. Broder, On the resemblance and containment of documents, 1997). A copy with other times, line
ends or digits, or a part of the record, has many of these keys; another run of the experiment, with
other noise, has none.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt32

from tustinnet.data.experiment import Experiment
from tustinnet.signals.stretches import stretch_keys

_STRETCH = 50  # steps of a stretch, of which twelve differ from the one before
_KEYS, _KEY_DIGITS = 32, 8  # keys of a fingerprint; hexadecimal digits of each

FINGERPRINT = rf"^([0-9a-f]{{{_KEY_DIGITS}}}){{0,{_KEYS}}}$"  # a pattern of them


def step_quanta(records: Sequence[Experiment]) -> list[float]:
    """Units of the steps in fingerprints of some records, a power of two for each channel."""
    squares = np.sum([np.sum(_steps(e) ** 2, axis=0) for e in records], axis=0)
    usual = np.sqrt(squares / max(sum(len(e) - 1 for e in records), 1))
    # few steps in a usual one, so that rounded copies have the keys
    exponent = np.round(np.log2(np.clip(usual / 32, 1e-100, 1e100)))
    return [float(x) for x in 2.0**exponent]


def make_fingerprint(experiment: Experiment, quanta: Sequence[float]) -> str:
    """The fingerprint of a record, with units by `step_quanta`; empty where no speed changes."""
    smallest = _keys(experiment, quanta)[:_KEYS]
    return "".join(f"{key:0{_KEY_DIGITS}x}" for key in smallest)


def is_among(experiment: Experiment, fingerprints: Sequence[str], quanta: Sequence[float]) -> bool:
    """Whether a record is a copy or a part of one of those with some fingerprints.

    Args:
        experiment: the record.
        fingerprints: fingerprints, by `make_fingerprint`.
        quanta: their units.
    """
    if len(quanta) != experiment.channels.n_q + experiment.channels.n_u:
        return False
    own = _keys(experiment, quanta)
    if not len(own):
        return False
    for text in fingerprints:
        keys = np.array(
            [int(text[k : k + _KEY_DIGITS], 16) for k in range(0, len(text), _KEY_DIGITS)]
        )
        nearest = own[np.minimum(np.searchsorted(own, keys), len(own) - 1)]
        # runs of one step, without noise, may have three keys in common
        if np.count_nonzero(nearest == keys) > 3:
            return True
    return False


def _steps(e: Experiment) -> Float[np.ndarray, "n c"]:
    """Changes of all positions and inputs of a record from sample to sample."""
    return np.diff(np.concatenate([e.q, e.u], axis=1), axis=0)


def _keys(e: Experiment, quanta: Sequence[float]) -> UInt32[np.ndarray, " m"]:
    """Different keys of all stretches in which speeds change, the smallest first."""
    with np.errstate(invalid="ignore"):  # of numbers beyond those of integers
        steps = np.rint(_steps(e) / np.array(quanta)).astype(np.int64)
    # motion at a constant speed is alike in many records
    q = steps[:, e.channels.position]
    differs = np.any(np.diff(q, axis=0, prepend=q[:1]) != 0, axis=1)
    _, keys = stretch_keys(steps, differs, _STRETCH, 12)
    return np.unique((keys >> np.uint64(32)).astype(np.uint32))
