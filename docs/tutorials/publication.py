# ---
# jupyter:
#   data: qube-servo2
# ---

# %% [markdown]
# # The publication retraced on its data
#
# tustinnet began with one publication: S. van Esch, F. Bonassi, T. B. Schön, *Accounts of using the
# Tustin-Net architecture on a rotary inverted pendulum* ([where to find it](../explanation/paper.md)). These pages
# also call it the paper. This tutorial repeats its main steps with the measurements that its authors published. To
# run in about a minute, it trains its networks for only a tenth of the paper's epochs.
#
# You will
#
# * look at the records and compute velocities from the measured positions;
# * identify the paper's [grey box](../reference/glossary.md#grey-box), with and without the spring of the encoder's
#   cable;
# * train two [Tustin-Nets](../reference/glossary.md#tustin-net), one in the standard way and one by the paper's
#   Algorithm 1, a training in two steps;
# * simulate records that were not trained on, and compare with what the paper reports.
#
# `tustinnet reproduce` does the same in full and draws the paper's figures.
# [The publication](../explanation/paper.md) has those results, and every difference between the paper, its
# public code and this package.

# %% [markdown]
# ## Section 2.1: the apparatus and its records
#
# ![The Qube-Servo 2: a motor turns an arm, and a pendulum hangs at the arm's end](../images/figure1.png)
#
# The apparatus is a Quanser Qube-Servo 2. A motor turns an arm by the angle `theta`. At the arm's end a
# pendulum swings freely; its angle `alpha` is 0 upright and pi hanging. Encoders read both angles, and the
# motor's voltage is the only input. A cable leads from the pendulum's encoder to the base: it acts on the arm
# like a weak spring.
#
# `tn.load("qube-servo2")` looks for the records in the folder that the environment variable `TUSTINNET_DATA`
# names. Without that variable it downloads them once (see
# [Data](../reference/data.md#the-qube-servo-2-data)).

# %%
import jax
import matplotlib.pyplot as plt

import tustinnet as tn

jax.config.update("jax_enable_x64", True)  # free runs are computed in double precision

data = tn.load("qube-servo2")
train, validation = list(data.split("train")), list(data.split("validation"))
for records in (train, validation):
    lengths = [len(e) * e.dt for e in records]
    print(
        f"{records[0].split}: {len(records)} records of {min(lengths):.1f} to {max(lengths):.1f} s,",
        f"one sample every {records[0].dt} s",
    )
print("training records:", ", ".join(e.name for e in train))

# %% [markdown]
# There are two kinds of records. In a *fall* the pendulum is let go near upright and no voltage is applied. In
# a record with *white noise* (`wN`) it hangs at first, and the voltage takes random values.
#
# At the end of a fall the pendulum is at rest. The motion before that is the transient. The paper's Algorithm 1
# needs the sample at which the transient ends, which the paper calls k_bar. `tn.inspect_experiment` finds it.

# %% alt="Two training records. In the fall, theta and alpha swing and come to rest; a line marks the end of the transient after seven of eight seconds. Under white noise both angles move to the end of the record."
fall, noise = data["fall1"], data["wN_3V_1"]
figure, panels = plt.subplots(
    3, 2, figsize=(8, 4.6), sharex="col", sharey="row", layout="constrained"
)
for (top, middle, bottom), e in zip(panels.T, (fall, noise), strict=True):
    k_bar = tn.inspect_experiment(e).k_bar
    top.plot(e.t, e.q[:, 0], color="black", lw=1)
    middle.plot(e.t, e.q[:, 1], color="black", lw=1)
    bottom.step(e.t, e.u[:, 0], where="post", color="tab:blue", lw=0.6)
    if k_bar < len(e):
        for axes in (top, middle):
            axes.axvline(e.t[k_bar], color="tab:red", lw=1)
    top.set_title(e.name)
    bottom.set_xlabel("time [s]")
for axes, label in zip(panels[:, 0], ("theta [rad]", "alpha [rad]", "voltage [V]"), strict=True):
    axes.set_ylabel(label)
panels[0, 0].text(fall.t[tn.inspect_experiment(fall).k_bar], 0.5, " k_bar", color="tab:red")
plt.show()

# %% [markdown]
# ## Velocities from positions
#
# The encoders give positions only. The paper takes velocities from the five-point stencil, which at sample k
# is `(q[k-2] - 8 q[k-1] + 8 q[k+1] - q[k+2]) / (12 dt)`. The published files hold such velocities, with
# rows of zeros at both ends, where the stencil has no neighbours. `velocities("stencil")` takes the slope of a
# parabola there.

# %% alt="The first 0.4 seconds of alpha in the fall: the positions fall smoothly; the stored velocity starts with three zeros and then jumps to the stencil, which begins at minus 3.5 radians per second."
stencil, stored = fall.velocities("stencil"), fall.velocities("file")
inside = slice(3, -2)
print(f"largest difference inside the record: {abs(stencil - stored)[inside].max():.0e} rad/s")
row = f"alpha at {stored[0, 1]:.1f} rad/s, by the stencil {stencil[0, 1]:.1f}"
print("first row of the file:", row)

figure, (above, below) = plt.subplots(2, 1, figsize=(7, 3.6), sharex=True, layout="constrained")
first = slice(0, 40)
above.plot(fall.t[first], fall.q[first, 1], "k.-", ms=3)
above.set_ylabel("alpha [rad]")
below.plot(
    fall.t[first], stored[first, 1], "o", color="tab:orange", ms=4, label="stored in the file"
)
below.plot(fall.t[first], stencil[first, 1], ".-", color="tab:blue", ms=3, label="stencil")
below.set_ylabel("velocity [rad/s]")
below.set_xlabel("time [s]")
below.legend(frameon=False)
plt.show()

# %% [markdown]
# The zeros have an effect on the errors below. The paper starts its [free
# runs](../reference/glossary.md#free-run) (simulations that use no measured motion after the start) at the first
# row of the file. There the velocities are 0, although the pendulum already moves. This tutorial does the same, with
# the start `"file"`, so that its errors can be compared with the paper's. For models of your own, [another
# start](../reference/evaluation.md#where-a-free-run-starts) is better.
#
# ## Section 2.2: the grey box
#
# The paper's first model comes from the Euler-Lagrange equations. The kinetic and the potential energy, the
# damping and the motor's torque are known formulas; some of their parameters have to be identified. The package
# has this model as the system `qube-servo2`. `qube-servo2-naive` is the same without the cable's spring.
#
# `tn.fit` searches for the parameters with the lowest simulation error on the training records, as the paper
# does. To save time we use every second training record, 8 of 15. The next cell prints each parameter with its
# standard error.

# %%
fewer = tn.DataSet("fewer", (*train[::2], *validation))
spring = tn.fit(fewer, "grey", system="qube-servo2", quiet=True)
for e in spring.identification.estimates:
    told = f"at the {e.bound} end of its range" if e.bound else f"+- {e.error:.1e}"
    print(f"{e.name:17} {e.value:9.2e} {e.unit:12} {told}")

# %% [markdown]
# Most standard errors are about 3 to 10 % of the value. That of the cable's quadratic term is nearly half of its
# value: from these records it is hardly clear that the term is not 0. Two parameters are at the limit of their
# range. That is a sign that the equations lack some physics; see
# [Identification](../explanation/identification.md#what-the-result-says).
#
# ## Section 4.1: is the spring needed?
#
# The paper's Figure 3 compares free runs of the two grey boxes. A free run gets only the first state and the
# input. Its error is the *RMSE*: the squared errors of both angles are added at each sample, and the RMSE is the
# root of the mean of these sums.

# %%
naive = tn.fit(fewer, "grey", system="qube-servo2-naive", quiet=True)
models = {"with spring": spring.model, "without spring": naive.model}
scores = {name: tn.evaluate(model, validation, "file") for name, model in models.items()}
for name, found in scores.items():
    print(f"{name:15} mean RMSE over 6 validation records: {tn.mean_rmse(found):.3f} rad")


# %% alt="Free runs of a validation fall. With the spring, theta swings back as measured. Without it, theta stays near where it was let go. Both follow alpha for the first seconds."
def draw(record, colours):
    """Draws what was measured in one record, and the free runs of the models that have a colour."""
    figure, panels = plt.subplots(2, 1, figsize=(7, 4.2), sharex=True, layout="constrained")
    for j, (axes, coordinate) in enumerate(zip(panels, record.coordinates, strict=True)):
        axes.plot(record.t, record.q[:, j], color="black", lw=1.5, label="measured")
        for name, colour in colours.items():
            score = next(s for s in scores[name] if s.experiment == record.name)
            label = f"{name}, RMSE {score.rmse:.3f} rad"
            axes.plot(record.t, score.simulated[:, j], "--", color=colour, lw=1.1, label=label)
        axes.set_ylabel(f"{coordinate.name} [rad]")
    panels[0].set_title(f"{record.name}: free run", loc="left")
    panels[1].set_xlabel("time [s]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    plt.show()


draw(data["fallVal3"], {"with spring": "tab:orange", "without spring": "tab:purple"})

# %% [markdown]
# The paper reports 0.067 rad with the spring and 0.966 rad without it, on one of its test records. Here, too, the
# error without the spring is several times larger: nothing in this model pulls the arm back to `theta` = 0.
#
# ## Section 3.1: the Tustin-Net
#
# ![One step of the Tustin-Net: a network gives the velocity's increment, the trapezoidal rule the position](../images/figure2.png)
#
# A Tustin-Net needs no equations of motion. The inputs of its feedforward network are the sines and cosines of the
# angles, the velocities and the voltage. Its output is the change of the velocities in one step. The positions
# follow from the velocities by the trapezoidal (Tustin) rule, which is built in and is not learnt.
#
# *Standard training* simulates short parts of the records ([windows](../reference/glossary.md#window)) and compares
# the positions with the measured ones. The windows come from all parts of the records. The
# [recipe](../reference/glossary.md#recipe) `paper-standard` has the paper's settings: two hidden layers of 100 units
# and windows of 50 samples. It has 200 epochs; here we train for 20.

# %%
recipe = tn.read_recipe("paper-standard", ["stages.0.epochs=20"])
standard = tn.fit(data, recipe, seed=0, quiet=True)
print(f"{standard.detail('windows')[0]} windows, mean RMSE {standard.validation_rmse:.3f} rad")

# %% [markdown]
# ## Section 3.2: Algorithm 1
#
# In many of these windows the pendulum is almost at rest. A network may then learn the state of rest well and the
# motion badly. To prevent this, the paper uses transfer learning in three steps:
#
# 1. *pre-training* on windows that begin before k_bar, in the transient;
# 2. *freezing* the weights of the hidden layers;
# 3. *fine-tuning* the output layer on longer windows from the whole records.
#
# Pre-training and fine-tuning are the two stages of the recipe `paper-transfer`. Both compare velocities as well as
# positions. The recipe has the paper's 300 and 120 epochs; here we train for 30 and 12. We also train with the
# first stage alone, to have the network before fine-tuning.

# %%
recipe = tn.read_recipe("paper-transfer", ["stages.0.epochs=30", "stages.1.epochs=12"])
shorter = recipe.model_copy(update={"stages": recipe.stages[:1]})
pretrained = tn.fit(data, shorter, seed=0, quiet=True)
transfer = tn.fit(data, recipe, seed=0, quiet=True)
for stage, result in zip(recipe.stages, (pretrained, transfer), strict=True):
    w = stage.windows
    print(f"{stage.name}: {w.count} windows of {w.length} samples,", end=" ")
    print(f"{stage.frozen_layers} layers frozen, mean RMSE {result.validation_rmse:.3f} rad")

# %% [markdown]
# After 12 epochs, fine-tuning has not made the mean RMSE smaller. Did the freezing work? The next cell compares the
# weights before and after fine-tuning.

# %%
before, after = pretrained.model.network, transfer.model.network
layers = zip((*before.hidden, before.output), (*after.hidden, after.output), strict=True)
for name, (old, new) in zip(("hidden 1", "hidden 2", "output"), layers, strict=True):
    change = abs(new.weight - old.weight).max()
    print(f"{name}: {new.weight.size} weights, changed by at most {change:.4f}")

# %% [markdown]
# ## Section 4.2: free runs of both networks

# %% alt="Free runs of the same validation fall by the two networks. Both swing and come to rest, but fall out of step with the measured swings, and theta is wrong in the first two seconds."
scores["standard"] = tn.evaluate(standard.model, validation, "file")
scores["Algorithm 1"] = tn.evaluate(transfer.model, validation, "file")
draw(data["fallVal3"], {"standard": "tab:green", "Algorithm 1": "tab:red"})

# %% [markdown]
# ## Section 4.3: the table
#
# The next table is like the paper's Table 1, but for the six validation records; RMSE in rad. No model was fitted to
# these records. But the error on them decided which epoch's weights each network keeps.

# %%
print(f"{'':14}", *(f"{e.name:>11}" for e in validation), f"{'mean':>7}")
for name, found in scores.items():
    print(f"{name:14}", *(f"{s.rmse:11.3f}" for s in found), f"{tn.mean_rmse(found):7.3f}")

# %% [markdown]
# The following table has the paper's results, and those of this package with all training records and all epochs.
# For the networks they are [medians of five seeds](../explanation/paper.md#the-trainings-repeated).
#
# | mean RMSE in rad | paper, its 8 test records | this package, 6 validation records |
# |---|---|---|
# | Euler-Lagrange with spring | 0.171 | 0.157 |
# | Tustin-Net, standard training | 0.261 | 0.180 |
# | Tustin-Net, Algorithm 1 | 0.128 | 0.184 |
#
# The grey box of this tutorial, made from 8 records, is almost as good as that from all records. The networks of
# this tutorial are clearly worse than those of full training: a tenth of the epochs is too little to say which
# training is better. With all epochs, the two methods differ by less than the seeds of one method do. The authors'
# public code freezes one layer less than the paper says and takes other windows. With its settings, Algorithm 1
# has the smaller error: 0.159 against 0.193.
#
# `tustinnet reproduce` makes the full comparison, with several seeds and all figures.
# [The trainings repeated](../explanation/paper.md#the-trainings-repeated) has the commands and how long they take.
#
# ## Where to go from here
#
# * [The publication](../explanation/paper.md): each equation and where it is in the package, all results.
# * [Accuracy](../explanation/accuracy.md): models with smaller errors on the same records.
# * [Your own physics](own-physics.md): write the energies of your own system.
