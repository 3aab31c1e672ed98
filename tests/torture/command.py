"""Runs the command as a child process, and says what must hold however it ends."""

import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import material
from .oracle import require

_CHILD = Path(__file__).with_name("child.py")
_LONGEST = 600.0  # seconds that a small run may take, beside other work


_OUT = "{out}"  # in arguments: the folder of what is written


@dataclass(frozen=True)
class Job:
    """A command that is disturbed while it writes.

    Attributes:
        name: what it goes by; in names of folders, so that a space would be quoted in results.
        arguments: of the command; `{out}` in them is the folder of what it writes.
        again: the options with which it is started again.
        earlier: the arguments of a command whose results are there before, and are replaced.
        beside: a folder whose files are there before, and are kept.
    """

    name: str
    arguments: tuple[str, ...]
    again: tuple[str, ...]
    earlier: tuple[str, ...] = ()
    beside: Path | None = None

    def command(self, out: Path, *more: str) -> tuple[str, ...]:
        """What is run."""
        return (*(word.replace(_OUT, str(out)) for word in self.arguments), *more)

    def prepare(self, out: Path) -> None:
        """Makes the folder with what is there before."""
        if self.beside is not None:
            shutil.copytree(self.beside, out, dirs_exist_ok=True)
        if self.earlier:
            out.mkdir(exist_ok=True)
            done(tuple(word.replace(_OUT, str(out)) for word in self.earlier))


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str
    peak: int = field(default=0)

    def require_told(self) -> None:
        """No traceback; where it failed, one line says why."""
        require("Traceback" not in self.err, f"a traceback: {self.last_line}")
        require(self.code >= 0, f"ended by signal {-self.code}")
        if self.code not in (0, 130, 143):
            lines = [line for line in self.err.splitlines() if line.startswith("error: ")]
            require(len(lines) == 1, f"{len(lines)} lines `error: ...`, exit code {self.code}")

    @property
    def last_line(self) -> str:
        """The last line on standard error."""
        lines = [x for x in self.err.splitlines() if x.strip() and not x.startswith("peak ")]
        return lines[-1][:120] if lines else ""


_TO_FOLDER = ("--out", _OUT, "--quiet")
_REPLACE = ("--overwrite",)


def fits(place: Path) -> list[Job]:
    """A training of every family, an identification, a cross-validation."""
    logs, system = str(place / "logs"), str(place / "pendulum.py")
    found = []
    for kind in material.KINDS:
        recipe = place / f"{kind}.toml"
        recipe.write_text(material.recipe(kind))
        more = ("--set", "stages.*.epochs=12", "--seeds", "2")
        if kind == "hybrid":
            more += ("--physics", str(place / "euler-lagrange.safetensors"), "--system", system)
        arguments = ("fit", logs, "--recipe", str(recipe), *more, *_TO_FOLDER)
        found.append(Job(kind, arguments, ("--resume",)))
    grey = ("--recipe", "grey", "--system", system, "--set", "search.initial=anchored")
    found.append(Job("identification", ("fit", logs, *grey, *_TO_FOLDER), _REPLACE))
    folds = ("--recipe", str(place / "tustin-net.toml"), "--set", "stages.*.epochs=1")
    arguments = ("cross-validate", logs, *folds, "--folds", "3", *_TO_FOLDER)
    found.append(Job("cross-validate", arguments, _REPLACE))
    return found


def others(place: Path) -> list[Job]:
    """A selection, and every other verb that writes; most of them replace earlier results."""
    logs, published = str(place / "logs"), str(place / "published")
    for name, text in material.SELECTION.items():
        (place / name).write_text(text)
    network, other = str(place / "run" / "model.safetensors"), str(place / "linear.safetensors")
    table = ("--recipe", str(place / "tustin-net-short.toml"), "--records", "2,3", "--draws", "2")
    bare = place / "bare"
    bare.mkdir(exist_ok=True)
    for file in ("fall1.csv", "fall2.csv", "noise1.csv"):
        shutil.copy(place / "logs" / file, bare)
    material.write_published(place / "published")

    selection = ("fit", logs, "--plan", str(place / "plan.toml"), *_TO_FOLDER)
    has_ray = importlib.util.find_spec("ray") is not None
    on_cluster = [Job("selection-on-a-cluster", (*selection, "--cluster", "auto"), ("--resume",))]

    limits = ("--limits", "torque=-20:20", "--starts", "2", "--out", _OUT)
    identified = str(place / "euler-lagrange.safetensors")
    control = ("control", identified, "--system", str(place / "pendulum.py"), *limits)

    def replacing(name: str, target: str, *arguments: str, of: str = network) -> Job:
        """A verb that replaces what it made of another model."""
        verb, option = arguments[0], "--out"
        if target.startswith("figures"):
            option = "--figure" if target.endswith(".png") else "--figures"
        more = (*arguments[1:], option, f"{_OUT}/{target}" if target else _OUT)
        earlier = other if of == network else network
        return Job(name, (verb, of, *more, *_REPLACE), (), (verb, earlier, *more))

    return [
        Job("selection", selection, ("--resume",)),
        Job("selection-from-the-start", selection, _REPLACE),
        *(on_cluster if has_ray else []),
        Job(
            "learning-curve",
            ("cross-validate", logs, *table, "--records", "all", "--out", _OUT),
            _REPLACE,
        ),
        Job("reproduce", ("reproduce", "--data", published, "--models", "linear", *_TO_FOLDER), ()),
        Job("init", ("init", _OUT, "--yes"), _REPLACE, beside=bare),
        replacing("report", "page.html", "report", logs),
        Job(
            "control",
            (*control, "--at", "angle=0.5", *_REPLACE),
            (),
            (*control, "--at", "angle=0.4"),
        ),
        replacing("export", "", "export", "--to", "c"),
        replacing("export-mat", "", "export", "--to", "mat,js"),
        replacing("simulate", "", "simulate", logs),
        replacing("evaluate", "figures", "evaluate", logs, "--residuals"),
        Job(
            "several", ("evaluate", network, other, logs, "--figures", f"{_OUT}/figures"), _REPLACE
        ),
        Job("inspect", ("inspect", logs, "--figure", f"{_OUT}/figure.png"), _REPLACE),
    ]


def start(arguments: tuple[str, ...], asked: dict[str, Any], **more: Any) -> subprocess.Popen[str]:
    """Starts the command; `asked` is what `child` is to do.

    `by` are words before it, as of a program that changes the user; all `more` goes to `Popen`.
    """
    env = {**os.environ, "JAX_PLATFORMS": "cpu", "TORTURE": json.dumps(asked)}
    env |= more.pop("env", {})
    return subprocess.Popen(
        [*more.pop("by", ()), sys.executable, str(_CHILD), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env=env,
        **more,
    )


def finish(process: subprocess.Popen[str], seconds: float = _LONGEST) -> Ended:
    """Waits for its end; one that takes longer is killed, which is a finding."""
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        require(False, f"took more than {seconds:.0f} s")
        raise
    peak = re.search(r"^peak (\d+) MiB$", err, re.MULTILINE)
    return Ended(process.returncode, out, err, int(peak[1]) if peak else 0)


def run(arguments: tuple[str, ...], asked: dict[str, Any], **more: Any) -> Ended:
    """Runs the command to its end."""
    return finish(start(arguments, asked, **more))


def done(arguments: tuple[str, ...], **more: Any) -> Ended:
    """Runs the command, which must succeed."""
    ended = run(arguments, {}, **more)
    ended.require_told()
    require(ended.code == 0, f"failed: {ended.last_line}")
    return ended
