"""The errors that people are meant to read."""


class InputError(ValueError):
    """Something given to the package cannot be used.

    The message is one line: where, what was found, what was expected, what to do.
    The command prints it and exits with 1; a program can catch it as a `ValueError`.
    """

    def __init__(self, where: object, found: str, expected: str = "", remedy: str = "") -> None:
        parts = [f"{where}: {found}"]
        if expected:
            parts.append(f"expected {expected}")
        if remedy:
            parts.append(remedy)
        super().__init__("; ".join(" ".join(part.split()) for part in parts))
