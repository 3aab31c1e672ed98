"""What members are trained on: records laid end to end, windows as indices."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.data.inspection import scales_of, transient_end
from tustinnet.errors import InputError
from tustinnet.fitting.recipe import WindowRecipe
from tustinnet.models.contract import Model
from tustinnet.signals.windows import random_windows, strided_windows
from tustinnet.simulate.along import states_along
from tustinnet.simulate.drive import drive_of

_LONGEST = 4  # an adapted window is at most this many times the recipe's length
_USUAL_SHARE = 4  # and at most the median record over this
_ROUND = 5  # adapted lengths are multiples of this
_DECAYS = 3  # times of decay to 1/e after which a wrong start is forgotten


class Records(eqx.Module):
    """Records end to end, in float32.

    Attributes:
        x: positions and velocities, (rows, 2 n_q).
        u: what acts from each row to the next, (rows, ...); 0 in the last row of a record.
    """

    x: Float[Array, "rows n_measured"]
    u: Float[Array, "rows *drive"]


@dataclass(frozen=True)
class StageWindows:
    """The windows of a stage.

    Attributes:
        rows: the row of `Records` at which each window begins, (count,); of several members
            that train together (members, count).
        length: steps in a window that are compared.
        lead: steps before them that internal states follow: the warm-up of the model.
    """

    rows: Int[np.ndarray, "*members count"]
    length: int
    lead: int = 0


def lead_of(model: Model) -> int:
    """The samples before those compared in a window, see `StageWindows`."""
    return model.warm_up


def sameness(e: Experiment) -> Hashable:
    """What is equal where two records are the same: records of two devices may share a name."""
    return e.name, e.q.tobytes(), e.u.tobytes()


class Pool:
    """The records that any member has a use for, once each.

    Args:
        experiments: the records, perhaps several times.
    """

    def __init__(self, experiments: Sequence[Experiment]) -> None:
        known = {sameness(e): e for e in experiments}
        self.experiments = tuple(known.values())
        lengths = [len(e) for e in self.experiments]
        begins = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(int)
        self._begin = dict(zip(known, begins.tolist(), strict=True))

    def records(self, model: Model, velocity: VelocitySource) -> Records:
        """The records laid end to end."""
        x = [e.measured_states(velocity) for e in self.experiments]
        seen = [np.asarray(drive_of(model, e).u) for e in self.experiments]
        u = [np.append(u, np.zeros((1, *u.shape[1:])), axis=0) for u in seen]
        return Records(*(jnp.asarray(np.concatenate(a), jnp.float32) for a in (x, u)))

    def internal_states(
        self, model: Model, velocity: VelocitySource
    ) -> Float[np.ndarray, "rows n_z"]:
        """The states with which windows begin; none where every window has a lead."""
        rows = sum(len(e) for e in self.experiments)
        if lead_of(model) or not model.internal:
            return np.zeros((rows, 0), np.float32)
        along = states_along(model, self.experiments, velocity)
        return np.concatenate(along)[:, model.channels.internal].astype(np.float32)

    def rows(self, windows: Int[np.ndarray, "count 2"], of: Sequence[Experiment]) -> np.ndarray:
        """The rows at which windows (record, first sample) of some of the records begin."""
        begins = np.array([self._begin[sameness(e)] for e in of], dtype=int)
        return begins[windows[:, 0]] + windows[:, 1]


def stage_windows(
    experiments: Sequence[Experiment],
    recipe: WindowRecipe,
    generator: np.random.Generator,
    lead: int = 0,
) -> tuple[Int[np.ndarray, "count 2"], int]:
    """Draws the windows of a stage: (record, first sample) of each, and their length.

    Raises:
        InputError: a record is not longer than a window, or no window fits.
    """
    length = adapted_length(experiments, recipe.length) if recipe.adapt else recipe.length
    reach, shortest = length + lead, min(experiments, key=len)
    if len(shortest) <= reach:
        before = f", {lead} of them before what is compared" if lead else ""
        shorter = " or what its start needs" if lead else ""
        raise InputError(
            shortest.name,
            f"{len(shortest)} samples",
            f"more than a window of {reach} steps{before}",
            f"leave the record out, or shorten `length`{shorter} in the recipe",
        )
    windows = draw(experiments, recipe, reach, generator)
    if not len(windows):
        raise InputError(
            "windows",
            f"no window of {reach} steps fits (longest record: {max(map(len, experiments))})",
            "longer records",
            "shorten `length` in the recipe",
        )
    return windows, length


def draw(
    experiments: Sequence[Experiment],
    recipe: WindowRecipe,
    length: int,
    generator: np.random.Generator,
) -> Int[np.ndarray, "count 2"]:
    """Windows of the recipe's rule, (record, first sample); none where no record is long enough."""
    lengths = [len(e) for e in experiments]
    ends = [transient_end(e) for e in experiments] if recipe.until == "k_bar" else lengths
    if recipe.draw == "random":
        return random_windows(lengths, length, recipe.count or 0, generator, ends)
    reach = [min(n, end + length) for n, end in zip(lengths, ends, strict=True)]
    possible = sum(round(recipe.part * max(n - length, 0)) for n in reach)
    step = recipe.step or max(1, round(possible / (recipe.count or 1)))
    return strided_windows(reach, length, step, recipe.part)


def adapted_length(experiments: Sequence[Experiment], length: int) -> int:
    """A window length that fits the records.

    The faster a log is sampled compared to the motion, the less happens in a window. The length
    grows, up to four times, towards the samples in which the slowest coordinate covers one
    standard deviation of its positions at its typical speed; and shrinks to a quarter of the
    median record. Where a coordinate has few samples in a period, the velocity with which a window
    starts is uncertain: the window then lasts until that is forgotten, too.
    """
    q = np.concatenate([e.q - e.q.mean(axis=0) for e in experiments])
    v = np.concatenate([e.velocities() for e in experiments])
    moving = v.std(axis=0) > 0
    covered = q.std(axis=0)[moving] / (v.std(axis=0)[moving] * experiments[0].dt)
    slowest = float(covered.max()) if moving.any() else float(length)
    fast = [s.decay for s in scales_of(experiments).values() if s.fast]
    forgotten = _DECAYS * max(fast, default=0.0)
    usual = int(np.median([len(e) for e in experiments]))
    longest = min(_LONGEST * length, usual // _USUAL_SHARE)
    wanted = min(max(length, slowest, forgotten), longest)
    return max(_ROUND, int(wanted) // _ROUND * _ROUND)


def window_account(experiments: Sequence[Experiment], recipe: WindowRecipe) -> str:
    """What was measured for the windows of a stage, and what was chosen."""
    found = scales_of(experiments)
    length = adapted_length(experiments, recipe.length) if recipe.adapt else recipe.length
    if not found:
        return f"windows of {length} steps"
    name, of = min(found.items(), key=lambda item: item[1].period)
    hertz = 1 / (of.period * experiments[0].dt)
    account = (
        f"windows of {length} steps: {length / of.period:.1f} periods of the strongest line of "
        f"{name}, {hertz:.3g} Hz; it decays to 1/e in {of.decay:.0f} samples"
    )
    if of.fast:
        account += (
            f"; {of.period:.0f} samples a period are few: see `velocity` and `linear` in "
            "docs/reference/training.md"
        )
    return account
