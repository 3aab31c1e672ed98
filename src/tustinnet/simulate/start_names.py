"""Names of starts, and what the command's help says of each: read without NumPy and JAX."""

import re
from dataclasses import dataclass

from tustinnet.errors import InputError


@dataclass(frozen=True)
class StartName:
    """The name of a start.

    Attributes:
        form: the name, with `N` in the place of the number of samples.
        usual_samples: the usual number of samples.
        summary: what the start does, for the command's help, with `N` for the number of samples.
    """

    form: str
    usual_samples: int
    summary: str

    def with_samples(self, samples: int) -> str:
        """The name with a number of samples, such as `model-20`."""
        return self.form.replace("N", str(samples))

    @property
    def usual(self) -> str:
        """The name with the usual number of samples."""
        return self.with_samples(self.usual_samples)


STORED = StartName("file", 1, "first row of the record")
DERIVED = StartName("derived-N", 6, "parabola through the first N samples")
FITTED = StartName("model-N", 20, "state with which the model fits the first N samples best")
WARM_UP = StartName("warm-up-N", 20, "the model first follows N measured samples")
START_NAMES = (STORED, DERIVED, FITTED, WARM_UP)


def parse_start(name: str, where: object = "start") -> tuple[StartName, int]:
    """The kind of a start and its number of samples, by a name such as `model-20`.

    Args:
        name: the name.
        where: what names it, for messages; empty in a declaration, which says the key itself.

    Raises:
        InputError: no such start.
    """
    for kind in START_NAMES:
        if match := re.fullmatch(kind.form.replace("N", r"(\d+)"), name):
            return kind, int(match[1]) if match.groups() else kind.usual_samples
    forms = [
        f"'{kind.form}'" if kind.form == kind.usual else f"'{kind.form}' such as {kind.usual}"
        for kind in START_NAMES
    ]
    raise InputError(where, f"unknown start '{name}'", f"{', '.join(forms[:-1])} or {forms[-1]}")


def starts_help() -> str:
    """The starts and what each does, in a line for the command's help."""
    lines = [
        f"{kind.usual} ({kind.summary.replace('N', str(kind.usual_samples))})"
        for kind in START_NAMES
    ]
    return f"{', '.join(lines[:-1])} or {lines[-1]}; other numbers of samples are possible"
