"""The models of Table 1 by name; loads neither JAX nor the recipes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Entry:
    """A row of the table, or several by seed, that is fitted.

    Attributes:
        recipe: name of the recipe.
        system: name of the system that is identified, or None.
        corrects: name of the entry whose model a network corrects, or None.
    """

    recipe: str
    system: str | None = None
    corrects: str | None = None


ENTRIES = {
    "tustin-standard": Entry("paper-code-standard"),
    "tustin-transfer": Entry("paper-code-transfer"),
    "tustin-text-standard": Entry("paper-standard"),
    "tustin-text-transfer": Entry("paper-transfer"),
    "euler-lagrange": Entry("grey", system="qube-servo2"),
    "euler-lagrange-naive": Entry("grey", system="qube-servo2-naive"),
    "best-tustin": Entry("best-tustin"),
    "best-grey": Entry("best-grey", system="qube-servo2-memory"),
    "best-hybrid": Entry("best-hybrid", corrects="best-grey"),
    "gru": Entry("gru"),
    "neural-ode": Entry("neural-ode"),
    "linear": Entry("linear"),
}
AUTHORS = "authors"
ALL_MODELS = (AUTHORS, *ENTRIES)
EXTRA_MODELS = ("tustin-text-standard", "tustin-text-transfer", "gru", "neural-ode", "linear")
DEFAULT_MODELS = tuple(name for name in ALL_MODELS if name not in EXTRA_MODELS)
