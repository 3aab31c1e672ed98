"""Faults around a command: no room, no permission, folders that vanish, damaged caches, clocks."""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from random import Random

from . import oracle
from .command import Ended, Job, done, finish, fits, others, run, start
from .report import Part

_SLOW = 0.01
_NOBODY = 65534  # the user without rights
_BUDGET = 120.0  # seconds that a selection of 60 may take on a machine with other work


class Faults:
    """Every fault once on a training; files and folders that cannot be written with every verb.

    Args:
        place: the undamaged files; runs are made beside them.
        seed: of the campaign.
    """

    def __init__(self, place: Path, seed: int) -> None:
        self.jobs = [*fits(place), *others(place)]
        self.job, self.place, self.random = self.jobs[0], place, Random(seed)
        self.box, self.part = place / "faults", Part("faults")
        self.clean = self.box / "undisturbed" / "run"  # reports say the name of the folder
        shutil.rmtree(self.box, ignore_errors=True)
        self.clean.parent.mkdir(parents=True)

    def run(self, seconds: float) -> Part:
        """All faults for which there is time."""
        end = time.monotonic() + seconds
        outcome, told = oracle.judged(lambda: done(self.job.command(self.clean)))
        if outcome == "finding":
            self.part.count(outcome, f"undisturbed: {told}", "--parts faults")
            return self.part
        faults: list[tuple[str, Callable[[Path], None]]] = [
            *(
                (f"files of at most {size} bytes", partial(self._small_files, size))
                for size in (100, 2000, 6000)
            ),
            ("a full file system", self._full),
            ("a folder that may not be written", self._read_only),
            ("a file where the folder should be", self._blocked),
            ("a folder that is removed while it runs", self._removed),
            ("a folder that is removed and made again", partial(self._removed, again=True)),
            ("a compile cache with flipped bytes", partial(self._cache, "flip")),
            ("a compile cache that is cut", partial(self._cache, "cut")),
            ("a compile cache that is a file", partial(self._cache, "file")),
            *(
                (f"clocks that jump by {size:g} s", partial(self._clocks, size))
                for size in (10.0, 1e7)
            ),
            ("a budget while the clock on the wall jumps by 1e9 s", self._budget),
        ]
        every: list[tuple[str, Callable[[Path], None]]] = [
            (f"{name}, {job.name}", partial(fault, job))
            for job in self.jobs[1:]
            for name, fault in (
                ("files of at most 100 bytes", partial(self._replaced, {"largest": 100})),
                ("small files", partial(self._replaced, {"largest": None})),
                ("a full file system", self._crowded),
                ("a folder of another user", self._foreign),
            )
        ]
        self.random.shuffle(every)
        faults += every
        for number, (name, fault) in enumerate(faults):
            if time.monotonic() > end:
                self.part.notes.append(f"{len(faults) - number} of {len(faults)}: no time left")
                break
            out = self.box / name.replace(" ", "-") / "run"
            out.parent.mkdir()
            try:
                outcome, told = oracle.judged(partial(fault, out))
            except oracle.Skipped as skipped:
                self.part.count("skipped", f"{name}: {skipped}", "")
                continue
            self.part.count(outcome, f"{name}: {told}", "--parts faults")
        return self.part

    # --- what must hold afterwards ---

    def _goes_on(self, out: Path) -> None:
        """Once the fault is gone, a resumed run reaches the same bytes.

        A log that the fault has cost lines is set aside, and said so; the rest of it may differ.
        """
        oracle.require_readable(out)
        ended = done(self.job.command(out, *self.job.again))
        aside = list(out.glob("seed-*/log.damaged.jsonl"))
        for path in aside:
            oracle.require(path.name in ended.err, "a log is set aside without a word")
            path.unlink()
            shutil.copy(self.clean / path.parent.name / "log.jsonl", path.parent)
        curves = Path("figures", "training.png")  # are not drawn without the beginning of a log
        if aside and not (out / curves).exists():
            shutil.copy(self.clean / curves, out / curves)
        oracle.require_same_run(out, self.clean)

    def _told_or_done(self, ended: Ended, out: Path) -> None:
        ended.require_told()
        if ended.code == 0:
            oracle.require_same_run(out, self.clean)

    # --- the faults ---

    def _small_files(self, size: int, out: Path) -> None:
        ended = run(self.job.command(out), {"largest": size})
        self._told_or_done(ended, out)
        self._goes_on(out)

    def _full(self, out: Path) -> None:
        with _small_disk(out, "24k"):
            ended = run(self.job.command(out / "run"), {})
            ended.require_told()
            oracle.require(ended.code != 0, "a run in 24 KiB that succeeds")
            oracle.require_readable(out)
            kept = shutil.copytree(out / "run", self.box / "kept" / "run")
        self._goes_on(kept)

    def _clean(self, job: Job) -> tuple[Path, Path]:
        """What a command makes undisturbed, and what is there before."""
        clean, earlier = (self.box / "clean" / job.name / which / "run" for which in ("new", "old"))
        if not clean.exists():
            for folder in (clean, earlier):
                folder.parent.mkdir(parents=True, exist_ok=True)
                job.prepare(folder)
            done(job.command(clean))
        return clean, earlier

    def _refused(self, job: Job, ended: Ended, out: Path) -> None:
        """One line; what was there stays or is replaced as a whole; then it succeeds."""
        clean, earlier = self._clean(job)
        ended.require_told()
        oracle.require(not list(oracle.leftovers(out)), "temporary files are left")
        oracle.require_readable(out)
        oracle.require_old_or_new(out, clean, earlier)
        if ended.code == 0:
            oracle.require_same_run(out, clean)

    def _replaced(self, asked: dict[str, int | None], job: Job, out: Path) -> None:
        clean, _ = self._clean(job)
        sizes = [path.stat().st_size for path in clean.rglob("*") if path.is_file()]
        largest = asked["largest"] or self.random.randrange(100, max(sizes))
        job.prepare(out)
        ended = run(job.command(out), {"largest": largest})
        if out.exists():
            self._refused(job, ended, out)
        oracle.require(ended.code != 0, f"files of at most {largest} bytes, and exit code 0")
        done(job.command(out, *job.again))
        oracle.require_same_run(out, clean)

    def _crowded(self, job: Job, out: Path) -> None:
        """A file system with room for what is there before, and a part of what is added."""
        clean, earlier = self._clean(job)
        blocks = [
            sum(4 * (path.stat().st_size // 4096 + 1) for path in folder.rglob("*"))
            for folder in (earlier, clean)
            if folder.exists()
        ]
        size = 16 + (blocks[0] if len(blocks) > 1 else 0) + self.random.randrange(blocks[-1])
        with _small_disk(out, f"{size}k"):
            place = out / "run"
            job.prepare(place)
            ended = run(job.command(place), {})
            if place.exists():
                self._refused(job, ended, place)
            kept = out.parent / "kept" / "run"
            shutil.copytree(out, kept.parent)
        done(job.command(kept, *job.again))
        oracle.require_same_run(kept, clean)

    def _foreign(self, job: Job, out: Path) -> None:
        """A folder that belongs to another user; where nobody can be changed to, a closed one."""
        out.mkdir()
        job.prepare(out)
        before = _states(out)
        root, more = os.geteuid() == 0, {}
        if root:
            home = self.box / "home"
            home.mkdir(exist_ok=True)
            os.chown(home, _NOBODY, _NOBODY)
            env = {"HOME": str(home), "TUSTINNET_CONFIG": str(home / "config")}
            # who may read all, as Python may lie in a folder of the superuser, but write nothing
            capability = "+dac_read_search"
            by = (
                "setpriv",
                f"--reuid={_NOBODY}",
                f"--regid={_NOBODY}",
                "--clear-groups",
                f"--inh-caps={capability}",
                f"--ambient-caps={capability}",
            )
            if shutil.which(by[0]) is None:
                raise oracle.Skipped("no setpriv, by which the superuser becomes another user")
            more = {"by": by, "env": env}
        else:
            out.chmod(0o555)
        try:
            ended = run(job.command(out), {}, **more)
        finally:
            out.chmod(0o755)
        ended.require_told()
        oracle.require(ended.code == 1, f"exit code {ended.code} where nothing can be written")
        oracle.require(before == _states(out), "changed a folder that belongs to another user")

    def _budget(self, out: Path) -> None:
        job = next(job for job in self.jobs if job.name == "selection")
        begun = time.monotonic()
        ended = run(job.command(out, "--budget", "60"), {"jump": 1e9})
        ended.require_told()
        oracle.require(ended.code == 0, f"failed: {ended.last_line}")
        oracle.require(time.monotonic() - begun < _BUDGET, "more than its budget")
        seconds = json.loads((out / "summary.json").read_text())["seconds"]
        oracle.require(0 < seconds < _BUDGET, f"a duration of {seconds:g} s")
        oracle.require_readable(out)

    def _read_only(self, out: Path) -> None:
        """Mode bits do not bind the superuser; the flag `immutable` does."""
        out.mkdir()
        root = os.geteuid() == 0
        forbid, allow = (
            (["chattr", "+i"], ["chattr", "-i"]) if root else (["chmod", "a-w"], ["chmod", "u+w"])
        )
        if shutil.which(forbid[0]) is None or subprocess.run([*forbid, out]).returncode != 0:
            raise oracle.Skipped("a folder cannot be closed to the superuser here")
        try:
            ended = run(self.job.command(out), {})
        finally:
            subprocess.run([*allow, out], check=True)
        self._told_or_done(ended, out)
        oracle.require(ended.code == 1 and not list(out.iterdir()), "wrote where it may not")
        self._goes_on(out)

    def _blocked(self, out: Path) -> None:
        out.write_text("a file")
        ended = run(self.job.command(out / "run"), {})
        self._told_or_done(ended, out)
        oracle.require(ended.code == 1, "a folder inside a file")
        oracle.require(out.read_text() == "a file", "a file was changed")

    def _removed(self, out: Path, *, again: bool = False) -> None:
        process = start(self.job.command(out), {"slow": 5 * _SLOW})
        while process.poll() is None and not list(out.glob("seed-*/checkpoint.safetensors")):
            time.sleep(0.01)
        out.rename(out.with_name(f"{out.name}-before"))
        if again:
            out.mkdir()
        self._told_or_done(finish(process), out)
        self._goes_on(out)
        shutil.rmtree(out.with_name(f"{out.name}-before"), ignore_errors=True)

    def _cache(self, how: str, out: Path) -> None:
        cache = self.box / f"cache-{how}"
        env = {"JAX_COMPILATION_CACHE_DIR": str(cache)}
        if how == "file":
            cache.write_text("no folder")
        else:
            done(self.job.command(self.box / f"fills-{how}"), env=env)
            for path in cache.rglob("*"):
                if path.is_file() and (content := bytearray(path.read_bytes())):
                    for _ in range(20):
                        content[self.random.randrange(len(content))] ^= 0x55
                    path.write_bytes(content if how == "flip" else content[: len(content) // 2])
        self._told_or_done(run(self.job.command(out), {}, env=env), out)

    def _clocks(self, seconds: float, out: Path) -> None:
        ended = run(self.job.command(out), {"jump": seconds})
        ended.require_told()
        oracle.require(ended.code == 0, f"failed: {ended.last_line}")
        oracle.require_same_run(out, self.clean)


@contextmanager
def _small_disk(place: Path, size: str) -> Iterator[None]:
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)]
    if subprocess.run(command, capture_output=True).returncode != 0:
        raise oracle.Skipped("no file system may be mounted")
    try:
        yield
    finally:
        subprocess.run(["umount", str(place)], check=True)


def _states(folder: Path) -> dict[Path, tuple[int, ...]]:
    """What a command changes that writes a file or removes it; not when it was read."""
    stats = {path: path.stat() for path in folder.rglob("*")}
    return {p: (s.st_ino, s.st_mode, s.st_size, s.st_mtime_ns) for p, s in stats.items()}
