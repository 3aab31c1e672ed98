# %% [markdown]
# # Your own physics
#
# You know the equations of your mechanism, or at least its energies. Then you need no network: the
# program finds the parameters, says how sure it is of each, and tells you when something is
# missing. Such a model is a *grey box*.
#
# The mechanism of this tutorial is a cart between two springs. A motor pulls the cart, and a rod
# hangs from it like a pendulum. You will
#
# 1. write its energies in a file of 50 lines,
# 2. identify the parameters, and learn that one of them cannot be found from these records,
# 3. mend that with a kitchen scale,
# 4. find a force that the file lacks, and add it,
# 5. compare the models on records that were used for nothing before.
#
# The page takes one to two minutes on two cores.
#
# ## The records
#
# We simulate the cart with equations that were derived by hand and with another integrator than
# the package's. So the program gets no help from us. The true values stand in `TRUE`; on a real
# cart nobody would know them. The rails also have dry friction, `DRY`. Let us forget that for a
# while.
#
# Each record lasts 6 s. An encoder rounds the position of the cart to 0.05 mm, another one rounds
# the angle to 4096 counts a turn. Velocities are not logged.

# %%
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image
from scipy.integrate import solve_ivp

import tustinnet as tn

jax.config.update("jax_enable_x64", True)  # double precision
rng = np.random.default_rng(1)
PERIOD = 0.02  # s
TRUE = {
    "cart_mass": 0.5,  # kg
    "rod_mass": 0.2,  # kg
    "centre": 0.25,  # m, from the pivot to the middle of the rod
    "stiffness": 40.0,  # N/m, both springs
    "cart_damping": 0.8,  # N s/m
    "rod_damping": 0.005,  # N m s/rad
    "gain": 1.2,  # N/V
}
DRY = 0.4  # N


def rates(_: float, state: np.ndarray, volts: float) -> list[float]:
    """Equations of motion of the cart and the rod, derived on paper."""
    x, angle, speed, turning = state
    m, c = TRUE["rod_mass"], TRUE["centre"]
    losses = TRUE["cart_damping"] * speed + DRY * np.tanh(speed / 0.01)
    force = TRUE["gain"] * volts - TRUE["stiffness"] * x - losses
    force += m * c * np.sin(angle) * turning**2
    torque = -m * 9.81 * c * np.sin(angle) - TRUE["rod_damping"] * turning
    total, coupling, inertia = TRUE["cart_mass"] + m, m * c * np.cos(angle), m * c**2 * 4 / 3
    determinant = total * inertia - coupling**2
    return [
        speed,
        turning,
        (inertia * force - coupling * torque) / determinant,
        (total * torque - coupling * force) / determinant,
    ]


def log(name: str, angle: float, largest: float) -> None:
    """Lets the rod go at an angle, sets a new voltage now and then, writes a CSV file."""
    state, rows, now = np.array([0.0, angle, 0.0, 0.0]), [], 0
    while now < 300:
        stop = now + int(rng.choice([15, 20, 30]))
        stop = stop if stop < 280 else 300
        volts = round(rng.uniform(-largest, largest), 2)
        times = PERIOD * np.arange(now, stop + 1)
        ends = times[[0, -1]]
        solved = solve_ivp(rates, ends, state, "LSODA", times, args=(volts,), rtol=1e-8, atol=1e-10)
        rows += [(t, x[0], x[1], volts) for t, x in zip(times[:-1], solved.y.T, strict=False)]
        state, now = solved.y[:, -1], stop
    t, x, turned, u = np.array(rows).T
    millimetres = 0.05 * np.round(1000 * x / 0.05)
    degrees = 360 / 4096 * np.round(4096 * turned / (2 * np.pi))
    table = np.column_stack([t, millimetres, degrees, u])
    head = "time,x_mm,angle_deg,volts"
    np.savetxt(f"LOGS/{name}.csv", table, "%.8g", ",", header=head, comments="")


Path("LOGS").mkdir()
for number, (angle, largest) in enumerate([(0, 4), (0, 3), (1.2, 0), (0, 4), (-0.8, 3), (0, 4)]):
    log(f"fit{number + 1}", angle, largest)
for number, (angle, largest) in enumerate([(0, 4), (1.0, 3)]):
    log(f"check{number + 1}", angle, largest)

with Path("LOGS/dataset.toml").open("w") as card:
    print(
        """
name = "cart"
dt = 0.02

[time]
column = "time"

[[coordinates]]
name = "x"
kind = "linear"
column = "x_mm"
unit = "mm"
resolution = 5e-5     # m a count

[[coordinates]]
name = "angle"
kind = "angular"
column = "angle_deg"
unit = "deg"
counts_per_revolution = 4096

[[inputs]]
name = "motor"
column = "volts"
unit = "V"
hold = "zero-order"

[splits]
train = ["fit*.csv"]
test = ["check*.csv"]
""",
        file=card,
    )

# %% [markdown]
# The data card above is explained in [From logs to a trusted model](from-logs.md). With your own
# logs, run `tustinnet inspect LOGS` now, as described there.
#
# ## The system file
#
# Write the kinetic energy, the potential energy, what opposes the motion, and what the motor does.
# Nobody derives equations of motion: the program does that by automatic differentiation.
#
# * `q` has the positions, `v` the velocities, in the order of `coordinates`. `p` has the
#   parameters by name.
# * Names, kinds and units are those of the data card.
# * A parameter has a unit, a first guess, and the range in which it is searched for. Here all
#   guesses are off, by a fifth to a factor of two and a half.
# * `links` say how the mechanism is drawn in a [report](../reference/report.md). They change no
#   result.

# %%
SYSTEM = '''import jax.numpy as jnp
import tustinnet as tn
from tustinnet.models import forces


def kinetic(q, v, p):
    """Cart, and a slender rod whose middle moves with it [J]."""
    along = v[0] + p["centre"] * jnp.cos(q[1]) * v[1]
    up = p["centre"] * jnp.sin(q[1]) * v[1]
    turning = p["centre"] ** 2 / 3 * v[1] ** 2
    return p["cart_mass"] * v[0] ** 2 / 2 + p["rod_mass"] * (along**2 + up**2 + turning) / 2


def potential(q, p):
    """Springs, and the height of the rod's middle [J]."""
    spring = p["stiffness"] * q[0] ** 2 / 2
    return spring - 9.81 * p["rod_mass"] * p["centre"] * jnp.cos(q[1])


def dissipation(q, v, p):
    """Viscous friction of the rails [N] and of the bearing [N m]."""
    return forces.viscous(v, jnp.stack([p["cart_damping"], p["rod_damping"]]))


def input_map(q, v, u, p):
    """The motor pulls the cart [N]; it does not turn the rod."""
    return jnp.stack([p["gain"] * u[0], 0.0])


SYSTEM = tn.LagrangianSystem(
    name="cart",
    coordinates=(tn.Coordinate("x", "linear"), tn.Coordinate("angle", "angular")),
    inputs=(tn.Input("motor", "V"),),
    parameters=(
        tn.Parameter("cart_mass", "kg", 1.0, 0.1, 5.0),
        tn.Parameter("rod_mass", "kg", 0.3, 0.02, 2.0),
        tn.Parameter("centre", "m", 0.2, 0.05, 1.0),
        tn.Parameter("stiffness", "N/m", 100.0, 5.0, 500.0),
        tn.Parameter("cart_damping", "N s/m", 2.0, 0.01, 20.0),
        tn.Parameter("rod_damping", "N m s/rad", 0.01, 1e-4, 0.1),
        tn.Parameter("gain", "N/V", 2.0, 0.2, 10.0),
    ),
    kinetic=kinetic,
    potential=potential,
    dissipation=dissipation,
    input_map=input_map,
    links=(
        tn.Link("x", axis=(1, 0, 0), reach=(0, 0, 0)),
        tn.Link("angle", axis=(0, -1, 0), reach=(0, 0, -0.5)),
    ),
)
'''
with Path("cart.py").open("w") as file:
    print(SYSTEM, file=file)

# %% [markdown]
# All that such a file may contain is in [Systems](../reference/systems.md).
#
# ## First attempt
#
# The recipe `grey` searches for the parameters with which free runs of the training records are
# closest to the measurements. A free run is a simulation from the first state with nothing but the
# voltage.

# %% language="bash"
# tustinnet fit LOGS --recipe grey --system cart.py --out first --quiet

# %% [markdown]
# Read the sentences at the end first.
#
# **"only ratios of ... can be identified"**: if you multiply all masses, the stiffness, the
# friction and the motor's gain by two, the motion stays the same. So the records cannot tell these
# parameters apart. The program found that out, fixed one of them at its first guess and went on.
# The others are then wrong by the same factor: compare `stiffness` with the true 40 N/m. Their
# small errors hold only if the guess that was fixed is right.
#
# `centre` is not in the list. It follows from how fast the rod swings, whatever its mass is.
#
# ## Fix a mass
#
# Something must set the scale of the forces: a mass or a motor's constant. We unhook the rod and
# put it on a kitchen scale: 0.200 kg. In your own file you would write `tn.Parameter("rod_mass",
# "kg", 0.2, 0.02, 2.0, fixed=True)`. An option does the same:

# %% language="bash"
# tustinnet fit LOGS --recipe grey --system cart.py --out weighed --quiet \
#     --set model.fixed.rod_mass=0.2

# %% [markdown]
# The sentence about ratios is gone, and every parameter has its own scale. But the model is bad,
# and three things say so:
#
# * Free runs are off by 0.07 rad, about 50 counts of the encoder.
# * "residuals are ... times the encoders' quantisation and alike from sample to sample: something
#   is not modelled". Residuals are what was measured minus what was simulated. If the model lacked
#   nothing, only rounding would be left.
# * The two kinds of errors differ several times. `error of J'J` is the usual formula; it holds for
#   a model that lacks nothing. `std. error` comes from how the records disagree. The program says
#   which one to trust.
#
# No error can repair a model that lacks something: `cart_damping` is found as twice the true
# value, and its 95 % interval does not hold the truth. So look for the reason first, and believe
# the values later.
#
# ## What is missing?
#
# Look at the force that the model lacks. At each sample we know the acceleration (from the
# measurements) and the acceleration that the model would have. Their difference times the mass
# matrix is the missing force. We draw it against the speed of the cart.

# %% alt="The missing force over the cart's speed: down a step at zero speed, else rising"


def identified(run: str) -> dict[str, float]:
    """The parameters that a run found, and those that were fixed."""
    account = json.loads(Path(run, "summary.json").read_text())["identification"]
    return {e["name"]: e["value"] for e in account["estimates"]} | account["fixed"]


model = tn.load_system("cart.py").model(identified("weighed"))


def missing(q: jax.Array, v: jax.Array, a: jax.Array, u: jax.Array) -> jax.Array:
    """What would have to act on every coordinate besides what the model knows [N, N m]."""
    return model.mass_matrix(q) @ (a - model.acceleration(jnp.concatenate([q, v]), u))


figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
for record in tn.load("LOGS").split("train"):
    q, v = record.q, record.velocities("stencil")
    a = np.diff(v, axis=0) / PERIOD  # between two samples
    q, v = (q[1:] + q[:-1]) / 2, (v[1:] + v[:-1]) / 2
    lacks = jax.vmap(missing)(q, v, a, record.u[:-1])
    axes.plot(v[:, 0], lacks[:, 0], "k.", markersize=3, alpha=0.4)
axes.set(xlabel="speed of the cart [m/s]", ylabel="missing force on it [N]", ylim=(-1.5, 1.5))
axes.grid(alpha=0.3)
plt.show()

# %% [markdown]
# A cloud without a shape, about zero, would be good. This one has a shape: the missing force jumps
# by 0.8 N where the speed changes its sign. For slow motion it acts against the motion, with 0.4 N
# either way. That is dry (Coulomb) friction. For fast motion it grows into the direction of the
# motion, because the search made the viscous friction too large to make up for what it did not
# know. (Points far away from the others are samples at which the voltage jumps.)
#
# Other shapes tell other things: a slope against the speed is viscous friction, a slope against
# the position is a spring, a loop is a force with memory.
#
# ## Add the force
#
# You need not change the file to try a force. `model.forces` adds one that the package has, here
# dry friction of the coordinate `x` ([all of
# them](../explanation/identification.md#forces-that-are-missing)).

# %% language="bash"
# tustinnet fit LOGS --recipe grey --system cart.py --out rubbing --quiet \
#     --set model.fixed.rod_mass=0.2 --set 'model.forces=["coulomb:x"]'

# %% [markdown]
# Free runs are now off by a few thousandths of a radian, and errors of the parameters are below
# one per cent. What is left is still a few counts of the encoders: the model turns the sign of the
# dry friction within a speed of its own (`x.smooth_speed`), the simulated bench within another
# one. That is a matter of how friction is described, and no model of it is exact.
#
# On this page we know the truth:

# %%
account = json.loads(Path("rubbing/summary.json").read_text())["identification"]
print("parameter          true      found   std. error   95 % interval")
for e in account["estimates"]:
    true = TRUE.get(e["name"], DRY)
    interval = "{:.5g} .. {:.5g}".format(*e["interval"])
    print(f"{e['name']:14} {true:8.4g} {e['value']:10.5g} {e['error']:12.2g}   {interval}")

# %% [markdown]
# All values are right to within one per cent, the dry friction of 0.4 N too. A 95 % interval is
# allowed to miss once in twenty times. Intervals that are far off would be a bad sign: then
# something else is missing.
#
# On a real mechanism you have no such table. Then ask: are the values plausible? Does one of them
# lie at an end of its range (the result says so)? Do the records agree?
#
# When you are content, write the force into the file, so that it has a name and a range of your
# choice:
#
# ```python
# def dissipation(q, v, p):
#     """Viscous friction, and dry friction of the rails."""
#     viscous = forces.viscous(v, jnp.stack([p["cart_damping"], p["rod_damping"]]))
#     return viscous + jnp.stack([forces.coulomb(v[0], p["dry"], 0.01), 0.0])
# ```
#
# and among the parameters `tn.Parameter("dry", "N", 0.4, 0.01, 5.0)`.
#
# ## The judgement
#
# Two records, `check1` and `check2`, were used for nothing so far.

# %% language="bash"
# tustinnet compare weighed/model.safetensors rubbing/model.safetensors LOGS \
#     --split test --figures compared

# %% alt="Cart and angle in check2: the model with dry friction lies on the measurement"
Image("compared/check2.png")

# %% [markdown]
# The model with dry friction follows the measurement for 6 s, from the first samples and the
# voltage alone. The one without it is many times worse. A force that the records do not show would
# help nothing here. The program says so when the parameter of a friction ends at zero. Then leave
# it out.
#
# ## What to do next
#
# * If something small remains that you cannot name, let a network learn it on top of your physics:
#   `tustinnet fit LOGS --recipe best-hybrid --physics rubbing/model.safetensors --system cart.py
#   --out hybrid` ([Recipes and training](../reference/training.md#recipes)).
# * Bring the model into a controller, a simulator or an optimiser: [Into the
#   controller](into-the-controller.md), [Exports](../reference/export.md).
# * Put bands around its free runs: [Trust](../explanation/trust.md).
# * Sensors with a wrong zero or gain, delays, spoilt samples, records under control:
#   [Identification](../explanation/identification.md).
# * A payload that changes between records:
#   [Systems](../reference/systems.md#parameters-that-change-between-records).
# * Add your mechanism to the package: [Add a system](../how-to/add-a-system.md).
