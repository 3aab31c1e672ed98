# %% [markdown]
# # Into the controller
#
# You have logs of a machine and want it to do something: swing up and stay there. Three commands lead from the logs to a
# controller in C that was tested against what the model does not know. Then the same model goes into Simulink as an FMU.
#
# You will
#
# 1. fit a [grey box](../reference/glossary.md#grey-box) to logs;
# 2. design a controller with one command, and read what it says about the controller;
# 3. play it on a device that differs from the model;
# 4. compile it in C, the code for a microcontroller;
# 5. run the model as an FMU, and see how to use it in Simulink.
#
# You need a C compiler (`cc`) and the extra `fmu`: `pip install 'tustinnet[fmu]'`. The page is a
# notebook with Python cells and shell commands. Start in an empty folder: all files are written there.

# %% [markdown]
# ## A model to control
#
# We have no bench here. Instead we use the package's [twin](../reference/systems.md#the-twin): a simulated rotary
# pendulum (Quanser Qube-Servo 2) with encoders. A motor turns an arm by the angle `theta`. At the arm's end a
# pendulum swings by `alpha`, which is 0 upright and pi hanging. The input is the motor's voltage. The next cell writes
# six of the twin's records for training and one for the test.

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from fmpy import simulate_fmu

import tustinnet as tn
from tustinnet.store.data_set_folder import write_data_set
from tustinnet.systems import qube_servo2_twin

jax.config.update("jax_enable_x64", True)  # the exports compute in double precision, too

names = ("fall1", "fall2", "fall3", "noise1", "noise3", "noise5", "noise_test2")
twin = qube_servo2_twin.twin(seed=0)
records = tn.DataSet("twin", tuple(twin[f"twin_{name}"] for name in names))
write_data_set(records, Path("logs"), "Rotary pendulum, simulated")
for split in ("train", "test"):
    print(f"{split}:", ", ".join(path.stem for path in sorted(Path("logs", split).iterdir())))

# %% [markdown]
# The model is a grey box: the equations of motion of the packaged system `qube-servo2`, with parameters identified
# from the logs. The twin also has dry friction and a cable whose force has
# [memory](../reference/glossary.md#memory). The equations lack both. So the model differs from the device, as it does
# on a real bench. What `fit` prints goes to the file `fit.txt`.

# %% language="bash"
# tustinnet fit logs --recipe grey --system qube-servo2 --out pendulum > fit.txt 2>&1

# %%
model = tn.load_model("pendulum/model.safetensors")
record = tn.load("logs")["twin_noise_test2"]
(score,) = tn.evaluate(model, record, "derived-6")
print(f"free run of the test record, {len(record) * record.dt:.0f} s: RMSE {score.rmse:.3f} rad")

# %% [markdown]
# ## A controller by one command
#
# `--at alpha=0` is where the pendulum is to stay, and `--swing-up` where it begins: hanging. The motor takes 10 V. The
# records (`--data`) tell the noise of the filter that estimates the velocities.

# %% language="bash"
# tustinnet control pendulum/model.safetensors --at alpha=0 --swing-up --limits voltage=-10:10 \
#     --data logs --out controller 2> messages.txt

# %% [markdown]
# What this says, from above:
#
# * **The equilibrium**, how fast the pendulum falls there, and that the voltage moves everything that falls and the encoders
#   show it.
# * **The gains** of the feedback about it. They follow from how far each state may deviate: half of its range in the records.
#   `--weight alpha=5deg` would make it stricter.
# * **The margins**: how much the loop's gain, phase and delay may change before it is unstable.
# * **The motion**, planned so that it stays within what the records have, here 4 V and their speeds, and within 80 % of the
#   voltage; the rest is for the feedback along it.
# * **After a fall** the controller damps the motion until the pendulum hangs nearly at rest, and swings it up again.
# * **The table of robustness.** The controller was played 20 times on each kind of plant that differs from the model. If your
#   device may be of a kind that fails, record more, or ask for less.

# %% [markdown]
# ## On the device
#
# The device is the twin, sampled through encoders of 2048 counts. The controller has never seen it. In Python the files are
# played as follows; `closed_loop` reads the encoders, estimates the state and applies the voltage, sample by sample.

# %%
control = tn.control
design = control.read_controller("controller")
noise = control.find_noise(model, list(tn.load("logs").split("train")))
goal = control.Goal({"alpha": 0.0})
runs = [
    control.closed_loop(
        control.qube_twin(),
        control.TrackingFeedback(design),
        control.ExtendedKalmanFilter(model, noise),
        800,
        start,
        seed=i,
        goal=goal,
    )
    for i, start in enumerate(control.draw_starts([0.0, np.pi], [0.1, 0.05], 5))
]
for run in runs:
    print(run.outcome.sentence)

# %% alt="Five swing-ups of the device. Theta swings to both sides and comes back to zero; alpha rises from hanging to upright within about one and a half seconds and stays there; the voltage stays within about five volts."
figure, panels = plt.subplots(3, 1, figsize=(7, 5.4), sharex=True, layout="constrained")
for run in runs:
    t = run.dt * np.arange(len(run.inputs))
    for axes, column in zip(panels, (*run.states[:-1, :2].T, run.inputs[:, 0]), strict=True):
        axes.plot(t, column, lw=1.0)
for axes, label in zip(panels, ("theta [rad]", "alpha [rad]", "voltage [V]"), strict=True):
    axes.set_ylabel(label)
planned = design.plan
panels[1].plot(planned.dt * np.arange(len(planned.x)), planned.x[:, 1], "k--", label="plan")
panels[1].legend(frameon=False)
panels[2].set_xlabel("time [s]")
plt.show()

# %% [markdown]
# ## The code
#
# The folder has the controller, the filter and the model in C99. They allocate nothing and need only the mathematics library.
# `main.c` closes the loop in software; on a microcontroller you write its loop with your encoders and your motor.

# %% language="bash"
# cd controller
# ls
# make && ./main > loop.csv && head -n 1 loop.csv
# sed -n "/for (int k/,/^    }/p" main.c

# %% [markdown]
# Before anything was written, this code was compiled and compared with Python sample by sample. A period of controller and filter
# takes less than a microsecond here; what it needs on a Cortex-M7 is in the [reference](../reference/control.md#speed-and-size). Open
# `controller/control.html` in a browser: the pendulum moves there, and you can disturb it. `problem.py`, `acados_problem.py` and
# `do_mpc_controller.py` are the same task for predictive control by CasADi, acados and do-mpc.
#
# ## The model in Simulink
#
# An FMU (Functional Mock-up Unit) is a file with a model that many simulators can import. `export` writes it, and checks it: it computes
# a step at 200 random states and inputs and compares the result with the model. The last column is the largest
# difference, as the title of the table says it: relative to 1 + the size of the state.

# %% language="bash"
# tustinnet export pendulum/model.safetensors --to c,fmu --out out

# %% [markdown]
# `model-fmi2.fmu` and `model-fmi3.fmu` are for versions 2 and 3 of the standard FMI. Both contain the C code, as sources and as a
# binary for this machine. `fmpy` runs them in Python. The start
# `derived-6` means that the [initial state](../reference/evaluation.md#where-a-free-run-starts) is computed from
# the first six samples.

# %%
x0, u = tn.initial_state(record, "derived-6"), record.u[:-1]
own = np.asarray(tn.rollout(model, x0, u))
times = record.dt * np.arange(len(u))
inputs = np.array(list(zip(times, u[:, 0], strict=True)), [("time", float), ("voltage", float)])
start = dict(zip(("theta", "alpha", "der_theta", "der_alpha"), map(float, x0), strict=True))
found = simulate_fmu(
    "out/fmu/model-fmi2.fmu",
    start_values=start,
    input=inputs,
    output=["theta", "alpha"],
    output_interval=record.dt,
    stop_time=times[-1],
)
for j, name in enumerate(("theta", "alpha")):
    print(f"{name}: largest difference {abs(found[name] - own[: len(found), j]).max():.0e} rad")

# %% [markdown]
# In Simulink:
#
# 1. Add the block *FMU* (FMU Import) to your model and choose `model-fmi2.fmu` in its dialogue.
# 2. The block has the input `voltage` and the outputs `theta`, `alpha`, `der_theta` and `der_alpha`. The start values
#    of the outputs are parameters of the block.
# 3. Set its communication step size to the model's sampling period, here 0.01 s, or to a whole multiple. The FMU
#    refuses other steps with a message.
#
# The FMU was checked with fmpy. These steps have not been tried in Simulink. The binary of this page is for Linux on
# x86-64. For another machine [build one from the sources](../reference/export.md#fmu).
#
# ## Where to go from here
#
# * [From logs to a controller](../how-to/controller.md): weights, integral action, delays, other motions, plants of your own.
# * [Control](../explanation/control.md): which models are good enough for it, and what to record.
# * [Exports](../reference/export.md): the arguments of a step, speed and memory on a Cortex-M7, CasADi, ONNX, JavaScript,
#   matrices for MATLAB.
# * [The publication retraced](publication.md): measurements of the apparatus that this twin simulates.
