"""What an identification found, in words and numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.identification.least_squares import Fitted
from tustinnet.identification.space import Space
from tustinnet.identification.uncertainty import Uncertainty
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.simulation.integrators import Discretised

_POOR_CONDITION = 1e3
_AT_THE_COUNT = 1.5  # times the rms error of rounding to counts
_CORRELATED = 0.2  # residuals' correlation from one sample to the next that is more than chance


@dataclass(frozen=True)
class Estimate:
    """One parameter as identified.

    Attributes:
        name: the parameter.
        unit: its SI unit.
        value: the value found.
        error: standard error to trust, None where the value stands at the end of its range.
        naive_error: standard error from `J'J`, which takes residuals for independent noise.
        interval: 95 % interval that goes with `error`, or None.
        lower: smallest value allowed.
        upper: largest.
        bound: `lower` or `upper` where it stands at the end of its range, else "".
    """

    name: str
    unit: str
    value: float
    error: float | None
    naive_error: float | None
    interval: tuple[float, float] | None
    lower: float
    upper: float
    bound: str = ""


@dataclass(frozen=True)
class Identification:
    """What an identification found.

    Attributes:
        system: the system.
        model: the model with the values found.
        estimates: the parameters that were searched for.
        held: the parameters that were not, by name.
        correlation: of the estimates' errors, (n_p, n_p), NaN for those at a bound.
        condition: how much better the best determined combination of parameters is than the worst.
        converged: whether the search ended at a minimum.
        outcome: why it stopped, as a sentence.
        reversed_signs: coordinates and inputs whose sign is probably the wrong way round:
            alternatives, each the names to reverse together.
        findings: what one should know before using it, in plain language.
        trust: which errors to believe: `records` (how they disagree) or `residuals` (J'J).
        rmse: per record, root mean square of the residuals' 2-norm, from the initial states below.
        autocorrelation: of the residuals from one sample to the next, per channel, (n_y,).
        initial: how initial states were treated, see `Settings`.
        initial_states: those found, by record, (n_x,) each.
        validation_rmse: mean free-run RMSE of the validation records, if there are any.
        substeps: integration steps in a sampling period.
        iterations: of the last stage.
        seconds: time it took.
    """

    system: LagrangianSystem
    model: Discretised
    estimates: tuple[Estimate, ...]
    held: Mapping[str, float]
    correlation: Float[np.ndarray, "n_p n_p"]
    condition: float
    converged: bool
    outcome: str
    reversed_signs: tuple[tuple[str, ...], ...]
    findings: tuple[str, ...]
    trust: str
    rmse: Mapping[str, float]
    autocorrelation: tuple[float, ...]
    initial: str
    initial_states: Mapping[str, tuple[float, ...]]
    validation_rmse: float | None
    substeps: int
    iterations: int
    seconds: float

    @property
    def sound(self) -> bool:
        """Whether it ended at a minimum and no sign is suspected to be reversed."""
        return self.converged and not self.reversed_signs

    @property
    def values(self) -> dict[str, float]:
        """All values by name, those held included."""
        return dict(self.held) | {e.name: e.value for e in self.estimates}


def describe(
    *,
    system: LagrangianSystem,
    space: Space,
    fitted: Fitted,
    certain: Uncertainty,
    records: Sequence[Experiment],
    model: Discretised,
    bounds: Mapping[str, str],
    reversed_signs: Sequence[tuple[str, ...]],
    remarks: Sequence[str],
    initial: str,
    validation: float | None,
    seconds: float,
) -> Identification:
    """Puts the parts of an identification together and says what they mean."""
    estimates = _estimates(space, fitted, certain, bounds)
    lag, multiple = _residuals(fitted, records)
    with np.errstate(invalid="ignore", divide="ignore"):
        errors = np.sqrt(np.diag(certain.trusted))
        correlation = certain.trusted / np.outer(errors, errors)
    diverged = fitted.why == "diverged"
    findings = [
        *_about_signs(reversed_signs),
        *remarks,
        *_about_bounds(estimates),
        *([] if diverged else _about_condition(space, certain)),
        _about_errors(certain, lag, multiple, len(records)) if fitted.why == "converged" else "",
    ]
    outcome = {
        "diverged": "diverged: from the values found the records simulate to infinity; look at the "
        "signs in the data card and in the system file, and at the ranges",
        "converged": f"converged: no step promises a lower cost ({fitted.iterations} iterations)",
        "stalled": "stalled: no step lowers the cost though the gradient is not zero; start from "
        "other values, or look for a jump in the energies or forces",
        "limit": f"stopped at the limit of {fitted.iterations} iterations while still falling; "
        "allow more, or start from other values",
    }[fitted.why]
    rms = np.sqrt(fitted.normal.cost)
    return Identification(
        system=system,
        model=model,
        estimates=estimates,
        held=dict(space.held),
        correlation=correlation,
        condition=certain.condition,
        converged=fitted.why == "converged",
        outcome=outcome,
        reversed_signs=tuple(reversed_signs),
        findings=tuple(f for f in findings if f),
        trust="residuals" if certain.clustered is None else "records",
        rmse={e.name: float(r) for e, r in zip(records, rms, strict=True)},
        autocorrelation=tuple(lag.tolist()),
        initial=initial,
        initial_states={e.name: tuple(x.tolist()) for e, x in zip(records, fitted.x0, strict=True)},
        validation_rmse=validation,
        substeps=model.substeps,
        iterations=fitted.iterations,
        seconds=seconds,
    )


def _estimates(
    space: Space, fitted: Fitted, certain: Uncertainty, bounds: Mapping[str, str]
) -> tuple[Estimate, ...]:
    numbers, slopes = space.numbers(fitted.vector), space.slopes(fitted.vector)
    low, high = space.lower, space.upper
    with np.errstate(invalid="ignore"):  # what rounding has made negative is not known
        naive = np.sqrt(np.diag(certain.naive)) * np.abs(slopes)
        trusted = np.sqrt(np.diag(certain.trusted))
    found = []
    for i, p in enumerate(space.free):
        known = p.name not in bounds and bool(np.isfinite(trusted[i]))
        half = certain.trusted_quantile * trusted[i]
        # beyond its range a value is excluded beforehand
        edges = np.clip([fitted.vector[i] - half, fitted.vector[i] + half], low[i], high[i])
        interval = np.exp(edges) if p.positive else edges * slopes[i]
        found.append(
            Estimate(
                name=p.name,
                unit=p.unit,
                value=numbers[p.name],
                error=float(trusted[i] * abs(slopes[i])) if known else None,
                naive_error=float(naive[i]) if known and np.isfinite(naive[i]) else None,
                interval=(float(interval[0]), float(interval[1])) if known else None,
                lower=p.lower,
                upper=p.upper,
                bound=bounds.get(p.name, ""),
            )
        )
    return tuple(found)


def _residuals(
    fitted: Fitted, records: Sequence[Experiment]
) -> tuple[Float[np.ndarray, " n_y"], float | None]:
    """Correlation from sample to sample, and the size in encoder noise where counts are known."""
    errors = [
        np.nan_to_num(x[: len(e)], posinf=0.0, neginf=0.0)
        for x, e in zip(fitted.normal.error, records, strict=True)
    ]
    before, after = (
        np.concatenate([x[part] for x in errors]) for part in (slice(-1), slice(1, None))
    )
    power = np.sum(before**2, axis=0)
    lag = np.divide(
        np.sum(before * after, axis=0), power, out=np.zeros_like(power), where=power > 0
    )
    counts = records[0].resolution
    if not np.all(counts > 0):
        return lag, None
    sizes = np.sqrt(np.mean(np.concatenate(errors)[:, : len(counts)] ** 2, axis=0))
    return lag, float(np.max(sizes / (counts / np.sqrt(12))))


def _about_signs(reversed_signs: Sequence[tuple[str, ...]]) -> list[str]:
    if not reversed_signs:
        return []
    each = [" and ".join(f"'{name}'" for name in names) for names in reversed_signs]
    return [
        f"the sign of {' or of '.join(each)} is probably reversed: turned around, the equations of "
        "motion explain the records clearly better; check the data card or the system's signs"
    ]


def _about_bounds(estimates: Sequence[Estimate]) -> list[str]:
    return [
        f"'{e.name}' stands at the {e.bound} end of its range ({e.value:.4g} {e.unit}): the model "
        "lacks something, or the range is wrong"
        for e in estimates
        if e.bound
    ]


def _about_condition(space: Space, certain: Uncertainty) -> list[str]:
    if certain.condition < _POOR_CONDITION:
        return []
    members = np.argsort(-np.abs(certain.worst))
    names = [space.names[i] for i in members if abs(certain.worst[i]) > 0.1]
    if len(names) == 1:
        return [f"'{names[0]}' has hardly any effect on the simulations; fix it"]
    return [
        f"badly conditioned ({certain.condition:.1g}): {', '.join(names)} can change together with "
        "hardly any effect on the simulations; fix one of them or record motion that tells them "
        "apart"
    ]


def _about_errors(
    certain: Uncertainty, lag: np.ndarray, multiple: float | None, records: int
) -> str:
    strongest = float(lag[np.argmax(np.abs(lag))])
    correlated = abs(strongest) > _CORRELATED
    if multiple is not None and multiple < _AT_THE_COUNT:
        return "residuals are no larger than the encoders' quantisation: nothing is missing"
    size = f"{multiple:.0f} times the encoders' quantisation and " if multiple else ""
    if correlated:
        told = (
            f"residuals are {size}alike from sample to sample (correlation {strongest:.2f}): "
            "something is not modelled, and errors from J'J are too small"
        )
    else:
        told = f"residuals are {size}independent from sample to sample"
    if certain.clustered is not None:
        return f"{told}; trust the errors from how the {records} records disagree"
    few = f"{records} record{'s are' if records > 1 else ' is'} too few"
    if correlated:
        return f"{told}, {few} to say by how much"
    return f"{told}; the errors are those from J'J, {few} for others"
