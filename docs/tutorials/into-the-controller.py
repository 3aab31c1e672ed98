# %% [markdown]
# # Into the controller
#
# You have a fitted model and want to use it outside of Python: as C code on a microcontroller, as an FMU in Simulink,
# or as a CasADi function in an optimiser. This tutorial makes these three exports and controls a pendulum with two of
# them. An optimiser plans how the pendulum swings up (CasADi). A feedback law follows the plan, and a Kalman filter
# estimates the state from noisy encoders (C).
#
# You will
#
# 1. fit a [grey box](../reference/glossary.md#grey-box) to logs and export it to C, FMU and CasADi with one command;
# 2. compile the C code and compare its [free run](../reference/glossary.md#free-run) with that of the model in Python;
# 3. run the FMU and see how to use it in Simulink;
# 4. plan the swing-up with CasADi;
# 5. follow the plan with the C filter and a feedback law, on a device that differs a little from the model.
#
# You need a C compiler (`cc`) and the extras `fmu` and `casadi`: `pip install 'tustinnet[fmu,casadi]'`. The page is a
# notebook with Python cells and shell commands. Start in an empty folder: all files are written there.

# %% [markdown]
# ## A model to export
#
# We have no bench here. Instead we use the package's [twin](../reference/systems.md#the-twin): a simulated rotary
# pendulum (Quanser Qube-Servo 2) with encoders. A motor turns an arm by the angle `theta`. At the arm's end a
# pendulum swings by `alpha`, which is 0 upright and pi hanging. The input is the motor's voltage. The next cell writes
# six of the twin's records for training and one for the test.

# %%
import ctypes
from pathlib import Path

import casadi
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
# One command writes all three exports, each into a folder of its own. It also checks them: it computes a step of every
# export at 200 random states and inputs and compares the result with the model. The last column is the largest
# difference, as the title of the table says it: relative to 1 + the size of the state.

# %% language="bash"
# tustinnet export pendulum/model.safetensors --to c,fmu,casadi --out out

# %% [markdown]
# ## C
#
# `model.c` is plain C99. It allocates no memory and needs only the mathematics library. `model.h` declares all
# functions. These are its lines about a step of the model:

# %% language="bash"
# grep -A 13 "^typedef struct model_state" out/c/model.h

# %% [markdown]
# For a microcontroller you add `model.c` and `estimate.c` to the firmware. Here we make a shared library of them
# and call it from Python with `ctypes`. The next cell simulates the test record with the C code and with the model. The
# start `derived-6` means that the [initial state](../reference/evaluation.md#where-a-free-run-starts) is computed from
# the first six samples.

# %% language="bash"
# cc -std=c99 -O2 -fPIC -shared out/c/model.c out/c/estimate.c -lm -o model.so

# %%
C = ctypes.CDLL("./model.so")


def real(values):
    """Numbers as C has them."""
    values = np.atleast_1d(np.asarray(values, float))
    return (ctypes.c_double * len(values))(*values)


x0, u = tn.initial_state(record, "derived-6"), record.u[:-1]

state = real(x0)  # of `model_state` the only member is `x`
in_c = [np.array(state)]
for voltage in u:
    C.model_step(state, real(voltage))
    in_c.append(np.array(state))

own = np.asarray(tn.rollout(model, x0, u))
print(f"largest difference over {len(u)} steps: {abs(np.array(in_c) - own).max():.0e}")

# %% [markdown]
# The C code gives the same free run as the model, up to rounding. If you compile it with `-DMODEL_FLOAT`, it computes in
# single precision, for processors without double precision.
#
# ## FMU
#
# An FMU (Functional Mock-up Unit) is a file with a model that many simulators can import. `model-fmi2.fmu` and
# `model-fmi3.fmu` are for versions 2 and 3 of the standard FMI. Both contain the same C code, as sources and as a
# binary for this machine. `fmpy` runs them in Python:

# %%
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
# ## CasADi: a plan for the swing-up
#
# `step.casadi` is one step of the model as a function with exact derivatives. CasADi loads it without tustinnet.
# The plan is the solution of an optimal control problem. The pendulum moves from hanging to upright in 1.5 s. The sum of
# the squared voltages is minimised. The voltage stays within 10 V and the arm within 2 rad, in both directions.

# %%
step = casadi.Function.load("out/casadi/step.casadi")
STEPS = 150
hanging, upright = [0, np.pi, 0, 0], [0, 0, 0, 0]

problem = casadi.Opti()
x, v = problem.variable(4, STEPS + 1), problem.variable(1, STEPS)
problem.minimize(casadi.sumsqr(v))
problem.subject_to(x[:, 1:] == step.map(STEPS)(x[:, :-1], v))
problem.subject_to(x[:, 0] == hanging)
problem.subject_to(x[:, -1] == upright)
problem.subject_to(problem.bounded(-10, v, 10))
problem.subject_to(problem.bounded(-2, x[0, :], 2))
problem.set_initial(x[1, :], np.linspace(np.pi, 0, STEPS + 1))
problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
solved = problem.solve()
planned, voltages = solved.value(x).T, solved.value(v)
print(f"planned with at most {abs(voltages).max():.1f} V: {solved.stats()['return_status']}")

# %% [markdown]
# ## The controller
#
# The planned voltages alone are not enough: the upright equilibrium is unstable, and the device differs from the
# model. Two things are added.
#
# *Feedback.* A time-varying linear quadratic regulator (LQR) gives for every sample a vector of gains. The gains multiply
# the difference between the state and the plan. `model_linearise` of the C export gives the linearisation that the
# regulator needs. After the plan the pendulum is held upright for another 1.5 s.

# %%
HOLD = 150
plan = np.concatenate([planned[:-1], np.tile(upright, (HOLD, 1))])
feed = np.concatenate([voltages, np.zeros(HOLD)])


def slopes(x, u):
    """Derivatives of a step by the state and by the input."""
    following, a, b = real(np.zeros(4)), real(np.zeros(16)), real(np.zeros(4))
    C.model_linearise(real(x), real(u), following, a, b)
    return np.reshape(a, (4, 4)), np.reshape(b, (4, 1))


state_cost, input_cost = np.diag([2.0, 10.0, 0.1, 0.1]), 0.05
cost, gains = state_cost, []
# backwards from the end; the upright state comes first, until its gain no longer changes
for x, u in [(upright, 0.0)] * 500 + list(zip(plan[::-1], feed[::-1], strict=True)):
    a, b = slopes(x, u)
    gain = np.linalg.solve(input_cost + b.T @ cost @ b, b.T @ cost @ a)
    cost = state_cost + a.T @ cost @ (a - b @ gain)
    gains.append(gain)
gains = np.array(gains[:499:-1])[:, 0]
print(f"gains upright: {np.round(gains[-1], 1)}")

# %% [markdown]
# *Estimation.* Feedback needs velocities, and encoders do not measure them. `estimate.c` is an extended Kalman filter
# for the model. Its settings are three sets of standard deviations: of the initial state (`start` in the next cell), of
# the model's error in one step (`process`), and of the encoders' readings (`noise`). The model's error in one step is
# mainly an error of the velocities, so these have the largest values in `process`.
#
# The device is the twin, simulated with 10 integration steps in a sampling period. Its encoders have 2048 counts a turn,
# and we add noise with a standard deviation of 1 mrad to each reading. On a microcontroller you would write the loop
# below in C. In each sampling period it calls `model_estimate_correct`, computes the feedback law, and calls
# `model_estimate_predict`.


# %%
class Estimate(ctypes.Structure):
    """`model_estimate` of model.h."""

    _fields_ = [
        ("x", ctypes.c_double * 4),
        ("covariance", ctypes.c_double * 16),
        ("process", ctypes.c_double * 4),
        ("noise", ctypes.c_double * 2),
    ]


system = tn.load_system("qube-servo2-memory")
values = {name: np.float64(value) for name, value in qube_servo2_twin.TWIN_VALUES.items()}
device = tn.compiled_step(tn.discretise(system.model(values), 0.01, substeps=10))


def swing_up(*, feedback):
    """States of the device, what the encoders read, what the filter estimates, the voltage."""
    rng = np.random.default_rng(1)
    estimate = ctypes.byref(held := Estimate())
    start, process, noise = [0.01, 0.01, 0.1, 0.1], [1e-3, 1e-3, 0.3, 0.3], [2e-3, 2e-3]
    C.model_estimate_init(estimate, real(hanging), real(start), real(process), real(noise))
    true, rows = np.array([*hanging, 0.0]), []  # the last state is the cable's memory
    for x, u, gain in zip(plan, feed, gains, strict=True):
        count = qube_servo2_twin.COUNT
        read = np.round(true[:2] / count) * count + rng.normal(0, 1e-3, 2)
        C.model_estimate_correct(estimate, real(read))
        applied = float(np.clip(u - feedback * gain @ (held.x - x), -10, 10))
        rows.append((true[:4], read, np.array(held.x), [applied]))
        C.model_estimate_predict(estimate, real(applied))
        true = device(true, np.array([applied]))
    return [np.array(column) for column in zip(*rows, strict=True)]


with_feedback, without = swing_up(feedback=True), swing_up(feedback=False)
for name, run in (("with feedback", with_feedback), ("plan alone", without)):
    last = abs(run[0][-100:, 1]).max()
    print(f"{name:13}: in the last second alpha is at most {last:.3f} rad from upright")

# %% alt="The swing-up. With feedback theta and alpha follow the plan, and alpha stays at zero, upright, from 1.5 seconds on. With the plan's voltage alone alpha leaves the plan after about a second and falls over. Below, the voltages, at most 8 volts."
t = 0.01 * np.arange(len(plan))
figure, panels = plt.subplots(3, 1, figsize=(7, 5.4), sharex=True, layout="constrained")
for j, (axes, name) in enumerate(zip(panels, ("theta", "alpha"), strict=False)):
    axes.plot(t, plan[:, j], color="0.6", lw=3, label="plan")
    axes.plot(t, with_feedback[0][:, j], color="tab:blue", label="with feedback")
    axes.plot(t, without[0][:, j], "--", color="tab:red", label="plan alone")
    axes.set_ylabel(f"{name} [rad]")
panels[2].step(t, feed, where="post", color="0.6", lw=3)
panels[2].step(t, with_feedback[3][:, 0], where="post", color="tab:blue")
panels[2].set_ylabel("voltage [V]")
panels[2].set_xlabel("time [s]")
panels[0].legend(frameon=False, ncols=3)
plt.show()

# %% [markdown]
# With the planned voltage alone, the pendulum follows the plan for about the first second and then falls. With
# feedback it stays upright.
#
# How accurate are the velocities of the filter? A simple alternative is the difference of two readings, divided by
# the sampling period. The next figure shows the errors of both.

# %% alt="Errors of the velocity of alpha. That of the difference of readings reaches almost two radians per second during the swing and scatters by some tenths afterwards. That of the filter stays below half a radian per second and scatters less."
true, read, estimated, _ = with_feedback
difference = np.diff(read, axis=0, prepend=read[:1]) / 0.01
errors = {"difference of readings": difference - true[:, 2:], "filter": (estimated - true)[:, 2:]}

figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
for (name, error), colour in zip(errors.items(), ("tab:orange", "tab:blue"), strict=True):
    theta, alpha = np.sqrt(np.mean(error**2, axis=0))
    print(f"{name}: RMSE {theta:.2f} rad/s (theta), {alpha:.2f} rad/s (alpha)")
    axes.plot(t, error[:, 1], color=colour, lw=0.9, label=name)
axes.set_ylabel("error of alpha's velocity [rad/s]")
axes.set_xlabel("time [s]")
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# The RMSE of the filter's velocities is about a third of that of the differences.
#
# ## Where to go from here
#
# * Tune the filter on records of your device with `tn.kalman_filter`, the same filter in Python
#   ([Simulation](../reference/python.md#simulation)).
# * [Exports](../reference/export.md): the arguments of a step, speed and memory on a Cortex-M7, ONNX, JavaScript,
#   matrices for MATLAB.
# * [The publication retraced](publication.md): measurements of the apparatus that this twin simulates.
