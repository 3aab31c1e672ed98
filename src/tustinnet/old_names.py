"""Names of before the first release, and what to write instead: all that is known of them."""

from collections.abc import Iterable, Mapping

from tustinnet.errors import InputError

# public Python names, `tn.NAME`
NAMES = {
    "Asked": "SelectionOptions",
    "make_question": "make_cross_validation_options",
    "Drive": "InputSignal",
    "drive_of": "input_signal",
}
# verbs of the command
VERBS = {
    "calibrate": "in Python: tn.calibrate(MODEL, records, FILE)",
    "committee": "in Python: tn.save_committee([MODEL, ...], FILE)",
    "compare": "tustinnet evaluate MODEL MODEL ... DATA",
    "learning-curve": "tustinnet cross-validate DATA --records all",
    "next-record": "in Python: tn.rank_proposals, or tn.design_record for the motion of a robot",
    "residuals": "tustinnet evaluate MODEL DATA --residuals",
}
# verbs of the command that read records
_READING = ("init", "inspect", "fit", "cross-validate", "simulate", "evaluate", "control", "report")
# options of verbs
OPTIONS = {
    (verb, "--strict"): "tustinnet inspect DATA --strict, before it"
    for verb in ("fit", "cross-validate")
} | {(verb, "--follow-links"): "TUSTINNET_FOLLOW_LINKS=1 in the environment" for verb in _READING}
_DENSITY = "a system file: SYSTEM = tn.load_robot(FILE, default_density=2700.0)"
OPTIONS |= {(verb, "--default-density"): _DENSITY for verb in ("init", "fit")}
# methods of models
METHODS = {
    "of": "for_record",
    "of_groups": "for_groups",
    "seen": "step_layout",
    "silent": "with_zero_output",
    "folded": "simplify",
    "beginning": "initial_state",
}
# methods of families
FAMILY_METHODS = {
    "trainable": "trainable_mask",
    "begun": "with_weights_from",
    "beginning": "with_initial_values",
    "corrected": "physics_in",
    "stepped": "physics_for_training",
    "shown": "summarise",
}
# forces of a recipe (`[model] forces`)
FORCES = {"rubbing": "coulomb_by_position"}
# keys of recipes
KEYS = {
    "stages": "nothing is trained: leave it out (a linear model is found by least squares)",
    "penalty": "train fewer epochs, or a smaller correction",
    "rates": "train each by itself with stages.*.rate, or use tn.fit_many(rates=...)",
    "loss": "a search compares positions, and velocities in its early stages: leave it out",
    "times": "to ignore timestamps, give `dt` and no [time] in the data card",
}


def attribute_error(owner: str, name: str, current: Mapping[str, str]) -> AttributeError:
    """The error of an attribute that is not there; of an old name it says the one of now.

    Args:
        owner: what was asked for it.
        name: the attribute.
        current: what to write instead, by old names.
    """
    instead = f"; it is called '{current[name]}' now" if name in current else ""
    return AttributeError(f"{owner} has no attribute '{name}'{instead}", name=name)


def refuse_old_names(where: str, names: Iterable[str], current: Mapping[str, str]) -> None:
    """Raises where names are old ones.

    Args:
        where: what has the names.
        names: the names.
        current: what to write instead, by old names.

    Raises:
        InputError: a name is old.
    """
    found = [name for name in current if name in names]
    if found:
        instead = ", ".join(dict.fromkeys(current[name] for name in found))
        raise InputError(where, f"names of an earlier version: {', '.join(found)}", instead)
