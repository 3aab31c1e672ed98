"""A model as C99: `model.h`, `model.c`, a Kalman filter, an example."""

import ctypes
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tustinnet.export.c_text import Code
from tustinnet.export.source import Source
from tustinnet.export.target import Files, NotRunnable, Stepper, Target, Vector
from tustinnet.export.words import fill_template
from tustinnet.simulate.filtering import GATE, LOST_AFTER

_SHARED = ("-std=c99", "-O1", "-fPIC", "-shared")


class C(Target):
    """C99 without allocation, for microcontrollers and other compilers of C."""

    name = "c"

    def files(self, source: Source) -> Files:
        """`model.h`, `model.c`, `estimate.c`, `example.c`, `README.md`."""
        return {
            **make_model_files(source),
            "estimate.c": make_filter_code("model.h"),
            "example.c": fill_template("example.c"),
            "README.md": _readme(source),
        }

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by `model.c`, compiled by `$CC` or gcc."""
        with tempfile.TemporaryDirectory() as build:
            library = Path(build) / "model.so"
            compile_c([folder / "model.c"], library, _SHARED)
            return library_step(library, source.n_x)


def make_model_files(
    source: Source,
    *,
    linearised: bool = True,
    parts: bool = False,
    lost_after: int = LOST_AFTER,
) -> dict[str, str]:
    """`model.h` and `model.c`.

    Args:
        source: the model.
        linearised: whether they have `model_linearise` and the declarations for a filter.
        parts: whether they have `model_advance`, of a model that `integrates`.
        lost_after: samples in a row without use after which an estimate of the filter is lost.
    """
    code = Code()
    code.add("step", source.step)
    if linearised:
        code.add("linearised", source.linearised)
        code.add("rest", source.rest)
    if parts:
        code.add("advance", source.part)
    header = fill_template(
        "model.h",
        states=source.n_x,
        positions=source.channels.n_q,
        inputs=source.n_w,
        period=float(source.channels.dt),
        more=(fill_template("advance.h") if parts else "")
        + (fill_template("estimate.h", lost_after=lost_after) if linearised else ""),
    )
    body = fill_template("model.c", code=code.text(), precision=fill_template("precision.c"))
    return {
        "model.h": header,
        "model.c": body
        + (fill_template("advance.c") if parts else "")
        + (fill_template("linearise.c") if linearised else ""),
    }


def make_filter_code(header: str, angular: Sequence[bool] = ()) -> str:
    """The C code of the extended Kalman filter that `model.h` declares.

    Args:
        header: the header that it includes.
        angular: for each position whether its innovation is wrapped to within half a turn; () for
            none of them.
    """
    innovation, helpers = "q[m] - e->state.x[m]", math_helpers(wrap=any(angular))
    angles = "Positions are not wrapped: an encoder that starts again from 0 has to be counted on."
    if any(angular):
        flags = ", ".join(str(int(is_angle)) for is_angle in angular)
        helpers += f"static const int angular[MODEL_POSITIONS] = {{{flags}}};\n"
        innovation = f"angular[m] ? wrapped({innovation}) : {innovation}"
        angles = "Angles are wrapped: whole turns between model and encoder do not count."
    return fill_template(
        "estimate.c",
        header=header,
        angles=angles,
        helpers=helpers,
        innovation=innovation,
        gate=GATE,
    )


def math_helpers(*, wrap: bool) -> str:
    """Macros of numbers in both precisions; on demand a function that wraps angles."""
    parts = ["#include <math.h>\n", fill_template("precision.c")]
    return "\n".join([*parts, fill_template("wrap.c")] if wrap else parts)


def find_compiler() -> list[str]:
    """The command that compiles C: `$CC`, or gcc.

    Raises:
        NotRunnable: there is none.
    """
    command = shlex.split(os.environ.get("CC", "")) or ["gcc"]
    if shutil.which(command[0]) is None:
        raise NotRunnable(f"not compiled, there is no {command[0]} here (set CC to a C compiler)")
    return command


def compile_c(sources: Sequence[Path], to: Path, flags: Sequence[str]) -> None:
    """Compiles C files of one folder, in that folder.

    Raises:
        NotRunnable: there is no compiler, or it reports an error.
    """
    command = [*find_compiler(), *flags, *(s.name for s in sources), "-o", str(to), "-lm"]
    process = subprocess.run(
        command,
        cwd=sources[0].parent,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    if process.returncode:
        error = (process.stderr.strip().splitlines() or ["without a message"])[0]
        raise NotRunnable(f"{command[0]} does not compile it: {error}")


def address(array: np.ndarray) -> ctypes.c_void_p:
    """Where the numbers of an array are, as functions in C take it."""
    return ctypes.c_void_p(array.ctypes.data)


def library_step(library: Path, n_x: int) -> Stepper:
    """The step of a shared library that has `model_init` and `model_step`, in double precision."""
    functions = ctypes.CDLL(str(library))
    state = np.zeros(n_x)  # of the same layout as `model_state`

    def step(x: Vector, u: Vector) -> Vector:
        x, u = (np.ascontiguousarray(v, np.float64) for v in (x, u))
        functions.model_init(address(state), address(x))
        functions.model_step(address(state), address(u))
        return state.copy()

    return step


def _readme(source: Source) -> str:
    """The text of `README.md`: tables of states and inputs."""
    states = [
        f"| `x[{i}]` | {markdown_cell(name)} | {markdown_cell(unit)} |"
        for i, (name, unit) in enumerate(zip(source.states, source.units, strict=True))
    ]
    inputs = []
    for k in source.input_layout.offsets:
        when = {0: "now", 1: "one sample later", -1: "one sample before"}.get(
            k, f"{abs(k)} samples {'later' if k > 0 else 'before'}"
        )
        inputs += [
            f"| `u[{len(inputs) + i}]` | {markdown_cell(channel.name)} "
            f"| {markdown_cell(channel.unit)} | {when} |"
            for i, channel in enumerate(source.channels.inputs)
        ]
    return fill_template(
        "readme.md",
        period=float(source.channels.dt),
        states="\n".join(states),
        inputs="\n".join(inputs) or "| none | | | |",
        notes="\n".join(f"- {note}" for note in source.notes) or "Nothing beyond this file.",
    )


def markdown_cell(text: str) -> str:
    """Text in a cell of a table in Markdown."""
    return text.replace("|", "\\|")


TARGET = C()
