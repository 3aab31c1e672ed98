"""Old names that still work, with a message that says the new one; they go in version 0.4."""

import warnings

# public Python names, `tn.NAME`
NAMES: dict[str, str] = {
    "Asked": "SelectionOptions",
    "make_question": "make_cross_validation_options",
}


def current_name(name: str, names: dict[str, str], kind: str) -> str:
    """The name that is used today, with a `FutureWarning` where an old one was given.

    Args:
        name: what was written.
        names: new names by old ones.
        kind: what is named, for the message, as "key" or "function".
    """
    if name not in names:
        return name
    warnings.warn(
        f"the {kind} '{name}' is called '{names[name]}' now; the old name goes in version 0.4",
        FutureWarning,
        stacklevel=3,
    )
    return names[name]
