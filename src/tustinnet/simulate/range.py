"""Where records lie: the smallest and largest states and inputs, and what came together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.spatial
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import convert_errors
from tustinnet.models.contract import Model
from tustinnet.simulate.along import states_along

KEY = "range"  # in headers of model files
_POINTS = 300  # of a cloud
_TRIED = 4000  # samples that they are taken from, at most
_DIGITS = 3  # of their numbers
_MARGIN = 0.1  # of the span, beyond which a value counts as outside
_LEAST = 1e-9  # span of what never moved


@dataclass(frozen=True)
class Cloud:
    """What positions, velocities and inputs of records came together.

    Attributes:
        points: some of them, that no other is far from, in units of their spread; of angles sine
            and cosine, (k, n_features).
        spread: these units, (n_features,).
        reach: how far from the nearest point a record is that was not among them.
    """

    points: Float[np.ndarray, "k n_features"]
    spread: Float[np.ndarray, " n_features"]
    reach: float

    def distance(self, features: Float[np.ndarray, "n n_features"]) -> Float[np.ndarray, " n"]:
        """How far from the nearest point, in times of `reach`, (n,)."""
        return _nearest(features / self.spread, self.points) / self.reach


@dataclass(frozen=True)
class Left:
    """Where a free run leaves what was recorded.

    Attributes:
        sample: the first one outside.
        what: the coordinate, velocity or input that is farthest outside, or "" where each by
            itself was recorded, but not together.
        value: the farthest value of it; of what did not come together how far it is from what
            was recorded, in times of the usual distance.
        recorded: its smallest and largest recorded value.
    """

    sample: int
    what: str
    value: float
    recorded: tuple[float, float]


@dataclass(frozen=True)
class Range:
    """Smallest and largest values along records.

    Attributes:
        states: of [q, v, z], (n_x, 2).
        inputs: (n_u, 2).
        cloud: what came together, None of one record and in older files.
    """

    states: Float[np.ndarray, "n_x 2"]
    inputs: Float[np.ndarray, "n_u 2"]
    cloud: Cloud | None = None

    def as_header(self) -> dict[str, Any]:
        """The same as plain values, as model files have it."""
        told: dict[str, Any] = {"states": self.states.tolist(), "inputs": self.inputs.tolist()}
        if self.cloud is not None:
            told["cloud"] = {
                "points": np.round(self.cloud.points, _DIGITS).tolist(),
                "spread": self.cloud.spread.tolist(),
                "reach": self.cloud.reach,
            }
        return told

    def left(
        self,
        channels: Channels,
        states: Float[np.ndarray, "n n_x"],
        u: Float[np.ndarray, "n n_u"],
    ) -> Left | None:
        """Where a free run leaves what was recorded; None where it does not.

        Values count as outside that are beyond the recorded ones by a tenth of their span;
        positions of angles only by what came together with them, as they may turn on.

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
        names += [c.name for c, is_linear in zip(channels.coordinates, linear, strict=True)
                  if is_linear]  # fmt: skip
        q, v = states[:, channels.position], states[:, channels.velocity]
        values = np.concatenate([v, u, q[:, linear]], axis=1)
        ends = np.concatenate([
            self.states[channels.velocity], self.inputs, self.states[channels.position][linear]
        ])  # fmt: skip
        span = np.maximum(np.ptp(ends, axis=1), _LEAST)
        with np.errstate(invalid="ignore"):
            beyond = np.maximum(ends[:, 0] - values, values - ends[:, 1]) / span
        beyond = np.where(np.isfinite(values), beyond, np.inf)
        apart = beyond.max(axis=1, initial=-np.inf) > _MARGIN
        far = np.zeros(len(values))
        if self.cloud is not None:
            finite = np.isfinite(values).all(axis=1)
            far[finite] = self.cloud.distance(features(channels, states, u)[finite])
        outside = np.flatnonzero(apart | (far > 1))
        if not len(outside):
            return None
        if not apart.any():
            return Left(int(outside[0]), "", float(far.max()), (0.0, 1.0))
        _, j = np.unravel_index(np.argmax(beyond), beyond.shape)
        k = int(np.argmax(beyond[:, j]))
        low, high = ends[j].tolist()
        return Left(int(outside[0]), names[j], float(values[k, j]), (low, high))

    @classmethod
    def from_header(cls, header: Mapping[str, Any], model: Model) -> "Range | None":
        """What the header of a model's file says; None where it says nothing.

        Args:
            header: the whole header.
            model: the model of the file.

        Raises:
            InputError: it says something that is no range of this model.
        """
        told = header.get(KEY)
        if told is None:
            return None
        n_x, n_u = model.state_size, model.channels.n_u
        expected = f"smallest and largest values of {n_x} states and {n_u} inputs"
        with convert_errors(KEY, "no range of the model", expected):
            states, inputs = (np.array(told[part], float) for part in ("states", "inputs"))
            found = cls(states.reshape(n_x, 2), inputs.reshape(n_u, 2), _cloud_from(told, model))
        # internal states of a model that diverged are no numbers along its records
        return found if all(np.isfinite(e).all() for e in (states, inputs)) else None


def range_of(model: Model, experiments: Sequence[Experiment], cloud: Cloud | None = None) -> Range:
    """Where records lie, internal states as the model has them along the records.

    Args:
        model: the model.
        experiments: the records.
        cloud: what came together in them, where it is known: it is the same for every model.
    """
    states = np.concatenate(states_along(model, experiments))
    inputs = np.concatenate([e.u for e in experiments])
    known = cloud_of(model.channels, experiments) if cloud is None else cloud
    return Range(_ends(states), _ends(inputs), known)


def joined(ranges: Sequence[Range], channels: Channels) -> Range:
    """The range of models that step together, their internal states one after the other.

    What came together is known where all are of the same records.

    Args:
        ranges: of each model.
        channels: what they share.
    """
    measured = [of.states[channels.measured] for of in ranges]
    internal = [of.states[channels.internal] for of in ranges]
    clouds = [of.cloud for of in ranges if of.cloud is not None]
    same = len(clouds) == len(ranges) and all(
        np.array_equal(cloud.points, clouds[0].points) for cloud in clouds
    )
    return Range(
        np.concatenate([_around(measured), *internal]),
        _around([of.inputs for of in ranges]),
        clouds[0] if same else None,
    )


def _around(ends: Sequence[Float[np.ndarray, "c 2"]]) -> Float[np.ndarray, "c 2"]:
    low, high = np.moveaxis(np.stack(ends), -1, 0)
    return np.stack([low.min(axis=0), high.max(axis=0)], axis=1)


def _ends(signals: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "c 2"]:
    return np.stack([signals.min(axis=0), signals.max(axis=0)], axis=1)


def cloud_of(channels: Channels, experiments: Sequence[Experiment]) -> Cloud | None:
    """What came together in records; None of a single one.

    The reach is the largest distance of any record from the points of the others.

    Args:
        channels: of the model.
        experiments: the records.
    """
    if len(experiments) < 2:  # nothing says how far another record would be
        return None
    every = [features(channels, e.measured_states(), e.u) for e in experiments]
    step = max(1, sum(map(len, every)) // _TRIED)
    some = [of[::step] for of in every]
    spread = np.maximum(np.concatenate(some).std(axis=0), _LEAST)
    some = [of / spread for of in some]
    away = []
    for i, own in enumerate(some):
        others = np.concatenate([of for j, of in enumerate(some) if j != i])
        away.append(_nearest(own, _spread_out(others)).max())
    reach = max(float(max(away)), _LEAST)
    return Cloud(_spread_out(np.concatenate(some)), spread, reach)


def features(
    channels: Channels, states: Float[np.ndarray, "n n_x"], u: Float[np.ndarray, "n n_u"]
) -> Float[np.ndarray, "n n_features"]:
    """Linear positions, sine and cosine of angles, velocities, inputs, (n, n_features)."""
    q, angles = states[:, channels.position], channels.angular
    parts = [q[:, ~angles], np.sin(q[:, angles]), np.cos(q[:, angles])]
    return np.concatenate([*parts, states[:, channels.velocity], u], axis=1)


def _spread_out(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "k d"]:
    """Points of a set that no other is far from: each the farthest from those before it.

    References:
        Gonzalez (1985), Clustering to minimize the maximum intercluster distance.
    """
    chosen, far = [0], np.sum((points - points[0]) ** 2, axis=1)
    while len(chosen) < min(_POINTS, len(points)):
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.sum((points - points[chosen[-1]]) ** 2, axis=1))
    return points[chosen]


def _nearest(
    values: Float[np.ndarray, "n d"], points: Float[np.ndarray, "k d"]
) -> Float[np.ndarray, " n"]:
    return scipy.spatial.KDTree(points).query(values)[0]


def _cloud_from(told: Mapping[str, Any], model: Model) -> Cloud | None:
    of = told.get("cloud")
    if of is None:
        return None
    channels = model.channels
    size = channels.n_q + int(channels.angular.sum()) + channels.n_q + channels.n_u
    points = np.array(of["points"], float).reshape(-1, size)
    return Cloud(points, np.array(of["spread"], float).reshape(size), float(of["reach"]))
