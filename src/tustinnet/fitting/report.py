"""Results of fits: what training and identification return, and their plain values for files."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.data.fingerprint import make_fingerprint, step_quanta
from tustinnet.finding import Finding
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Member
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.shown import Plotted, Shown

FINISHED = "finished"
OUT_OF_TIME = "out of time"  # how the outcome of a fit that was stopped begins

SignAlternatives = tuple[tuple[str, ...], ...]  # each the names to reverse together; () for none


@dataclass(frozen=True)
class Estimate:
    """An identified parameter.

    Attributes:
        name: the parameter.
        unit: its SI unit.
        value: the identified value.
        error: standard error to trust, None where the value is at its bound.
        naive_error: standard error from `J'J`, which takes residuals for independent noise.
        interval: 95 % interval that goes with `error`, or None.
        lower: smallest value allowed.
        upper: largest.
        bound: `lower` or `upper` where it is at this bound, else "".
        is_informed: whether the records tell more of it than its prior: its error is less than half
            of what was known beforehand, which is its range where it has no prior.
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
    is_informed: bool = True


@dataclass(frozen=True)
class Stretch:
    """Samples of a record whose residuals weigh little, each less than half.

    Attributes:
        record: the record's name.
        begin: time of its first sample [s].
        end: time of its last sample [s].
        weight: mean weight, 1 for residuals that count in full.
    """

    record: str
    begin: float
    end: float
    weight: float


@dataclass(frozen=True)
class Side:
    """The estimate of a parameter from some of the records alone.

    Attributes:
        what: the records: a record's name, a group's value as `payload=1kg`, `the 5 others`.
        value: the value.
        error: its standard error.
    """

    what: str
    value: float
    error: float


@dataclass(frozen=True)
class Disagreement:
    """A parameter on which records disagree beyond their errors.

    Attributes:
        parameter: its name.
        unit: its SI unit.
        group: the group that divides the records, empty where one record contradicts the others.
        sides: the estimates of either side; a contradicting record comes first.
        chance: probability of one such difference among all that were tested, if they agreed.
    """

    parameter: str
    unit: str
    group: str
    sides: tuple[Side, Side]
    chance: float


@dataclass(frozen=True)
class Refit:
    """The result of fitting parameters once more to free runs.

    Attributes:
        before: mean free-run RMSE of the training records before it [rad or m].
        after: mean free-run RMSE of the training records after it [rad or m].
        iterations: how many steps were taken.
        values: the parameters that were searched for, by name.
    """

    before: float
    after: float
    iterations: int
    values: dict[str, float]


@dataclass(frozen=True)
class ForceError:
    """The force at a coordinate that equations of motion do not explain.

    Attributes:
        split: of the records along which it is missing.
        coordinate: the coordinate's name.
        unit: of forces on it.
        cutoff: frequency up to which forces were compared [Hz].
        size: root mean square of the actuators' force; without an actuator, of the forces that the
            motion needs.
        missing: root mean square of what the motion needs and the actuators do not give.
        moving: share of the actuators' force that is missing while the joint moves.
        by_file: the same of all samples by the nominal values, as of a robot's file.
        by_least_squares: the same by least squares on the training records, without priors, ranges
            and added forces; None where there are no training records.
        is_driven: whether an actuator acts on it; without one a share is of the forces that the
            motion needs, which may be none.
    """

    split: str
    coordinate: str
    unit: str
    cutoff: float
    size: float
    missing: float
    moving: float
    by_file: float
    by_least_squares: float | None
    is_driven: bool

    @property
    def share(self) -> float:
        """Share of the actuators' force that is missing."""
        return self.missing / self.size


@dataclass(frozen=True)
class BaseParameterEstimate:
    """An identified combination of parameters that forces tell by itself.

    Attributes:
        name: the parameter that it is named after, whose factor is 1.
        unit: its SI unit.
        terms: factors of the other parameters by name.
        value: the value of the combination.
        interval: 95 % interval, None where all its parameters are at a bound.
    """

    name: str
    unit: str
    terms: Mapping[str, float]
    value: float
    interval: tuple[float, float] | None

    @property
    def expression(self) -> str:
        """The combination as text: `arm.inertia_zz + 0.09 hand.mass`, factors to three digits."""
        parts = [self.name]
        for name, factor in self.terms.items():
            size = f"{abs(factor):.3g}"
            parts.append(f"{'-' if factor < 0 else '+'} {'' if size == '1' else f'{size} '}{name}")
        return " ".join(parts)


@dataclass(frozen=True, repr=False)
class Identification(Shown):
    """The result of an identification.

    Attributes:
        system: the system.
        model: the model with the identified values, or those of `refit`.
        estimates: the parameters that were searched for.
        fixed: the parameters that were not, by name.
        correlation: of the estimates' errors, (n_p, n_p), NaN for those at a bound.
        condition: how much better the best determined combination of parameters is than the worst.
        converged: whether the search ended at a minimum.
        outcome: why it stopped, as a sentence.
        reversed_signs: coordinates and inputs whose sign is probably the wrong way round:
            alternatives, each the names to reverse together.
        findings: what one should know before using it.
        trust: which errors to believe: `records` (how they disagree), `segments` (how these do, of
            few records) or `residuals` (J'J).
        rmse: per record, root mean square of the residuals' 2-norm, from the initial states below.
        autocorrelation: of the residuals from one sample to the next, per channel, (n_y,).
        disagreements: what records disagree about, by group and one by one.
        initial: how initial states were treated, see `SearchRecipe`.
        initial_states: the estimated states at the records' beginnings, by name, (n_x,) each.
        start: the start of the free runs that rank: the default start; over a horizon of 20 samples
            or more `model-20`.
        horizons: length of the segments [s] that records were compared over, by name; validation
            records too. Records that are not named were compared as a whole.
        validation_rmse: mean free-run RMSE of the validation records, if there are any.
        substeps: integration steps in a sampling period.
        iterations: of the last stage.
        seconds: time it took.
        downweighted: stretches that weigh less than half, where the search was robust.
        refit: the values of the model and what they are worth, where the recipe has a second fit
            to free runs; `estimates`, their errors and `rmse` are of the search before it.
        force_errors: errors of the forces of each coordinate, where it was identified by inverse
            dynamics; `rmse` is then that of these errors, each relative to the size of its force.
        base_parameters: combinations of the parameters that change these forces.
    """

    system: LagrangianSystem
    model: Discretised
    estimates: tuple[Estimate, ...]
    fixed: Mapping[str, float]
    correlation: Float[np.ndarray, "n_p n_p"]
    condition: float
    converged: bool
    outcome: str
    reversed_signs: SignAlternatives
    findings: tuple[Finding, ...]
    trust: str
    rmse: Mapping[str, float]
    autocorrelation: tuple[float, ...]
    disagreements: tuple[Disagreement, ...]
    initial: str
    initial_states: Mapping[str, tuple[float, ...]]
    start: str
    horizons: Mapping[str, float]
    validation_rmse: float | None
    substeps: int
    iterations: int
    seconds: float = 0.0
    downweighted: tuple[Stretch, ...] = ()
    refit: Refit | None = None
    force_errors: tuple[ForceError, ...] = ()
    base_parameters: tuple[BaseParameterEstimate, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether it ended at a minimum and no sign is suspected to be reversed."""
        return self.converged and not self.reversed_signs

    @property
    def horizon(self) -> float | None:
        """Length of the longest validation free run [s], None where they are whole records."""
        return min(self.horizons.values(), default=None)

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters after the search, by name, those fixed included."""
        return dict(self.fixed) | {e.name: e.value for e in self.estimates}

    def as_plain(self) -> dict[str, Any]:
        """The identification as plain values, as files have it."""
        return {
            "system": self.system.name,
            "converged": self.converged,
            "trust": self.trust,
            "condition": self.condition,
            "initial": self.initial,
            "horizons": dict(self.horizons),
            "iterations": self.iterations,
            "substeps": self.substeps,
            "estimates": [dataclasses.asdict(e) for e in self.estimates],
            "fixed": dict(self.fixed),
            "correlation": self.correlation.tolist(),
            "residual_rmse": dict(self.rmse),
            "residual_autocorrelation": list(self.autocorrelation),
            "downweighted": [dataclasses.asdict(s) for s in self.downweighted],
            "disagreements": [dataclasses.asdict(d) for d in self.disagreements],
            "initial_states": {name: list(x) for name, x in self.initial_states.items()},
            **({"refined": dataclasses.asdict(self.refit)} if self.refit else {}),
            **(
                {"force_errors": [dataclasses.asdict(e) for e in self.force_errors]}
                if self.force_errors
                else {}
            ),
            **(
                {"base_parameters": [dataclasses.asdict(b) for b in self.base_parameters]}
                if self.base_parameters
                else {}
            ),
        }


@dataclass(frozen=True, repr=False)
class FitResult(Plotted):
    """A fitted model and how it came about.

    Attributes:
        model: the model, in the cheapest form that computes the same.
        recipe: what was done.
        member: the seed, and what the recipe's rates were multiplied by.
        outcome: a sentence on why the fit ended.
        sound: whether it ended as it should.
        start: where the validation free runs started.
        horizon: how long they lasted at most [s], None where they were whole records.
        validation_rmse: mean free-run RMSE over the validation records [rad or m]; None without
            these, of least squares, and of inverse dynamics.
        physics_rmse: that of the physics alone, where a correction of it was trained.
        seconds: time spent, compilation included; of fits that ran together an equal share.
        details: plain values under one key that names the way of fitting: `training` has
            `windows`, `window_lengths`, `epochs` of each stage and `kept_epoch`, the epoch of the
            last one whose weights the model has, 0 of physics alone; `identification` has the
            estimates.
        findings: what one should know before using the model.
        identification: the result of an identification, None of a training.
        fewest_samples: validation records of fewer samples were left out, if there were longer
            ones.
        roles: the records; None of a fit within a selection or cross-validation.
        data: what they are called.
    """

    model: Model
    recipe: Recipe
    member: Member
    outcome: str
    sound: bool
    start: str
    validation_rmse: float | None
    seconds: float
    details: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    physics_rmse: float | None = None
    findings: tuple[Finding, ...] = ()
    identification: Identification | None = None
    horizon: float | None = None
    fewest_samples: int = 0
    roles: Roles | None = None
    data: str = ""

    @property
    def seed(self) -> int:
        """The seed of the member."""
        return self.member.seed

    @property
    def finished(self) -> bool:
        """Whether it ended as it should."""
        return self.sound

    @property
    def is_out_of_time(self) -> bool:
        """Whether it was stopped at a time limit."""
        return self.outcome.startswith(OUT_OF_TIME)

    @property
    def failure(self) -> str:
        """The failure of a fit that is not sound: a reversed sign first, else the outcome."""
        result = self.identification
        return self.findings[0].text if result and result.reversed_signs else self.outcome

    def detail(self, key: str) -> Any:
        """Detail of the fit by its name, None where this way of fitting does not have it."""
        return next((values[key] for values in self.details.values() if key in values), None)

    def as_header(self) -> dict[str, Any]:
        """The entries of a model file's header on the fit."""
        common = {
            "seed": self.seed,
            "rate": self.member.rate,
            "outcome": self.outcome,
            "seconds": self.seconds,
        }
        return {
            "recipe": self.recipe.model_dump(mode="json"),
            "findings": [finding.as_plain() for finding in self.findings],
            **{way: {**common, **values} for way, values in self.details.items()},
        }


def data_header(name: str, records: Sequence[Experiment]) -> dict[str, Any]:
    """The header entries on the records of a model, by which they are recognised."""
    quanta = step_quanta(records)
    return {
        "name": name,
        "quanta": quanta,
        "columns": {c.name: [*c.column] for c in records[0].coordinates if c.column},
        "records": [
            {
                "name": e.name,
                "split": e.split,
                "source": e.source,
                "sha256": e.sha256,
                "rows": [*e.logged_rows],
                "fingerprint": make_fingerprint(e, quanta),
            }
            | ({"groups": dict(e.groups)} if e.groups else {})
            for e in records
        ],
    }
