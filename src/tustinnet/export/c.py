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
from tustinnet.export.target import Files, Stepper, Target, NotRunnable, Vector

_TEMPLATES = Path(__file__).parent / "templates"
_SHARED = ("-std=c99", "-O1", "-fPIC", "-shared")


class C(Target):
    """C99 without allocation, for microcontrollers and whatever else compiles C."""

    name = "c"

    def files(self, source: Source) -> Files:
        """`model.h`, `model.c`, `estimate.c`, `example.c`, `README.md`."""
        return {
            **make_model_files(source),
            "estimate.c": template("estimate.c"),
            "example.c": template("example.c"),
            "README.md": _readme(source),
        }

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by `model.c`, compiled by `$CC` or gcc."""
        with tempfile.TemporaryDirectory() as place:
            library = Path(place) / "model.so"
            compile_c([folder / "model.c"], library, _SHARED)
            return library_step(library, source.n_x)


def template(name: str, **values: object) -> str:
    """A text of this package, with `@name@` replaced."""
    text = (_TEMPLATES / name).read_text(encoding="utf-8")
    for key, value in values.items():
        text = text.replace(f"@{key}@", str(value))
    return text


def make_model_files(source: Source, *, linearised: bool = True) -> dict[str, str]:
    """`model.h` and `model.c`.

    Args:
        source: the model.
        linearised: whether `model_linearise` is in it, and what a filter needs is declared.
    """
    code = Code()
    code.add("step", source.step)
    if linearised:
        code.add("linearised", source.linearised)
    more = [template(name) if linearised else "" for name in ("estimate.h", "linearise.c")]
    header = template(
        "model.h", states=source.n_x, positions=source.channels.n_q, inputs=source.n_w,
        period=float(source.channels.dt), more=more[0],
    )  # fmt: skip
    return {"model.h": header, "model.c": template("model.c", code=code.text()) + more[1]}


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
        NotRunnable: there is no compiler, or it does not take them.
    """
    command = [*find_compiler(), *flags, *(s.name for s in sources), "-o", str(to), "-lm"]
    done = subprocess.run(
        command, cwd=sources[0].parent, capture_output=True, text=True, errors="replace",
        check=False,
    )  # fmt: skip
    if done.returncode:
        told = (done.stderr.strip().splitlines() or ["without a word"])[0]
        raise NotRunnable(f"{command[0]} does not compile it: {told}")


def library_step(library: Path, n_x: int) -> Stepper:
    """The step of a shared library that has `model_init` and `model_step`, in double precision."""
    functions = ctypes.CDLL(str(library))
    state = np.zeros(n_x)  # of the same layout as `model_state`
    pointer = ctypes.c_void_p

    def at(values: np.ndarray) -> ctypes.c_void_p:
        return pointer(values.ctypes.data)

    def step(x: Vector, u: Vector) -> Vector:
        x, u = (np.ascontiguousarray(v, np.float64) for v in (x, u))
        functions.model_init(at(state), at(x))
        functions.model_step(at(state), at(u))
        return state.copy()

    return step


def _readme(source: Source) -> str:
    states = "\n".join(
        f"| `x[{i}]` | {_shown(name)} | {_shown(unit)} |"
        for i, (name, unit) in enumerate(zip(source.states, source.units, strict=True))
    )
    rows = [
        f"| `u[{i}]` | {_shown(name)} | {_shown(unit)} | {when} |"
        for i, (name, unit, when) in enumerate(samples_of(source))
    ]
    return template(
        "readme.md", period=float(source.channels.dt), states=states,
        inputs="\n".join(rows) or "| none | | | |",
        notes="\n".join(f"- {note}" for note in source.notes) or "None.",
    )  # fmt: skip


def samples_of(source: Source) -> list[tuple[str, str, str]]:
    """Of each number that a step is given of the inputs: name, unit, which sample."""
    when = {0: "now", 1: "one sample later", -1: "one sample before"}
    return [
        (i.name, i.unit, when.get(at, f"{abs(at)} samples {'later' if at > 0 else 'before'}"))
        for at in source.input_layout.offsets
        for i in source.channels.inputs
    ]


def _shown(text: str) -> str:
    """Text in a cell of a table."""
    return text.replace("|", "\\|")


TARGET = C()
