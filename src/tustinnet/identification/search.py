"""The stages of a search: from first values over longer and longer segments to whole records."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import jax.numpy as jnp
import numpy as np

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.identification import inverse_dynamics
from tustinnet.identification.gradient import minimise_by_gradient
from tustinnet.identification.identifiability import confounded
from tustinnet.identification.least_squares import Fitted, Iteration, Prior, minimise
from tustinnet.identification.segments import Segments, cut
from tustinnet.identification.sensitivity import Shape, lanes_for, normal_products
from tustinnet.identification.space import Searched, Space
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.simulation.initial_state import default_start
from tustinnet.simulation.integrators import Discretised, discretise
from tustinnet.simulation.substeps import PROBED_SECONDS, enough_substeps

Initial = Literal["choose", "anchored", "free"]
Loss = Literal["positions", "state"]
Times = Literal["recorded", "nominal"]
Part = Literal["whole", "transients"]
Method = Literal["levenberg-marquardt", "l-bfgs"]

_TARGET = 0.25  # integration error allowed, in encoder counts: less than rounding to them makes
_TARGET_SPAN = 1e-5  # or of the largest travel, where no count is known
_SWINGS = (4, 16)  # lengths of the first stages' segments, in quarters of a swing


@dataclass(frozen=True)
class Settings:
    """How to identify.

    Attributes:
        initial: what is done with every record's initial state while identifying. `anchored`:
            searched for, positions held to what the encoder read; `free`: searched for freely,
            which lets a model with missing physics start where it fits; `choose`: both, and the
            better free run on the validation records decides (`anchored` without them); or a
            start that `initial_state` knows (`file`, `derived-6`), then it is held.
        loss: `positions` (the paper) or `state`, which compares velocities too.
        periodic: compare angles by the periodic distance `2 (1 - cos e)`.
        times: `recorded`: step from timestamp to timestamp; `nominal`: by the sampling period, for
            logs whose timestamps jitter more than their sampling does.
        part: `whole` records, or `transients`: up to `k_bar`, without the standstill after it.
        method: `levenberg-marquardt`, or `l-bfgs` for systems with many parameters.
        tolerance: converged when the next step promises less than this part of the cost.
        most: iterations allowed in the last stage.
        substeps: integration steps in a period; None to choose them from the error target, a
            quarter of an encoder count within 2 s.
    """

    initial: Initial | str = "choose"
    loss: Loss = "positions"
    periodic: bool = False
    times: Times = "recorded"
    part: Part = "whole"
    method: Method = "levenberg-marquardt"
    tolerance: float = 1e-5
    most: int = 50
    substeps: int | None = None

    def __post_init__(self) -> None:
        for name, kind in (("loss", Loss), ("times", Times), ("part", Part), ("method", Method)):
            if getattr(self, name) not in get_args(kind):
                raise InputError(
                    f"identification, {name}", f"'{getattr(self, name)}'",
                    f"one of {', '.join(get_args(kind))}",
                )  # fmt: skip
        if self.most < 1 or (self.substeps is not None and self.substeps < 1):
            raise InputError(
                "identification", f"most {self.most}, substeps {self.substeps}", "at least 1"
            )


DEFAULT_SETTINGS = Settings()


class Search:
    """The records, the space and the compiled shape that the stages of a search share."""

    def __init__(
        self,
        system: LagrangianSystem,
        records: list[Experiment],
        held: list[Experiment],
        settings: Settings,
        space: Space,
        told: Callable[[Iteration], None],
    ) -> None:
        self.system, self.records, self.held = system, records, held
        self.settings, self.space, self.told = settings, space, told
        self.motion = inverse_dynamics.measured_motion(records)
        self.start = default_start([*records, *held])
        self.substeps = settings.substeps or 1
        self.variance = 1e-4
        self._segments: dict[tuple[int | None, str], Segments] = {}

    def model(self, vector: Searched) -> Discretised:
        """The model with the values of a vector."""
        values = {name: jnp.asarray(x) for name, x in self.space.numbers(vector).items()}
        return discretise(LagrangianModel(self.system, values), self.records[0].dt, self.substeps)

    @property
    def shape(self) -> Shape:
        """What the compiled program is made for."""
        angles = tuple(
            c.kind == "angular" and self.settings.periodic for c in self.system.coordinates
        )
        velocity = (False,) * len(angles) if self.settings.loss == "state" else ()
        longest = max(len(e) for e in (*self.records, *self.held)) - 1
        lanes = lanes_for(len(self.records))
        return Shape(self.system, self.space.free, (*angles, *velocity), lanes, longest)

    def segments(self, length: int | None, initial: str) -> Segments:
        """The records cut for a stage."""
        key = (length, initial)
        if key not in self._segments:
            searched = initial in ("anchored", "free")
            found = cut(
                self.records,
                self.model(self.space.vector(self.system.nominal())),
                length,
                start="estimated" if searched else initial,
                weights=self._weights(),
                velocity_loss=self.settings.loss == "state",
                recorded_times=self.settings.times == "recorded",
            )
            if initial == "free":
                found = replace(found, precision=np.zeros_like(found.precision))
            self._segments[key] = found
        return self._segments[key]

    def _weights(self) -> np.ndarray:
        """1 over the unit in which each residual counts; the paper's 1 where all are of a kind."""
        spans = np.sqrt(np.mean([e.q.var(axis=0) for e in self.records], axis=0))
        kinds = {c.kind for c in self.system.coordinates}
        positions = np.ones(len(spans)) if len(kinds) == 1 else 1 / np.where(spans > 0, spans, 1.0)
        if self.settings.loss == "positions":
            return positions
        speeds = np.sqrt(
            np.mean([np.mean(e.velocities() ** 2, axis=0) for e in self.records], axis=0)
        )
        return np.concatenate([positions, positions * spans / np.where(speeds > 0, speeds, 1.0)])

    def prior(self, cost: float | None = None) -> Prior:
        """What is known beforehand, made comparable with residuals of the given cost."""
        variance = self.variance
        if cost is not None and np.isfinite(cost):  # a search that diverged has none
            variance = cost / len(self.records)
        samples = sum(len(e) for e in self.records)
        return Prior(
            centre=np.array([p.nominal for p in self.space.free]),
            precision=np.array([1 / p.prior if p.prior else 0.0 for p in self.space.free]),
            variance=variance,
            weight=variance * len(self.records) / samples,
        )

    def hold_confounded(self, vector: Searched) -> tuple[np.ndarray, list[str]]:
        """Holds one parameter of every set that the records cannot tell apart."""
        s = self.segments(_SWINGS[0] * self.motion.length, self._first)
        products = normal_products(self.shape, self.space, vector, s.x0, s, 1).pp.sum(axis=0)
        if not np.isfinite(products).all():
            return vector, [
                "the first values simulate to infinity; identifiability was not checked"
            ]
        found = confounded(self.space, vector, products)
        if not found:
            return vector, []
        names = {direction.suggestion for direction in found}
        numbers = self.space.numbers(vector)
        free = tuple(p for p in self.space.free if p.name not in names)
        if not free:
            raise InputError(
                f"system '{self.system.name}'",
                "; ".join(str(direction) for direction in found),
                "records that say something of at least one parameter",
            )
        self.space = Space(free, dict(self.space.held) | {name: numbers[name] for name in names})
        told = [f"{direction}; here it was held at its first value" for direction in found]
        return self.space.vector(numbers), told

    def first_values(self, vector: Searched) -> tuple[Searched, float]:
        """Least squares on the equations of motion, and what they leave of the worst record."""
        found, shares = inverse_dynamics.first_values(self.system, self.space, vector, self.motion)
        left = float(shares.max())
        self.told(Iteration("first values", 1, left, 0.0))
        self._choose_substeps(found)
        return found, left

    def _choose_substeps(self, vector: Searched) -> None:
        """Integration steps in a period, by the error target."""
        if self.settings.substeps:
            return
        counts = [r for r in self.records[0].resolution if r]
        reach = max(float(np.abs(e.q - e.q[-1]).max()) for e in self.records)
        target = _TARGET * min(counts) if counts else _TARGET_SPAN * reach
        probed = max(2, round(PROBED_SECONDS / self.records[0].dt))
        parts = self._held_runs([e[:probed] for e in self.records])

        def positions(substeps: int) -> np.ndarray:
            return self._errors(vector, parts, substeps)

        self.substeps = enough_substeps(positions, target)

    def _held_runs(self, records: Sequence[Experiment]) -> Segments:
        """Free runs from the start by which models are judged; nothing is searched for."""
        return cut(
            records, self.model(self.space.vector(self.system.nominal())), None,
            start=self.start, weights=self._weights(), velocity_loss=False, recorded_times=False,
        )  # fmt: skip

    @cached_property
    def _judging(self) -> Segments:
        """The validation records' free runs, laid out once for all scores."""
        return self._held_runs(self.held)

    def _errors(self, vector: Searched, runs: Segments, substeps: int) -> np.ndarray:
        """Simulated minus measured positions of free runs, 0 after their ends."""
        found = normal_products(self.shape, self.space, vector, runs.x0, runs, substeps)
        return found.error[..., : len(self.system.coordinates)]

    @property
    def _first(self) -> str:
        chosen = self.settings.initial
        return "anchored" if chosen in ("choose", "free") else chosen

    def search(self, vector: Searched) -> tuple[Fitted, str, float | None]:
        """All stages; the parameters, how initial states were treated, the validation RMSE."""
        longest = max(len(e) for e in self.records) - 1
        for swings in _SWINGS:
            length = swings * self.motion.length
            if length < longest:
                vector = self._stage(vector, length, self._first, 0.1, 20).vector
        rough = self._stage(vector, None, self._first, 1e-2, 30)
        self._choose_substeps(rough.vector)
        if self.settings.initial != "choose":
            fitted = self._last(rough.vector, self.settings.initial)
            return fitted, self.settings.initial, self._score(fitted) if self.held else None
        if not self.held:
            return self._last(rough.vector, "anchored"), "anchored", None
        loose = self._stage(rough.vector, None, "free", 1e-2, 15)
        chosen, name = min(
            ((rough, "anchored"), (loose, "free")), key=lambda entry: self._score(entry[0])
        )
        if chosen.why != "diverged":
            self.variance = chosen.cost / len(self.records)
        fitted = self._last(chosen.vector, name)
        return fitted, name, self._score(fitted)

    def _stage(
        self, vector: Searched, length: int | None, initial: str, tolerance: float, most: int
    ) -> Fitted:
        method = minimise if self.settings.method == "levenberg-marquardt" else minimise_by_gradient
        name = "whole records" if length is None else f"segments of {length * self.motion.dt:.2g} s"
        # over a few swings the integration error stays far below what the first stages leave
        substeps = self.substeps if length is None else max(1, self.substeps // 2)
        found = method(
            self.shape, self.space, vector, self.segments(length, initial), self.prior(),
            substeps=substeps, tolerance=tolerance, most=most, told=self.told,
            stage=f"{name}, {initial} start",
        )  # fmt: skip
        if found.why != "diverged":
            self.variance = found.cost / len(self.records)
        return found

    def _last(self, vector: Searched, initial: str) -> Fitted:
        return self._stage(vector, None, initial, self.settings.tolerance, self.settings.most)

    def _score(self, fitted: Fitted) -> float:
        """Mean free-run RMSE of the validation records."""
        error = self._errors(fitted.vector, self._judging, self.substeps)
        squares = np.sum(error**2, axis=(1, 2)) / [len(e) for e in self.held]
        score = float(np.mean(np.sqrt(squares)))
        return score if np.isfinite(score) else np.inf
