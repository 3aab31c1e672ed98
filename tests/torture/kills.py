"""Kills: whatever moment a run is killed at, started again it ends with the same bytes."""

import shutil
import signal
import subprocess
import time
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from random import Random
from threading import Lock

from . import oracle
from .command import Job, done, finish, jobs, start
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
        self.seed, self.jobs = seed, jobs(place)
        self.clean, self.out = place / "undisturbed", place / "killed"
        self.part, self._writing, self._signals = Part("kills"), 0, 0
        self._lasts: dict[str, float] = {}  # seconds from the first file to the end
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
        return self.part

    def one(self, number: int) -> None:
        """One case: a run that is killed once or twice and started again."""
        random = Random(f"kill {self.seed} {number}")
        job = self.jobs[random.choice(list(self.jobs))]
        with self._locks[job.name]:
            if job.name not in self._lasts:
                self._undisturbed(job)
        out = self.out / str(number)
        outcome, told = oracle.judged(lambda: self._case(job, out, random))
        repeat = f"--seed {self.seed} --kill {number}"
        self.part.count(outcome, f"{job.name}: {told}", repeat)
        if outcome != "finding":
            shutil.rmtree(out)

    def _undisturbed(self, job: Job) -> None:
        out = self.clean / job.name
        process = start(job.command(out), {"slow": _SLOW})
        appeared = _first_file(process, out)
        ended = finish(process)
        assert ended.code == 0, ended.err
        self._lasts[job.name] = time.monotonic() - appeared

    def _case(self, job: Job, out: Path, random: Random) -> None:
        for attempt in range(random.choice((1, 1, 2))):
            process = start(job.command(out, *([job.again] if attempt else [])), {"slow": _SLOW})
            if random.random() < 0.9:  # else while it starts
                _first_file(process, out)
            time.sleep(random.uniform(0, 1.05) * self._lasts[job.name])
            if random.random() < 0.5:
                _half_written(process, out)
            sent = random.choice((signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT))
            self._kill(process, sent, out)
            if out.exists():
                oracle.require_readable(out)
        done(job.command(out, job.again))
        oracle.require_same_run(out, self.clean / job.name)

    def _kill(self, process: "subprocess.Popen[str]", sent: signal.Signals, out: Path) -> None:
        going = process.poll() is None
        process.send_signal(sent)
        if going:
            self._signals += 1
            self._writing += sent == signal.SIGKILL and any(oracle.leftovers(out))
        ended = finish(process, _STOPPING)
        if ended.code != -signal.SIGKILL:
            told = "Traceback" not in ended.err
            oracle.require(told, f"a traceback at {sent.name}: {ended.last_line}")


def _first_file(process: "subprocess.Popen[str]", out: Path) -> float:
    """Waits until a run has made something in its folder, or has ended; the time of it."""
    while process.poll() is None and not (out.exists() and any(out.iterdir())):
        time.sleep(0.005)
    return time.monotonic()


def _half_written(process: "subprocess.Popen[str]", out: Path) -> None:
    """Waits until a file is being written, or the run has ended."""
    while process.poll() is None and not any(oracle.leftovers(out)):
        time.sleep(0.002)
