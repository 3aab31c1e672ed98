"""Ranking of proposed records by the information that recording them would give.

For an identified system: how much the covariance of its parameters would shrink (D-optimality).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import LARGEST, Experiment
from tustinnet.errors import InputError, convert_errors
from tustinnet.fitting.shooting.information import fisher_information, search_space_for
from tustinnet.fitting.shooting.space import SearchSpace
from tustinnet.models.contract import Model, require_float64, with_dtype
from tustinnet.models.groups import model_for_groups
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.shown import Brief
from tustinnet.simulate.input_signal import initial_inputs, input_signals
from tustinnet.simulate.simulation import simulate_runs

SHRINKAGE = 0.1  # of the correlations: those of few records leave directions without any error


@dataclass(frozen=True, repr=False)
class Proposal(Brief):
    """A record that could be made.

    Attributes:
        name: name of the record.
        q: positions at its beginning, (n_q,) [rad or m].
        v: velocities there, (n_q,).
        u: inputs, a row a sample, (n, n_u); of a machine without inputs (n, 0).
        groups: conditions of the record, as `{"payload": "1kg"}`.
    """

    name: str
    q: Float[np.ndarray, " n_q"]
    v: Float[np.ndarray, " n_q"]
    u: Float[np.ndarray, "n n_u"]
    groups: Mapping[str, str] = field(default_factory=dict)

    def checked(self, channels: Channels) -> "Proposal":
        """The proposal with arrays of the channels' sizes.

        Raises:
            InputError: other sizes, values that are not finite, or fewer than 2 samples.
        """
        q, v, u = (np.asarray(x, float) for x in (self.q, self.v, self.u))
        n_q, n_u = channels.n_q, channels.n_u
        sizes = q.shape, v.shape, u.shape[1:]
        if sizes != ((n_q,), (n_q,), (n_u,)) or len(u) < 2:
            raise InputError(
                f"proposal '{self.name}'",
                f"q {q.shape}, v {v.shape}, u {u.shape}",
                f"({n_q},), ({n_q},), (n, {n_u}) of at least 2 samples",
            )
        if not all(np.isfinite(x).all() for x in (q, v, u)):
            raise InputError(f"proposal '{self.name}'", "values that are not finite", "numbers")
        return replace(self, q=q, v=v, u=u)


@dataclass(frozen=True)
class InformationGain:
    """The information that a proposed record would give.

    Attributes:
        name: the proposal.
        value: half the logarithm of the covariance's determinant before over after [nats]; NaN
            where the model cannot simulate the record.
        words: what it would improve most.
    """

    name: str
    value: float
    words: str


def rank_proposals(
    model: Model, header: Mapping[str, Any], proposals: Sequence[Proposal]
) -> tuple[InformationGain, ...]:
    """Ranks proposed records by how much they would shrink the covariance of the parameters.

    Args:
        model: an identified system.
        header: the header of its file, which has the errors of the parameters.
        proposals: the records that could be made.

    Returns:
        What each proposal would give, the most informative one first: that should be recorded next.

    Raises:
        InputError: a model without errors of its parameters, or that can simulate none of them; two
            proposals of one name, or arrays that do not fit the model.
    """
    require_float64("rank_proposals")
    names = [p.name for p in proposals]
    if duplicates := sorted({name for name in names if names.count(name) > 1}):
        raise InputError("rank_proposals", f"two proposals '{duplicates[0]}'", "different names")
    proposals = [p.checked(model.channels) for p in proposals]
    predicted = _predict_records(model, proposals)
    records = [e for e in predicted.values() if e is not None]
    expected = "those of an identified system"
    if not header.get("identification"):
        raise InputError("rank_proposals", "a model without errors of its parameters", expected)
    with convert_errors("rank_proposals", "errors of parameters that do not fit", expected):
        gains = _covariance_gains(model, header["identification"], records)
    finite = sorted((g for g in gains if np.isfinite(g.value)), key=lambda g: -g.value)
    if not finite:
        raise InputError(
            "rank_proposals",
            "no proposal that the model can simulate to finite numbers",
            "one at least",
            "fit it to more records, or propose gentler ones",
        )
    others = [name for name in predicted if name not in {g.name for g in finite}]
    diverging = [InformationGain(n, float("nan"), "the model cannot simulate it") for n in others]
    return (*finite, *diverging)


def _predict_records(model: Model, proposals: Sequence[Proposal]) -> dict[str, Experiment | None]:
    """The records that the model simulates for proposals, None where it diverges."""
    channels, records = model.channels, {}
    simulators: dict[frozenset[tuple[str, str]], Model] = {}
    for p in proposals:
        n, groups = len(p.u), frozenset(p.groups.items())
        if groups not in simulators:
            chosen = model_for_groups(model, p.groups, p.name)
            simulators[groups] = with_dtype(chosen, np.float64).simplify()
        simulator = simulators[groups]
        zero = np.zeros((n, channels.n_q))
        blank = Experiment(
            name=p.name,
            t=np.arange(n) * channels.dt,
            q=zero,
            u=p.u,
            channels=channels,
            v=zero.copy(),
            v_measured=True,
            groups=tuple(p.groups.items()),
        )
        signal = input_signals(simulator, [blank])
        inputs = initial_inputs(simulator, signal)
        u = None if inputs is None else jnp.asarray(inputs[0])
        x0 = np.asarray(simulator.initial_state(jnp.concatenate([p.q, p.v]), u))[None]
        x = np.asarray(simulate_runs(simulator, x0, signal))[0]
        finite = (np.abs(x) <= LARGEST).all()  # False of what is no number
        q, v = x[:, channels.position], x[:, channels.velocity]
        records[p.name] = replace(blank, q=q, v=v) if finite else None
    return records


def _covariance_gains(
    model: Model, identification: Mapping[str, Any], records: Sequence[Experiment]
) -> list[InformationGain]:
    """By how much the covariance of an identified system's parameters would shrink."""
    if not records:
        return []
    continuous = equations_of_motion(model)
    assert isinstance(model, Discretised)
    assert continuous is not None
    values = {name: float(x) for name, x in continuous.values.items()}
    space, covariance, estimates = parameter_covariance(continuous, identification, SHRINKAGE)
    # residuals of a record are not independent: it counts as much less as the errors say
    ratios = [e["naive_error"] / e["error"] for e in estimates if e["naive_error"]]
    weight = min(float(np.median(ratios)) ** 2, 1.0) if ratios else 1.0
    squares = np.square(list(identification["residual_rmse"].values()))
    deviation = float(np.sqrt(np.mean(squares) / model.channels.n_q))
    added = fisher_information(
        space, continuous.system, values, records, model.substeps, max(deviation, 1e-12)
    )
    root = np.linalg.cholesky(covariance + 1e-12 * np.diag(np.diag(covariance)))
    gains = []
    for e, matrix in zip(records, added, strict=True):
        inner = np.eye(len(root)) + root.T @ (weight * matrix) @ root
        if not np.isfinite(inner).all():
            gains.append(InformationGain(e.name, float("nan"), ""))
            continue
        gain = float(np.linalg.slogdet(inner)[1]) / 2
        after = root @ np.linalg.solve(inner, root.T)
        remaining = np.sqrt(np.diag(after) / np.diag(covariance))
        best = int(np.argmin(remaining))
        words = f"error of {space.names[best]} to {100 * remaining[best]:.0f} %"
        gains.append(InformationGain(e.name, gain, words))
    return gains


def equations_of_motion(model: Model) -> LagrangianModel | None:
    """The equations of motion that a model steps, None for one that is not made of them alone."""
    continuous = model.continuous if isinstance(model, Discretised) else None
    return continuous if isinstance(continuous, LagrangianModel) else None


def parameter_covariance(
    model: LagrangianModel, identification: Mapping[str, Any], shrinkage: float
) -> tuple[SearchSpace, Float[np.ndarray, "n_p n_p"], list[Mapping[str, Any]]]:
    """The covariance of identified parameters, in the coordinates of a search.

    Args:
        model: the equations of motion.
        identification: the identification, as model files have it.
        shrinkage: share by which correlations are made smaller.

    Returns:
        The search space of the parameters that have errors, their covariance, and their entries in
        the file, in the order of the file.

    Raises:
        InputError: no parameter has an error.
    """
    values = {name: float(x) for name, x in model.values.items()}
    rows = [
        i for i, e in enumerate(identification["estimates"]) if e["error"] and e["name"] in values
    ]
    if not rows:
        raise InputError(
            "rank_proposals",
            "a model whose parameters have no errors",
            "one whose parameters have some",
            "fit it to more records",
        )
    estimates = [identification["estimates"][i] for i in rows]
    names = [e["name"] for e in estimates]
    space = search_space_for(model.system, values, names)
    order = np.array([names.index(name) for name in space.names])
    # in the order of the space, correlations shrunk
    index = np.asarray(rows)[order]
    correlation = np.array(identification["correlation"], float)
    correlation = np.nan_to_num(correlation)[np.ix_(index, index)]
    errors = np.array([identification["estimates"][i]["error"] for i in index])
    shrunk = (1 - shrinkage) * correlation + shrinkage * np.eye(len(index))
    covariance = shrunk * np.outer(errors, errors)
    covariance = covariance / np.outer(*[space.derivatives(space.to_vector(values))] * 2)
    return space, covariance, estimates
