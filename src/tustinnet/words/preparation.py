"""Sentences on records before a fit: holds and delays of inputs, parts that are left out."""

from tustinnet.words.sentence import note, warning

_DELAY = "{delay:.3g} ± {delay_error:.1g} s ({delay_periods:.2g} periods)"
_LAG = "a first-order lag of {lag:.3g} ± {lag_error:.1g} s ({lag_periods:.2g} periods)"
_FORCE = "[[{advises_force}; the force `lag` adds it to equations of motion]]"
_HOLD = "[[; hold {hold}]][[ ({rivals:or} fits as well)]]"

PREPARATION = {
    "timing none": note("input '{input}' acts without delay" + _HOLD),
    "timing delay": note(
        f"input '{{input}}' acts with a delay of {_DELAY}, or less of one before a short lag"
        + _HOLD
    ),
    "timing lag": note(
        f"input '{{input}}' acts through {_LAG}, or less of one after a delay{_FORCE}" + _HOLD
    ),
    "timing delay and lag": note(
        f"input '{{input}}' acts with a delay of {_DELAY} and {_LAG}{_FORCE}" + _HOLD
    ),
    "timing delay or lag": note(
        f"input '{{input}}' acts with a delay of {_DELAY}, or {_LAG}: these records do not tell "
        "which; the delay is taken" + _HOLD
    ),
    "timing early": warning(
        "input '{input}' acts {lead:.3g} ± {delay_error:.1g} s ({lead_periods:.2g} periods) before "
        "it is logged" + _HOLD
    ),
    "timing hidden": note(
        "input '{input}' is made by a controller from the motion, which hides when it acts; no "
        "delay is taken" + _HOLD
    ),
    "timing unclear": note(
        "input '{input}' acts at a time that these records do not tell; no delay is taken" + _HOLD
    ),
    "timing declared": note(
        "input '{input}' acts with the declared delay of {declared:g} s" + _HOLD
    ),
    "timing not found": warning(
        "holds and delays of inputs: not found ({why}); {hold} and no delay taken where they are "
        "not known"
    ),
    "hold of card": note(
        "hold of '{input}': {hold} as in the data card, not {of_system} as in the system"
    ),
    "left out": note("left out: {place}: {reason}"),
    "spoiled": warning("spoiled: {sentence}"),
    "spoiled none": note("spoiled records: none found, nothing was left out"),
    "spoiled no time": note("spoiled records: no time was left to search for them"),
    "spoiled not searched": warning("spoiled records: not searched for: {why}"),
}
