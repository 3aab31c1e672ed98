"""Kills: whatever moment a run is killed at, started again it ends with the same bytes."""

import shutil
import signal
import subprocess
import time
from collections import Counter
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from random import Random
from threading import Lock

from . import oracle
from .command import Job, done, finish, fits, others, start
from .report import Part

_SLOW = 0.02  # seconds that each half of a write takes longer
_STOPPING = 30.0  # seconds that a run may take to end when it is asked to


class Kills:
    """Runs that are killed, and what they should have become.

    Args:
        place: the undamaged files; runs are made beside them.
        seed: of the campaign.
    """

    def __init__(self, place: Path, seed: int) -> None:
        self.seed = seed
        self.groups = [{job.name: job for job in group} for group in (fits(place), others(place))]
        self.jobs = self.groups[0] | self.groups[1]
        self.clean, self.out = place / "undisturbed", place / "killed"
        self.part, self._writing, self._signals = Part("kills"), 0, 0
        self._lasts: dict[str, tuple[float, float]] = {}  # seconds to the first file, and after it
        self._by_job = Counter[str]()
        self._locks = {name: Lock() for name in self.jobs}
        for folder in (self.clean, self.out):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()

    def run(self, seconds: float, cases: int, at_once: int) -> Part:
        """Cases until the time is over or so many are done."""
        end, number, going = time.monotonic() + seconds, 0, set[Future[None]]()
        with ThreadPoolExecutor(at_once) as pool:
            while going or (number < cases and time.monotonic() < end):
                while len(going) < at_once and number < cases and time.monotonic() < end:
                    going.add(pool.submit(self.one, number))
                    number += 1
                finished, going = wait(going, return_when=FIRST_COMPLETED)
                for future in finished:
                    future.result()
        told = f"{self._signals} signals, {self._writing} of them while a file was being written"
        self.part.notes.append(told)
        counts = ", ".join(f"{name} {count}" for name, count in sorted(self._by_job.items()))
        self.part.notes.append(f"signals by command: {counts}")
        return self.part

    def one(self, number: int) -> None:
        """One case: a run that is killed once or twice and started again."""
        random = Random(f"kill {self.seed} {number}")
        # one of the fits, which have most to lose, as often as one of all the others together
        job = random.choice(list(random.choice(self.groups).values()))
        out = self.out / str(number) / "run"
        outcome, told = oracle.judged(lambda: self._case(job, out, random))
        repeat = f"--seed {self.seed} --kill {number}"
        self.part.count(outcome, f"{job.name}: {told}", repeat)
        if outcome != "finding":
            shutil.rmtree(out.parent, ignore_errors=True)

    def _undisturbed(self, job: Job) -> None:
        out, earlier = _folder(self.clean, job), _folder(self.clean, job, "earlier")
        shutil.rmtree(self.clean / job.name, ignore_errors=True)
        for folder in (out, earlier):
            folder.parent.mkdir(parents=True)
            job.prepare(folder)
        before, begun = _names(out), time.monotonic()
        process = start(job.command(out), {"slow": _SLOW})
        appeared = _first_file(process, out, before)
        ended = finish(process)
        ended.require_told()
        oracle.require(ended.code == 0, f"failed undisturbed: {ended.last_line}")
        self._lasts[job.name] = appeared - begun, time.monotonic() - appeared

    def _case(self, job: Job, out: Path, random: Random) -> None:
        with self._locks[job.name]:
            if job.name not in self._lasts:
                self._undisturbed(job)
        out.parent.mkdir(parents=True)
        job.prepare(out)
        clean, earlier = _folder(self.clean, job), _folder(self.clean, job, "earlier")
        starting, writing = self._lasts[job.name]
        for attempt in range(random.choice((1, 1, 2))):
            before = _names(out)
            process = start(job.command(out, *(job.again if attempt else ())), {"slow": _SLOW})
            if random.random() < 0.9:
                _first_file(process, out, before)
                time.sleep(random.uniform(0, 1.05) * writing)
            else:
                time.sleep(random.uniform(0, 1) * starting)
            if random.random() < 0.5:
                _half_written(process, out)
            sent = random.choice((signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT))
            self._kill(process, sent, out, job.name)
            if out.exists():
                oracle.require_readable(out)
                oracle.require_old_or_new(out, clean, earlier)
        done(job.command(out, *job.again))
        oracle.require_same_run(out, clean)

    def _kill(
        self, process: "subprocess.Popen[str]", sent: signal.Signals, out: Path, name: str
    ) -> None:
        going = process.poll() is None
        process.send_signal(sent)
        if going:
            self._signals += 1
            self._by_job[name] += 1
            self._writing += sent == signal.SIGKILL and any(oracle.leftovers(out))
        ended = finish(process, _STOPPING)
        if ended.code != -signal.SIGKILL:
            told = "Traceback" not in ended.err
            oracle.require(told, f"a traceback at {sent.name}: {ended.last_line}")


def _folder(place: Path, job: Job, which: str = "new") -> Path:
    """A folder of results; all have one name, which the card of `init` says."""
    return place / job.name / which / "run"


def _names(out: Path) -> set[str]:
    """The names in a folder."""
    return {path.name for path in out.iterdir()} if out.is_dir() else set()


def _first_file(process: "subprocess.Popen[str]", out: Path, before: set[str]) -> float:
    """Waits until a command has made something new in its folder, or has ended; the time of it."""
    while process.poll() is None and not _names(out) - before:
        time.sleep(0.002)
    return time.monotonic()


def _half_written(process: "subprocess.Popen[str]", out: Path) -> None:
    """Waits until a file is being written, or the run has ended."""
    while process.poll() is None and not any(oracle.leftovers(out)):
        time.sleep(0.002)
