"""How quick and how large exported models are.

python benchmarks/export.py [--emx PATH]

Step times in C are medians over 61 rounds; in a round every candidate steps 300 times, one after
the other, so that what else the machine does meets all. The plain loops do the 10,900 products of
the network and nothing else. CasADi's C generator is compared where CasADi is installed,
emx-onnx-cgen where `--emx` says where its command is and onnx is installed, sizes on a Cortex-M7
where arm-none-eabi-gcc is.
"""

import argparse
import contextlib
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp

import tustinnet as tn
from tustinnet.export.c import make_model_files
from tustinnet.export.source import Source, make_source
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.models.blocks import Scaling
from tustinnet.registry import TARGETS
from tustinnet.report.tables import Table
from tustinnet.systems.qube_servo2 import SYSTEM, WITH_MEMORY

FLAGS = {
    "-O2": ["-std=c99", "-O2"],
    "-O3 -march=native": ["-std=c99", "-O3", "-march=native"],
    "-O3 -march=native -ffp-contract=fast": [
        "-std=c99",
        "-O3",
        "-march=native",
        "-ffp-contract=fast",
    ],
}
CORTEX = "-std=c99 -O2 -mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard -ffunction-sections "
CORTEX += "-fdata-sections -fstack-usage -DMODEL_FLOAT"
TIMER = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
enum { ROUNDS = 61, STEPS = 300, STATES = @states@ };
typedef void step_function(double *x, const double *u);
extern step_function @names@;
static struct { const char *name; step_function *step; double ns[ROUNDS]; } all[] = { @table@ };
static int order(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}
int main(void)
{
    const int count = (int)(sizeof all / sizeof *all);
    for (int round = 0; round < ROUNDS; round++)
        for (int i = 0; i < count; i++) {
            double x[STATES] = {0.1}, u[1] = {0.5};
            struct timespec a, b;
            clock_gettime(CLOCK_MONOTONIC, &a);
            for (int k = 0; k < STEPS; k++) all[i].step(x, u);
            clock_gettime(CLOCK_MONOTONIC, &b);
            all[i].ns[round] = ((double)(b.tv_sec - a.tv_sec) * 1e9
                                + (double)(b.tv_nsec - a.tv_nsec)) / STEPS;
        }
    for (int i = 0; i < count; i++) {
        qsort(all[i].ns, ROUNDS, sizeof(double), order);
        printf("%s,%.1f,%.1f\\n", all[i].name, all[i].ns[ROUNDS / 2], all[i].ns[0]);
    }
    return 0;
}
"""
OURS = """
#include "model.h"
void ours(double *x, const double *u)
{
    model_state s;
    model_init(&s, x);
    model_step(&s, u);
    for (int i = 0; i < MODEL_STATES; i++) x[i] = s.x[i];
}
"""
PLAIN = """
static double w[10900], h[100], g[100];
static void columns(int m, int n, const double *restrict a, const double *restrict x,
                    double *restrict y)
{
    for (int i = 0; i < m; i++) y[i] = 0;
    for (int j = 0; j < n; j++) for (int i = 0; i < m; i++) y[i] += a[j * m + i] * x[j];
}
static void rows(int m, int n, const double *restrict a, const double *restrict x,
                 double *restrict y)
{
    for (int i = 0; i < m; i++) {
        double sum = 0;
        for (int j = 0; j < n; j++) sum += a[i * n + j] * x[j];
        y[i] = sum;
    }
}
#define LAYERS(f) double o[2]; f(100, 7, w, h, g); f(100, 100, w + 700, g, h); \\
    f(2, 100, w + 10700, h, o); x[0] += o[0]; h[0] = x[0] + u[0]
void plain_columns(double *x, const double *u) { LAYERS(columns); }
void plain_rows(double *x, const double *u) { LAYERS(rows); }
"""
CASADI = """
int step(const double **, double **, long long int *, double *, int);
void casadi(double *x, const double *u)
{
    static double w[20000];
    static long long int iw[2000];
    const double *arg[100] = {x, u};
    double next[@states@], *res[100] = {next};
    step(arg, res, iw, w, 0);
    for (int i = 0; i < @states@; i++) x[i] = next[i];
}
"""
EMX = """
void emx_model(const double x[][@states@], const double u[][1], double out[][@states@]);
void emx(double *x, const double *u)
{
    double out[1][@states@];
    emx_model((const double (*)[@states@])x, (const double (*)[1])u, out);
    for (int i = 0; i < @states@; i++) x[i] = out[0][i];
}
"""


def network() -> tn.TustinNet:
    """Layers 7-100-100-2: angles of the rotary pendulum as sine and cosine, rates, the voltage."""
    one = jnp.ones(2, jnp.float32)
    units = Scaling(jnp.zeros(0), jnp.zeros(0), 5 * one, one[:1], 30 * one, jnp.zeros(0))
    channels = tn.Channels(SYSTEM.coordinates, SYSTEM.inputs, 0.01)
    return random_tustin_net(channels, units, jax.random.key(0), hidden=(100, 100))


def grey_box() -> tn.Model:
    """The rotary pendulum with the cable's memory, nominal, two steps of Runge-Kutta a period."""
    values = {name: jnp.asarray(value) for name, value in WITH_MEMORY.nominal().items()}
    return tn.discretise(WITH_MEMORY.model(values), 0.01, 2)


class Bench:
    """One model and who steps it, in a folder."""

    def __init__(self, folder: Path, source: Source, emx: str | None, *, plain: bool) -> None:
        self.folder, self.source = folder, source
        self.names = ["ours"]
        for name, text in make_model_files(source).items():
            (folder / name).write_text(text)
        self._write("ours.c", OURS)
        if plain:
            self._write("plain.c", PLAIN)
            self.names += ["plain_columns", "plain_rows"]
        self._casadi()
        if emx:
            self._emx(emx)

    def _write(self, name: str, text: str) -> None:
        (self.folder / name).write_text(text.replace("@states@", str(self.source.n_x)))

    def _casadi(self) -> None:
        try:
            files = TARGETS["casadi"].files(self.source)
            import casadi
        except Exception as error:
            print(f"casadi: left out ({error})")
            return
        (self.folder / "step.casadi").write_bytes(bytes_of(files["step.casadi"]))
        function = casadi.Function.load(str(self.folder / "step.casadi"))
        with contextlib.chdir(self.folder):  # CasADi writes its C only where it is
            function.generate("casadi_step.c")
        self._write("casadi.c", CASADI)
        self.names.append("casadi")

    def _emx(self, command: str) -> None:
        try:
            files = TARGETS["onnx"].files(self.source)
        except Exception as error:
            print(f"emx-onnx-cgen: left out ({error})")
            return
        (self.folder / "step.onnx").write_bytes(bytes_of(files["step.onnx"]))
        done = subprocess.run(
            [
                command,
                "compile",
                "--large-weight-threshold",
                "0",
                "--large-temp-threshold",
                "0",
                "--restrict-arrays",
                "--input-dim",
                "batch=1",
                "step.onnx",
                "emx_step.c",
            ],
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            print(f"emx-onnx-cgen: left out ({done.stdout.strip().splitlines()[-1:]})")
            return
        text = (self.folder / "emx_step.c").read_text()
        (self.folder / "emx_step.c").write_text(re.sub(r"\bvoid model\(", "void emx_model(", text))
        self._write("emx.c", EMX)
        self.names.append("emx")

    def times(self, flags: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Median and smallest time of a step [ns], by candidate."""
        table = ", ".join(f'{{"{name}", {name}, {{0}}}}' for name in self.names)
        timer = TIMER.replace("@names@", ", ".join(self.names)).replace("@table@", table)
        self._write("timer.c", timer)
        sources = [p.name for p in self.folder.glob("*.c")]
        run(["gcc", *flags, "-w", *sources, "-lm", "-o", "timer"], self.folder)
        told = run(["./timer"], self.folder)
        rows = [line.split(",") for line in told.split()]
        return {name: (float(median), float(least)) for name, median, least in rows}

    def sizes(self) -> tuple[int, int, int]:
        """Flash of a program that only steps, of the constants in it, and stack [bytes]."""
        (self.folder / "main.c").write_text(
            '#include "model.h"\nmodel_state s; model_real u[MODEL_INPUTS + 1];\n'
            "int main(void) { model_init(&s, u); for (;;) model_step(&s, u); }\n"
        )
        flags = CORTEX.split()
        run(["arm-none-eabi-gcc", *flags, "-c", "model.c", "main.c"], self.folder)
        run(
            [
                "arm-none-eabi-gcc",
                *flags,
                "-nostartfiles",
                "-Wl,--gc-sections",
                "-Wl,-e,main",
                "model.o",
                "main.o",
                "-lm",
                "-lc",
                "-lgcc",
                "--specs=nosys.specs",
                "-o",
                "program",
            ],
            self.folder,
        )
        told = run(["arm-none-eabi-size", "-A", "program"], self.folder)
        sections = {
            p[0]: int(p[1])
            for p in map(str.split, told.splitlines())
            if len(p) == 3 and p[1].isdigit()
        }
        flash = sum(sections.get(name, 0) for name in (".text", ".rodata", ".data", ".ARM.exidx"))
        stacks = {}
        for line in (self.folder / "model.su").read_text().splitlines():
            place, size, _ = line.split("\t")
            stacks[place.rsplit(":", 1)[1]] = int(size)
        own = [n for name, n in stacks.items() if "linearise" not in name]
        return flash, sections.get(".rodata", 0), sum(own)


def bytes_of(content: bytes | str) -> bytes:
    """A file's content as bytes."""
    return content.encode() if isinstance(content, str) else content


def run(command: Sequence[str], folder: Path) -> str:
    """What a command prints."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
    return done.stdout


def main() -> None:
    """All tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--emx", help="the command of emx-onnx-cgen")
    args = parser.parse_args()
    models = {"network 7-100-100-2": network(), "grey box with memory": grey_box()}
    rows, sizes = [], []
    for title, model in models.items():
        with tempfile.TemporaryDirectory() as place:
            is_network = title.startswith("network")
            bench = Bench(Path(place), make_source(model), args.emx, plain=is_network)
            for name, flags in FLAGS.items():
                times = bench.times(flags)
                for who, (median, least) in times.items():
                    ratio = median / times["plain_columns" if is_network else "ours"][0]
                    rows.append([title, name, who, f"{median:.0f}", f"{least:.0f}", f"{ratio:.2f}"])
            if shutil.which("arm-none-eabi-gcc"):
                sizes.append([title, *map(str, bench.sizes())])
    compared = "to the plain loop by columns (network) or to ours"
    headings = ["model", "flags", "who", "median ns", "least ns", "ratio"]
    print(Table(headings, rows, title=f"A step in C, double; ratio {compared}").markdown())
    title = "Cortex-M7, float, -O2 [bytes]; stack without libm's"
    print(Table(["model", "flash", "constants", "stack"], sizes, title=title).markdown())
    fmu_times(models)


def fmu_times(models: dict[str, tn.Model]) -> None:
    """Seconds that FMUs of both versions take to be written and compiled."""
    rows = []
    for title, model in models.items():
        source = make_source(model)
        _ = source.step  # reading the model is part of every export
        started = time.perf_counter()
        files = TARGETS["fmu"].files(source)
        seconds = time.perf_counter() - started
        rows.append([title, f"{seconds:.2f}", str(sum(len(f) for f in files.values()))])
    print(Table(["model", "seconds", "bytes"], rows, title="Both FMUs, compiled").markdown())


if __name__ == "__main__":
    main()
