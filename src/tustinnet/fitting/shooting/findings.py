"""Findings of an identification as sentences, from its numbers.

Each function describes one thing: why the search ended, signs, horizons, disagreements, bounds,
corrupted samples, condition, errors. `results` puts them together.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.report import (
    OUT_OF_TIME,
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
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.wording import counted

_POOR_CONDITION = 1e3
_AT_NOISE = 1.5  # times the rms error of rounding to counts: residuals that show no more
_MOST_STRETCHES = 5  # that are listed in a sentence
_MOST_NAMES = 12
_MOST_RANGES = 3  # that a line for a system file has
_CORRELATED = 0.2  # residuals' correlation from one sample to the next that is more than chance


def describe_outcome(
    status: str,
    iterations: int,
    records: Sequence[Experiment],
    rmse: Mapping[str, float],
    horizons: Mapping[str, float],
) -> str:
    """Sentence on why the search ended, and on what to do where it did not converge.

    Args:
        status: see `LeastSquaresResult`.
        iterations: of the final stage.
        records: the training records.
        rmse: of every record's residuals.
        horizons: horizons [s] of records that were not simulated as a whole.
    """
    if status == "diverged":
        return (
            "diverged: the simulations with the estimated values diverge; look at the signs in "
            "the data card and in the system file, and at the ranges"
        )
    if status == "converged":
        return f"converged: no step promises a lower cost ({iterations} iterations)"
    if status == "stalled":
        return (
            "stalled: no step lowers the cost though the gradient is not zero; start from other "
            "values, or look for a jump in the energies or forces"
        )
    # where records are not followed at all, shorter segments help
    lost = [e for e in records if rmse[e.name] > np.sqrt(np.sum(e.q.var(axis=0)))]
    advice = "allow more (search.iterations), or start from other values"
    if lost:
        span = min(horizons.get(e.name, (len(e) - 1) * e.dt) for e in lost)
        advice = (
            f"the simulations of {_listed([e.name for e in lost])} miss by more than the records "
            f"vary; compare them over less than {span:.2g} s at once "
            f"(search.horizon={span / 2:.2g}), or leave them out"
        )
    return f"stopped at the limit of {iterations} iterations while still falling; {advice}"


def describe_stop(state: SearchState) -> str:
    """Sentence on where a search was stopped, and on the stage whose result it has."""
    if not state.stages:
        return (
            f"{OUT_OF_TIME}: stopped at its time limit among the optional terms; the values are "
            f"those of a fit to {state.stage}"
        )
    return (
        f"{OUT_OF_TIME}: stopped at its time limit after stage {state.finished_stages} of "
        f"{state.stages} ({state.stage})"
    )


def describe_signs(reversed_signs: SignAlternatives) -> list[str]:
    """Sentence on coordinates and inputs whose sign is probably reversed."""
    if not reversed_signs:
        return []
    alternatives = [" and ".join(f"'{name}'" for name in names) for names in reversed_signs]
    return [
        f"the sign of {' or of '.join(alternatives)} is probably reversed: turned around, the "
        "equations of motion explain the records clearly better; check the data card or the "
        "system's signs"
    ]


def describe_horizons(
    horizons: Mapping[str, float],
    records: Sequence[Experiment],
    *,
    is_from_recipe: bool,
    longest_stable: float = 0.0,
    scoring_start: str | None,
) -> list[str]:
    """Sentences on the horizons over which records were compared, and their cause.

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
    sentences = []
    for seconds, names in sorted(names_by_horizon.items()):
        if seconds == longest_stable:
            cause = "simulations of longer segments diverge, "
        elif is_from_recipe:
            cause = ""
        else:
            cause = f"errors of the start grow too much beyond about {seconds:.2g} s, "
        sentences.append(f"{_listed(names)}: {cause}fitted over segments of {seconds:.2g} s")
    if whole := [e.name for e in records if e.name not in horizons]:
        sentences.append(f"{_listed(whole)}: fitted as a whole")
    if scoring_start is not None:
        sentences.append(
            f"validation records are scored over segments of {min(horizons.values()):.2g} s, "
            f"each from the start '{scoring_start}'"
        )
    return sentences


def _listed(names: Sequence[str]) -> str:
    """Names for a sentence, no more than a line has room for."""
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more


def describe_disagreements(disagreements: Sequence[Disagreement]) -> list[str]:
    """Sentences on parameters on which records disagree, and on what to do about it."""
    sentences = []
    for d in disagreements:
        one, other = d.sides
        values = " against ".join(f"{s.value:.4g} +- {s.error:.2g}" for s in d.sides)
        about = f"about `{d.parameter}` ({values} {d.unit}".rstrip() + ")"
        if d.group:
            sentences.append(
                f"the records of {one.what} and {other.what} disagree {about}: declare it "
                f'per="{d.group}"'
            )
        else:
            sentences.append(
                f"record '{one.what}' contradicts {other.what} {about}: look at its log and at "
                "what was changed, give it a group, or leave it out"
            )
    return sentences


def describe_bounds(
    estimates: Sequence[Estimate], noise_ratio: float | None, system: LagrangianSystem
) -> list[str]:
    """Sentences on parameters that are at a bound, the probable cause, and how to move the bound.

    Args:
        estimates: the estimates.
        noise_ratio: size of the residuals over that of the encoders' rounding, None if unknown.
        system: the system, whose ranges say where they are from.
    """
    # of a machine a bound says something where the model follows its records, and only there
    follows = _is_at_noise(noise_ratio)
    cause = (
        "the records do not determine it, or the range is wrong"
        if follows
        else "the model lacks something, or the range is wrong"
    )
    bases = {p.name: p.basis for p in system.parameters}
    sentences, ranges, vanished = [], {}, []
    for e in estimates:
        if not e.bound:
            continue
        if e.bound == "lower" and e.lower == 0:
            vanished.append(f"'{e.name}' is 0, its lower bound")
            continue
        name = e.name.partition("[")[0]
        basis = bases.get(name, "")
        where = f"; range: {basis}" if basis else ""
        sentences.append(
            f"'{e.name}' is at its {e.bound} bound ({e.value:.4g} {e.unit}{where}): {cause}"
        )
        if e.bound == "lower" and name.endswith(".stribeck_speed"):
            sentences.append(
                "the breakaway friction beside it then stands for a joint that sticks, which the "
                "rounded sign of the model does not: trust neither, and compare free runs with "
                "those of 'curve'"
            )
        if basis:
            ranges[name] = _wider(e)
    if follows:
        sentences += [f"{name}: the records show nothing of it" for name in vanished]
    elif vanished:
        advice = (
            ""
            if system.added_parameters
            else '; try `changes=` \'model.forces=["constant"]\' or "curve"'
        )
        sentences.append(
            f"{', '.join(vanished)}: that says nothing of the machine as long as the model does "
            f"not follow the records{advice}"
        )
    if ranges and system.source is not None:
        some = dict([*ranges.items()][:_MOST_RANGES])
        sentences.append(
            f"a system file moves bounds: {system.source.call(ranges=some)}; values that then go "
            "on to the new bound say that the model lacks something"
        )
    return sentences


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


def describe_forces(errors: Sequence[ForceError]) -> str:
    """Sentence on the errors of the forces of each coordinate, of the last split.

    Args:
        errors: the errors.
    """
    split, cutoff = errors[-1].split, errors[-1].cutoff
    errors = [e for e in errors if e.split == split]
    listed = ", ".join(
        f"{e.coordinate} {100 * e.share:.3g} % ({e.missing:.3g} {e.unit})" for e in errors
    )
    where = "the validation records" if split == "validation" else "the training records"
    means = (
        f"{100 * np.mean([getattr(e, name) for e in errors if e.is_driven]):.3g} % {words}"
        for name, words in (
            ("share", "on the mean"),
            ("moving", "while they move"),
            ("by_least_squares", "by least squares alone"),
            ("by_file", "by the first values"),
        )
    )
    told = f"; {', '.join(means)}" if any(e.is_driven for e in errors) else ""
    return f"forces that are missing on {where}, up to {cutoff:.3g} Hz: {listed}{told}"


def describe_trials(trials: Sequence[tuple[str, float, float, bool]]) -> list[str]:
    """Sentence on forces that were tried, by what they explain of forces that were left out.

    Args:
        trials: of each its name, the share that was missing before and with it, and whether it is
            kept.
    """
    if not trials:
        return []
    listed = (
        f"{name} {'kept' if is_kept else 'not kept'} ({100 * before:.3g} % to {100 * after:.3g} %)"
        for name, before, after, is_kept in trials
    )
    return [f"forces tried, by what is missing of those that were left out: {', '.join(listed)}"]


def describe_informed(
    names: Sequence[str], informed: Bool[np.ndarray, " n_p"], rank: int
) -> list[str]:
    """Sentences on the parameters that records say little of, which stay at their nominal values.

    Args:
        names: the parameters.
        informed: those of which records say more than the prior.
        rank: how many combinations of parameters change the forces at all.
    """
    kept = [name for name, is_informed in zip(names, informed, strict=True) if not is_informed]
    count = (
        f"{rank} combinations of the {len(names)} parameters change the forces (base parameters)"
    )
    if not kept:
        return [count]
    listed = ", ".join(kept[:_MOST_NAMES])
    if len(kept) > _MOST_NAMES:
        listed += f" and {len(kept) - _MOST_NAMES} more"
    return [f"{count}; the records say little of {listed}, which stay near their nominal values"]


def describe_scale(
    estimates: Sequence[Estimate],
    confounded: Sequence[ConfoundedParameters],
    space: SearchSpace,
    vector: ParameterVector,
) -> list[str]:
    """Sentence on estimates that are known only beside others, which were fixed at first values.

    Args:
        estimates: the estimates.
        confounded: the sets of which one was fixed.
        space: the search space.
        vector: the estimates as it has them.
    """
    derivatives = dict(zip(space.names, space.derivatives(vector), strict=True))
    known = []
    for e in estimates:
        spreads = {c.suggestion: c.spread[e.name] for c in confounded if e.name in c.spread}
        spread = float(np.linalg.norm([*spreads.values()]) * derivatives[e.name])
        if spread > (e.error or 0.0):
            by = max(spreads, key=lambda name: spreads[name])
            known.append((spread / (abs(e.value) or spread), f"{e.name} +- {spread:.2g} (by {by})"))
    if not known:
        return []
    listed = [text for _, text in sorted(known, reverse=True)]
    return [
        "errors are those beside the fixed values; with what is not known of these they are "
        f"{_listed(listed)}: records with a known load, with two loads, or with a measured torque "
        "or current tell more"
    ]


def describe_stretches(stretches: Sequence[Stretch]) -> list[str]:
    """Sentence on stretches of records that weigh little: probably corrupted samples."""
    if not stretches:
        return []
    longest = sorted(stretches, key=lambda s: s.begin - s.end)[:_MOST_STRETCHES]
    listed = ", ".join(f"'{s.record}' {s.begin:.4g}..{s.end:.4g} s" for s in longest)
    more = f" and {len(stretches) - len(longest)} more" if len(stretches) > len(longest) else ""
    return [
        f"residuals of {len(stretches)} stretches weigh less than half of the others: {listed}"
        f"{more}; look at the records there"
    ]


def describe_condition(names: Sequence[str], uncertainty: Uncertainty) -> list[str]:
    """Sentence on parameters that are badly conditioned: they can hardly be told apart.

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
        return [f"'{involved[0]}' has hardly any effect on the simulations; fix it"]
    return [
        f"badly conditioned ({uncertainty.condition:.1g}): {', '.join(involved)} can change "
        "together with hardly any effect on the simulations; fix one of them or record motion "
        "that tells them apart"
    ]


def describe_errors(
    uncertainty: Uncertainty,
    lag: Float[np.ndarray, " n_y"],
    noise_ratio: float | None,
    n_records: int,
) -> str:
    """Sentence on the residuals, and on the errors of the parameters to trust.

    Args:
        uncertainty: the covariances.
        lag: correlation of the residuals from one sample to the next, by channel.
        noise_ratio: size of the residuals over that of the encoders' rounding, None if unknown.
        n_records: number of training records.
    """
    if _is_at_noise(noise_ratio):
        noise = "the encoders' quantisation" if noise_ratio else "a millionth of the motion"
        return f"residuals are no larger than {noise}: nothing is missing"
    size = f"{noise_ratio:.0f} times the encoders' quantisation and " if noise_ratio else ""
    strongest = float(lag[np.argmax(np.abs(lag))])
    is_correlated = abs(strongest) > _CORRELATED
    if is_correlated:
        residuals = (
            f"residuals are {size}alike from sample to sample (correlation {strongest:.2f}): "
            "something is not modelled, and errors from J'J are too small"
        )
    else:
        residuals = f"residuals are {size}independent from sample to sample"
    if uncertainty.clustered is not None:
        return f"{residuals}; trust the errors from how the {counted(n_records, 'record')} disagree"
    few = f"{n_records} record{'s are' if n_records > 1 else ' is'} too few"
    if uncertainty.source == "segments":
        by = f"the {counted(uncertainty.segments, 'segment')} disagree"
        return f"{residuals}; the errors are those from how {by}, {few} for others"
    if is_correlated:
        return f"{residuals}, {few} to say by how much"
    return f"{residuals}; the errors are those from J'J, {few} for others"


def _is_at_noise(noise_ratio: float | None) -> bool:
    """Whether residuals are so small that the encoders show no more."""
    return noise_ratio is not None and noise_ratio < _AT_NOISE
