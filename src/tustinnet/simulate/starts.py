"""Where a free run starts: the state at a sample of a record, guessed from samples around it.

A start is one class here and one entry of `STARTS`.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import scales_of
from tustinnet.engine.equations import Formula
from tustinnet.engine.runs import evaluate
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.signals.derivatives import polynomial_fit
from tustinnet.simulate.along import followed
from tustinnet.simulate.batches import in_batches
from tustinnet.simulate.drive import drives_of
from tustinnet.simulate.simulation import beginnings, simulated
from tustinnet.simulate.state_fits import FEWEST, fitted_states, fitted_states_in_training

DERIVED = 6  # samples of the usual parabola
FITTED = 20  # samples that a state is usually fitted to
_FEWEST_DERIVED = 3


@dataclass(frozen=True)
class Start(ABC):
    """A rule that guesses the state at a sample of a record.

    Attributes:
        samples: how many samples it is given, from the record's first on.
    """

    pattern: ClassVar[str]
    usual: ClassVar[int] = 1  # samples, where the name says none

    samples: int

    @property
    @abstractmethod
    def name(self) -> str:
        """What scores call it."""

    @property
    def first(self) -> int:
        """The sample at which the free run begins."""
        return 0

    @property
    def fitted(self) -> int:
        """Samples that any model then simulates well, because the state was chosen for them."""
        return 0

    @abstractmethod
    def material(self, model: Model, experiments: Sequence[Experiment]) -> Any:
        """What `states` needs of records, arrays with the record first.

        Raises:
            InputError: a record that does not have what the start asks for.
        """

    def states(self, model: Model, material: Any) -> Float[Array, "records n_x"]:
        """The states; can be compiled, and differentiated by the model.

        Here of positions and velocities, (records, 2 n_q), with the internal states that the model
        expects there.
        """
        return jax.vmap(model.initial_state)(jnp.asarray(material))

    def estimated(self, model: Model, material: Any) -> Float[np.ndarray, "records n_x"]:
        """The states, by the engine: what `states` computes, for models that are not trained."""
        return beginnings(model, np.asarray(material))


class Stored(Start):
    """`file`: the first row as it is stored, velocities included."""

    pattern: ClassVar[str] = r"file"

    @property
    def name(self) -> str:
        """`file`."""
        return "file"

    def material(self, model: Model, experiments: Sequence[Experiment]) -> Any:
        """The first rows."""
        return np.stack([_stored(e) for e in experiments])


class Derived(Start):
    """`derived-N`: the least-squares parabola through the first N samples, at their times."""

    pattern: ClassVar[str] = r"derived-(\d+)"

    @property
    def name(self) -> str:
        """`derived-N`."""
        return f"derived-{self.samples}"

    def material(self, model: Model, experiments: Sequence[Experiment]) -> Any:
        """Values and slopes at the first sample."""
        for e in experiments:
            _require_samples(e, self.name, self.samples, _FEWEST_DERIVED, "the parabola")
        return np.stack([parabola(e, 0, self.samples) for e in experiments])


class Fitted(Start):
    """`model-N`: the state from which the model explains the first N samples best."""

    pattern: ClassVar[str] = r"model-(\d+)"

    @property
    def name(self) -> str:
        """`model-N`."""
        return f"model-{self.samples}"

    @property
    def fitted(self) -> int:
        """All N."""
        return self.samples

    def material(self, model: Model, experiments: Sequence[Experiment]) -> Any:
        """Where the search begins, parabolas; the inputs and positions of the first samples."""
        for e in experiments:
            _require_samples(e, self.name, self.samples, FEWEST, "the fit")
        reach = min(self.samples, DERIVED)
        guess = np.stack([parabola(e, 0, reach) for e in experiments])
        drive = drives_of(model, experiments, slice(self.samples))
        return guess, drive, np.stack([e.q[: self.samples] for e in experiments])

    def states(self, model: Model, material: Any) -> Float[Array, "records n_x"]:
        """Least squares through the model, see `fitted_states`."""
        guess, drive, q = material
        return fitted_states_in_training(model, super().states(model, guess), drive, q)

    def estimated(self, model: Model, material: Any) -> Float[np.ndarray, "records n_x"]:
        """Least squares through the model, see `fitted_states`."""
        guess, drive, q = material
        return fitted_states(model, beginnings(model, guess), drive, q)


class _AfterSamples(Start):
    """A start that uses N samples and begins the free run at the last of them."""

    @property
    def first(self) -> int:
        """The last of the N samples."""
        return self.samples - 1

    @property
    def fitted(self) -> int:
        """All N."""
        return self.samples


class WarmUp(_AfterSamples):
    """`warm-up-N`: internal states follow the first N samples; the run begins at the last of them.

    Positions and velocities there are those of the parabola through the 6 samples up to it, so
    that nothing later is used. For models whose internal states say what the past was.
    """

    pattern: ClassVar[str] = r"warm-up-(\d+)"

    @property
    def name(self) -> str:
        """`warm-up-N`."""
        return f"warm-up-{self.samples}"

    def material(self, model: Model, experiments: Sequence[Experiment]) -> Any:
        """Positions and velocities along the first N samples, and the inputs."""
        for e in experiments:
            _require_samples(e, self.name, self.samples, DERIVED, "the warm-up")
        heads = [e[: self.samples] for e in experiments]
        known = [e.measured_states("stencil") for e in heads]
        for x, e in zip(known, heads, strict=True):
            x[-1] = parabola(e, self.first, DERIVED)
        return np.stack(known), drives_of(model, experiments, slice(self.samples))

    def states(self, model: Model, material: Any) -> Float[Array, "records n_x"]:
        """The measured state with the internal states that the samples led to."""
        known, drive = material
        run = followed(model, jnp.asarray(known), drive)
        internal = run[:, -1, model.channels.internal]
        return jnp.concatenate([jnp.asarray(known)[:, -1].astype(run.dtype), internal], axis=1)

    def estimated(self, model: Model, material: Any) -> Float[np.ndarray, "records n_x"]:
        """The measured state with the internal states that the samples led to."""
        known, drive = material
        run = simulated(model, beginnings(model, known[:, 0]), drive, known)
        return np.concatenate([known[:, -1], run[:, -1, model.channels.internal]], axis=1)


class Encoder(_AfterSamples):
    """`encoder-N`: the model's encoder says the state at the last of the first N samples.

    The run begins there. For models that were trained with this start.
    """

    pattern: ClassVar[str] = r"encoder(?:-(\d+))?"
    usual: ClassVar[int] = FITTED

    @property
    def name(self) -> str:
        """`encoder-N`."""
        return f"encoder-{self.samples}"

    def material(self, model: Model, experiments: Sequence[Experiment]) -> Any:
        """Positions of the first N samples, and the inputs."""
        known = None if model.encoder is None else model.encoder.samples
        if known != self.samples:
            has = f"with an encoder of {known} samples" if known else "without encoder"
            usual = f"use the start 'encoder-{known}'" if known else "use the start 'model-20'"
            raise InputError(
                "start", f"'{self.name}' for a model {has}", f"a model trained with `start = "
                f'"{self.name}"`', usual,
            )  # fmt: skip
        for e in experiments:
            _require_samples(e, self.name, self.samples, 1, "the encoder")
        q = np.stack([e.q[: self.samples] for e in experiments])
        return q, drives_of(model, experiments, slice(self.samples)).u

    def states(self, model: Model, material: Any) -> Float[Array, "records n_x"]:
        """What the encoder says."""
        assert model.encoder is not None
        q, u = (jnp.asarray(a) for a in material)
        return jax.vmap(partial(model.encoder, model.channels))(q, u)

    def estimated(self, model: Model, material: Any) -> Float[np.ndarray, "records n_x"]:
        """What the encoder says."""
        encoder, channels = model.encoder, model.channels
        assert encoder is not None
        q, u = (np.asarray(a, np.float64) for a in material)
        points = np.concatenate([q.reshape(len(q), -1), u.reshape(len(u), -1)], axis=1)
        size = q[0].size

        def estimate(point: Array) -> Array:
            return encoder(
                channels, point[:size].reshape(q.shape[1:]), point[size:].reshape(u.shape[1:])
            )

        return evaluate(Formula(estimate, points.shape[1], where="the encoder"), points)


STARTS: tuple[type[Start], ...] = (Stored, Derived, Fitted, WarmUp, Encoder)


def start_named(name: str, where: object = "start") -> Start:
    """A start by its name: `file`, `derived-6`, `model-20`, `warm-up-20`, `encoder-20`.

    Any number may stand in its place; `encoder` is `encoder-20`.

    Args:
        name: the name.
        where: what names it, for messages; empty in a declaration, which says the key itself.

    Raises:
        InputError: no such start.
    """
    for kind in STARTS:
        match = re.fullmatch(kind.pattern, name)
        if match:
            number = match[1] if match.groups() else None
            return kind(kind.usual if number is None else int(number))
    raise InputError(
        where,
        f"unknown start '{name}'",
        "'file', 'derived-N' such as derived-6, 'model-N' such as model-20, 'warm-up-N' or "
        "'encoder-N'",
    )


def default_start(experiments: Sequence[Experiment], *models: Model) -> str:
    """The start that is used where nobody names one, the same for all of some models.

    The encoder, where every model has one of as many samples; a warm-up where a model needs one;
    else `file` where every record stores velocities; else `derived-6`, or `model-20` where a
    coordinate swings with few samples in a period: a parabola through 6 samples is then far from
    the motion.
    """
    encoders = {model.encoder.samples if model.encoder else 0 for model in models}
    if len(encoders) == 1 and max(encoders):
        return Encoder(max(encoders)).name
    warm_up = max((model.warm_up for model in models), default=0)
    if warm_up:
        return WarmUp(warm_up).name
    if all(e.v is not None for e in experiments):
        return "file"
    long = min(map(len, experiments)) >= 2 * FITTED
    fast = long and any(scales.fast for scales in scales_of(experiments).values())
    return (Fitted(FITTED) if fast else Derived(DERIVED)).name


def start_states(
    model: Model, experiments: Sequence[Experiment], start: str | Start
) -> Float[np.ndarray, "records n_x"]:
    """Where the free runs of records start, (records, n_x).

    Args:
        model: the model.
        experiments: the records.
        start: a start, or the name of one.

    Raises:
        InputError: an unknown start, or records too short for it.
    """
    rule = start_named(start) if isinstance(start, str) else start

    def of_batch(own: Model, some: Sequence[Experiment]) -> Float[np.ndarray, "records n_x"]:
        return rule.estimated(own, rule.material(own, some))

    return np.stack(in_batches(model, experiments, of_batch))


def initial_state(experiment: Experiment, start: str) -> Float[np.ndarray, " n_x"]:
    """The initial state of a record's free run without a model, [q, v], (2 n_q,).

    Args:
        experiment: the record.
        start: `file`, the first row as it is stored, velocities included; or `derived-N`, the
            least-squares parabola through the first N samples (6 is usual).

    Raises:
        InputError: an unknown start, no velocities for `file`, too few samples for `derived-N`.
    """
    rule = start_named(start)
    if rule.fitted:
        raise InputError(
            "start", f"'{start}' without a model", "'file', 'derived-N' such as derived-6",
            "use start_states",
        )  # fmt: skip
    if isinstance(rule, Stored):
        return _stored(experiment)
    _require_samples(experiment, rule.name, rule.samples, _FEWEST_DERIVED, "the parabola")
    return parabola(experiment, 0, rule.samples)


def parabola(e: Experiment, k: int, samples: int) -> Float[np.ndarray, " n"]:
    """Value and slope at sample k of the least-squares parabola through so many samples there.

    At the beginning of a record these are the first ones, else those up to sample k.
    """
    near = slice(max(0, k + 1 - samples), max(k + 1, samples))
    q, v = polynomial_fit(e.t[near], e.q[near], 2, at=e.t[k : k + 1])
    return np.concatenate([q[0], v[0]])


def _stored(e: Experiment) -> Float[np.ndarray, " n"]:
    if e.v is None:
        raise InputError(
            e.name,
            "start 'file' without velocity columns",
            "velocities in the file",
            f"use the start '{Derived(DERIVED).name}'",
        )
    return np.concatenate([e.q[0], e.v[0]])


def _require_samples(e: Experiment, name: str, samples: int, fewest: int, what: str) -> None:
    if samples < fewest:
        raise InputError("start", f"'{name}'", f"at least {fewest} samples for {what}")
    if samples > len(e):
        raise InputError(
            e.name, f"{len(e)} samples", f"at least {samples} for the start '{name}'",
            "leave the record out, or take another start",
        )  # fmt: skip
