"""Equations of motion as people write them, with the values that a fit found."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.errors import InputError
from tustinnet.models.contract import AccelerationModel, ContinuousModel, Model, Stateful
from tustinnet.models.physical_values import equations_in
from tustinnet.program.reading import Unreadable, read
from tustinnet.program.sums import Sum, Symbol, TooLong, read_sums, write_latex, write_plain

_MOST_COORDINATES = 4  # more are chains, whose equations fill pages
_LONGEST_EQUATION = 600  # characters of an equation in plain text
_GREEK = {
    *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa"),
    *("lambda", "mu", "nu", "xi", "pi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega"),
}


@dataclass(frozen=True)
class EquationsOfMotion:
    """The equations of motion of a model, one a coordinate, then one an internal state.

    Attributes:
        text: in plain text: `theta'' = -20 sin(theta) - 0.8 theta' + 4 torque`.
        latex: in LaTeX.
    """

    text: tuple[str, ...]
    latex: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(self.text)

    def _repr_latex_(self) -> str:
        lines = r" \\ ".join(line.replace("=", "&=", 1) for line in self.latex)
        return rf"$$\begin{{aligned}} {lines} \end{{aligned}}$$"


def equations_of_motion(model: Model | ContinuousModel) -> EquationsOfMotion:
    """The equations of motion in a model, with its values.

    The left side has the accelerations with their inertias, the right side all forces; an equation
    of one acceleration is divided by a constant inertia. Positions are in rad or m. In those of a
    hybrid `network_theta` is the acceleration of `theta` that its network adds.

    Args:
        model: a model with equations of motion. Where values differ by groups and it is the model
            of none, those of the first group count.

    Raises:
        InputError: a model without equations of motion, or whose equations are too long to read.
    """
    if not isinstance(model, Stateful):
        remedy = "give its `model`" if hasattr(model, "model") else ""
        raise InputError("equations", type(model).__name__, "a model", remedy)
    equations = equations_in(model)
    if equations is None:
        raise InputError("equations", "a model without equations of motion", "one with them")
    system = equations.system.plant
    by_group = {p.name: [*p.by_group(equations.values).values()][:1] for p in system.grouped}
    values = {name: x for name, first in by_group.items() for x in first} | equations.values
    equations = system.model({p.name: values[p.name] for p in system.parameters})
    coordinates = [_symbol_name(name) for name in system.coordinate_names]
    if (n := len(coordinates)) > _MOST_COORDINATES:
        raise _too_long(f"{n} coordinates")
    own = [_symbol_name(name.replace(" ", "_")) for name in system.states.memory.names]
    n_z, n_u = len(own), len(system.inputs)

    def forces(q: Any, v: Any, *others: Any) -> dict[str, Any]:
        z = others[0] if n_z else jnp.zeros(0)
        u = others[-1] if n_u else jnp.zeros(0)
        force = equations.conservative(q, v) + equations.applied(q, v, z, u)
        rate = system.states.memory.compute_rate(q, v, z, u, equations.values)
        return {"inertia": equations.mass_matrix(q).ravel(), "force": force, "rate": rate}

    symbols = {
        "q": coordinates,
        "v": [_derivative(c, 1) for c in coordinates],
        **({"z": own} if n_z else {}),
        **({"u": [_symbol_name(i.name) for i in system.inputs]} if n_u else {}),
    }
    try:
        program = read(forces, {name: len(group) for name, group in symbols.items()})
        sums = read_sums(program, symbols)
    except (Unreadable, TooLong) as error:
        raise _too_long(str(error)) from error
    accelerations = [_derivative(c, 2) for c in coordinates]
    corrections = [_network_symbol(c) for c in coordinates] if _has_network(model) else []
    inertia = np.array(sums["inertia"], object).reshape(n, n)
    sides = []
    for i in range(n):
        row, force = list(inertia[i]), sums["force"][i]
        alone = row[i].value if all(x.value == 0 for k, x in enumerate(row) if k != i) else None
        if alone:
            row[i], force = Sum.number(1.0), force.scaled(1 / alone)
        left = _times(row, accelerations)
        sides.append((left, force + _times(row, corrections)))
    rates = [Sum.factor(_derivative(z, 1)) for z in own]
    sides += zip(rates, sums["rate"], strict=True)
    text = [f"{write_plain(left)} = {write_plain(right)}" for left, right in sides]
    latex = [f"{write_latex(left)} = {write_latex(right)}" for left, right in sides]
    if (longest := max(map(len, text))) > _LONGEST_EQUATION:
        raise _too_long(f"an equation of {longest} characters")
    return EquationsOfMotion(tuple(text), tuple(latex))


def _times(row: Sequence[Sum], symbols: Sequence[Symbol]) -> Sum:
    """The sum of a row's entries times as many symbols; 0 of no symbols."""
    total = Sum.number(0.0)
    for x, symbol in zip(row, symbols, strict=False):
        total = total + x.grouped() * Sum.factor(symbol)
    return total


def _has_network(model: Model | ContinuousModel) -> bool:
    """Whether a network corrects the accelerations of the equations in a model."""

    def is_network(node: Any) -> bool:
        return isinstance(node, AccelerationModel)

    return any(map(is_network, jax.tree.leaves(model, is_leaf=is_network)))


def equations_header(model: Model | ContinuousModel) -> dict[str, tuple[str, ...]]:
    """The entry of a model file's header with the equations; none where they cannot be read."""
    try:
        return {"equations": equations_of_motion(model).text}
    except Exception:  # of any kind: they only describe the model, and no fit is lost by them
        return {}


def _too_long(found: str) -> InputError:
    return InputError("equations", found, "equations that can be read")


def _symbol_name(name: str) -> Symbol:
    """The symbol of a name: Greek letters are those, other names stand upright."""
    stem, _, index = name.partition("_")
    if stem.lower() in _GREEK:
        letter = rf"\{stem}"
        return Symbol(name, f"{letter}_{{{index}}}" if index else letter)
    if re.fullmatch("[A-Za-z][0-9]*", name):
        return Symbol(name, f"{name[0]}_{{{name[1:]}}}" if name[1:] else name)
    upright = name.replace("_", r"\_")
    return Symbol(name, rf"\mathrm{{{upright}}}")


def _network_symbol(symbol: Symbol) -> Symbol:
    """The acceleration that a network adds to that of a coordinate."""
    return Symbol(f"network_{symbol.text}", rf"\mathrm{{network}}_{{{symbol.latex}}}")


def _derivative(symbol: Symbol, order: int) -> Symbol:
    """A derivative by time."""
    mark = r"\dot" if order == 1 else r"\ddot"
    return Symbol(symbol.text + "'" * order, rf"{mark}{{{symbol.latex}}}")
