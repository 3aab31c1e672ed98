"""How quick and how large exported controllers are: a period of controller and filter in C.

python benchmarks/control_code.py

The feedback holds the rotary pendulum upright; the plan has 300 periods with feedback along it.
Predictive control begins with either, and looks 20 periods ahead. An arm of six joints follows a
motion of 250 periods by computed torque, and by a plan with feedback.
Times are medians over 61 rounds of 300 periods, in which device and encoders take no part. Sizes on
a Cortex-M7 are told where arm-none-eabi-gcc is.
"""

import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from export import CORTEX

import tustinnet as tn
import tustinnet.control as tc
from tustinnet.control.computed_torque import smooth_motion
from tustinnet.report.tables import Table
from tustinnet.simulate.filtering import FilterNoise
from tustinnet.systems.qube_servo2 import SYSTEM, WITH_MEMORY
from tustinnet.systems.qube_servo2_twin import COUNT

PERIOD, STEPS, AHEAD = 0.01, 300, 20
ARM_PERIOD, ARM_STEPS = 0.008, 250
FLAGS = ("-O2", "-O2 -DMODEL_FLOAT", "-O3 -march=native")
SOURCES = ["controller.c", "estimator.c", "model.c"]
DEVIATIONS = {"theta": 1.0, "alpha": 0.5, "der_theta": 10.0, "der_alpha": 10.0, "voltage": 5.0}
TIMER = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "controller.h"
#include "estimator.h"
enum { ROUNDS = 61, STEPS = 300 };
static int order(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}
int main(void)
{
    static double us[3][ROUNDS];
    for (int r = 0; r < ROUNDS; r++)
        for (int part = 0; part < 3; part++) {
            estimator e;
            controller c;
            model_real y[MODEL_POSITIONS] = {0}, u[CONTROLLER_INPUTS] = {0};
            struct timespec a, b;
            estimator_reset(&e, y);
            controller_reset(&c);
            clock_gettime(CLOCK_MONOTONIC, &a);
            for (int k = 0; k < STEPS; k++) {
                if (part != 1)
                    controller_inputs(&c, e.x, u);
                if (part != 0)
                    estimator_update(&e, y, u);
            }
            clock_gettime(CLOCK_MONOTONIC, &b);
            us[part][r] = ((double)(b.tv_sec - a.tv_sec) * 1e6
                           + (double)(b.tv_nsec - a.tv_nsec) / 1e3) / STEPS;
        }
    for (int part = 0; part < 3; part++) {
        qsort(us[part], ROUNDS, sizeof(double), order);
        printf("%.3f ", us[part][ROUNDS / 2]);
    }
    return 0;
}
"""
BARE = """
#include "controller.h"
#include "estimator.h"
controller c;
estimator e;
model_real y[MODEL_POSITIONS], u[CONTROLLER_INPUTS];
int main(void)
{
    estimator_reset(&e, y);
    controller_reset(&c);
    for (;;) {
        controller_inputs(&c, e.x, u);
        estimator_update(&e, y, u);
    }
}
"""


def pendulum(system: tn.LagrangianSystem, substeps: int) -> tn.Model:
    """The rotary pendulum with nominal values, its encoders and the limits of its voltage."""
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    model = tn.discretise(system.model(values), PERIOD, substeps)
    channels = model.channels
    return replace(
        model,
        channels=replace(
            channels,
            coordinates=tuple(replace(c, resolution=COUNT) for c in channels.coordinates),
            inputs=tuple(replace(i, limits=(-10.0, 10.0)) for i in channels.inputs),
        ),
    )


def arm() -> tn.Model:
    """An arm of six joints of the size of a person's, with friction and encoders."""
    parts = ['<robot name="arm"><link name="base"/>']
    lengths = (0.2, 0.5, 0.4, 0.1, 0.1, 0.1)
    masses = (8.0, 12.0, 6.0, 2.0, 2.0, 0.5)
    for i, (length, mass, axis) in enumerate(zip(lengths, masses, "zyyyzy", strict=True)):
        direction = " ".join(str(int(name == axis)) for name in "xyz")
        wide, thin = mass * length**2 / 8, mass * length**2 / 20
        parent = f"link{i - 1}" if i else "base"
        parts.append(
            f'<link name="link{i}"><inertial><origin xyz="0.01 0.02 {length / 2}"/>'
            f'<mass value="{mass}"/><inertia ixx="{wide}" iyy="{wide}" izz="{thin}" ixy="0" '
            f'ixz="0" iyz="0"/></inertial></link><joint name="joint{i}" type="revolute">'
            f'<origin xyz="0 0.05 {lengths[i - 1] if i else 0.1}"/><parent link="{parent}"/>'
            f'<child link="link{i}"/><axis xyz="{direction}"/><dynamics damping="3" friction="2"/>'
            '<limit lower="-3" upper="3" effort="150" velocity="4"/></joint>'
        )
    with tempfile.TemporaryDirectory() as place:
        (file := Path(place) / "arm.urdf").write_text("".join([*parts, "</robot>"]))
        system = tn.load_robot(file)
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    values |= {f"joint{i}.armature": jnp.asarray(0.5) for i in range(6)}
    values |= {f"joint{i}.coulomb_speed": jnp.asarray(0.1) for i in range(6)}
    model = tn.discretise(system.model(values), ARM_PERIOD)
    coordinates = tuple(replace(c, resolution=5e-5) for c in model.channels.coordinates)
    inputs = tuple(replace(i, limits=(-150.0, 150.0)) for i in model.channels.inputs)
    return replace(model, channels=replace(model.channels, coordinates=coordinates, inputs=inputs))


def arm_controllers(model: tn.Model) -> dict[str, tc.Tracking]:
    """Computed torque along a motion of 250 periods, and feedback along the same plan."""
    names = [c.name for c in model.channels.coordinates]
    ends = np.array([0.0, -1.0, 1.2, -0.8, 0.3, 0.0]), np.array([0.5, -0.5, 1.7, -0.3, 0.8, 0.5])
    motion = smooth_motion(*ends, ARM_STEPS, ARM_PERIOD)
    point = tc.find_equilibrium(model, dict(zip(names, ends[1].tolist(), strict=True)))
    feedback = tc.lqr(model, point.x, point.u)
    by_torque = tc.computed_torque(model, motion, feedback)
    by_feedback = tc.Tracking(by_torque.plan, np.tile(feedback.gain, (ARM_STEPS, 1, 1)), feedback)
    return {"computed torque": by_torque, "plan": by_feedback}


def controllers(model: tn.Model) -> dict[str, tc.Feedback | tc.Tracking | tc.Mpc]:
    """The feedback, a plan from beside the goal with feedback along it, and both looking ahead."""
    x0, u0 = np.zeros(model.state_size), np.zeros(1)
    feedback = tc.lqr(model, x0, u0, deviations=DEVIATIONS)
    step, states, inputs = tn.compiled_step(model), [x0 + 0.1 * (np.arange(len(x0)) < 2)], []
    for _ in range(STEPS):
        inputs.append(np.clip(-feedback.gain @ states[-1], -10, 10))
        states.append(step(states[-1], inputs[-1]))
    plan = tc.Plan(
        np.array(states),
        np.array(inputs),
        0.0,
        converged=True,
        reached=True,
        iterations=0,
        dt=PERIOD,
        goal=x0,
        before=u0,
    )
    gains = np.tile(feedback.gain, (STEPS, 1, 1))
    along = tc.Tracking(plan, gains, feedback)
    ahead = {"steps": AHEAD, "deviations": DEVIATIONS}
    return {
        "feedback": feedback,
        "plan": along,
        "predictive": tc.Mpc(model, feedback, **ahead),
        "predictive, plan": tc.Mpc(model, along, **ahead),
    }


def run(command: list[str], folder: Path) -> str:
    """What a command prints."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
    return done.stdout


def times(folder: Path, *flags: str) -> list[str]:
    """Microseconds of the controller, the filter, and both in a period."""
    (folder / "timer.c").write_text(TIMER)
    run(["gcc", "-std=c99", *flags, *SOURCES, "timer.c", "-lm", "-o", "timer"], folder)
    return run(["./timer"], folder).split()


def text(folder: Path) -> str:
    """Bytes of code and constants of model, estimator and controller, here by -O2."""
    run(["gcc", "-std=c99", "-O2", "-c", *SOURCES], folder)
    lines = run(["size", *(s.replace(".c", ".o") for s in SOURCES)], folder).splitlines()[1:]
    return str(sum(int(line.split()[0]) for line in lines))


def sizes(folder: Path) -> list[str]:
    """Flash, constants in it, largest stack of a call, and what the structures take [bytes]."""
    (folder / "bare.c").write_text(BARE)
    flags = CORTEX.split()
    run(["arm-none-eabi-gcc", *flags, "-c", *SOURCES, "bare.c"], folder)
    objects = [source.replace(".c", ".o") for source in (*SOURCES, "bare.c")]
    run(
        [
            "arm-none-eabi-gcc",
            *flags,
            "-nostartfiles",
            "-Wl,--gc-sections",
            "-Wl,-e,main",
            *objects,
            "-lm",
            "-lc",
            "-lgcc",
            "--specs=nosys.specs",
            "-o",
            "program",
        ],
        folder,
    )
    rows = [
        line.split() for line in run(["arm-none-eabi-size", "-A", "program"], folder).split("\n")
    ]
    sections = {r[0]: int(r[1]) for r in rows if len(r) == 3 and r[1].isdigit()}
    flash = sum(sections.get(name, 0) for name in (".text", ".rodata", ".data", ".ARM.exidx"))
    stack = {}
    for source in SOURCES:
        for line in (folder / source.replace(".c", ".su")).read_text().splitlines():
            place, size, _ = line.split("\t")
            stack[place.rsplit(":", 1)[1]] = int(size)
    # the deepest chain of calls: update, predict, linearise, and what the model's code calls
    chain = ("estimator_update", "model_estimate_predict", "model_linearise")
    inner = sum(n for name, n in stack.items() if name.startswith("linearised"))
    deepest = sum(stack.get(name, 0) for name in chain) + inner
    return [str(n) for n in (flash, sections.get(".rodata", 0), deepest, sections.get(".bss", 0))]


def main() -> None:
    """Both tables."""
    speed, space = [], []
    models = {
        "grey box": pendulum(SYSTEM, 1),
        "grey box with memory": pendulum(WITH_MEMORY, 2),
        "arm of six joints": arm(),
    }
    for title, model in models.items():
        n_x, n_q = model.state_size, model.channels.n_q
        noise = FilterNoise(np.full(n_x, 0.01), np.full(n_x, 1e-3), np.full(n_q, COUNT / 3.5))
        made = arm_controllers(model) if n_q == 6 else controllers(model)
        for name, controller in made.items():
            with tempfile.TemporaryDirectory() as place:
                folder = Path(place)
                tc.export_controller(model, controller, noise, folder)
                written = sum(len((folder / source).read_bytes()) for source in SOURCES) / 1000
                size = text(folder)
                speed += [
                    [title, name, f"{written:.0f}", flags, *times(folder, *flags.split()), size]
                    for flags in FLAGS
                ]
                if shutil.which("arm-none-eabi-gcc"):
                    space.append([title, name, *sizes(folder)])
    columns = ["controller us", "filter us", "both us", "-O2 [bytes]"]
    headings = ["model", "controller", "C [kB]", "flags", *columns]
    print(Table(headings, speed, title="A period in C, medians [us]").markdown())
    title = "Cortex-M7, float, -O2 [bytes]; stack without libm's"
    headings = ["model", "controller", "flash", "constants", "stack", "structures"]
    print(Table(headings, space, title=title).markdown())


if __name__ == "__main__":
    main()
