"""A record as the checks look at it: with its velocities, its noise, and its lines in the card."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.check.levels import LEVELS
from tustinnet.data.card import Card, CoordinateCard, InputCard
from tustinnet.data.experiment import Experiment
from tustinnet.data.recording import Recording, describe_recording
from tustinnet.finding import Finding, make_finding
from tustinnet.signals import transients
from tustinnet.signals.outliers import sensor_noise
from tustinnet.words.sentence import Severity


@dataclass(frozen=True)
class RecordView:
    """A record with what several checks compute from it.

    Attributes:
        experiment: the record.
        card: its data card, None for a record that was made from arrays.
    """

    experiment: Experiment
    card: Card | None = None

    @cached_property
    def recording(self) -> Recording:
        """The time base and the encoders as logged."""
        e = self.experiment
        return e.recording or describe_recording(e.t, e.q, e.dt)

    @cached_property
    def samples(self) -> Float[np.ndarray, "n c"]:
        """Coordinates and inputs side by side, (n, n_q + n_u)."""
        return np.concatenate([self.experiment.q, self.experiment.u], axis=1)

    @cached_property
    def velocity(self) -> Float[np.ndarray, "n n_q"]:
        """Velocities from the positions by the five-point stencil, (n, n_q)."""
        e = self.experiment
        return e.velocities("stencil") if len(e) >= LEVELS.stencil else np.zeros_like(e.q)

    @cached_property
    def moving(self) -> Bool[np.ndarray, " n_q"]:
        """Mask of the coordinates that move."""
        return transients.is_moving(self.experiment.q) & ~self.flickers

    @cached_property
    def flickers(self) -> Bool[np.ndarray, " n_q"]:
        """Mask of the coordinates that flicker between two neighbouring counts."""
        e = self.experiment
        # what goes from one place to another in a sample does so once or twice
        return np.array(
            [
                len(np.unique(q)) == 2
                and (
                    np.count_nonzero(np.diff(q)) > 2
                    if c.resolution is None
                    else bool(np.ptp(q) < 1.5 * c.resolution)
                )
                for c, q in zip(e.coordinates, e.q.T, strict=True)
            ]
        )

    @cached_property
    def counts(self) -> list[float]:
        """Encoder count of each coordinate: found in the positions, else as declared, else 0."""
        declared = [c.resolution for c in self.experiment.coordinates]
        return [a or b or 0.0 for a, b in zip(self.recording.counts, declared, strict=True)]

    @cached_property
    def noise(self) -> Float[np.ndarray, " n_q"]:
        """Standard deviation of the white part of each coordinate, (n_q,) [rad or m]."""
        return sensor_noise(self.experiment.q, np.array(self.counts))

    def wild_share(self, j: int, factor: float = 1.0) -> float:
        """Share of the periods in which an angle moves by more than a quarter turn, if many.

        Args:
            j: the coordinate.
            factor: a scale that the angle would have.

        Returns:
            The share, 0 where it is small: an angle that is sampled well moves so rarely.
        """
        e = self.experiment
        share = float(np.mean(np.abs(np.diff(e.q[:, j])) * factor > np.pi / 2))
        return share if e.coordinates[j].kind == "angular" and share > LEVELS.wild else 0.0

    def seconds(self, sample: int) -> float:
        """Time of a sample from the first one on [s]."""
        return float(self.experiment.t[sample] - self.experiment.t[0])

    def channel_card(self, name: str) -> CoordinateCard | InputCard | None:
        """The block of a coordinate or input in the card."""
        blocks = (*self.card.coordinates, *self.card.inputs) if self.card else ()
        return next((block for block in blocks if block.name == name), None)

    def coordinate_card(self, j: int) -> CoordinateCard | None:
        """The block of a coordinate, by its index in the record, in the card."""
        block = self.channel_card(self.experiment.coordinates[j].name)
        return block if isinstance(block, CoordinateCard) else None

    def finding(
        self,
        code: str,
        mend: str,
        channel: str = "",
        time: float | None = None,
        *,
        severity: Severity | None = None,
        column: str = "",
        is_of_all: bool = False,
        **values: Any,
    ) -> Finding:
        """A finding in this record.

        Args:
            code: name of the check.
            mend: the line of the card.
            channel: name of a coordinate or input.
            time: where it begins [s].
            severity: its severity, where it is not the usual one of the check.
            column: the column of the log, where it is not that of the channel.
            is_of_all: whether it is about all records, not this one.
            values: what its sentence names.
        """
        finding = make_finding(code, **values)
        block = self.channel_card(channel)
        own_column = None if block is None else block.column
        return replace(
            finding,
            severity=severity or finding.severity,
            mend=mend,
            records=() if is_of_all else (self.experiment.name,),
            channel=channel,
            column=column or ("" if own_column is None else str(own_column)),
            time=time,
        )
