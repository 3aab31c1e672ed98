"""The Levenberg-Marquardt iteration, whatever its steps are made of.

`iterate` takes the point to start from, a function that proposes a damped step from a point, and a
rule for the damping; it returns the last point and why it stopped. `least_squares` uses it for the
parameters and initial states of segments, `refit` for the parameters of free runs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

_STEPS = 10  # accepted, that have to lower the cost noticeably


@runtime_checkable
class IterationPoint(Protocol):
    """A point of an iteration."""

    @property
    def cost(self) -> float:
        """The cost there, infinite where a simulation diverges."""
        ...


P = TypeVar("P", bound=IterationPoint)


@dataclass(frozen=True)
class DampingRule:
    """Rule by which the damping follows the success of the steps.

    Attributes:
        initial: the damping to start with.
        largest: the iteration has stalled when a larger damping is needed.
        increase: factor after a rejected step.
        decreased: the damping after an accepted step, from that of the step and its gain ratio.
        least_gain_ratio: actual over predicted decrease that a step must exceed to be accepted.
    """

    initial: float
    largest: float
    increase: float
    decreased: Callable[[float, float], float]
    least_gain_ratio: float


@dataclass(frozen=True)
class IterationResult(Generic[P]):
    """Result of an iteration: where it ended, and why.

    Attributes:
        point: the last accepted point.
        iterations: accepted steps.
        status: `converged`, `stalled` where no step lowers the cost, `slow` where ten lower it by
            next to nothing, `limit` of iterations, or `stopped`.
    """

    point: P
    iterations: int
    status: str


def iterate(
    start: P,
    propose: Callable[[P, float], tuple[P, float]],
    has_converged: Callable[[P, float], bool],
    damping_rule: DampingRule,
    max_iterations: int,
    on_step: Callable[[int, P, float, bool], None],
    should_stop: Callable[[], bool],
    least_decrease: float = 0.0,
) -> IterationResult[P]:
    """Takes damped steps until the iteration has converged, has stalled or reaches its limit.

    Args:
        start: the point to start from, of finite cost.
        propose: function from a point and a damping to the point where a step leads, and to how
            much lower the quadratic model of the cost is there.
        has_converged: whether to stop at a point, given the cost before it (infinite at first).
        damping_rule: how the damping changes.
        max_iterations: limit of accepted steps.
        on_step: called after every step with the number of those that were accepted, the best
            point, the damping of the next step, and whether this one was accepted.
        should_stop: asked before every step.
        least_decrease: share of the cost that ten accepted steps take off together; where they take
            off less, the iteration is slow and ends.
    """
    costs = [start.cost]
    point, previous_cost, damping, iterations = start, np.inf, damping_rule.initial, 0
    while iterations < max_iterations:
        if has_converged(point, previous_cost):
            return IterationResult(point, iterations, "converged")
        while damping <= damping_rule.largest:
            if should_stop():
                return IterationResult(point, iterations, "stopped")
            trial, predicted = propose(point, damping)
            decrease = point.cost - trial.cost
            gain_ratio = decrease / predicted if np.isfinite(trial.cost) else -1.0
            if gain_ratio > damping_rule.least_gain_ratio:
                break
            damping *= damping_rule.increase
            on_step(iterations, point, damping, False)
        else:
            return IterationResult(point, iterations, "stalled")
        previous_cost, point = point.cost, trial
        iterations += 1
        damping = damping_rule.decreased(damping, gain_ratio)
        on_step(iterations, point, damping, True)
        costs = [*costs[-_STEPS:], point.cost]
        if len(costs) > _STEPS and costs[0] - point.cost < least_decrease * point.cost:
            return IterationResult(point, iterations, "slow")
    return IterationResult(point, iterations, "limit")
