"""Everything that is known of columns, and what is chosen from it: the values of a draft."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tustinnet.channels import Kind
from tustinnet.data.drafting.assignment import Verdict
from tustinnet.data.drafting.names import NameReading
from tustinnet.data.drafting.numbers import Numbers, Values
from tustinnet.data.drafting.relations import Slopes


@dataclass(frozen=True)
class Question:
    """Question on what the columns do not say.

    Attributes:
        key: name of the answer.
        text: the question.
        assumption: the answer that is taken without another one.
        options: answers that are possible, () for any text or number.
        is_number: whether the answer is a positive number.
    """

    key: str
    text: str
    assumption: str
    options: tuple[str, ...] = ()
    is_number: bool = False


@dataclass(frozen=True)
class VelocityChoice:
    """The velocity column of a coordinate; attributes as in the card."""

    column: str
    unit: str | None
    measured: bool
    because: str


@dataclass(frozen=True)
class CoordinateChoice:
    """A coordinate of the draft.

    Attributes:
        column: its column.
        name: its name.
        kind: angular or linear.
        unit: its unit as the card has it.
        counts: encoder counts in a turn, None where not known.
        resolution: encoder count [rad or m], None where not known.
        sine: column of the sine of an angle whose cosine the column has, None otherwise.
        wraps: whether jumps of more than half a turn are taken for wraps.
        velocity: its velocity column, if there is one.
        because: the reasons, a sentence each.
        doubts: what to check, a sentence each.
        assumed: keys of the card that neither a name nor the numbers say.
    """

    column: str
    name: str
    kind: Kind
    unit: str
    counts: int | None = None
    resolution: float | None = None
    velocity: VelocityChoice | None = None
    because: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    sine: str | None = None
    wraps: bool = True


@dataclass(frozen=True)
class InputChoice:
    """An input of the draft; attributes as those of a coordinate."""

    column: str
    name: str
    unit: str
    because: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    scale: float = 1.0


@dataclass
class Choice:
    """Coordinates, inputs, columns that are not used, and open questions.

    Attributes:
        coordinates: the coordinates in the order of their columns.
        inputs: the inputs.
        unused: the reason for each column that is not used.
        questions: what the columns do not say.
        missing: sentences on coordinates and inputs of a system that have no column.
    """

    coordinates: list[CoordinateChoice] = field(default_factory=list)
    inputs: list[InputChoice] = field(default_factory=list)
    unused: dict[str, str] = field(default_factory=dict)
    questions: list[Question] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    @property
    def motion(self) -> list[str]:
        """The columns of positions and of velocities."""
        velocities = (c.velocity for c in self.coordinates)
        positions = (n for c in self.coordinates for n in (c.column, c.sine) if n is not None)
        return [*positions, *(v.column for v in velocities if v)]


@dataclass(frozen=True)
class Findings:
    """Knowledge of the columns from which channels are chosen.

    Attributes:
        readings: the meaning of their names.
        numbers: properties of their numbers; of a cosine, of its angle.
        samples: their samples without wraps, record by record; of a cosine, of its angle.
        times: the times of each record [s].
        slopes: comparison of changes with integrals.
        verdicts: their roles.
        answers: answers to questions.
        by_motion: answers that the motion of the records shows.
        sines: the column of the sine of each column that is the cosine of an angle.
    """

    readings: Mapping[str, NameReading]
    numbers: Mapping[str, Numbers]
    samples: Mapping[str, Sequence[Values]]
    times: Sequence[Values]
    slopes: Slopes
    verdicts: Mapping[str, Verdict]
    answers: Mapping[str, str]
    by_motion: Mapping[str, str] = field(default_factory=dict)
    sines: Mapping[str, str] = field(default_factory=dict)

    def answer(self, key: str) -> tuple[str, str] | None:
        """The answer to a question and where it is from; None where it is open."""
        if key in self.answers:
            return self.answers[key], "as you say"
        return (self.by_motion[key], "as the motion shows") if key in self.by_motion else None

    def columns(self, role: str) -> list[str]:
        """The columns of a role, in the order of the file."""
        return [name for name, verdict in self.verdicts.items() if verdict.role == role]


def range_text(numbers: Numbers) -> str:
    """The range of a column in words."""
    low, high = numbers.range or (np.nan, np.nan)
    return f"{low:.4g} .. {high:.4g}"
