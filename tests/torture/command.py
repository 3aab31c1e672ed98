"""Runs the command as a child process, and says what must hold however it ends."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import material
from .oracle import require

_CHILD = Path(__file__).with_name("child.py")
_LONGEST = 180.0  # seconds that a small run may take


@dataclass(frozen=True)
class Job:
    """A fit or a cross-validation that is disturbed.

    Attributes:
        name: what it goes by.
        arguments: of the command, without `--out`.
        again: the option with which it is started again.
    """

    name: str
    arguments: tuple[str, ...]
    again: str

    def command(self, out: Path, *more: str) -> tuple[str, ...]:
        """What is run."""
        return (*self.arguments, "--out", str(out), "--quiet", *more)


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


def jobs(place: Path) -> dict[str, Job]:
    """A training of every family, an identification, a cross-validation."""
    logs, system = str(place / "logs"), str(place / "pendulum.py")
    found = []
    for kind in material.KINDS:
        recipe = place / f"{kind}.toml"
        recipe.write_text(material.recipe(kind))
        more = ("--set", "stages.*.epochs=12", "--seeds", "2")
        if kind == "hybrid":
            more += ("--physics", str(place / "euler-lagrange.safetensors"), "--system", system)
        found.append(Job(kind, ("fit", logs, "--recipe", str(recipe), *more), "--resume"))
    grey = ("--recipe", "grey", "--system", system, "--set", "search.initial=anchored")
    found.append(Job("identification", ("fit", logs, *grey), "--overwrite"))
    folds = ("--recipe", str(place / "tustin-net.toml"), "--set", "stages.*.epochs=1")
    found.append(
        Job("cross-validate", ("cross-validate", logs, *folds, "--folds", "3"), "--overwrite")
    )
    return {job.name: job for job in found}


def start(arguments: tuple[str, ...], asked: dict[str, Any], **more: Any) -> subprocess.Popen[str]:
    """Starts the command; `asked` is what `child` is to do, `more` goes to `Popen`."""
    env = {**os.environ, "JAX_PLATFORMS": "cpu", "TORTURE": json.dumps(asked)}
    env |= more.pop("env", {})
    return subprocess.Popen(
        [sys.executable, str(_CHILD), *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace", env=env,
        **more,
    )  # fmt: skip


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
