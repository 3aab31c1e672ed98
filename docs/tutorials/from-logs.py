# %% [markdown]
# # From logs to a trusted model
#
# You have a folder of CSV files from a test bench. You want a model that simulates the bench, and
# you want to know how far you can trust it. This tutorial shows all steps on a small example: an
# arm with a weight at its end, driven by a motor. An encoder measures the angle. The logger writes
# a row every 20 ms.
#
# You will
#
# 1. let `init` describe the columns in a data card, and correct it,
# 2. look at the records before you fit anything,
# 3. train three networks and read what `fit` says,
# 4. compare with a simple model and test the residuals,
# 5. test the model on new records, with [bands](../reference/glossary.md#band) around its
#    simulations,
# 6. simulate a motion outside of what was recorded, and write a report.
#
# The commands of this page take one to two minutes on two cores. The page is a notebook with Python
# cells and shell commands. You can also type the shell commands in a terminal. Start in an empty
# folder: all files are written there. Other terms are in the
# [glossary](../reference/glossary.md).

# %% [markdown]
# ## The logs
#
# We have no bench here, so the next cell simulates one and writes what a lab logger would write.
# If you have logs of your own, you need only its imports.
#
# The logger writes a row every 20 ms, up to 0.4 ms early or late. In each row it writes the time,
# reads the encoder and sets a new voltage, which stays until the next row. The encoder has 4096
# counts a turn and shows 512 when the arm hangs straight down. Each file is one
# [record](../reference/glossary.md#record), that is one experiment. There are three kinds: voltage
# steps, sine sweeps, and releases by hand without voltage. Their lengths differ.

# %%
import csv
import math
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import tustinnet as tn

rng = np.random.default_rng(4)
PERIOD = 0.02  # s


def acceleration(angle: float, speed: float, volts: float) -> float:
    """The bench: motor, viscous and dry friction, gravity [rad/s^2]."""
    friction = 0.010 * speed + 0.012 * math.tanh(speed / 0.05)
    return (0.045 * volts - friction - 0.30 * math.sin(angle)) / 0.012


def move(angle: float, speed: float, volts: float, seconds: float) -> tuple[float, float]:
    """One sampling period: 10 steps of the midpoint rule."""
    h = seconds / 10
    for _ in range(10):
        middle = angle + h / 2 * speed, speed + h / 2 * acceleration(angle, speed, volts)
        angle, speed = angle + h * middle[1], speed + h * acceleration(*middle, volts)
    return angle, speed


def log(file: Path, volts: np.ndarray, angle: float = 0.0) -> None:
    """Runs the bench from standstill and writes one CSV file."""
    stamps = PERIOD * np.arange(len(volts) + 1) + rng.uniform(-4e-4, 4e-4, len(volts) + 1)
    speed = 0.0
    with file.open("w", newline="") as opened:
        rows = csv.writer(opened)
        rows.writerow(["time", "encoder", "volts"])
        for now, later, set_to in zip(stamps[:-1], stamps[1:], volts.round(3), strict=True):
            counts = round(angle / (2 * math.pi) * 4096) + 512
            rows.writerow([f"{now + 17.3:.5f}", counts, set_to])
            angle, speed = move(angle, speed, set_to, later - now)


def steps(largest: float = 3.0) -> np.ndarray:
    """A new voltage [V] every 0.2 to 0.9 s."""
    levels = [np.full(rng.integers(10, 45), rng.uniform(-largest, largest)) for _ in range(20)]
    return np.concatenate(levels)


def sweep() -> np.ndarray:
    """From 0.3 to 2 Hz, with a size and a phase of its own."""
    length = rng.integers(350, 500)
    cycles = 0.3 * PERIOD * np.arange(length) + 1.7 * PERIOD * np.arange(length) ** 2 / length / 2
    return rng.uniform(1, 2.5) * np.sin(2 * np.pi * cycles + rng.uniform(0, 6))


def session(folder: Path, records_of_a_kind: int) -> None:
    """A folder of records of each kind."""
    folder.mkdir()
    for number in range(1, records_of_a_kind + 1):
        log(folder / f"steps{number}.csv", steps())
        log(folder / f"sweep{number}.csv", sweep())
        start = (2.4 if number == 1 else rng.uniform(0.8, 2.2)) * rng.choice([-1, 1])
        log(folder / f"release{number}.csv", np.zeros(rng.integers(200, 300)), start)


def lose_counts(file: Path, counts: int, row: int) -> None:
    """Spoils a record: from a row on the encoder reads `counts` less."""
    rows = [line.split(",") for line in file.read_text().splitlines()]
    for line in rows[row:]:
        line[1] = str(int(line[1]) - counts)
    file.write_text("\n".join(",".join(line) for line in rows) + "\n")


session(Path("LOGS"), 4)
lose_counts(Path("LOGS/sweep2.csv"), 300, row=120)  # as if somebody touched the plug

# %% language="bash"
# ls LOGS
# head -4 LOGS/steps1.csv

# %% [markdown]
# ## The data card
#
# A file `dataset.toml` in the folder says what the columns mean. This file is the
# [data card](../reference/glossary.md#data-card). `init` writes it. It looks at the names and the
# numbers of all columns, asks what they do not say, and inspects the records. With `--yes` it asks
# nothing and says what it assumed. You need no velocity column: velocities are computed from the
# positions.

# %% language="bash"
# tustinnet init LOGS --yes

# %% alt="Time, encoder and voltage of a record, each with what it was taken for and why"
Image("LOGS/init.png")

# %% [markdown]
# The first lines say what each column was taken for, and why. The figure shows the same. A wrong
# unit gives a wrong model without an error message, so read what was `assumed`: nothing in the files
# says how many counts the encoder has in a turn, and 4096 was taken. Here that is right. The records
# are of three kinds, and one of each kind is for validation. The tables are explained
# [below](#look-before-you-fit).
#
# Two things only you know: the encoder shows 512 where the arm hangs down (`offset`), and the logger
# keeps the voltage until the next row (`hold`). The next cell writes them into the card, and gives
# the channels the names that this page uses:
#
# * `hold = "zero-order"` says that the voltage stays as it is until the next row.
# * `[splits]` says what each record is for. Records under `train` are trained on. Records under
#   `validation` are not trained on. The error on them decides which weights of the network are
#   kept. Put records of every kind into both.
#
# All keys are in [the reference](../reference/data.md#the-data-card).

# %%
CARD = """
name = "arm"
dt = 0.02                       # nominal sampling period, s

[time]
column = "time"

[[coordinates]]
name = "angle"
kind = "angular"
column = "encoder"
unit = "counts"
counts_per_revolution = 4096
offset = 512                    # what the counter shows where the angle is 0

[[inputs]]
name = "motor"
column = "volts"
unit = "V"
hold = "zero-order"

[splits]
"""


def write_card(folder: str, splits: str) -> None:
    """Writes `dataset.toml` into a folder of logs."""
    Path(folder, "dataset.toml").write_text(CARD + splits)


SPLITS = """
train = ["steps[1-3].csv", "sweep[1-3].csv", "release[1-3].csv"]
validation = ["*4.csv"]
"""
write_card("LOGS", SPLITS)

# %% [markdown]
# ## Look before you fit

# %% language="bash"
# tustinnet inspect LOGS --figure records.png

# %% [markdown]
# The most important columns are:
#
# * `dt` is the declared sampling period, `log` the one found in the file. They agree. The jitter of
#   about 0.3 ms is small against 20 ms. A bad sign would be another period than you declared, or
#   `gaps`. The command refuses intervals that are more than 5 % off and says what to do.
# * `rest` is the share of time near a standstill. Records that mostly stand still teach little.
# * In the second table, compare `range` with what you know of the machine. An angle of 90 rad
#   would mean that degrees were declared as radians. `count` is the encoder count found in the
#   data: 2 pi / 4096 = 0.00153.
# * `at its ends` is the share of time at an end of the input's range. A large share means that the
#   logged voltage may not be what the motor received.
#
# [The reference](../reference/data.md#of-a-data-set) explains the other columns.
#
# Below the tables are [findings](../reference/findings.md) and remarks. A `warning` is a bad sign: the
# angle of `sweep2` jumps within one sample. `hold` is a reminder: the voltage changes fast, so it matters what it does between two
# rows. We know that our logger keeps it constant, as `hold = "zero-order"` says.
#
# Now look at the curves.

# %% alt="Angle and voltage of each record; the angle of sweep2 drops suddenly after 2.4 s"
Image("records.png")

# %% [markdown]
# After about 2.4 s, the angle of `sweep2` drops by almost half a radian from one sample to the next.
# Afterwards the arm swings about a wrong zero. No real arm can move like that: the encoder lost
# counts. We leave the record out. The other records look right: the releases decay to zero, and the
# arm responds to the voltage steps. A red line and a green band mark where a release comes to rest;
# see [inspect](../reference/data.md#of-a-data-set).
#
# The next cell writes the card again, without `sweep2` in the split `train`.

# %%
write_card("LOGS", SPLITS.replace("sweep[1-3]", "sweep[13]"))

# %% [markdown]
# ## Fit
#
# A [recipe](../reference/glossary.md#recipe) says how a model is built and trained. `fit` without a
# recipe tries several kinds of models within the time that you give (`--budget 10min`), and chooses
# one ([Choosing a model](../explanation/choosing.md)). Use that for your own logs. To save time, we
# train only one kind here, a [Tustin-Net](../reference/glossary.md#tustin-net). It is a small neural
# network for the acceleration. Positions follow from velocities by the trapezoidal rule, so the
# network need not learn that.
#
# The recipe `standard` is made for logs of any mechanism. `--set` changes a setting of the recipe. We
# change four to save time: smaller layers, fewer epochs, fewer
# [windows](../reference/glossary.md#window) (short parts of the records to train on) and a larger
# learning rate. `--seeds 3` trains three networks at once, each from other random initial weights.
# `--quiet` hides the progress.

# %% language="bash"
# tustinnet fit LOGS --recipe standard --seeds 3 --out network --quiet --set model.hidden=[32,32] \
#     --set stages.0.epochs=60 --set stages.0.windows.count=800 --set stages.0.rate=2e-3

# %% [markdown]
# The most important number is `mean RMSE`, the root mean square error of **free runs** of the
# validation records. In a free run the model gets only the state at the beginning of the record and
# the voltage. Errors accumulate, because the simulation is never corrected by measurements. Here the
# errors are about one degree (0.017 rad), while the arm swings by one or two radians. The start
# `derived-6` means that the initial state is computed from the first six samples
# ([Starts](../reference/evaluation.md#where-a-free-run-starts)).
#
# * The errors of the three seeds are similar. A bad sign would be a seed that is several times worse
#   than another: then train longer, or record more.
# * Training records and validation records have errors of the same size. Validation errors that
#   are several times larger would be a sign of
#   [overfitting](../reference/glossary.md#overfitting).
# * `kept` is the epoch whose weights were kept. If it is among the last ones, `fit` says so and
#   tells you to train longer. Do that with your own logs.
#
# `network/model.safetensors` is the network of the best seed. The folders `network/seed-0`, `seed-1`
# and `seed-2` have all three.

# %% alt="Training loss and validation error of three seeds fall over 60 epochs; the rate is constant"
Image("network/figures/training.png")

# %% [markdown]
# The training loss (top) and the validation error (middle) should both fall and become flat. A bad
# sign is a validation error that rises while the training loss still falls. Dots mark the epochs
# that were kept; the figure counts epochs from 0. Below is the learning rate.
#
# ## Compare with something simple
#
# Is a network needed at all? To find out, we fit a linear state-space model to the same records.
# Then `evaluate` compares both. What the first command prints goes to the file `linear.txt`; we do not
# need it here.

# %% language="bash"
# tustinnet fit LOGS --recipe linear --out linear --quiet > linear.txt
# tustinnet evaluate network/model.safetensors linear/model.safetensors LOGS \
#     --split validation --figures compared

# %% alt="The network's free run lies on the measurement, the linear model swings too far"
Image("compared/steps4.png")

# %% [markdown]
# The errors of the linear model are 6 to 10 times as large. The torque of gravity depends on the
# sine of the angle, and a linear model cannot have a sine. If both models were equally good, you
# would take the linear one. If both were bad, you would look for faults of the records or of the
# bench: an input that was not logged, a wrong sign, play in a gear.
#
# ## Test the residuals
#
# **Residuals** are the measurement minus the simulation. With a perfect model only the quantisation
# of the encoder would be left. The residuals would then be
# [white](../reference/glossary.md#whiteness): not correlated from sample to sample.

# %% language="bash"
# tustinnet evaluate network/model.safetensors LOGS --split validation --residuals \
#     --figures tested | tail -n 9

# %% alt="Autocorrelation of the residuals and their correlation with the motor voltage"
Image("tested/residuals.png")

# %% [markdown]
# The residuals are not white: the model still lacks something. That is usual for free runs,
# because small errors of the acceleration accumulate. Two things matter more.
#
# * How large are the residuals? The `RMS` is about 0.012 rad, less than one degree.
# * Do they depend on the input? See the right panel. At lags from 0 on, all bars are inside the
#   shaded range. That is what `outside, motor` counts. Bars outside would be a bad sign: the model
#   would lack a part of the input's effect, for instance a delay. Bars at negative lags do not count
#   against the model of the input.
#
# ## New records
#
# The validation records decided which epoch is kept, so the errors on them are a little too small. A
# fair test needs records that were not used before. We simulate twelve new ones.
#
# From nine of them we estimate how large the errors of free runs are. This is called *calibration*.
# Three are for the test. In this folder the split `validation` is for calibration.

# %%
session(Path("LATER"), 4)
write_card("LATER", 'validation = ["*[1-3].csv"]\ntest = ["*4.csv"]\n')

# %% [markdown]
# A single network gives no measure of its uncertainty. Three networks do: their free runs differ
# most where the training records determine the motion poorly. `save_committee` combines them into one
# model that averages their accelerations. `calibrate` then simulates the nine records and stores in
# the model how large the errors were. It refuses records that the model was trained on.

# %%
jax.config.update("jax_enable_x64", True)  # double precision, as the command has
tn.save_committee(sorted(Path("network").glob("seed-*/model.safetensors")), "committee.safetensors")
later = tn.load("LATER").split("validation")
bands = tn.calibrate("committee.safetensors", later, "trusted.safetensors")
f"the highest level is {bands.highest_level:.0%}"

# %% [markdown]
# ## The test
#
# Now we evaluate the model on the three test records. `--band 0.8` asks for a band that contains the
# measurement for 80 % of the time.

# %% language="bash"
# tustinnet evaluate trusted.safetensors LATER --split test --band 0.8 --figures checked

# %% alt="A new record: the free run lies on the measurement, in a narrow band"
Image("checked/steps4.png")

# %% [markdown]
# * `fit [%]` is 100 for a perfect free run and 0 for one that is no better than the mean of the
#   record. Here it is about 93 to 95. Each free run lasts for the whole record.
# * The errors are about as large as those of the validation records. A bad sign would be new records
#   whose errors are several times larger. Then the bench has changed, or the validation records were
#   too similar to the training records.
# * `inside` is the share of time in which the measurement was within the band. The promise is 80 %
#   on average over many records like these. Three test records are too few to check it: the column
#   `95 % interval` is wide. Much less than 80 % on many records would be a bad sign.
# * `moving` and `rest` are scored separately. Only one of the three test records comes to rest.
# * `width` is the distance from the lower to the upper edge of the band.
#
# We asked for 80 % because nine calibration records can promise 90 % at most. A band at that limit
# must cover the worst of the nine records, so it is wide.
#
# How bands are made, and what exactly they promise, is in [How far a model can be
# trusted](../explanation/trust.md). The other columns are in
# [Scores](../reference/evaluation.md#scores).
#
# ## Outside of the records
#
# In all records the voltage was at most 3 V. What if the motor gets more? We log one record with
# steps of up to about 7 V, and simulate it.

# %%
Path("STRONG").mkdir()
volts = steps()
log(Path("STRONG/strong.csv"), np.linspace(0.5, 2.5, len(volts)) * volts)
write_card("STRONG", 'test = ["strong.csv"]')

# %% language="bash"
# tustinnet simulate trusted.safetensors STRONG --band 0.8 --out simulated
# head -1 simulated/strong.csv

# %% [markdown]
# The note says when the free run leaves the range of the training records, and in which quantity. It
# needs no measurement, so you also get it for a motion that you only plan. `simulate` writes a CSV
# file with the free run and the edges of the band. The next cell draws it.

# %% alt="The voltage grows: the free run follows, and its band opens after seven seconds"
run = np.genfromtxt("simulated/strong.csv", delimiter=",", names=True)
since = run["time"] - run["time"][0]
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.fill_between(since, run["angle_low"], run["angle_high"], color="tab:red", alpha=0.2)
axes.plot(since, run["angle_measured"], "k", label="measured")
axes.plot(since, run["angle"], "tab:red", linestyle="--", label="free run, with band of 80 %")
axes.set(xlabel="time [s]", ylabel="angle [rad]")
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# The band becomes wide where the motion is larger than in any training record. The three networks
# were not trained on such motions, so their free runs differ. The measurement stays inside for much
# of this record, but that is not guaranteed. The promise of a band holds only for records like the
# calibration records. If your controller needs larger motions, record them and train again.
#
# ## The report
#
# One HTML file shows the results: an animation of the measured and the simulated arm, the free runs,
# their errors and bands. In its [playground](../reference/glossary.md#playground) the model runs in
# the browser: drag the arm, or set the voltage of the motor. The file needs no server, so you can
# send it to colleagues.

# %% language="bash"
# tustinnet report trusted.safetensors LATER --split test --out report.html

# %% [markdown]
# ## What you have now
#
# `trusted.safetensors` is one file with three networks, the units of their channels, and the
# calibration of the bands. You know
#
# * that its free runs have an RMSE of about one degree on records that were not used before,
# * how much better that is than a linear model,
# * how wide its bands are, and for which motions they hold.
#
# Next:
#
# * If you know the equations of your mechanism, write them down: [Your own
#   physics](own-physics.md).
# * To use the model in C, Simulink or an optimiser: [Into the controller](into-the-controller.md).
# * How many records are enough: [How much to record](../explanation/data-needs.md).
# * If your logs have more jitter than 5 %, gaps, angles that wrap or reversed signs: [how-to
#   guides](../how-to/index.md).
