"""Equations of motion as people write them say what the model computes."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import cos, exp, sign, sin, sqrt, tanh  # noqa: F401 (of the formulas)

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.models.blocks import Scaling
from tustinnet.models.written_equations import equations_header


def nominal(system: tn.LagrangianSystem) -> tn.LagrangianModel:
    """The model of a system with the values that its parameters begin with."""
    return system.model({name: jnp.asarray(value) for name, value in system.nominal().items()})


LIBRARY = ("reaction_wheel", "crane", "ball_and_beam", "cart_pole", "duffing", "positioning_axis")


def test_the_equation_of_a_pendulum_is_that_of_the_textbook() -> None:
    channels = (tn.Coordinate("theta", "angular"),), (tn.Input("torque", "N m"),)
    system = tn.LagrangianSystem(
        "pendulum",
        *channels,
        (tn.Parameter("stiff", "N m", 20.0, 1.0, 50.0),),
        kinetic=lambda q, v, p: 0.25 * v[0] ** 2,
        potential=lambda q, p: -p["stiff"] * jnp.cos(q[0]),
        dissipation=lambda q, v, p: 0.4 * v,
        input_map=lambda q, v, u, p: 2.0 * u,
    )
    written = tn.equations_of_motion(nominal(system))
    assert str(written) == "theta'' = -40 sin(theta) + 4 torque - 0.8 theta'"
    assert written.latex == (
        r"\ddot{\theta} = -40\, \sin\left(\theta\right) + 4\, \mathrm{torque} "
        r"- 0.8\, \dot{\theta}",
    )
    assert written._repr_latex_().startswith(r"$$\begin{aligned} \ddot{\theta} &= -40")


def test_equations_are_those_of_the_first_group_or_of_the_record_s() -> None:
    channels = (tn.Coordinate("theta", "angular"),), (tn.Input("torque", "N m"),)
    system = tn.LagrangianSystem(
        "wheel",
        *channels,
        (tn.Parameter("inertia", "kg m^2", 1.0, 0.1, 9.0, per="load"),),
        kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2,
        input_map=lambda q, v, u, p: u,
    )
    values = {"inertia[full]": 2.0, "inertia[none]": 0.5}
    model = system.model({name: jnp.asarray(x) for name, x in values.items()})
    assert tn.equations_of_motion(model).text == ("theta'' = 0.5 torque",)
    assert equations_header(model) == {"equations": ("theta'' = 0.5 torque",)}
    other = model.for_groups({"load": "none"}, "here")
    assert other.for_groups({}, "there").values == other.values  # what was taken stays
    assert tn.equations_of_motion(other).text == ("theta'' = 2 torque",)


def evaluate(text: str, numbers: dict[str, float]) -> float:
    """The value of one side of an equation in plain text."""
    factor = r"(?<=[\w')|]) (?=[\w(|])"  # a blank between factors is a product
    text = re.sub(r"\|([^|]*)\|", r"abs(\1)", text)
    text = re.sub(factor, " * ", text).replace("^", "**")
    for name in sorted(numbers, key=len, reverse=True):
        text = re.sub(rf"(?<!\w){re.escape(name)}(?![\w'])", f"({numbers[name]!r})", text)
    return float(eval(text))


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["qube-servo2", *LIBRARY])
def test_both_sides_are_equal_where_the_model_accelerates_so(name: str) -> None:
    folder = "src/tustinnet/systems/library"
    place = name if name == "qube-servo2" else f"{folder}/{name}.py"
    system = tn.load_system(place)
    model = nominal(system)
    equations = tn.equations_of_motion(model)
    generator = np.random.default_rng(1)
    for _ in range(3):
        x = generator.normal(size=2 * len(system.coordinates))
        u = generator.normal(size=len(system.inputs))
        a = np.asarray(model.acceleration(jnp.asarray(x), jnp.asarray(u)))
        names = [c.name for c in system.coordinates]
        numbers = dict(zip(names, x, strict=False))
        numbers |= {f"{n}'": v for n, v in zip(names, x[len(names) :], strict=True)}
        numbers |= {f"{n}''": y for n, y in zip(names, a, strict=True)}
        numbers |= {i.name: float(y) for i, y in zip(system.inputs, u, strict=True)}
        for line in equations.text:
            left, right = (evaluate(side, numbers) for side in line.split(" = "))
            terms = [
                abs(evaluate(t, numbers))
                for t in re.split(r" [+-] (?![^(]*\))", line.split(" = ")[1])
            ]
            assert left == pytest.approx(right, abs=2e-3 * max(terms))


@pytest.mark.thorough
def test_models_without_equations_and_long_ones_are_refused_with_the_reason() -> None:
    arm = tn.load_system("benchmarks/simulated/systems/planar_arm.py")
    with pytest.raises(InputError, match="equations that can be read"):
        tn.equations_of_motion(nominal(arm))
    assert equations_header(nominal(arm)) == {}


def test_internal_states_and_a_network_have_their_terms() -> None:
    channels = (tn.Coordinate("theta", "angular"),), (tn.Input("torque", "N m"),)
    system = tn.LagrangianSystem(
        "late",
        *channels,
        (tn.Parameter("lag", "s", 0.5, 0.1, 5.0),),
        kinetic=lambda q, v, p: v[0] ** 2 / 2,
        memory=tn.Memory(
            ("drive",),
            lambda q, v, z, u, p: (u - z) / p["lag"],
            lambda q, v, z, p: 3 * z,
        ),
    )
    physics = tn.discretise(nominal(system), 0.02)
    rate = "drive' = 2 torque - 2 drive"
    assert tn.equations_of_motion(physics).text == ("theta'' = 3 drive", rate)
    assert tn.equations_of_motion(physics).latex[1].startswith(r"\dot{\mathrm{drive}} = 2")
    one, none = jnp.ones(1, jnp.float32), jnp.zeros(0, jnp.float32)
    network = random_tustin_net(
        physics.channels, Scaling(none, none, one, one, one, none), jax.random.key(0), hidden=(3,)
    )
    hybrid = tn.HybridModel(physics, network)
    assert tn.equations_of_motion(hybrid).text == ("theta'' = 3 drive + network_theta", rate)
    with pytest.raises(InputError, match=r"(model|equations): str; expected"):
        tn.equations_of_motion("grey.safetensors")  # pyright: ignore[reportArgumentType]
