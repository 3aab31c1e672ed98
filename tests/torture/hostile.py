"""Inputs that were made to do harm: formulas that are programs, names, links, robots, glitches."""

import re
import shutil
import time
import tomllib
import unicodedata
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import tustinnet as tn
from tustinnet.control.controllers import LinearFeedback
from tustinnet.control.estimator import ExtendedKalmanFilter
from tustinnet.control.lqr import lqr
from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError
from tustinnet.simulate.filtering import FilterNoise

from ..hostile_files import NAMES, WRITERS
from . import material, oracle
from .command import Job, done, others, run
from .report import Part

_CODE = (
    """("'", (lambda: __import__("os").system("touch {marker}"))(), "'")""",
    """__import__('os').system('touch {marker}')""",
    """"'" and where.__globals__["__builtins__"]["open"]("{marker}", "w") or "'\"""",
    """open("{marker}", "w")""",
)
_ROBOTS = (
    '<worldbody><replicate count="{n}" offset="0 0 1">{body}</replicate></worldbody>',
    '<asset><hfield name="h" nrow="{n}" ncol="{n}" size="1 1 1 1"/></asset>'
    "<worldbody>{body}</worldbody>",
    '<include file="{path}"/><worldbody>{body}</worldbody>',
    '<worldbody><body><include file="{path}"/></body>{body}</worldbody>',
    '<extension><plugin plugin="{path}"/></extension><worldbody>{body}</worldbody>',
    '<asset><mesh name="m" file="{path}"/></asset><worldbody>{body}</worldbody>',
)
_BODY = (
    '<body name="b"><joint name="j"/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/></body>'
)
_SLOW = ("learning-curve", "selection", "selection-from-the-start", "selection-on-a-cluster")
_PIDS = 400  # numbers of processes to come, under whose names links are planted


class Hostile:
    """Cases of each kind in turn, until the time is over.

    Args:
        place: the undamaged files; results are made beside them.
        seed: of the campaign.
    """

    def __init__(self, place: Path, seed: int) -> None:
        self.place, self.box, self.seed = place, place / "hostile", seed
        self.part = Part("hostile")
        self.jobs = [job for job in others(place) if job.name not in _SLOW]
        kinds: tuple[Callable[[Random], str], ...] = (
            self._formula,
            self._names,
            self._robot,
            self._link,
            self._glitches,
        )
        self.kinds = kinds

    def run(self, seconds: float, cases: int) -> Part:
        """Cases until the time is over or so many are done."""
        end, number = time.monotonic() + seconds, 0
        counts = dict.fromkeys((kind.__name__[1:] for kind in self.kinds), 0)
        while number < cases and time.monotonic() < end:
            kind = self.kinds[number % len(self.kinds)]
            shutil.rmtree(self.box, ignore_errors=True)
            self.box.mkdir()
            random = Random(f"hostile {self.seed} {number}")
            outcome, told = oracle.judged(partial(kind, random))
            again = f"--parts hostile --seed {self.seed} --cases {number + 1}"
            self.part.count(outcome, f"{kind.__name__[1:]}: {told}", again)
            counts[kind.__name__[1:]] += 1
            number += 1
        self.part.notes.append(", ".join(f"{n} of {kind}" for kind, n in counts.items()))
        return self.part

    def _formula(self, random: Random) -> str:
        """An MDF file with code in a conversion somewhere, or behind others."""
        from asammdf import MDF, Signal
        from asammdf.blocks.conversion_utils import from_dict

        marker, version = self.box / "marker", random.choice(("3.30", "4.00", "4.10"))
        conversion: Any = {"formula": random.choice(_CODE).format(marker=marker)}
        if version >= "4":
            conversion = from_dict(conversion)
            for _ in range(random.randrange(4)):
                conversion = from_dict(
                    {"val_0": random.randrange(9), "text_0": b"n/a", "default_addr": conversion}
                )
        t = np.arange(0, 1, 0.01)
        path = self.box / f"log.{'mf4' if version >= '4' else 'mdf'}"
        name = random.choice(("u", "CAN_DataFrame.ID", "CAN_DataFrame.BusChannel", "LIN_Frame.ID"))
        with MDF(version=version) as file:
            channel = Signal(np.arange(100, dtype="u1"), t, name=name, conversion=conversion)
            file.append([Signal(np.sin(t), t, name="angle", unit="rad"), channel])
            if version >= "4" and random.random() < 0.3:
                block: Any = file.groups[0].channels[0]
                block.conversion = conversion
            file.save(path, overwrite=True)
        columns = read_columns(path)
        for column in columns.names:
            np.asarray(columns[column])
        oracle.require(not marker.exists(), "code of a file was run")
        oracle.require(any(n.endswith(name) for n in columns.others), "a formula is not named")
        return "accepted"

    def _names(self, random: Random) -> str:
        """Names in a log, through `init` and `inspect`."""
        folder = self.box / "logs"
        folder.mkdir()
        while not list(folder.rglob("log.*")) and not (folder / "meta").exists():
            with suppress(Exception):  # names that the library of a format does not write
                random.choice(WRITERS)(folder, random.sample(NAMES, 3))
        for command in (("init", str(folder), "--yes"), ("inspect", str(folder))):
            ended = run(command, {})
            ended.require_told()
            for text in (ended.out, re.sub(r"(?m)^peak .*$", "", ended.err)):
                odd = {c for c in text if unicodedata.category(c) in ("Cc", "Cf", "Co", "Cs")}
                oracle.require(odd <= {"\n", "\r"}, f"{command[0]} prints {sorted(odd)}")
        card = folder / "dataset.toml"
        if card.exists():
            keys = {*tomllib.loads(card.read_text(encoding="utf-8"))}
            known = {"name", "dt", "assumed", "time", "coordinates", "inputs", "splits", "format"}
            oracle.require(keys <= known, f"keys {keys - known} in a card")
        return "accepted"

    def _robot(self, random: Random) -> str:
        """A robot that takes much, or leads to another file."""
        path = self.box / "robot.xml"
        (self.box.parent / "outside.xml").write_text(f"<mujoco>{_BODY}</mujoco>")
        elsewhere = random.choice(("/etc/passwd", "../outside.xml", "robot.xml", "/dev/zero", "."))
        form = random.choice(_ROBOTS)
        n = 10 ** random.randrange(3, 9)
        body = form.format(n=n, path=elsewhere, body=_BODY)
        path.write_text(f"<mujoco>{body}</mujoco>")
        try:
            tn.load_robot(path)
        except InputError as error:
            oracle.require("root:" not in str(error), "the text of another file")
            raise
        oracle.require("include" not in form, "another file was included")
        return "accepted"

    def _link(self, random: Random) -> str:
        """A verb that writes into a folder in which links are planted."""
        job: Job = random.choice(self.jobs)
        clean, out, victim = self.box / "clean" / "run", self.box / "run", self.box / "victim"
        victim.write_text("precious")
        clean.parent.mkdir()
        job.prepare(clean)
        done(job.command(clean))
        job.prepare(out)
        out.mkdir(exist_ok=True)
        last = int(Path("/proc/loadavg").read_text().split()[-1])
        for file in clean.rglob("*"):
            place = out / file.relative_to(clean)
            if not file.is_file():
                continue
            place.parent.mkdir(parents=True, exist_ok=True)
            for number in range(last, last + _PIDS):
                (place.parent / f".{place.name}.{number}.part").symlink_to(victim)
        ended = run(job.command(out), {})
        ended.require_told()
        oracle.require(victim.read_text() == "precious", f"{job.name} wrote through a link")
        return "accepted"

    def _glitches(self, random: Random) -> str:
        """Wrong samples of an encoder, through a filter and a controller in closed loop."""
        model = material.physics()
        limits = {"torque": (-2.0, 2.0)}
        feedback = LinearFeedback(lqr(model, np.zeros(2), np.zeros(1), limits=limits))
        noise = FilterNoise(np.array([0.01, 1.0]), np.full(2, 1e-3), np.array([1e-3]))
        estimator = ExtendedKalmanFilter(model, noise)
        step, x, u = tn.compiled_step(model), np.array([0.3, 0.0]), np.zeros(1)
        wrong = (np.nan, np.inf, -np.inf, 1e300, 3.0, -7.5, 0.1)
        feedback.reset()
        estimate = estimator.reset(x[:1])
        for k in range(2000):
            u = feedback.inputs(k, estimate)
            oracle.require(bool(np.isfinite(u).all() and (np.abs(u) <= 2.0).all()), f"input {u}")
            x = step(x, u)
            is_wrong = k < 1500 and random.random() < 0.2
            y = np.array([random.choice(wrong)]) if is_wrong else x[:1]
            estimate = estimator.update(y, u)
        oracle.require(not estimator.is_lost and abs(x[0]) < 0.05, f"ends at {x}")
        return "accepted"
