# %% [markdown]
# # From logs to a trusted model
#
# You have a folder of CSV files from a test bench. You want a model that simulates the bench, and
# you want to know how far you can trust it. This tutorial goes the whole way on a small example:
# an arm with a weight at its end, driven by a motor. An encoder counts the angle, the logger
# writes a row every 20 ms.
#
# You will
#
# 1. describe the columns in a data card,
# 2. look at the records before you fit anything,
# 3. train three networks and read what `fit` says,
# 4. compare with a simple model and test the residuals,
# 5. judge the model on records that were used for nothing before, with bands around its free runs,
# 6. ask for a motion that nobody recorded, and write a report.
#
# The whole page takes one to two minutes on two cores. It is a notebook: you can run the same
# commands in a terminal. Words such as *free run* are explained where they appear first, and in
# the [glossary](../reference/glossary.md).

# %% [markdown]
# ## The logs
#
# We have no bench here, so the next cell simulates one and writes what a lab logger would write.
# If you have logs of your own, skip it.
#
# The logger wakes up every 20 ms, up to 0.4 ms early or late. It writes the time, reads the
# encoder (4096 counts a turn; the counter shows 512 when the arm hangs straight down) and sets a
# new voltage, which stays until the next row. There are three kinds of records: voltage steps,
# sweeps, and releases by hand without voltage. No two are equally long.

# %%
import csv
import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

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
# A file `dataset.toml` in the folder says what the columns mean. Nothing is guessed, because a
# wrong unit would give a wrong model without an error. You need no velocity column: velocities are
# computed from the positions.
#
# * `hold = "zero-order"` says that the voltage stays as it is until the next row.
# * `[splits]` says what each record is for. Records under `train` are trained on. Records under
#   `validation` are not trained on, but they choose which weights are kept. Put records of every
#   kind into both.
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
# Read the first table from left to right:
#
# * `dt` and `log` agree, and the jitter of 0.3 ms is small against 20 ms. A bad sign would be
#   another period than you declared, or `gaps`. The command refuses intervals that are more than 5
#   % off and says what to do.
# * `rest` is the share of time near a standstill. Records that mostly stand still teach little.
# * In the second table, compare `range` with what you know of the machine. An angle of 90 rad
#   would mean that degrees were declared as radians. `count` is the encoder count found in the
#   data: 2 pi / 4096 = 0.00153.
# * `saturated` is the share of time at an end of the input's range. Much of it means that the
#   logged voltage may not be what the motor received.
#
# Then come sentences. The line `suspicious` is a bad sign: the angle of `sweep2` jumps within one
# sample. The line about `hold` is a reminder: the voltage jumps, so it matters what it does
# between two rows. We know that our logger holds it.
#
# Now look at the curves.

# %% alt="Angle and voltage of each record; the angle of sweep2 drops suddenly after 2.4 s"
Image("records.png")

# %% [markdown]
# After 2.4 s, `sweep2` drops by half a radian and stays there. No arm does that: the encoder lost
# counts. We leave the record out. The others look as they should: the releases decay to zero, and
# the arm answers every step of the voltage. (Red and green mark where a record comes to rest; see
# [inspect](../reference/data.md#inspect).)

# %%
write_card("LOGS", SPLITS.replace("sweep[1-3]", "sweep[13]"))

# %% [markdown]
# ## Fit
#
# `fit` without a recipe tries several kinds of models within the minutes that you give (`--budget
# 10min`), and chooses one ([Choosing a model](../explanation/choosing.md)). Take that for your own
# logs. Here we train one kind, a [Tustin-Net](../reference/glossary.md), so that this page stays
# short. It is a small neural network for the acceleration. Positions follow from velocities by the
# trapezoidal rule, so the network need not learn that.
#
# The recipe `standard` is made for unknown logs. We change four of its numbers to save time: fewer
# epochs, fewer windows, smaller layers, larger steps. Three seeds train at once. Each begins with
# other random weights.

# %% language="bash"
# tustinnet fit LOGS --recipe standard --seeds 3 --out network --quiet --set model.hidden=[32,32] \
#     --set stages.0.epochs=60 --set stages.0.windows.count=800 --set stages.0.rate=2e-3

# %% [markdown]
# The number that counts is `mean RMSE`, the root mean square error of **free runs**. In a free run
# the model gets the state at the beginning of the record and the voltage, and nothing else. So an
# error at one sample stays in all later ones. Here the errors are about one degree (0.017 rad),
# while the arm swings by one or two radians.
#
# * The three seeds agree. A bad sign would be a seed that is several times worse than another:
#   then train longer, or record more.
# * Training records and validation records have errors of the same size. Validation errors that
#   are several times larger would mean that the network learnt the training records by heart.
# * `kept` is the epoch whose weights were kept. If it is among the last ones, `fit` says so and
#   tells you to train longer. Do that with your own logs.

# %% alt="Training loss and validation error of three seeds fall together over 60 epochs"
Image("network/figures/training.png")

# %% [markdown]
# Both curves should fall together and become flat. A bad sign is a validation error that rises
# while the training loss still falls. Dots mark the epochs that were kept.
#
# ## Compare with something simple
#
# Is a network needed at all? A linear state-space model answers that. It is trained on the same
# records.

# %% language="bash"
# tustinnet fit LOGS --recipe standard --out linear --quiet --set 'model={kind="linear"}' \
#     --set stages.0.epochs=10 --set stages.0.windows.count=300 > linear.txt
# tustinnet compare network/model.safetensors linear/model.safetensors LOGS \
#     --split validation --figures compared

# %% alt="The network's free run lies on the measurement, the linear model swings too far"
Image("compared/steps4.png")

# %% [markdown]
# The linear model is many times worse, since gravity acts by the sine of the angle. If both were
# equally good, you would take the linear one. If both were bad, look for what the records do not
# show: an input that was not logged, a wrong sign, play in a gear.
#
# ## What is left?
#
# **Residuals** are what was measured minus what was simulated. If the model had everything, only
# the noise of the encoder would be left, and one sample would say nothing about the next.

# %% language="bash"
# tustinnet residuals network/model.safetensors LOGS --split validation --figure residuals.png

# %% alt="Autocorrelation of the residuals and their correlation with the motor voltage"
Image("residuals.png")

# %% [markdown]
# The residuals are not white: the model still lacks something. That is usual for free runs,
# because small errors of the acceleration add up. What matters is how much is left (`RMS`, about
# one degree) and whether it depends on the input (right). Here the correlation with the motor
# stays within its band at lags from 0 on. Bars outside the band there would be a bad sign: the
# input's effect is not all modelled, for instance because it acts later than the card says. Bars
# at negative lags say nothing against the model of the input.
#
# ## New records
#
# The validation records chose the epochs, so their scores are a little too good. A judgement needs
# records that were used for nothing before. We go back to the bench.
#
# Nine of the new records will tell how large the errors are (*calibration*). Three are the judges.
# In this folder the split `validation` is for calibration.

# %%
session(Path("LATER"), 4)
write_card("LATER", 'validation = ["*[1-3].csv"]\ntest = ["*4.csv"]\n')

# %% [markdown]
# A single network does not know how sure it is. Three do: where their free runs differ, the
# records did not tell them what to do. `committee` puts them together as one model that averages
# their accelerations. `calibrate` then compares free runs with the nine records and stores how far
# off they were. It would refuse records that the model was made from.

# %% language="bash"
# tustinnet committee network/seed-*/model.safetensors --out committee.safetensors
# tustinnet calibrate committee.safetensors LATER --split validation --out trusted.safetensors

# %% [markdown]
# ## The judgement
#
# Now, once, the three records that nobody has looked at.

# %% language="bash"
# tustinnet evaluate trusted.safetensors LATER --split test --band 0.8 --figures checked

# %% alt="A new record: the free run lies on the measurement, in a narrow band"
Image("checked/steps4.png")

# %% [markdown]
# * `fit [%]` is 100 for a perfect free run and 0 for one that is no better than the mean of the
#   record. Well above 90 here, over the whole record, from the first samples alone.
# * The errors are about those of the validation records. A bad sign would be new records that are
#   several times worse: then the bench has changed, or the validation records were too much like
#   the training records.
# * `inside` says how much of the time the measurement was within the band. The promise is 80 % on
#   average over many records like these. Three judges are few: the column `95 % interval` says how
#   little they prove. Much less than 80 % on many records would be a bad sign.
# * `width` is how wide the band is, from its lower to its upper edge. We asked for 80 % because
#   nine calibration records can promise 90 % at most, and a band at that limit is as wide as the
#   worst of the nine demands.
# * Bands are made apart for the time in which the arm moves and for the time after it has come to
#   rest.
#
# How bands are made, and what exactly they promise, is in [How far a model can be
# trusted](../explanation/trust.md).
#
# ## Where trust ends
#
# The bench never had more than 3 V. What if it gets more? We log one record whose voltage grows to
# 7 V, and simulate it.

# %%
Path("STRONG").mkdir()
volts = steps()
log(Path("STRONG/strong.csv"), np.linspace(0.5, 2.5, len(volts)) * volts)
write_card("STRONG", 'test = ["strong.csv"]')

# %% language="bash"
# tustinnet simulate trusted.safetensors STRONG --band 0.8 --out simulated
# head -1 simulated/strong.csv

# %% [markdown]
# The note says when the free run leaves what the model was made from, and by what. You need no
# measurement for that note, so it also comes when you plan a motion. `simulate` writes a CSV file
# with the free run and the edges of the band. Let us draw it.

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
# Where the arm moves faster than it ever did, the band opens: the three networks disagree about
# what they have never seen. The measurement may stay inside, as it does for most of this record,
# but nobody promised that. A band is a promise for records like those of the calibration. If your
# controller needs stronger motions, record them and train again.
#
# ## The report
#
# One HTML file shows it all: the arm moving, measured and simulated; free runs, errors and bands;
# a playground in which you drag the arm and drive the motor. It needs no server; send it to your
# colleagues.

# %% language="bash"
# tustinnet report trusted.safetensors LATER --split test --out report.html

# %% [markdown]
# ## What you have now
#
# `trusted.safetensors` is one file with three networks, their units, and their bands. You know
#
# * that its free runs were off by a degree or two on records that nobody had used,
# * how much better that is than a linear model,
# * how wide its bands are, and for which motions they hold.
#
# Next:
#
# * If you know the equations of your mechanism, write them down: [Your own
#   physics](own-physics.md).
# * To use the model in C, Simulink or an optimiser: [Into the controller](into-the-controller.md).
# * How many records are enough: [How much to record](../explanation/data-needs.md).
# * Jitter above 5 %, gaps, angles that wrap, reversed signs: [how-to guides](../how-to/index.md).
