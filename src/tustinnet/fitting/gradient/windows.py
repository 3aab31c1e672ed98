"""Training windows: records laid end to end, and the rows at which windows begin."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.data.inspection import coordinate_timescales, correlation_times, transient_end
from tustinnet.errors import InputError
from tustinnet.fitting.recipe import WindowRecipe
from tustinnet.models.contract import Model
from tustinnet.signals.windows import random_windows, strided_windows
from tustinnet.simulate.along import states_along
from tustinnet.simulate.input_signal import input_signal
from tustinnet.wording import counted

_RECORD_SHARE = 4  # and at most the median record over this
_ROUND = 5  # adapted lengths are multiples of this
_SHORTEST_SPAN, _LONGEST_SPAN = 25, 200  # steps of a window whose length follows the records
_STEPS_AN_OCTAVE = 2  # of such lengths


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


def record_identity(experiment: Experiment) -> Hashable:
    """The name and samples of a record: records of two devices may share a name."""
    return experiment.name, experiment.q.tobytes(), experiment.u.tobytes()


class RecordPool:
    """The records of all members, once each.

    Args:
        experiments: the records, perhaps several times.
    """

    def __init__(self, experiments: Sequence[Experiment]) -> None:
        distinct = {record_identity(e): e for e in experiments}
        self.experiments = tuple(distinct.values())
        lengths = [len(e) for e in self.experiments]
        first_rows = np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(int)
        self._first_rows = dict(zip(distinct, first_rows.tolist(), strict=True))

    def records(self, model: Model, velocity: VelocitySource) -> Records:
        """The records laid end to end."""
        x = [e.measured_states(velocity) for e in self.experiments]
        steps = [np.asarray(input_signal(model, e).u) for e in self.experiments]
        u = [np.append(u, np.zeros((1, *u.shape[1:])), axis=0) for u in steps]
        return Records(*(jnp.asarray(np.concatenate(a), jnp.float32) for a in (x, u)))

    def internal_states(
        self, model: Model, velocity: VelocitySource
    ) -> Float[np.ndarray, "rows n_z"]:
        """The internal states with which windows begin; none where the model has a warm-up."""
        rows = sum(len(e) for e in self.experiments)
        if model.warm_up or not model.internal:
            return np.zeros((rows, 0), np.float32)
        states = np.concatenate(states_along(model, self.experiments, velocity))
        return states[:, model.channels.internal].astype(np.float32)

    def window_rows(
        self, windows: Int[np.ndarray, "count 2"], experiments: Sequence[Experiment]
    ) -> Int[np.ndarray, " count"]:
        """The rows at which windows (record, first sample) of some of the records begin."""
        first_rows = np.array(
            [self._first_rows[record_identity(e)] for e in experiments], dtype=int
        )
        return first_rows[windows[:, 0]] + windows[:, 1]


def draw_stage_windows(
    experiments: Sequence[Experiment],
    recipe: WindowRecipe,
    generator: np.random.Generator,
    lead: int = 0,
) -> tuple[Int[np.ndarray, "count 2"], int]:
    """Draws the windows of a stage: (record, first sample) of each, and their length.

    Raises:
        InputError: a record is not longer than a window, or no window fits.
    """
    length = window_length(experiments, recipe)
    reach, shortest = length + lead, min(experiments, key=len)
    if len(shortest) <= reach:
        before = f", {lead} of them before what is compared" if lead else ""
        shorter = " or what its start needs" if lead else ""
        raise InputError(
            shortest.name,
            counted(len(shortest), "sample"),
            f"more than a window of {reach} steps{before}",
            f"leave the record out, or shorten `length`{shorter} in the recipe",
        )
    windows = draw_windows(experiments, recipe, reach, generator)
    if not len(windows):
        raise InputError(
            "windows",
            f"no window of {reach} steps fits (longest record: {max(map(len, experiments))})",
            "longer records",
            "shorten `length` in the recipe",
        )
    return windows, length


def draw_windows(
    experiments: Sequence[Experiment],
    recipe: WindowRecipe,
    length: int,
    generator: np.random.Generator,
) -> Int[np.ndarray, "count 2"]:
    """Draws windows by a rule, (record, first sample); none where no record is long enough."""
    lengths = [len(e) for e in experiments]
    ends = [transient_end(e) for e in experiments] if recipe.until == "k_bar" else lengths
    if recipe.draw == "random":
        return random_windows(lengths, length, recipe.count or 0, generator, ends)
    reach = [min(n, end + length) for n, end in zip(lengths, ends, strict=True)]
    possible = sum(round(recipe.part * max(n - length, 0)) for n in reach)
    step = recipe.step or max(1, round(possible / (recipe.count or 1)))
    return strided_windows(reach, length, step, recipe.part)


def window_length(experiments: Sequence[Experiment], recipe: WindowRecipe) -> int:
    """The steps in a window that are compared, from the records where the recipe says so."""
    if recipe.length is None:
        return span_length(experiments, recipe.span or 1.0)
    return adapt_length(experiments, recipe.length) if recipe.adapt else recipe.length


def span_length(experiments: Sequence[Experiment], span: float) -> int:
    """A window length [steps] of so many correlation times of the slowest velocity.

    In that time every velocity is changed by what acts on it, so a window shows the forces and not
    the start alone. Where the slowest coordinate takes far longer than it makes sense to simulate
    in a step of the optimiser, and where the fastest one would be seen too shortly, lengths end at
    25 and 200 steps; and at a quarter of the median record and below the shortest. Lengths are
    steps of a geometric series, so that folds of the records have the same one.

    Args:
        experiments: the records.
        span: how many correlation times.
    """
    slowest = max(correlation_times(experiments).values(), default=1.0)
    longest = min(_LONGEST_SPAN, max(_room(experiments), _ROUND))
    length = min(max(span * slowest, _SHORTEST_SPAN), longest)
    step = int(np.log2(length / _SHORTEST_SPAN) * _STEPS_AN_OCTAVE + 0.5)
    rounded = int(_SHORTEST_SPAN * 2.0 ** (step / _STEPS_AN_OCTAVE)) // _ROUND * _ROUND
    return max(_ROUND, min(rounded, longest))


def adapt_length(experiments: Sequence[Experiment], length: int) -> int:
    """A window length [steps] that fits the records.

    The faster a log is sampled compared to the motion, the less happens in a window. The length
    grows, up to four times, towards the samples in which the slowest coordinate covers one
    standard deviation of its positions at its typical speed; and shrinks to a quarter of the
    median record, and below the shortest. Where a coordinate has few samples in a period, the
    velocity with which a window starts is uncertain: the window then lasts until that is forgotten,
    too.
    """
    q = np.concatenate([e.q - e.q.mean(axis=0) for e in experiments])
    v = np.concatenate([e.velocities() for e in experiments])
    moving = v.std(axis=0) > 0
    samples = q.std(axis=0)[moving] / (v.std(axis=0)[moving] * experiments[0].dt)
    slowest = float(samples.max()) if moving.any() else float(length)
    fast_decays = [s.decay for s in coordinate_timescales(experiments).values() if s.is_fast]
    # by then a wrong start has decayed to 5 %
    until_forgotten = 3 * max(fast_decays, default=0.0)
    adapted = min(max(length, slowest, until_forgotten), 4 * length, _room(experiments))
    return max(_ROUND, int(adapted) // _ROUND * _ROUND)


def _room(experiments: Sequence[Experiment]) -> int:
    """Steps of the longest window that all records have, and most have room for several of."""
    lengths = [len(e) for e in experiments]
    return min(int(np.median(lengths)) // _RECORD_SHARE, min(lengths) - 1)


def describe_windows(experiments: Sequence[Experiment], recipe: WindowRecipe) -> str:
    """A sentence on what was measured for the windows of a stage, and which length was chosen."""
    scales = coordinate_timescales(experiments)
    length = window_length(experiments, recipe)
    if not scales:
        return f"windows of {length} steps"
    name, fastest = min(scales.items(), key=lambda item: item[1].period)
    hertz = 1 / (fastest.period * experiments[0].dt)
    sentence = (
        f"windows of {length} steps: {length / fastest.period:.1f} periods of the dominant "
        f"frequency of {name}, {hertz:.3g} Hz; it decays to 1/e in {fastest.decay:.0f} samples"
    )
    if fastest.is_fast:
        sentence += (
            f"; {fastest.period:.0f} samples a period are few: see `velocity` and `linear` in "
            "docs/reference/training.md"
        )
    return sentence
