"""The equations of motion of a system, as the engine takes them: which parameter stands where."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.engine.equations import Equations, Formula
from tustinnet.engine.runs import evaluate
from tustinnet.fitting.shooting.space import Space
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.sensors import delay_name
from tustinnet.simulate.simulation import system_motion

Pick = Int[np.ndarray, "n n_g"]


@dataclass(frozen=True)
class SystemEquations:
    """The equations of a system, their parameters in a fixed order.

    Attributes:
        system: the system.
        searched: the parameters that derivatives are needed by; one per group counts once.
        others: all other parameters.
        delays: whether delays of inputs are among what is searched for. Then the inputs are
            followed by their derivatives by their delays, and the parameters by the delays that
            the inputs were made with.
    """

    system: LagrangianSystem
    searched: tuple[str, ...]
    others: tuple[str, ...]
    delays: bool

    @property
    def n_p(self) -> int:
        """How many parameters derivatives are needed by."""
        return len(self.searched)

    @property
    def size(self) -> int:
        """How many parameters the equations take in all."""
        made = len(self.system.inputs) if self.delays else 0
        return self.n_p + len(self.others) + made

    @cached_property
    def motion(self) -> Equations:
        """The derivative of the state."""
        return system_motion(self.system, self.searched, self.others, delays=self.delays)

    @cached_property
    def expected(self) -> Formula:
        """The internal states that are expected at a beginning, by [q, v] and the parameters."""
        system, measured = self.system, self.system.channels.measured

        def expected(point: Array) -> Array:
            model = system.model(self._of_point(point[measured.stop :]))
            return model.initial_internal(point[measured])

        by = range(measured.stop + self.n_p)
        return Formula(expected, measured.stop + self.size, by, f"system '{system.name}'")

    @cached_property
    def momenta(self) -> Formula:
        """Momentum and generalised force, (2 n_q,), by [q, v], the inputs and the parameters.

        Differentiated by the parameters that are searched for. Forces with memory are left out.
        """
        system, of = self.system, self.system.channels
        first = of.measured.stop + of.n_u

        def momenta(point: Array) -> Array:
            q, v, u = point[of.position], point[of.velocity], point[of.measured.stop : first]
            values = self._of_point(point[first:])
            momentum = jax.grad(system.kinetic, argnums=1)(q, v, values)
            force = jax.grad(system.kinetic)(q, v, values)
            if system.potential:
                force = force - jax.grad(system.potential)(q, values)
            still = jnp.zeros(len(system.internal), q.dtype)
            return jnp.concatenate([momentum, force + system.model(values).applied(q, v, still, u)])

        return Formula(
            momenta, first + self.size, range(first, first + self.n_p), f"system '{system.name}'"
        )

    @cached_property
    def slopes(self) -> Formula:
        """The derivative of the state, by the state, the inputs and the parameters.

        Differentiated by the state.
        """
        n_x, n_u = self.motion.n_x, len(self.system.inputs)

        def derivative(point: Array) -> Array:
            model = self.system.model(self._of_point(point[n_x + n_u :]))
            return model.derivative(point[:n_x], point[n_x : n_x + n_u])

        where = f"system '{self.system.name}'"
        return Formula(derivative, n_x + n_u + self.size, range(n_x), where)

    def _of_point(self, parameters: Array) -> dict[str, Any]:
        return self._named(parameters[: self.n_p], parameters[self.n_p :])

    def _named(self, p: Any, c: Any) -> dict[str, Any]:
        """Parameters by name."""
        searched = {name: p[i] for i, name in enumerate(self.searched)}
        return searched | {name: c[i] for i, name in enumerate(self.others)}

    def values(self, values: Mapping[str, float], pick: Pick) -> Float[np.ndarray, "n n_p"]:
        """What the equations take of parameters, in every segment or sample.

        Args:
            values: the parameters by name, those per group with a value for each of its values.
            pick: which of these hold, see `groups.picks`.
        """
        columns = []
        grouped = {p.name: i for i, p in enumerate(self.system.grouped)}
        for name in (*self.searched, *self.others):
            options = self.system.grouped[grouped[name]].by_group(values) if name in grouped else {}
            if options:
                columns.append(np.array(list(options.values()))[pick[:, grouped[name]]])
            else:
                columns.append(np.full(len(pick), values[name]))
        if self.delays:
            made = [values.get(delay_name(i), 0.0) for i in self.system.inputs]
            columns += [np.full(len(pick), delay) for delay in made]
        return np.stack(columns, axis=1)

    def base(self, space: Space) -> list[int]:
        """The place, among the parameters of the equations, of each one that is searched for."""
        return [self.searched.index(_base(self.system, name)) for name in space.names]

    def chain(self, space: Space, vector: np.ndarray, pick: Pick) -> Float[np.ndarray, "n n_p"]:
        """Derivatives of the parameters of the equations by the coordinates of the search.

        Of a parameter per group 0 where another of its values holds.
        """
        return self.acts(space, pick) * space.slopes(vector)

    def acts(self, space: Space, pick: Pick) -> Float[np.ndarray, "n n_p"]:
        """Which of the parameters that are searched for hold, 1 or 0."""
        acts = np.ones((len(pick), len(space.names)))
        every = dict.fromkeys([*space.names, *space.fixed], 0.0)
        for i, p in enumerate(self.system.grouped):
            names = [p.for_group(value).name for value in p.by_group(every)]
            for j, name in enumerate(space.names):
                if name in names:
                    acts[:, j] = pick[:, i] == names.index(name)
        return acts

    def models(
        self, model: Discretised, values: Float[np.ndarray, "n n_p"]
    ) -> Iterator[Discretised]:
        """Models with the parameters of each segment, as `values` returned them."""
        for row in values:
            named = self._named(row[: self.n_p], row[self.n_p :])
            arrays = {name: jnp.asarray(x) for name, x in named.items()}
            yield replace(model, continuous=self.system.model(arrays))

    def beginnings(
        self, x0: Float[np.ndarray, "n n_x"], values: np.ndarray, expected: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States in which segments begin, and their derivatives by parameters and by `x0`.

        Args:
            x0: states as `Segments` has them.
            values: what `values` returned for the segments.
            expected: whether the internal states that the system expects are added, 1 or 0, (n,).

        Returns:
            States (n, n_x); derivatives, a direction in a row: (n, n_p, n_x), (n, n_x, n_x).
        """
        n, n_x = x0.shape
        n_m, n_p, start = self.system.channels.measured.stop, self.n_p, x0.copy()
        by_parameter, by_state = np.zeros((n, n_p, n_x)), np.tile(np.eye(n_x), (n, 1, 1))
        if self.system.memory is None or self.system.memory.initial is None:
            return start, by_parameter, by_state
        points, share = np.concatenate([x0[:, :n_m], values], axis=1), expected[:, None]
        start[:, n_m:] += share * evaluate(self.expected, points)
        slopes = evaluate(self.expected, points, derivatives=True).reshape(n, n_x - n_m, n_m + n_p)
        slopes = share[:, :, None] * np.swapaxes(slopes, 1, 2)
        by_state[:, :n_m, n_m:] = slopes[:, :n_m]
        by_parameter[:, :, n_m:] = slopes[:, n_m:]
        return start, by_parameter, by_state


@lru_cache(maxsize=64)  # equations that were read once are not read again
def system_equations(
    system: LagrangianSystem, searched: tuple[str, ...] = (), *, delays: bool = False
) -> SystemEquations:
    """The equations of a system, with derivatives by some of its parameters.

    Args:
        system: the system.
        searched: the parameters; of those per group the names of their values.
        delays: see `SystemEquations`.
    """
    bases = tuple(dict.fromkeys(_base(system, name) for name in searched))
    others = tuple(p.name for p in system.parameters if p.name not in bases)
    return SystemEquations(system, bases, others, delays)


def _base(system: LagrangianSystem, name: str) -> str:
    """The parameter of a system that a name is of: of `mass[1kg]` it is `mass`."""
    for p in system.grouped:
        if p.by_group({name: 0.0}):
            return p.name
    return name
