"""Steps that use everything a program may hold, for the tests of targets."""

from collections.abc import Callable
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import tustinnet as tn
from tustinnet.export.source import Source, make_source
from tustinnet.program.program import OPERATIONS, Program

SIZE = 10  # of the vectors that operations are tried on
NUMBERS = np.array([-2.5, -1.0, -0.3, -0.0, 0.0, 0.7, 1.0, 2.5, 1e-9, 30.0])
OTHERS = np.array([1.5, -1.0, 0.0, 0.0, -2.0, 0.7, -0.0, 3.0, 2.0, -1.25])
_OTHER_NAMES = {"and": "bitwise_and", "or": "bitwise_or", "not": "bitwise_not"}


class Stepping(tn.Model):
    """A model that steps by any function of a state and an input."""

    function: Callable = eqx.field(static=True)
    channels: tn.Channels = eqx.field(static=True)

    def step(self, x, u):
        return self.function(x, u)


def stepping(function: Callable) -> Source:
    """A function of a state and an input as the step of a model; what it leaves out stays."""
    known = jax.ShapeDtypeStruct((2 * SIZE,), np.float64), jax.ShapeDtypeStruct((1,), np.float64)
    size = jax.eval_shape(function, *known).shape[0]
    coordinates = tuple(tn.Coordinate(f"q{i}", "linear") for i in range(-(-size // 2)))

    def filled(x, u):
        return jnp.concatenate([function(x, u), x[size:]])

    return make_source(Stepping(filled, tn.Channels(coordinates, (tn.Input("force", "N"),), 0.1)))


def every_operation(x, u):
    """All operations on long vectors, then on single numbers."""
    return jnp.concatenate([*_operations(x), *(jnp.stack(r) for r in _by_number(x))])


def _operations(x) -> list:
    a, b, found = x[:SIZE], x[SIZE : 2 * SIZE], []
    for name, operation in OPERATIONS.items():
        apply = getattr(lax, _OTHER_NAMES.get(name, name))
        if name == "select":
            found.append(apply(a > b, a, b))
            continue
        given = (a > 0, b > 0) if name in _OTHER_NAMES else (a, b)
        value = apply(*given[: cast(np.ufunc, operation.apply).nin])
        found.append(value.astype(float))
    return found


def _by_number(x) -> list[list]:
    """The same of some numbers, one by one."""
    rows = []
    for k in (0, 5, 9):
        one = jnp.concatenate([jnp.repeat(x[k : k + 1], SIZE), jnp.repeat(x[SIZE + k], SIZE)])
        rows.append([value[0] for value in _operations(one)])
    return rows


def every_loop(x, u):
    """Loops in a loop, which carry vectors, numbers and truths, some of them swapped."""
    matrix = jnp.asarray(np.random.default_rng(0).normal(size=(SIZE, SIZE))) / 4
    offset = x[SIZE : 2 * SIZE]

    def inner(carried, given):
        one, other = carried
        return (other * 0.9 + given * u[0], one), None

    def turn(carried, given):
        v, flag, flags, one, other = carried
        (one, other), _ = lax.scan(inner, (one, other), jnp.linspace(-1, 1, 110))
        turned = jnp.where(flags, matrix @ v + given, jnp.where(flag, jnp.sin(v[::-1]), -v))
        told = jnp.sum(jnp.where(flags == (v > 0), 1.0, 0.0))
        following = flag & (v[0] < 3), flags != (turned > offset), other + 1e-3 * told, one
        return (turned, *following), None

    start = x[:SIZE], x[0] < 1, x[:SIZE] > 0, x[0], x[1]
    v, flag, flags, one, other = lax.scan(turn, start, jnp.linspace(0, 1, 8))[0]
    ends = jnp.stack([flag.astype(float), one, other])
    return jnp.concatenate([v, flags.astype(float), ends])


def constants(x, u):
    """Constants that are not finite, tables, and outputs that are constant or inputs."""
    far = jnp.where(x[:SIZE] > 0, jnp.inf, jnp.where(x[:SIZE] < -1, jnp.nan, -jnp.inf))
    table = jnp.where(x[:SIZE] > 0, jnp.arange(SIZE) * 0.1, -jnp.arange(SIZE))
    return jnp.concatenate([far, table, jnp.full(SIZE, -0.5), u, x[3:4]])


def without_inputs() -> tn.Model:
    """A mass that nothing drives."""
    system = tn.LagrangianSystem(
        name="mass",
        coordinates=(tn.Coordinate("s", "linear"),),
        inputs=(),
        parameters=(),
        kinetic=lambda q, v, p: v[0] ** 2 / 2,
        potential=lambda q, p: jnp.cos(q[0]),
    )
    return tn.discretise(tn.LagrangianModel(system, {}), 0.01)


PROGRAMS = {"operations": every_operation, "loops": every_loop, "constants": constants}


def state_of(source: Source) -> np.ndarray:
    """A state to try a step at."""
    return np.resize(np.concatenate([NUMBERS, OTHERS]), source.n_x)


def operations_in(program: Program) -> set[str]:
    """The kinds of nodes of a program, loops included."""
    found = {node.op for node in program.nodes}
    return found.union(*(operations_in(loop.body) for loop in program.loops))


def require_same_run(found: object, expected: object, *, relative: float = 1e-12) -> None:
    """Two free runs, (time, n_x), agree: each state relative to its largest value in the run.

    A relative error of each number would ask for most where a state passes through 0, and what
    is rounded on the way depends on the machine.
    """
    runs = [np.asarray(run, float) for run in (found, expected)]
    assert runs[0].shape == runs[1].shape
    largest = np.abs(runs[1]).max(axis=0)
    difference = np.abs(runs[0] - runs[1]).max(axis=0)
    assert np.all(difference <= relative * largest), (difference, largest)
