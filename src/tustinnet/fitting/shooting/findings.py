"""What an identification found, in words and numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.report import Disagreement, Estimate, Identification, Stretch
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.least_squares import Fitted
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.fitting.shooting.space import Space
from tustinnet.fitting.shooting.uncertainty import Uncertainty, bounded, lag_correlation
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianSystem

_POOR_CONDITION = 1e3
_AT_THE_COUNT = 1.5  # times the rms error of rounding to counts
_EXACT = 1e-6  # of the motion: what records without counts show no more of
_LITTLE = 0.5  # of the weight of residuals that count in full
_TOLD = 5  # stretches that are told in a sentence
_MOST_NAMED = 12
_CORRELATED = 0.2  # residuals' correlation from one sample to the next that is more than chance


@dataclass(frozen=True)
class Found:
    """What a search found, before it is put into words.

    Attributes:
        fitted: where it ended.
        segments: what it compared.
        space: the parameters' coordinates.
        model: the model with the values found.
        records: the records.
        certain: how far the values can be trusted.
        horizons: see `Identification`.
        asked: whether the recipe says them.
        disagreements: what the records disagree about.
        reversed_signs: see `Identification`.
        remarks: what was said on the way.
        initial: how initial states were treated.
        start: see `Identification`.
        validation_rmse: mean free-run RMSE of the validation records, or None.
        weights: what every squared residual weighs, record after record, None where all alike.
    """

    fitted: Fitted
    segments: Segments
    space: Space
    model: Discretised
    records: Sequence[Experiment]
    certain: Uncertainty
    horizons: Mapping[str, float]
    asked: bool
    disagreements: tuple[Disagreement, ...]
    reversed_signs: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...]
    initial: str
    start: str
    validation_rmse: float | None
    weights: Float[np.ndarray, "n n_y"] | None = None


def described(system: LagrangianSystem, found: Found) -> Identification:
    """Puts the parts of an identification together and says what they mean."""
    fitted, space, certain, records = found.fitted, found.space, found.certain, found.records
    estimates = _estimates(found)
    lag, multiple = _residuals(found)
    with np.errstate(invalid="ignore", divide="ignore"):
        errors = np.sqrt(np.diag(certain.trusted))
        correlation = certain.trusted / np.outer(errors, errors)
    diverged = fitted.why == "diverged"
    spoilt = () if found.weights is None else _stretches(found.weights, records)
    findings = [
        *_about_signs(found.reversed_signs),
        *found.remarks,
        *_about_horizons(found),
        *_about_disagreements(found.disagreements),
        *_about_bounds(estimates, multiple),
        *_about_stretches(spoilt),
        *([] if diverged else _about_condition(space, certain)),
        _about_errors(certain, lag, multiple, len(records)) if fitted.why == "converged" else "",
    ]
    return Identification(
        system=system,
        model=found.model,
        estimates=estimates,
        fixed=dict(space.fixed),
        correlation=correlation,
        condition=certain.condition,
        converged=fitted.why == "converged",
        outcome=_outcome(found),
        reversed_signs=found.reversed_signs,
        findings=tuple(f for f in findings if f),
        trust="residuals" if certain.clustered is None else "records",
        rmse=_rmse(found),
        autocorrelation=tuple(lag.tolist()),
        disagreements=found.disagreements,
        initial=found.initial,
        initial_states=_initial_states(system, found),
        horizons=found.horizons,
        start=found.start,
        validation_rmse=found.validation_rmse,
        substeps=found.model.substeps,
        iterations=fitted.iterations,
        downweighted=spoilt,
    )


def _initial_states(system: LagrangianSystem, found: Found) -> dict[str, tuple[float, ...]]:
    """Of each record by name."""
    segments, fitted = found.segments, found.fitted
    first = segments.begins
    equations = system_equations(system)
    values = equations.values(found.space.values(fitted.vector), segments.pick[first])
    states, *_ = equations.beginnings(fitted.x0[first], values, segments.expected[first])
    return {e.name: tuple(x.tolist()) for e, x in zip(found.records, states, strict=True)}


def _stretches(
    weights: Float[np.ndarray, "n n_y"], records: Sequence[Experiment]
) -> tuple[Stretch, ...]:
    """Samples one after the other whose mean weight over the channels is below a half."""
    found, row = [], 0
    for e in records:
        mean = weights[row : row + len(e)].mean(axis=1)
        row += len(e)
        edges = np.flatnonzero(np.diff(mean < _LITTLE, prepend=False, append=False))
        for a, b in edges.reshape(-1, 2).tolist():
            weight = float(mean[a:b].mean())
            found.append(Stretch(e.name, float(e.t[a]), float(e.t[b - 1]), weight))
    return tuple(found)


def _about_stretches(spoilt: Sequence[Stretch]) -> list[str]:
    if not spoilt:
        return []
    worst = sorted(spoilt, key=lambda s: s.begin - s.end)  # the longest first
    told = ", ".join(f"'{s.record}' {s.begin:.4g}..{s.end:.4g} s" for s in worst[:_TOLD])
    more = f" and {len(spoilt) - _TOLD} more" if len(spoilt) > _TOLD else ""
    return [
        f"residuals of {len(spoilt)} stretches weigh less than half of the others: {told}{more}; "
        "look at the records there"
    ]


def _outcome(found: Found) -> str:
    fitted = found.fitted
    return {
        "diverged": "diverged: from the values found the records simulate to infinity; look at the "
        "signs in the data card and in the system file, and at the ranges",
        "converged": f"converged: no step promises a lower cost ({fitted.iterations} iterations)",
        "stalled": "stalled: no step lowers the cost though the gradient is not zero; start from "
        "other values, or look for a jump in the energies or forces",
        "limit": f"stopped at the limit of {fitted.iterations} iterations while still falling; "
        + _more_or_shorter(found),
    }[fitted.why]


def _more_or_shorter(found: Found) -> str:
    """What to do at the limit of iterations: where records are not followed at all, cut them."""
    rmse = _rmse(found)
    lost = [e for e in found.records if rmse[e.name] > np.sqrt(np.sum(e.q.var(axis=0)))]
    if not lost:
        return "allow more (search.iterations), or start from other values"
    names = _listed([e.name for e in lost])
    spans = [found.horizons.get(e.name, (len(e) - 1) * e.dt) for e in lost]
    return (
        f"the simulations of {names} miss by more than the records vary; compare them over less "
        f"than {min(spans):.2g} s at once (search.horizon={min(spans) / 2:.2g}), or leave them out"
    )


def _rmse(found: Found) -> dict[str, float]:
    """Root mean square of every record's residuals, all its segments together."""
    of, cost = found.segments, found.fitted.normal.cost
    # every residual weighs 1 / T, and a joint of two segments counts in both
    total, weight = np.bincount(of.record, cost), np.bincount(of.record, of.share * (of.steps + 1))
    names = (e.name for e in found.records)
    return dict(zip(names, np.sqrt(total / weight).tolist(), strict=True))


def _about_horizons(found: Found) -> list[str]:
    """Which records were compared over which horizon, and why."""
    if not found.horizons:
        return []
    trained = {e.name for e in found.records}
    by_length: dict[float, list[str]] = {}
    for name in sorted(trained & set(found.horizons), key=list(found.horizons).index):
        by_length.setdefault(found.horizons[name], []).append(name)
    told = []
    for seconds, names in sorted(by_length.items()):
        why = "" if found.asked else f"errors grow a thousandfold in about {seconds:.2g} s, "
        told.append(f"{_listed(names)}: {why}fitted over segments of {seconds:.2g} s")
    if whole := [e.name for e in found.records if e.name not in found.horizons]:
        told.append(f"{_listed(whole)}: fitted as a whole")
    if found.validation_rmse is not None:
        shortest = min(found.horizons.values())
        told.append(
            f"validation records are scored over segments of {shortest:.2g} s, each from "
            f"the start '{found.start}'"
        )
    return told


def _listed(names: Sequence[str]) -> str:
    """Names for a sentence, no more than a line has room for."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def _estimates(found_by: Found) -> tuple[Estimate, ...]:
    space, fitted, certain = found_by.space, found_by.fitted, found_by.certain
    bounds = space.at_bounds(fitted.vector)
    numbers, slopes = space.numbers(fitted.vector), space.slopes(fitted.vector)
    low, high = space.lower, space.upper
    with np.errstate(invalid="ignore"):  # what rounding has made negative is not known
        naive = np.sqrt(np.diag(certain.naive)) * np.abs(slopes)
        trusted = np.sqrt(np.diag(certain.trusted))
    found = []
    for i, p in enumerate(space.searched):
        known = p.name not in bounds and bool(np.isfinite(trusted[i]))
        # a value of one group is told by the records of that group
        own = [e for e in found_by.records if not p.per or p.name.endswith(f"[{e.group(p.per)}]")]
        half = certain.quantile_of(len(own)) * trusted[i]
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


def _residuals(found: Found) -> tuple[Float[np.ndarray, " n_y"], float | None]:
    """Correlation from sample to sample, and the size in encoder noise where that is known.

    Of records without counts it is 0 where the model fits them exactly.
    """
    errors = found.fitted.normal.error
    lag = lag_correlation(errors)
    counts = found.records[0].channels.resolution
    sizes = np.sqrt(np.mean(np.concatenate(bounded(errors))[:, : len(counts)] ** 2, axis=0))
    if not np.all(counts > 0):
        motion = np.concatenate([e.q for e in found.records]).std(axis=0)
        return lag, 0.0 if np.all(sizes < _EXACT * motion) else None
    return lag, float(np.max(sizes / (counts / np.sqrt(12))))


def _about_signs(reversed_signs: Sequence[tuple[str, ...]]) -> list[str]:
    if not reversed_signs:
        return []
    each = [" and ".join(f"'{name}'" for name in names) for names in reversed_signs]
    return [
        f"the sign of {' or of '.join(each)} is probably reversed: turned around, the equations of "
        "motion explain the records clearly better; check the data card or the system's signs"
    ]


def _about_disagreements(disagreements: Sequence[Disagreement]) -> list[str]:
    told = []
    for d in disagreements:
        one, other = d.sides
        values = " against ".join(f"{s.value:.4g} +- {s.error:.2g}" for s in d.sides)
        about = f"about `{d.parameter}` ({values} {d.unit}".rstrip() + ")"
        if d.group:
            told.append(
                f"the records of {one.what} and {other.what} disagree {about}: declare it "
                f'per="{d.group}"'
            )
        else:
            told.append(
                f"record '{one.what}' contradicts {other.what} {about}: look at its log and at "
                "what was changed, give it a group, or leave it out"
            )
    return told


def _about_bounds(estimates: Sequence[Estimate], multiple: float | None) -> list[str]:
    cause = (
        "the records do not tell it, or the range is wrong"
        if _at_the_count(multiple)
        else "the model lacks something, or the range is wrong"
    )
    return [
        f"'{e.name}' is 0, the lower end of its range: the records show nothing of it"
        if e.bound == "lower" and e.lower == 0
        else f"'{e.name}' stands at the {e.bound} end of its range ({e.value:.4g} {e.unit}): "
        f"{cause}"
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


def _at_the_count(multiple: float | None) -> bool:
    """Whether residuals are so small that the encoders show no more."""
    return multiple is not None and multiple < _AT_THE_COUNT


def _about_errors(
    certain: Uncertainty, lag: np.ndarray, multiple: float | None, records: int
) -> str:
    strongest = float(lag[np.argmax(np.abs(lag))])
    correlated = abs(strongest) > _CORRELATED
    if _at_the_count(multiple):
        least = "the encoders' quantisation" if multiple else "a millionth of the motion"
        return f"residuals are no larger than {least}: nothing is missing"
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
