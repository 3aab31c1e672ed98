# %% [markdown]
# # Your own physics
#
# You know the equations of your mechanism, or at least its energies. Then you need no network. The
# program finds the parameters and their standard errors, and tells you when the model lacks
# something. Such a model is a *grey box*.
#
# The mechanism of this tutorial is a cart between two springs. A motor pulls the cart, and a rod
# hangs from it like a pendulum. You will
#
# 1. write its energies in a file of about 50 lines,
# 2. identify the parameters, and see that these records determine most of them only up to a common
#    factor,
# 3. measure a mass, which determines this factor,
# 4. find a force that the file lacks, and add it,
# 5. compare the models on two records that were not used to fit them.
#
# The commands of this page take one to two minutes on two cores. The page is a notebook with Python
# cells and shell commands. Start in an empty folder: all files are written there.
#
# ## The records
#
# We simulate the cart with equations that were derived by hand and with another integrator than
# the package's. So the records do not depend on the code that we use to fit them. The true
# parameters are in `TRUE`; on a real cart nobody would know them. The rails also have dry friction,
# `DRY`. Our first model leaves it out on purpose.
#
# Each record lasts 6 s. One encoder measures the position of the cart in counts of 0.05 mm, another
# one the angle with 4096 counts a turn. Velocities are not logged. The last part of the cell writes
# the [data card](../reference/glossary.md#data-card), the file that says what the columns mean.

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
# Write functions for the kinetic energy, the potential energy, the friction and the force of the
# motor. You need not derive equations of motion: the program derives them from the energies by
# automatic differentiation.
#
# * `q` has the positions, `v` the velocities, in the order of `coordinates`. `p` has the
#   parameters by name.
# * Names, kinds and units are those of the data card.
# * A parameter has a name, a unit, a first guess, and the lower and upper limit of the search. Here
#   all guesses are wrong: one is a fifth too small, the others are 1.5 to 2.5 times the true value.
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
# [Systems](../reference/systems.md) describes everything that such a file may contain.
#
# ## First attempt
#
# The recipe `grey` searches for the parameters with which simulations of the training records are
# closest to the measurements. The table `train free runs` then scores the result. A *free run* is a
# simulation that gets only the initial state and the voltage. The start `derived-6` means that the
# initial state is computed from the first six samples
# ([Starts](../reference/evaluation.md#where-a-free-run-starts)).
#
# The table `train, from the identified initial states` has the error that the search minimised. Here it
# has no unit: where some coordinates are angles and others lengths, the search divides each by its
# spread in the records. So its numbers cannot be compared with those of the free runs.

# %% language="bash"
# tustinnet fit LOGS --recipe grey --system cart.py --out first --quiet

# %% [markdown]
# Read the messages that begin with `*` first.
#
# **"only ratios of ... can be identified"**: if you multiply all masses, the stiffness, the
# friction and the motor's gain by two, the motion stays the same. So the records determine only the
# ratios of these parameters. The program found that out. It fixed one of them, `cart_mass`, at its
# first guess of 1 kg and identified the others. The true mass is half of that, so most of the others
# are about twice too large: compare `stiffness` with the true 40 N/m. Their standard errors hold only
# if the fixed guess is right.
#
# `centre` is not in the list. It follows from the frequency at which the rod swings, which does not
# depend on the rod's mass.
#
# The second message says that the model lacks something. We come back to it below.
#
# ## Fix a mass
#
# One of these parameters must be measured in another way: a mass or the motor's gain. We unhook the
# rod and weigh it: 0.200 kg. In your own file you would write `tn.Parameter("rod_mass", "kg", 0.2,
# 0.02, 2.0, fixed=True)`. The option `--set` does the same:

# %% language="bash"
# tustinnet fit LOGS --recipe grey --system cart.py --out weighed --quiet \
#     --set model.fixed.rod_mass=0.2

# %% [markdown]
# The message about ratios is gone: now all parameters can be identified. But the model is bad. Three
# things show it:
#
# * The free runs have a mean RMSE of about 0.07. (It combines the position in m and the angle in rad.
#   Most of it is the angle: about 40 counts of its encoder.)
# * "residuals are ... times the encoders' quantisation and alike from sample to sample: something
#   is not modelled". Residuals are the differences between measurement and simulation. With a
#   perfect model only the quantisation would be left.
# * The two kinds of standard errors differ by a factor of 4 to 12. [`error of
#   J'J`](../reference/glossary.md#jj) is the usual formula, as in MATLAB; it holds only for a model
#   that lacks nothing. `std. error` is computed from the differences between the records. The
#   program says which one to trust.
#
# But standard errors do not show how wrong a model is that lacks something. Here the identified
# `cart_damping` is twice the true value, and its 95 % interval does not contain the true value. So
# find out what is missing before you trust the values.
#
# ## What is missing?
#
# We compute the force that the model lacks. At each sample we know the measured acceleration (by
# differences of the positions) and the acceleration that the model gives. Their difference times the
# [mass matrix](../reference/glossary.md#mass-matrix) is the missing force. We draw it over the speed
# of the cart.

# %% alt="The missing force over the cart's speed: it rises, with a step down at zero speed"


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
# If nothing were missing, the points would scatter about zero. Here they do not. Where the speed
# changes its sign, the missing force jumps by about 0.8 N. At low speed it acts against the motion,
# with about 0.4 N in both directions. That is dry (Coulomb) friction. At high speed the missing force
# acts in the direction of the motion. The reason is the identified viscous friction: it is too large,
# because it stands in for the dry friction. (Points far away from the others are samples at which the
# voltage jumps.)
#
# Other shapes have other causes. A falling line over the speed is viscous friction. A falling line
# over the position is a spring. A loop is a force with
# [memory](../reference/glossary.md#memory).
#
# ## Add the force
#
# You can try a force without changing the file. A name behind the recipe adds a force of the
# package, here dry friction of the coordinate `x`. The names are in [Recipes and
# training](../reference/training.md#forces-that-are-missing).

# %% language="bash"
# tustinnet fit LOGS --recipe "grey + coulomb:x" --system cart.py --out rubbing --quiet \
#     --set model.fixed.rod_mass=0.2

# %% [markdown]
# The RMSE of the free runs is now a few thousandths instead of 0.07, and the standard errors of the
# parameters are below one per cent. The message about the residuals is still there, with 9 instead of
# 657. One difference remains: near standstill the dry friction changes its sign over a small range of
# speeds. This range is about 0.008 m/s in the model (`x.smooth_speed`) and 0.01 m/s in the simulated
# cart.
#
# On this page we know the true values:

# %%
account = json.loads(Path("rubbing/summary.json").read_text())["identification"]
print("parameter          true      found   std. error   95 % interval")
for e in account["estimates"]:
    true = TRUE.get(e["name"], DRY)
    interval = "{:.5g} .. {:.5g}".format(*e["interval"])
    print(f"{e['name']:14} {true:8.4g} {e['value']:10.5g} {e['error']:12.2g}   {interval}")

# %% [markdown]
# All values are right to within one per cent, also the dry friction of 0.4 N. A 95 % interval misses
# the true value once in twenty cases. If many intervals missed it by far, something else would be
# missing.
#
# On a real mechanism you have no such table. Then ask three questions. Are the values plausible? Is
# one of them at an end of its range (the result says so)? Do the records agree with one another?
#
# When you are satisfied, write the force into the file, so that it has a name and a range of your
# choice:
#
# ```python
# def dissipation(q, v, p):
#     """Viscous friction, and dry friction of the rails."""
#     viscous = forces.viscous(v, jnp.stack([p["cart_damping"], p["rod_damping"]]))
#     return viscous + jnp.stack([forces.coulomb(v[0], p["dry"], 0.01), 0.0])
# ```
#
# Add to the parameters: `tn.Parameter("dry", "N", 0.4, 0.01, 5.0)`.
#
# ## Test on new records
#
# Two records, `check1` and `check2`, were not used so far. The card has them in the split `test`.

# %% language="bash"
# tustinnet evaluate weighed/model.safetensors rubbing/model.safetensors LOGS \
#     --split test --figures compared

# %% alt="Cart and angle in check2: the model with dry friction lies on the measurement"
Image("compared/check2.png")

# %% [markdown]
# The model with dry friction follows the measurement for all 6 s. The errors of the model without it
# are about 20 times as large.
#
# If you add a force that the mechanism does not have, the errors on new records do not get smaller.
# Where a friction is identified as zero, the program says so. Leave such forces out.
#
# ## What to do next
#
# * If an error remains whose cause you do not find, train a network that corrects your model (a
#   [hybrid](../reference/glossary.md#hybrid)): `tustinnet fit LOGS --recipe best-hybrid --physics
#   rubbing/model.safetensors --system cart.py --out hybrid`. Put some records into a split
#   `validation` first ([Recipes and training](../reference/training.md#hybrids)).
# * Bring the model into a controller, a simulator or an optimiser: [Into the
#   controller](into-the-controller.md), [Exports](../reference/export.md).
# * Put [bands](../reference/glossary.md#band) around its free runs: [Trust](../explanation/trust.md).
# * Sensors with a wrong zero or gain, delays, wrong samples, records in closed loop:
#   [Identification](../explanation/identification.md).
# * A payload that changes between records:
#   [Systems](../reference/systems.md#parameters-that-change-between-records).
# * Add your mechanism to the package: [Add a system](../how-to/add-a-system.md).
