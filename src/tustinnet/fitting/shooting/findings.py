"""Findings of an identification, from its numbers.

Each function has one thing: why the search ended, signs, horizons, disagreements, bounds, corrupted
samples, condition, errors. `results` puts them together; `tustinnet.words` has the sentences.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.experiment import Experiment
from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.report import (
    Disagreement,
    Estimate,
    ForceError,
    SignAlternatives,
    Stretch,
)
from tustinnet.fitting.shooting.identifiability import ConfoundedParameters
from tustinnet.fitting.shooting.problem import SearchState
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.fitting.shooting.uncertainty import Uncertainty
from tustinnet.models.chains import INERTIAL
from tustinnet.models.lagrangian import LagrangianSystem

_POOR_CONDITION = 1e3
_AT_NOISE = 1.5  # times the rms error of rounding to counts: residuals that show no more
_CORRELATED = 0.2  # residuals' correlation from one sample to the next that is more than chance


def describe_outcome(
    status: str,
    iterations: int,
    records: Sequence[Experiment],
    rmse: Mapping[str, float],
    horizons: Mapping[str, float],
) -> Finding:
    """Why the search ended, and what to do where it did not converge.

    Args:
        status: see `LeastSquaresResult`.
        iterations: of the final stage.
        records: the training records.
        rmse: of every record's residuals.
        horizons: horizons [s] of records that were not simulated as a whole.
    """
    if status in ("diverged", "converged", "stalled"):
        return make_finding(status, iterations=iterations)
    # where records are not followed at all, shorter segments help
    lost = [e for e in records if rmse[e.name] > np.sqrt(np.sum(e.q.var(axis=0)))]
    if not lost:
        code = "slow" if status == "slow" else "limit of iterations"
        return make_finding(code, iterations=iterations)
    span = min(horizons.get(e.name, (len(e) - 1) * e.dt) for e in lost)
    return make_finding(
        "limit of iterations lost",
        iterations=iterations,
        records=[e.name for e in lost],
        seconds=span,
        shorter=span / 2,
    )


def describe_stop(state: SearchState) -> Finding:
    """The point at which a search was stopped, and the stage whose result it has."""
    if not state.stages:
        return make_finding("out of time optional", stage=state.stage)
    return make_finding(
        "out of time", finished=state.finished_stages, stages=state.stages, stage=state.stage
    )


def describe_signs(reversed_signs: SignAlternatives) -> list[Finding]:
    """Coordinates and inputs whose sign is probably reversed."""
    if not reversed_signs:
        return []
    return [make_finding("sign reversed", alternatives=[[*names] for names in reversed_signs])]


def describe_horizons(
    horizons: Mapping[str, float],
    records: Sequence[Experiment],
    *,
    is_from_recipe: bool,
    longest_stable: float = 0.0,
    scoring_start: str | None,
) -> list[Finding]:
    """The horizons over which records were compared, and their cause.

    Args:
        horizons: horizons [s] by record, validation records too.
        records: the training records.
        is_from_recipe: whether the horizon is the recipe's.
        longest_stable: horizon [s] beyond which simulations diverge; 0 where none do.
        scoring_start: the start of the validation free runs, None without validation records.
    """
    if not horizons:
        return []
    trained = {e.name for e in records}
    names_by_horizon: dict[float, list[str]] = {}
    for name, seconds in horizons.items():
        if name in trained:
            names_by_horizon.setdefault(seconds, []).append(name)
    findings = []
    for seconds, names in sorted(names_by_horizon.items()):
        code = "segments" if is_from_recipe else "segments errors grow"
        code = "segments diverge" if seconds == longest_stable else code
        findings.append(make_finding(code, records=names, seconds=seconds))
    if whole := [e.name for e in records if e.name not in horizons]:
        findings.append(make_finding("whole records", records=whole))
    if scoring_start is not None:
        shortest = min(horizons.values())
        findings.append(make_finding("validation segments", seconds=shortest, start=scoring_start))
    return findings


def describe_disagreements(disagreements: Sequence[Disagreement]) -> list[Finding]:
    """Parameters on which records disagree, and what to do about it."""
    return [
        make_finding(
            "groups disagree" if d.group else "record contradicts",
            parameter=d.parameter,
            unit=d.unit,
            group=d.group,
            one=one.what,
            value=one.value,
            error=one.error,
            other=other.what,
            other_value=other.value,
            other_error=other.error,
        )
        for d in disagreements
        for one, other in [d.sides]
    ]


def describe_bounds(
    estimates: Sequence[Estimate], noise_ratio: float | None, system: LagrangianSystem
) -> list[Finding]:
    """Parameters that are at a bound, the probable cause, and how to move the bound.

    Args:
        estimates: the estimates.
        noise_ratio: size of the residuals over that of the encoders' rounding, None if unknown.
        system: the system, whose ranges say where they are from.
    """
    # of a machine a bound says something where the model follows its records, and only there
    follows = _is_at_noise(noise_ratio)
    bases = {p.name: p.basis for p in system.parameters}
    findings, ranges, vanished = [], {}, []
    for e in estimates:
        if not e.bound:
            continue
        if e.bound == "lower" and e.lower == 0:
            vanished.append(e.name)
            continue
        name = e.name.partition("[")[0]
        basis = bases.get(name, "")
        findings.append(
            make_finding(
                "at bound" if follows else "at bound misfit",
                parameter=e.name,
                bound=e.bound,
                value=e.value,
                unit=e.unit,
                basis=basis,
            )
        )
        if e.bound == "lower" and name.endswith(".stribeck_speed"):
            findings.append(make_finding("breakaway sticks"))
        if basis:
            ranges[name] = _wider(e)
    if follows:
        findings += [make_finding("vanished", parameter=name) for name in vanished]
    elif vanished:
        findings.append(
            make_finding(
                "vanished misfit",
                parameters=vanished,
                advises_forces=not system.added_parameters,
            )
        )
    masses = [e for e in estimates if e.name.partition("[")[0].endswith(f".{INERTIAL[0]}")]
    for bound in ("lower", "upper"):
        at_bound = [e for e in masses if e.bound == bound]
        if len(masses) > 1 and 2 * len(at_bound) > len(masses):
            counts = {"count": len(at_bound), "total": len(masses)}
            findings.append(make_finding("masses at bound", bound=bound, **counts))
    if ranges and system.source is not None:
        some = dict([*ranges.items()][:3])  # a line for a system file has no room for more
        findings.append(make_finding("wider ranges", call=system.source.call(ranges=some)))
    return findings


def _wider(e: Estimate) -> tuple[float, float]:
    """A range whose bound at which an estimate is lies farther out, in short numbers."""
    if e.lower > 0:
        lower, upper = (e.lower / 10, e.upper) if e.bound == "lower" else (e.lower, 10 * e.upper)
    else:
        more = 3 * (e.upper - e.lower)
        lower, upper = (
            (e.lower - more, e.upper) if e.bound == "lower" else (e.lower, e.upper + more)
        )
    return float(f"{lower:.3g}"), float(f"{upper:.3g}")


def describe_forces(errors: Sequence[ForceError]) -> Finding:
    """The errors of the forces of each coordinate, of the last split.

    Args:
        errors: the errors.
    """
    errors = [e for e in errors if e.split == errors[-1].split]
    driven = [e for e in errors if e.is_driven]

    def mean(share: str) -> float | None:
        return float(np.mean([getattr(e, share) for e in driven])) if driven else None

    return make_finding(
        "missing forces",
        split="validation" if errors[-1].split == "validation" else "training",
        cutoff=errors[-1].cutoff,
        joints=[
            make_finding(
                "missing force" if e.is_driven else "missing force undriven",
                joint=e.coordinate,
                share=e.share,
                force=e.missing,
                unit=e.unit,
            )
            for e in errors
        ],
        mean=mean("share"),
        moving=mean("moving"),
        by_least_squares=mean("by_least_squares"),
        by_file=mean("by_file"),
    )


def describe_trials(trials: Sequence[tuple[str, float, float, bool]]) -> list[Finding]:
    """Forces that were tried, by what they explain of forces that were left out.

    Args:
        trials: of each its name, the share that was missing before and with it, and whether it is
            kept.
    """
    if not trials:
        return []
    listed = [
        make_finding(
            "force kept" if is_kept else "force not kept", force=name, before=before, after=after
        )
        for name, before, after, is_kept in trials
    ]
    return [make_finding("forces tried", trials=listed)]


def describe_informed(
    names: Sequence[str], informed: Bool[np.ndarray, " n_p"], rank: int
) -> Finding:
    """The number of combinations that records determine, and the parameters hardly known.

    Args:
        names: the parameters.
        informed: those of which records say more than the prior.
        rank: how many combinations of parameters change the forces at all.
    """
    kept = [name for name, is_informed in zip(names, informed, strict=True) if not is_informed]
    return make_finding("base parameters", rank=rank, total=len(names), uninformed=kept)


def describe_scale(
    estimates: Sequence[Estimate],
    confounded: Sequence[ConfoundedParameters],
    space: SearchSpace,
    vector: ParameterVector,
) -> list[Finding]:
    """Estimates that are known only beside others, which were fixed at first values.

    Args:
        estimates: the estimates.
        confounded: the sets of which one was fixed.
        space: the search space.
        vector: the estimates as it has them.
    """
    derivatives = dict(zip(space.names, space.derivatives(vector), strict=True))
    known: list[tuple[float, Finding]] = []
    for e in estimates:
        spreads = {c.suggestion: c.spread[e.name] for c in confounded if e.name in c.spread}
        spread = float(np.linalg.norm([*spreads.values()]) * derivatives[e.name])
        if spread > (e.error or 0.0):
            by = max(spreads, key=lambda name: spreads[name])
            one = make_finding("known beside", parameter=e.name, spread=spread, fixed=by)
            known.append((spread / (abs(e.value) or spread), one))
    if not known:
        return []
    known.sort(key=lambda pair: -pair[0])
    return [make_finding("known beside fixed", known=[one for _, one in known])]


def describe_stretches(stretches: Sequence[Stretch]) -> list[Finding]:
    """Stretches of records that weigh little: probably corrupted samples."""
    if not stretches:
        return []
    # five are listed
    longest = sorted(stretches, key=lambda s: s.begin - s.end)[:5]
    listed = [make_finding("stretch", record=s.record, begin=s.begin, end=s.end) for s in longest]
    return [
        make_finding(
            "stretches weigh little",
            count=len(stretches),
            stretches=listed,
            more=len(stretches) - len(longest),
        )
    ]


def describe_condition(names: Sequence[str], uncertainty: Uncertainty) -> list[Finding]:
    """Parameters that are badly conditioned: they can hardly be told apart.

    Args:
        names: the free parameters.
        uncertainty: how well they are determined.
    """
    if uncertainty.condition < _POOR_CONDITION:
        return []
    direction = np.abs(uncertainty.worst_direction)
    order: list[int] = np.argsort(-direction).tolist()
    involved = [names[i] for i in order if direction[i] > 0.1]
    if len(involved) == 1:
        return [make_finding("no effect on simulations", parameter=involved[0])]
    return [make_finding("badly conditioned", condition=uncertainty.condition, parameters=involved)]


def describe_errors(
    uncertainty: Uncertainty,
    lag: Float[np.ndarray, " n_y"],
    noise_ratio: float | None,
    n_records: int,
) -> list[Finding]:
    """Findings on the residuals, and which errors of the parameters to trust.

    Args:
        uncertainty: the covariances.
        lag: correlation of the residuals from one sample to the next, by channel.
        noise_ratio: size of the residuals over that of the encoders' rounding, None if unknown.
        n_records: number of training records.
    """
    if _is_at_noise(noise_ratio):
        return [make_finding("residuals of counts" if noise_ratio else "residuals of nothing")]
    strongest = float(lag[np.argmax(np.abs(lag))])
    is_correlated = abs(strongest) > _CORRELATED
    residuals = make_finding(
        "residuals correlated" if is_correlated else "residuals independent",
        ratio=noise_ratio,
        correlation=strongest,
    )
    if uncertainty.clustered is not None:
        source = "errors of records"
    elif uncertainty.source == "segments":
        source = "errors of segments"
    else:
        source = "errors unknown" if is_correlated else "errors of residuals"
    return [residuals, make_finding(source, records=n_records, segments=uncertainty.segments)]


def _is_at_noise(noise_ratio: float | None) -> bool:
    """Whether residuals are so small that the encoders show no more."""
    return noise_ratio is not None and noise_ratio < _AT_NOISE
