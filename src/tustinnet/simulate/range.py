"""Range of records: smallest and largest states and inputs, and states that the records had."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import convert_errors
from tustinnet.models.contract import Model
from tustinnet.simulate.along import states_along

KEY = "range"  # in headers of model files
_STATES = 200  # recorded states that are kept, at most
_MARGIN = 0.1  # of the span, beyond which a value counts as outside
_LEAST_SPAN = 1e-9  # span of what never moved
_LEAST_REACH = 1 / 3  # standard deviations, a tenth of the span of usual signals


@dataclass(frozen=True)
class TrainingSupport:
    """Points of positions, velocities and inputs that came together in records.

    Attributes:
        points: some of the samples, which no other is far from, in units of their spread; of
            angles sine and cosine, (k, n_features).
        spread: these units, (n_features,).
        reach: how far from the nearest point a record is that was not among them.
    """

    points: Float[np.ndarray, "k n_features"]
    spread: Float[np.ndarray, " n_features"]
    reach: float

    def distance(self, features: Float[np.ndarray, "n n_features"]) -> Float[np.ndarray, " n"]:
        """Distance from the nearest point, in multiples of `reach`, (n,)."""
        return _nearest(features / self.spread, self.points) / self.reach


@dataclass(frozen=True)
class ExtrapolationPoint:
    """The point at which a free run leaves the range of the records.

    Attributes:
        sample: the first sample outside.
        signal: the coordinate, velocity or input that is farthest outside, or "" where each by
            itself was recorded, but not together.
        value: its farthest value; where signals did not come together, their distance from the
            records, in multiples of the usual distance.
        recorded: its smallest and largest recorded value.
    """

    sample: int
    signal: str
    value: float
    recorded: tuple[float, float]


@dataclass(frozen=True)
class Range:
    """Smallest and largest values along records.

    Attributes:
        states: of [q, v, z], (n_x, 2).
        inputs: (n_u, 2).
        support: the points that came together, None of one record.
        recorded_states: positions and velocities at some samples of the records, (k, 2 n_q), None
            where they are not known.
    """

    states: Float[np.ndarray, "n_x 2"]
    inputs: Float[np.ndarray, "n_u 2"]
    support: TrainingSupport | None = None
    recorded_states: Float[np.ndarray, "k n_measured"] | None = None

    def as_header(self) -> dict[str, Any]:
        """The range as plain values for the header of a model file."""
        header: dict[str, Any] = {"states": self.states.tolist(), "inputs": self.inputs.tolist()}
        if self.support is not None:
            header["cloud"] = {
                "points": np.round(self.support.points, 3).tolist(),
                "spread": self.support.spread.tolist(),
                "reach": self.support.reach,
            }
        if self.recorded_states is not None:
            header["recorded_states"] = self.recorded_states.tolist()
        return header

    def share_of_spans(
        self, share: float, channels: Channels, largest_angle: float
    ) -> Float[np.ndarray, " n_q"]:
        """A share of the recorded span of each coordinate [rad or m], (n_q,).

        Args:
            share: the share.
            channels: of the model.
            largest_angle: the largest result of an angle [rad].
        """
        shares = share * np.ptp(self.states[channels.position], axis=1)
        return np.where(channels.angular, np.minimum(shares, largest_angle), shares)

    def extrapolation_point(
        self,
        channels: Channels,
        states: Float[np.ndarray, "n n_x"],
        u: Float[np.ndarray, "n n_u"],
    ) -> ExtrapolationPoint | None:
        """The point at which a free run leaves the range of the records; None where it does not.

        Values count as outside that are beyond the recorded ones by a tenth of their span;
        positions of angles only by the signals that came together with them, as they may turn on.

        Args:
            channels: of the model.
            states: the free run.
            u: its inputs.
        """
        names = [
            *(f"der_{c.name}" for c in channels.coordinates),
            *(i.name for i in channels.inputs),
        ]
        linear = ~channels.angular
        names += [
            c.name for c, is_linear in zip(channels.coordinates, linear, strict=True) if is_linear
        ]
        q, v = states[:, channels.position], states[:, channels.velocity]
        values = np.concatenate([v, u, q[:, linear]], axis=1)
        ends = np.concatenate(
            [self.states[channels.velocity], self.inputs, self.states[channels.position][linear]]
        )
        span = np.maximum(np.ptp(ends, axis=1), _LEAST_SPAN)
        with np.errstate(invalid="ignore"):
            beyond = np.maximum(ends[:, 0] - values, values - ends[:, 1]) / span
        beyond = np.where(np.isfinite(values), beyond, np.inf)
        outside_range = beyond.max(axis=1, initial=-np.inf) > _MARGIN
        distance = np.zeros(len(values))
        if self.support is not None:
            finite = np.isfinite(values).all(axis=1)
            distance[finite] = self.support.distance(features(channels, states, u)[finite])
        outside = np.flatnonzero(outside_range | (distance > 1))
        if not len(outside):
            return None
        if not outside_range.any():
            return ExtrapolationPoint(int(outside[0]), "", float(distance.max()), (0.0, 1.0))
        _, j = np.unravel_index(np.argmax(beyond), beyond.shape)
        k = int(np.argmax(beyond[:, j]))
        low, high = ends[j].tolist()
        return ExtrapolationPoint(int(outside[0]), names[j], float(values[k, j]), (low, high))

    @classmethod
    def from_header(cls, header: Mapping[str, Any], model: Model) -> "Range | None":
        """The range in the header of a model's file; None where it has none.

        Args:
            header: the whole header.
            model: the model of the file.

        Raises:
            InputError: a range that is not one of this model.
        """
        plain = header.get(KEY)
        if plain is None:
            return None
        channels, n_x, n_u = model.channels, model.state_size, model.channels.n_u
        expected = f"smallest and largest values of {n_x} states and {n_u} inputs"
        with convert_errors(KEY, "no range of the model", expected):
            states, inputs = (np.array(plain[part], float) for part in ("states", "inputs"))
            support, points = None, plain.get("cloud")
            if points is not None:
                size = channels.n_q + int(channels.angular.sum()) + channels.n_q + n_u
                support = TrainingSupport(
                    np.array(points["points"], float).reshape(-1, size),
                    np.array(points["spread"], float).reshape(size),
                    float(points["reach"]),
                )
            recorded = plain.get("recorded_states")
            if recorded is not None:
                recorded = np.array(recorded, float).reshape(len(recorded), channels.measured.stop)
                if not len(recorded) or not np.isfinite(recorded).all():
                    raise ValueError("recorded states that are not finite, or none")
            result = cls(states.reshape(n_x, 2), inputs.reshape(n_u, 2), support, recorded)
        # internal states of a model that diverged are no numbers along its records
        return result if all(np.isfinite(e).all() for e in (states, inputs)) else None


def recorded_range(
    model: Model, experiments: Sequence[Experiment], support: TrainingSupport | None = None
) -> Range:
    """The range of records, internal states as the model has them along the records.

    Args:
        model: the model.
        experiments: the records.
        support: their training support, if known: it is the same for every model.
    """
    states = np.concatenate(states_along(model, experiments))
    inputs = np.concatenate([e.u for e in experiments])
    if support is None:
        support = training_support(model.channels, experiments)
    recorded = _distinct_states(states[:, model.channels.measured])
    return Range(_ends(states), _ends(inputs), support, recorded)


def join_ranges(ranges: Sequence[Range], channels: Channels) -> Range:
    """The range of models that step together, their internal states one after the other.

    It has a training support where all are of the same records, and the recorded states of all
    where each has some.

    Args:
        ranges: the range of each model.
        channels: the channels that they share.
    """
    measured = [r.states[channels.measured] for r in ranges]
    internal = [r.states[channels.internal] for r in ranges]
    supports = [r.support for r in ranges if r.support is not None]
    is_shared = len(supports) == len(ranges) and all(
        np.array_equal(support.points, supports[0].points) for support in supports
    )
    recorded = [r.recorded_states for r in ranges if r.recorded_states is not None]
    return Range(
        np.concatenate([_enclosing(measured), *internal]),
        _enclosing([r.inputs for r in ranges]),
        supports[0] if is_shared else None,
        _distinct_states(np.unique(np.concatenate(recorded), axis=0))
        if len(recorded) == len(ranges)
        else None,
    )


def _distinct_states(states: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "k c"]:
    """States at regular distances, at most `_STATES`; in an order that depends on them alone."""
    return np.unique(states[:: -(-len(states) // _STATES)], axis=0)


def _enclosing(ends: Sequence[Float[np.ndarray, "c 2"]]) -> Float[np.ndarray, "c 2"]:
    low, high = np.moveaxis(np.stack(ends), -1, 0)
    return np.stack([low.min(axis=0), high.max(axis=0)], axis=1)


def _ends(signals: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "c 2"]:
    return np.stack([signals.min(axis=0), signals.max(axis=0)], axis=1)


def training_support(
    channels: Channels, experiments: Sequence[Experiment]
) -> TrainingSupport | None:
    """Points that came together in records; None of a single one.

    The reach is the largest distance of any record from the points of the others, at least a third
    of a standard deviation: of an experiment that was repeated it would be the noise.

    Args:
        channels: of the model.
        experiments: the records.
    """
    if len(experiments) < 2:  # nothing says how far another record would be
        return None
    by_record = [features(channels, e.measured_states(), e.u) for e in experiments]
    # from 4000 samples, at most, the points of a support are taken
    step = max(1, sum(map(len, by_record)) // 4000)
    by_record = [rows[::step] for rows in by_record]
    spread = np.maximum(np.concatenate(by_record).std(axis=0), _LEAST_SPAN)
    by_record = [rows / spread for rows in by_record]
    distances = []
    for i, rows in enumerate(by_record):
        others = np.concatenate([other for j, other in enumerate(by_record) if j != i])
        distances.append(_nearest(rows, _spread_points(others)).max())
    reach = max(float(max(distances)), _LEAST_REACH)
    return TrainingSupport(_spread_points(np.concatenate(by_record)), spread, reach)


def features(
    channels: Channels, states: Float[np.ndarray, "n n_x"], u: Float[np.ndarray, "n n_u"]
) -> Float[np.ndarray, "n n_features"]:
    """Linear positions, sine and cosine of angles, velocities, inputs, (n, n_features)."""
    q, angles = states[:, channels.position], channels.angular
    parts = [q[:, ~angles], np.sin(q[:, angles]), np.cos(q[:, angles])]
    return np.concatenate([*parts, states[:, channels.velocity], u], axis=1)


def _spread_points(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "k d"]:
    """Points of a set that no other is far from: each is the farthest from those before it.

    References:
        Gonzalez (1985), Clustering to minimize the maximum intercluster distance.
    """
    columns = np.ascontiguousarray(points.T)  # sums over a few columns take longer row by row

    def squared_distance(index: int) -> Float[np.ndarray, " n"]:
        return np.sum((columns - columns[:, index, None]) ** 2, axis=0)

    indices, distance = [0], squared_distance(0)
    # a support has 300 points
    while len(indices) < min(300, len(points)):
        indices.append(int(np.argmax(distance)))
        distance = np.minimum(distance, squared_distance(indices[-1]))
    return points[indices]


def _nearest(
    values: Float[np.ndarray, "n d"], points: Float[np.ndarray, "k d"]
) -> Float[np.ndarray, " n"]:
    import scipy.spatial  # takes time to load, and few calls need it

    return scipy.spatial.KDTree(points).query(values)[0]
