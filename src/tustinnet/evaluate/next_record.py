"""What to record next: which of some proposed records would tell the most.

Of an identified system: how much the covariance of its parameters would shrink (D-optimality). Of
a committee: how much its members disagree on what would happen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import LARGEST, Experiment
from tustinnet.data.proposals import Proposal
from tustinnet.errors import InputError
from tustinnet.evaluate.bands import alternatives_of, guesses
from tustinnet.fitting.shooting.information import fisher_information, search_space_for
from tustinnet.models.contract import Model, require_float64, with_dtype
from tustinnet.models.groups import model_for_groups
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.simulate.input_signal import input_signals
from tustinnet.simulate.simulation import simulate_runs

_SHRUNK = 0.1  # of the correlations: those of few records leave directions without any error
COVARIANCE, DISAGREEMENT = "covariance of the parameters", "disagreement of the members"


@dataclass(frozen=True)
class Promise:
    """What a proposed record would tell.

    Attributes:
        name: the proposal.
        value: by which proposals are ranked, the more the better, NaN where the model cannot
            simulate it: nats, half the logarithm of the covariance's determinant before over
            after; or the root mean square difference of the members' free runs from that of all
            [rad or m].
        words: what it says most of.
    """

    name: str
    value: float
    words: str


@dataclass(frozen=True)
class Ranking:
    """Proposals, the one that tells the most first.

    Attributes:
        criterion: what they are ranked by.
        unit: of the values.
        promises: of each proposal.
    """

    criterion: str
    unit: str
    promises: tuple[Promise, ...]

    def as_plain(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "criterion": self.criterion,
            "unit": self.unit,
            "proposals": [vars(of) for of in self.promises],
        }


def ranked(
    model: Model,
    header: Mapping[str, Any],
    proposals: Sequence[Proposal],
    *,
    horizon: float | None = None,
) -> Ranking:
    """Ranks proposed records by what they would tell.

    Args:
        model: the model.
        header: what its file says; of an identified system its parameters' errors.
        proposals: the records that could be made.
        horizon: over how long members' free runs are compared [s], each from where the committee
            is; None for whole records. Means nothing to an identified system.

    Raises:
        InputError: a model that knows nothing of its errors, or can simulate none of them.
    """
    require_float64("next-record")
    imagined = _imagined(model, proposals)
    records = [e for e in imagined.values() if e is not None]
    found = header.get("identification")
    if found and horizon is not None:
        raise InputError("--horizon", "means nothing to an identified system", "a committee")
    if found:
        criterion, unit, promises = COVARIANCE, "nats", _shrinking(model, found, records)
    else:
        promises = _differing(model, header, records, horizon)
        criterion, unit = DISAGREEMENT, model.channels.unit
    known = sorted((of for of in promises if np.isfinite(of.value)), key=lambda of: -of.value)
    if not known:
        raise InputError(
            "next-record", "no proposal that the model can simulate to finite numbers",
            "one at least", "fit it to more records, or propose gentler ones",
        )  # fmt: skip
    others = [name for name in imagined if name not in {of.name for of in known}]
    lost = [Promise(name, float("nan"), "the model cannot simulate it") for name in others]
    return Ranking(criterion, unit, (*known, *lost))


def _imagined(model: Model, proposals: Sequence[Proposal]) -> dict[str, Experiment | None]:
    """What the model says would be recorded, None where it runs away."""
    of, found = model.channels, {}
    simulators: dict[frozenset[tuple[str, str]], Model] = {}
    for p in proposals:
        n, groups = len(p.u), frozenset(p.groups.items())
        if groups not in simulators:
            chosen = model_for_groups(model, p.groups, p.name)
            simulators[groups] = with_dtype(chosen, np.float64).simplify()
        simulator = simulators[groups]
        blank = Experiment(
            name=p.name, t=np.arange(n) * of.dt, q=np.zeros((n, of.n_q)), u=p.u, channels=of,
            v=np.zeros((n, of.n_q)), v_measured=True, groups=tuple(p.groups.items()),
        )  # fmt: skip
        x0 = np.asarray(simulator.initial_state(jnp.concatenate([p.q, p.v])))[None]
        x = np.asarray(simulate_runs(simulator, x0, input_signals(simulator, [blank])))[0]
        sound = (np.abs(x) <= LARGEST).all()  # False of what is no number
        found[p.name] = replace(blank, q=x[:, of.position], v=x[:, of.velocity]) if sound else None
    return found


def _shrinking(
    model: Model, told: Mapping[str, Any], records: Sequence[Experiment]
) -> list[Promise]:
    """By how much the covariance of an identified system's parameters would shrink."""
    if not records:
        return []
    assert isinstance(model, Discretised)
    continuous = model.continuous
    assert isinstance(continuous, LagrangianModel)
    values = {name: float(x) for name, x in continuous.values.items()}
    kept = [i for i, e in enumerate(told["estimates"]) if e["error"] and e["name"] in values]
    if not kept:
        raise InputError("next-record", "a model whose parameters have no errors",
                         "one whose parameters have some", "fit it to more records")  # fmt: skip
    estimates = [told["estimates"][i] for i in kept]
    names = [e["name"] for e in estimates]
    space = search_space_for(continuous.system, values, names)
    order = [names.index(name) for name in space.names]
    covariance = _covariance(told, kept, order) / np.outer(
        *[space.derivatives(space.to_vector(values))] * 2
    )
    # residuals of a record are not independent: it counts as much less as the errors say
    ratios = [e["naive_error"] / e["error"] for e in estimates if e["naive_error"]]
    counts = min(float(np.median(ratios)) ** 2, 1.0) if ratios else 1.0
    n_q = model.channels.n_q
    deviation = float(np.sqrt(np.mean(np.square(list(told["residual_rmse"].values()))) / n_q))
    found = fisher_information(
        space, continuous.system, values, records, model.substeps, max(deviation, 1e-12)
    )
    return [_promise(e.name, space.names, covariance, counts * f)
            for e, f in zip(records, found, strict=True)]  # fmt: skip


def _covariance(
    told: Mapping[str, Any], kept: Sequence[int], order: Sequence[int]
) -> Float[np.ndarray, "n_p n_p"]:
    """Of the estimates that have errors, as the model's fit found it."""
    of = np.asarray(kept)[np.asarray(order)]
    correlation = np.nan_to_num(np.array(told["correlation"], float))[np.ix_(of, of)]
    errors = np.array([told["estimates"][i]["error"] for i in of])
    shrunk = (1 - _SHRUNK) * correlation + _SHRUNK * np.eye(len(of))
    return shrunk * np.outer(errors, errors)


def _promise(name: str, names: Sequence[str], covariance: np.ndarray, added: np.ndarray) -> Promise:
    root = np.linalg.cholesky(covariance + 1e-12 * np.diag(np.diag(covariance)))
    inner = np.eye(len(root)) + root.T @ added @ root
    if not np.isfinite(inner).all():
        return Promise(name, float("nan"), "")
    gain = float(np.linalg.slogdet(inner)[1]) / 2
    after = root @ np.linalg.solve(inner, root.T)
    left = np.sqrt(np.diag(after) / np.diag(covariance))
    best = int(np.argmin(left))
    return Promise(name, gain, f"error of {names[best]} to {100 * left[best]:.0f} %")


def _differing(
    model: Model, header: Mapping[str, Any], records: Sequence[Experiment], horizon: float | None
) -> list[Promise]:
    """How much the members' free runs differ."""
    others = alternatives_of(model, header, "next-record")
    found = []
    for guess in guesses(model, others, records, "file", horizon=horizon) if records else ():
        each = np.sqrt(np.mean(guess.spread**2, axis=0))
        worst = int(np.argmax(each))
        most = model.channels.coordinates[worst]
        words = f"{most.name} differs by {each[worst]:.3g} {most.unit}"
        found.append(Promise(guess.record, float(np.sqrt(np.sum(each**2))), words))
    return found
