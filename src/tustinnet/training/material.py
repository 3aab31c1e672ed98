"""What a stage is trained on: records laid end to end, windows as indices into them."""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.data.inspection import transient_end
from tustinnet.errors import InputError
from tustinnet.evaluation.free_run import stack_drives
from tustinnet.models.base import DiscreteModel
from tustinnet.signals.stacking import stacked
from tustinnet.signals.windows import random_windows, strided_windows
from tustinnet.simulation.initial_state import samples_fitted
from tustinnet.simulation.internal_states import known_states
from tustinnet.simulation.model_start import guessed_states, start_states
from tustinnet.training.recipe import WindowRecipe

_LONGEST = 4  # an adapted window is at most this many times the recipe's length
_USUAL_SHARE = 4  # and at most the median record over this
_ROUND = 5  # adapted lengths are multiples of this


class Records(eqx.Module):
    """Records end to end, in float32.

    Attributes:
        x: states [q, v, z], (rows, n_x).
        u: what acts from each row to the next, (rows, ...); 0 in the last row of a record.
    """

    x: Float[Array, "rows n_x"]
    u: Float[Array, "rows *drive"]


class ValidationRuns(eqx.Module):
    """Free runs to compare with, in float32.

    Attributes:
        x0: initial states, or where the search for them begins, (records, n_x).
        u: what drives them, (records, steps, ...), 0 after a record's end.
        q: measured positions, (records, steps + 1, n_q).
        weight: 1 / length within a record, 0 after its end, (records, steps + 1).
        records: the same records end to end, for losses over windows.
        fitted: samples that initial states are fitted to, 0 where they are as given.
    """

    x0: Float[Array, "records n_x"]
    u: Float[Array, "records steps *drive"]
    q: Float[Array, "records samples n_q"]
    weight: Float[Array, "records samples"]
    records: Records
    fitted: int = eqx.field(static=True, default=0)


@dataclass(frozen=True)
class StageWindows:
    """The windows of a stage.

    Attributes:
        rows: the row of `Records` at which each window begins, (count,); of several members
            that train together (members, count).
        length: steps in a window.
    """

    rows: Int[np.ndarray, "*members count"]
    length: int


def lay_out(
    model: DiscreteModel, experiments: Sequence[Experiment], velocity: VelocitySource
) -> Records:
    """Lays records end to end, with the model's internal states as they follow the record."""
    drives = [model.drive(e) for e in experiments]
    x = np.concatenate(known_states(model, experiments, velocity))
    u = np.concatenate([np.append(u, np.zeros((1, *u.shape[1:])), axis=0) for u in drives])
    return Records(jnp.asarray(x, jnp.float32), jnp.asarray(u, jnp.float32))


def validation_runs(
    model: DiscreteModel,
    experiments: Sequence[Experiment],
    start: str,
    velocity: VelocitySource,
) -> ValidationRuns:
    """Prepares the free runs of records from a named start, and their windows' states."""
    fitted = samples_fitted(start)
    # a start that is fitted is so with the weights of every epoch; here it only needs a guess
    x0 = (
        guessed_states(model, experiments, fitted)
        if fitted
        else start_states(model, experiments, start)
    )
    u = stack_drives(model, experiments)
    q = stacked([e.q for e in experiments])
    weight = stacked([np.full(len(e), 1.0 / len(e)) for e in experiments])
    x0, u, q, weight = (jnp.asarray(a, jnp.float32) for a in (x0, u, q, weight))
    return ValidationRuns(x0, u, q, weight, lay_out(model, experiments, velocity), fitted)


def stage_windows(
    experiments: Sequence[Experiment], recipe: WindowRecipe, generator: np.random.Generator
) -> StageWindows:
    """Draws the windows of a stage.

    Raises:
        InputError: a record is not longer than a window, or no window fits.
    """
    length = adapted_length(experiments, recipe.length) if recipe.adapt else recipe.length
    shortest = min(experiments, key=len)
    if len(shortest) <= length:
        raise InputError(
            shortest.name,
            f"{len(shortest)} samples",
            f"more than a window of {length} steps",
            "leave the record out, or shorten `length` in the recipe",
        )
    rows = _draw(experiments, recipe, length, generator)
    if not len(rows):
        raise InputError(
            "windows",
            f"no window of {length} steps fits (longest record: {max(map(len, experiments))})",
            "longer records",
            "shorten `length` in the recipe",
        )
    return StageWindows(rows, length)


def held_windows(
    experiments: Sequence[Experiment],
    recipe: WindowRecipe,
    length: int,
    generator: np.random.Generator,
) -> StageWindows | None:
    """Windows of the stage's rule and length in records that are not trained on, if any fit."""
    rows = _draw(experiments, recipe, length, generator)
    return StageWindows(rows, length) if len(rows) else None


def _draw(
    experiments: Sequence[Experiment],
    recipe: WindowRecipe,
    length: int,
    generator: np.random.Generator,
) -> Int[np.ndarray, " count"]:
    """The rows, among records laid end to end, at which windows begin."""
    lengths = [len(e) for e in experiments]
    ends = [transient_end(e) for e in experiments] if recipe.until == "k_bar" else lengths
    if recipe.draw == "random":
        windows = random_windows(lengths, length, recipe.count or 0, generator, ends)
    else:
        reach = [min(n, end + length) for n, end in zip(lengths, ends, strict=True)]
        possible = sum(round(recipe.part * max(n - length, 0)) for n in reach)
        step = recipe.step or max(1, round(possible / (recipe.count or 1)))
        windows = strided_windows(reach, length, step, recipe.part)
    offsets = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    return offsets[windows[:, 0]] + windows[:, 1]


def adapted_length(experiments: Sequence[Experiment], length: int) -> int:
    """A window length that fits the records.

    The faster a log is sampled compared to the motion, the less happens in a window. The length
    grows, up to four times, towards the samples in which the slowest coordinate covers one
    standard deviation of its positions at its typical speed; and shrinks to a quarter of the
    median record.
    """
    q = np.concatenate([e.q - e.q.mean(axis=0) for e in experiments])
    v = np.concatenate([e.velocities() for e in experiments])
    moving = v.std(axis=0) > 0
    covered = q.std(axis=0)[moving] / (v.std(axis=0)[moving] * experiments[0].dt)
    slowest = float(covered.max()) if moving.any() else float(length)
    usual = int(np.median([len(e) for e in experiments]))
    longest = min(_LONGEST * length, usual // _USUAL_SHARE)
    wanted = min(max(length, slowest), longest)
    return max(_ROUND, int(wanted) // _ROUND * _ROUND)
