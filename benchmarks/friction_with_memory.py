"""Frictions with memory (Dahl, LuGre, Bouc-Wen), identified from twins of several seeds.

    python benchmarks/friction_with_memory.py [SEEDS] [FIRST_SEED]      (default: 10 0)
    python benchmarks/friction_with_memory.py 20 100 --drawn

A joint with a known torque, an encoder of 1024 counts and a friction by name is simulated. Prints
for each law in how many twins the largest error is below 5 %, and how many of the true values of
these twins are within their 95 % intervals. With --drawn each twin has true values of its own, up
to a factor of 1.5 about those of the others.
"""

import jax

jax.config.update("jax_enable_x64", True)

import sys

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.models import forces
from tustinnet.models.added import with_forces
from tustinnet.systems.twin import Twin

JOINT = tn.LagrangianSystem(
    name="joint",
    coordinates=(tn.Coordinate("joint", "angular"),),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(
        tn.Parameter("inertia", "kg m^2", 0.02, 0.005, 0.1),
        tn.Parameter("viscous", "N m s/rad", 0.01, 1e-4, 0.1),
    ),
    kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2,
    dissipation=lambda q, v, p: forces.viscous(v, p["viscous"]),
    input_map=lambda q, v, u, p: jnp.asarray(u),
)
STICKING = {"joint.sticking": 0.1, "joint.presliding": 0.05}  # N m, rad
LAWS = {
    "dahl": STICKING,
    "lugre": STICKING
    | {"joint.breakaway": 0.05, "joint.stribeck_speed": 0.3, "joint.bristle_damping": 0.02},
    "bouc_wen": STICKING | {"joint.hysteresis_shape": 0.8, "joint.hysteresis_exponent": 2.0},
}
TRUTH = {"inertia": 0.025, "viscous": 0.02}
CLOSE = 0.05  # relative error of a value that counts as found
FACTOR = 1.5  # by which drawn values are larger or smaller, at most
AT_LEAST = {"joint.hysteresis_shape": 0.5, "joint.hysteresis_exponent": 1.0}  # by definition


def draw_values(law: str, seed: int) -> dict[str, float]:
    """True values about those of `LAWS` and `TRUTH`, alike on a logarithmic scale."""
    generator = np.random.default_rng([seed, len(law)])
    values = {
        name: x * FACTOR ** float(generator.uniform(-1, 1))
        for name, x in (LAWS[law] | TRUTH).items()
    }
    # the exponent is not searched for
    fixed = {name: x for name, x in LAWS[law].items() if name == "joint.hysteresis_exponent"}
    return {name: max(x, AT_LEAST.get(name, 0.0)) for name, x in (values | fixed).items()}


def sticking_twin(law: str, values: dict[str, float]) -> Twin:
    """The joint with a friction, by their true values."""
    parameters = tuple(tn.Parameter(name, "", values[name], 0.0, 10.0) for name in LAWS[law])
    own = {name: values[name] for name in TRUTH}
    return Twin(
        with_forces(JOINT, (f"{law}:joint",), parameters),
        own,
        (2 * np.pi / 1024,),
        amplitude=(0.25,),
        band=(0.3, 3.0),
        rest=(0.0,),
        spread=(0.0,),
        dt=0.005,
        substeps=20,
    )


def identify_friction(
    law: str, seed: int, values: dict[str, float]
) -> tuple[float, list[bool], tn.Identification]:
    """The largest relative error, whether intervals contain the true values, and the result."""
    twin = sticking_twin(law, values)
    table = {"name": "friction", "model": {"kind": "euler-lagrange", "forces": [law]}}
    records = twin.records(seed, train=4, validation=0, test=0)
    result = tn.identify(records, JOINT, tn.read_recipe(table))
    truth = twin.true_values()
    errors = [abs(e.value / truth[e.name] - 1) for e in result.estimates]
    inside = [
        e.interval is not None and e.interval[0] <= truth[e.name] <= e.interval[1]
        for e in result.estimates
    ]
    return max(errors), inside, result


def main() -> None:
    """Prints a line for each law."""
    numbers = [int(x) for x in sys.argv[1:] if x != "--drawn"]
    count, first = (*numbers, *(10, 0)[len(numbers) :])
    for law in LAWS:
        results = []
        for seed in range(first, first + count):
            values = draw_values(law, seed) if "--drawn" in sys.argv else LAWS[law] | TRUTH
            results.append(identify_friction(law, seed, values))
        found = [(worst, inside) for worst, inside, _ in results if worst < CLOSE]
        intervals = [x for _, inside in found for x in inside]
        worst = max((worst for worst, _ in found), default=float("nan"))
        print(
            f"{law}: found in {len(found)} of {count} twins, largest error {worst:.2%}; "
            f"{sum(intervals)} of {len(intervals)} values within their intervals",
            flush=True,
        )


if __name__ == "__main__":
    main()
