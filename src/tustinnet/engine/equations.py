"""Equations for the engine: functions of JAX arrays, read once as programs with derivatives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import jax.numpy as jnp

from tustinnet.program.adjoints import Adjoints, with_adjoints
from tustinnet.program.derivatives import with_derivatives
from tustinnet.program.program import Program
from tustinnet.program.reading import read


@dataclass(frozen=True, eq=False)
class SampledValues:
    """Changes at each sample: states that settle, and values that are held until the next.

    Attributes:
        function: of the state (n_x,), the inputs (n_u,) at the sample, the parameters that
            derivatives are needed by (n_p,), and all others (n_c,): the state that goes on, (n_x,),
            and the values, (size,), as those that a controller computes.
        size: how many values there are.
    """

    function: Callable[..., Any]
    size: int


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of motion, or the step of a discrete model.

    Attributes:
        function: of the state (n_x,), the inputs (n_u,), the parameters that derivatives are
            needed by (n_p,), and all others (n_c,): the derivative of the state, or the next
            state, (n_x,). Behind them it takes the matrices. It is written with JAX.
        n_x: how many numbers a state has.
        n_u: how many numbers of inputs the function takes at a time.
        n_p: how many parameters derivatives are needed by.
        n_c: how many other parameters there are.
        continuous: whether the function is the derivative, which is integrated by the classical
            Runge-Kutta method.
        where: its name in messages.
        matrices: the weights of layers that are given with every run, and their shapes.
        sampled: what happens at each sample; the function takes its values last. None for
            nothing.
        along: of state and inputs, the next state and its derivatives by both behind it,
            (n_x, 1 + n_x + n_u); None for those of the program.
    """

    function: Callable[..., Any]
    n_x: int
    n_u: int
    n_p: int = 0
    n_c: int = 0
    continuous: bool = True
    where: str = "model"
    matrices: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    sampled: SampledValues | None = None
    along: Callable[[Any, Any], Any] | None = None

    @cached_property
    def with_sampled_states(self) -> "tuple[Equations, Equations]":
        """Equations of states with the sampled values behind them, and the step at a sample.

        The first hold the values, the second, discrete ones, compute all anew.
        """
        assert self.sampled is not None
        held, n_x, size = self.sampled, self.n_x, self.n_x + self.sampled.size

        def flow(x: Any, u: Any, p: Any, c: Any) -> Any:
            rate = self.function(x[:n_x], u, p, c, x[n_x:])
            return jnp.concatenate([rate, jnp.zeros_like(x[n_x:])])

        def sample(x: Any, u: Any, p: Any, c: Any) -> Any:
            return jnp.concatenate(held.function(x[:n_x], u, p, c))

        return (
            replace(self, function=flow, n_x=size, sampled=None),
            replace(self, function=sample, n_x=size, sampled=None, continuous=False),
        )

    @property
    def programs(self) -> tuple[Program, ...]:
        """The programs of a simulation: the function, or the two of `with_sampled_states`.

        Raises:
            Unreadable: they use what no program can hold.
        """
        if self.sampled is None:
            return (self.program,)
        return tuple(equations.program for equations in self.with_sampled_states)

    @cached_property
    def program(self) -> Program:
        """The function as a program: `x`, `u`, `p`, `c` and the matrices to `x`.

        Only of equations without sampled values.

        Raises:
            Unreadable: it uses what no program can hold.
        """
        sizes = {"x": self.n_x, "u": self.n_u, "p": self.n_p, "c": self.n_c}
        return read(
            lambda *vectors: {"x": self.function(*vectors)}, sizes, self.where, self.matrices
        )

    @cached_property
    def derivatives(self) -> Program:
        """The program with a row of its derivatives, `by_x` and `by_p`: the one of `adjoint`."""
        return with_adjoints(self.program, "x", ("x", "p"), value=True).program

    @cached_property
    def linearised(self) -> Program:
        """The program with its derivatives by rows: `a` by the state, `b` by the inputs.

        Loops stay loops, so that machine code of a step is compiled in a fraction of a second.
        """
        if self.along is None:
            return with_derivatives(self.program, "x", {"a": "x", "b": "u"})
        return read_linearised(self.along, self.program.inputs, self.where)

    @cached_property
    def adjoints(self) -> Adjoints:
        """The program in reverse: adjoints of the state, the parameters and the layers."""
        return with_adjoints(self.program, "x", ("x", "p"))


def read_linearised(
    along: Callable[[Any, Any], Any], inputs: Mapping[str, int], where: str = "model"
) -> Program:
    """The program of a linearised step: `x`, and its derivatives `a` by the state, `b` by inputs.

    Args:
        along: see `Equations`.
        inputs: sizes of the program's inputs; state and inputs are the first two.
        where: its name in messages.
    """
    n_x = next(iter(inputs.values()))

    def linearised(x: Any, u: Any, *_: Any) -> dict[str, Any]:
        columns = along(x, u)
        return {"x": columns[:, 0], "a": columns[:, 1 : 1 + n_x], "b": columns[:, 1 + n_x :]}

    return read(linearised, inputs, where)


@dataclass(frozen=True, eq=False)
class ResidualFormula:
    """Formula of the residual of a simulation error: how the error counts.

    Attributes:
        function: from errors (n_y,) to residuals, (n_y,), each of its own error alone. Written
            with JAX.
        n_y: the number of errors.
    """

    function: Callable[[Any], Any]
    n_y: int

    @cached_property
    def program(self) -> Program:
        """The function as a program: `error` to `value`, and to `slope`, its Jacobian by rows."""
        values = read(
            lambda error: {"value": self.function(error)}, {"error": self.n_y}, "residual"
        )
        return with_derivatives(values, "value", {"slope": "error"})


@dataclass(frozen=True, eq=False)
class Formula:
    """A function of points, to be evaluated at many of them.

    Attributes:
        function: of a point, (n,), to a vector, (m,). Written with JAX.
        size: `n`.
        by: the numbers of a point that it is differentiated by; by default all.
        where: its name in messages.
        slope: of a point, the derivatives by all its numbers, (m, n); None for those of the
            program.
    """

    function: Callable[[Any], Any]
    size: int
    by: range | None = None
    where: str = "model"
    slope: Callable[[Any], Any] | None = None

    @cached_property
    def program(self) -> Program:
        """The function as a program: `x` to `value`.

        Raises:
            Unreadable: it uses what no program can hold.
        """
        return read(lambda x: {"value": self.function(x)}, {"x": self.size}, self.where)

    @cached_property
    def derivatives(self) -> Program:
        """The program of the derivatives, by rows: `x` to `value`."""
        if (slope := self.slope) is not None:
            return read(lambda x: {"value": slope(x)}, {"x": self.size}, self.where)
        columns = {} if self.by is None else {"x": self.by}
        both = with_derivatives(self.program, "value", {"slope": "x"}, columns)
        return Program(both.inputs, both.nodes, {"value": both.outputs["slope"]}, both.tables)
