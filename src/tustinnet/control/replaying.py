"""Logs of closed loops: what a controller would have commanded, and what its model missed."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.control.controller import Controller
from tustinnet.control.controllers import feedback_controller
from tustinnet.control.disturbances import DisturbedModel, observe_disturbances
from tustinnet.control.dynamics import InputLimits
from tustinnet.control.estimator import ExtendedKalmanFilter
from tustinnet.control.lqr import Feedback, Tracking
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError, convert_errors
from tustinnet.models.contract import Model, require_fit
from tustinnet.shown import Brief
from tustinnet.simulate.filtering import FilterNoise


@dataclass(frozen=True, repr=False)
class Replay(Brief):
    """A record of a machine, and what a controller makes of it.

    Attributes:
        record: the record.
        estimates: the states, (n, n_x).
        computed: the inputs that the controller commands at each sample, (n, n_u).
        late: samples by which the record's inputs follow them best.
        disturbance: mean of a constant disturbance beside each input that explains what the model
            misses, (n_u,).
        unused: positions that the estimator could not use.
    """

    record: Experiment
    estimates: Float[np.ndarray, "n n_x"]
    computed: Float[np.ndarray, "n n_u"]
    late: int
    disturbance: Float[np.ndarray, " n_u"]
    unused: int

    @property
    def difference(self) -> Float[np.ndarray, "samples n_u"]:
        """The record's inputs less those that the controller commands, `late` samples before."""
        return self.record.u[self.late :] - self.computed[: len(self.computed) - self.late]

    @property
    def is_foreign(self) -> bool:
        """Whether the controller explains so little of the inputs that another one made them."""
        return bool(np.mean(self.difference**2) > 0.25 * np.mean(self.record.u**2))


def replay(
    gains: Feedback | Tracking,
    model: Model,
    noise: FilterNoise,
    record: Experiment,
    controller: Controller | None = None,
) -> Replay:
    """Plays a controller and its estimator along a record, whose inputs drive the estimator.

    The controller begins at the first sample, and has its own earlier commands.

    Args:
        gains: the numbers of the controller.
        model: the model of its estimator.
        noise: the noise that this assumes.
        record: a record of the machine, mostly of the closed loop.
        controller: what computes the inputs; None for feedback by the gains.

    Raises:
        InputError: a record of other coordinates, inputs or period, or gains of another model.
    """
    require_fit(model, record)
    final = gains.final
    if len(final.x0) != model.state_size:
        raise InputError(
            "replay", f"gains of {len(final.x0)} states", f"{model.state_size} as the model has"
        )
    controller = controller or feedback_controller(gains)
    controller.reset()
    estimator = ExtendedKalmanFilter(model, noise, delay=final.delay)
    estimates = _estimates(estimator, record)
    computed = np.stack([controller.inputs(k, x) for k, x in enumerate(estimates)])
    observed, its_noise = model, noise
    if not isinstance(model, DisturbedModel):
        observed = observe_disturbances(model, InputLimits(final.lower, final.upper))
        spread = np.asarray(observed.spread)
        its_noise = FilterNoise(
            np.concatenate([noise.start, spread]),
            # a disturbance changes by a hundredth of its expected size in a sample
            np.concatenate([noise.process, 0.01 * spread]),
            noise.measured,
        )
    n_u = len(final.u0)
    observer = ExtendedKalmanFilter(observed, its_noise, delay=final.delay)
    disturbances = _estimates(observer, record)[:, -n_u:]
    late = min(
        # samples by which the inputs of a log may stand late
        range(min(5, len(record) - 1) + 1),
        key=lambda k: float(np.mean((record.u[k:] - computed[: len(computed) - k]) ** 2)),
    )
    return Replay(
        record, estimates, computed, late, np.nanmean(disturbances, axis=0), estimator.unused
    )


def model_of(gains: Feedback | Tracking, model: Model) -> Model:
    """The model of the estimator of a controller: with disturbances where its gains have them."""
    final = gains.final
    if len(final.x0) == model.state_size + len(final.u0):
        return observe_disturbances(model, InputLimits(final.lower, final.upper))
    return model


def read_estimator(file: str | Path) -> tuple[FilterNoise, bool]:
    """Reads what the estimator of a controller assumes, and whether the controller is predictive.

    Args:
        file: the `design.json` of its folder.

    Raises:
        InputError: there is no such file, or it has no such noise.
    """
    path = Path(file)
    with convert_errors(path, "cannot be read", "the summary of a controller, as `control` writes"):
        summary = json.loads(path.read_text(encoding="utf-8"))
        noise = summary["estimator"]
        found = FilterNoise(
            *(np.array(noise[name], float) for name in ("start", "process", "measured"))
        )
    return found, bool(summary.get("predictive"))


def _estimates(estimator: ExtendedKalmanFilter, record: Experiment) -> Float[np.ndarray, "n n_x"]:
    first = estimator.reset(record.q[0])
    following = [estimator.update(y, u) for y, u in zip(record.q[1:], record.u[:-1], strict=True)]
    return np.stack([first, *following])
