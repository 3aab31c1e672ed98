"""Damaged inputs: each is refused by one readable line, or read as what it is.

A case is a number: together with the campaign's seed it says what is damaged and how.
"""

import contextlib
import io
import multiprocessing
import os
import resource
import shutil
import tempfile
import time
import tomllib
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from multiprocessing.connection import wait
from pathlib import Path
from random import Random
from typing import Any

import tustinnet as tn
from tustinnet.cli.show import show
from tustinnet.fits.run import run_fit
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.task import make_task
from tustinnet.store.checkpoint import read_checkpoint

from . import material, oracle
from .mutations import mutate
from .pendulum import SYSTEM
from .report import Part

_SLOW = 10.0  # seconds that a case may take
_MEMORY = 2 << 30  # bytes that a case may take beside what is there already
_CORPUS = Path(__file__).with_name("corpus")
_BATCH = 200  # cases that a worker is given at once


@dataclass(frozen=True)
class Target:
    """A kind of file that is damaged.

    Attributes:
        name: what it goes by.
        clean: the undamaged file.
        kind: how it may be damaged, see `mutations`.
        check: reads the damaged file and judges what was read.
        weight: how often it is chosen.
    """

    name: str
    clean: Path
    kind: str
    check: Callable[[Path, bytes], None]
    weight: float = 1.0


def targets(place: Path) -> dict[str, Target]:
    """Everything that is read from disk, by name; `place` holds the undamaged files."""
    logs = {
        "csv": ("log.csv", "text", 4),
        "parquet": ("log.parquet", "binary", 2),
        "mat": ("log.mat", "binary", 1),
        "mat73": ("log73.mat", "binary", 1),
        "npz": ("log.npz", "binary", 2),
    }
    found = [
        Target(name, place / file, kind, partial(_check_log, place, name), weight)
        for name, (file, kind, weight) in logs.items()
    ]
    found += [
        Target(
            f"model {kind}",
            place / f"{kind}.safetensors",
            "safetensors",
            partial(_check_model, place, kind),
            0.3,
        )
        for kind in (*material.KINDS, "linear", "euler-lagrange")
    ]
    found += [
        Target("card", place / "dataset.toml", "text", partial(_check_card, place), 4),
        Target("recipe", place / "recipe.toml", "text", partial(_check_recipe, place), 3),
        Target("search", place / "search.toml", "text", partial(_check_recipe, place), 1),
        Target("system", place / "pendulum.py", "text", _check_system, 0.5),
        Target(
            "checkpoint",
            place / "run/seed-0/checkpoint.safetensors",
            "safetensors",
            partial(_check_checkpoint, place),
            0.3,
        ),
        Target("log", place / "run/seed-0/log.jsonl", "text", partial(_check_run_log, place), 0.1),
    ]
    return {target.name: target for target in found}


def prepare(place: Path) -> None:
    """Makes the undamaged files."""
    material.write_all(place)
    (place / "dataset.toml").write_text(material.card('train = ["log.csv"]'))


# --- what is done with a damaged file ---


def _beside(path: Path, clean: Path) -> None:
    if not (path.parent / clean.name).exists():
        shutil.copy(clean, path.parent)


@cache
def _clean_record(place: Path, file: str) -> tn.Experiment:
    return _load(place, place, file)[0]


def _load(place: Path, folder: Path, file: str) -> tn.DataSet:
    card = place / f"card-{file}.toml"
    if not card.exists():
        card.write_text(material.card(f'train = ["{file}"]'))
    return tn.load(folder, card)


def _check_log(place: Path, name: str, path: Path, content: bytes) -> None:
    e, clean = _load(place, path.parent, path.name)[0], _clean_record(place, path.name)
    oracle.require_sound(e, path.parent)
    tn.inspect_experiment(e)
    if name == "csv":
        oracle.require_as_csv_reads(e, content)
    elif name in ("npz", "mat"):  # their checksums see every damage
        oracle.require_same_samples(e, clean)
    else:
        oracle.require_same_size(e, clean)


def _check_card(place: Path, path: Path, content: bytes) -> None:
    _beside(path, place / "log.csv")
    data = tn.load(path)
    for e in data:
        oracle.require_sound(e, path.parent)
        tn.inspect_experiment(e)
    text = (place / "dataset.toml").read_text()
    if tomllib.loads(path.read_text()) == tomllib.loads(text):
        oracle.require_same_samples(data[0], _clean_record(place, "log.csv"))


def _check_recipe(place: Path, path: Path, content: bytes) -> None:
    recipe = read_recipe(path)
    oracle.require_finite(recipe.model_dump())
    needs = recipe.family.needs
    make_task(
        material.records(),
        recipe,
        physics=material.physics() if "physics" in needs else None,
        system=SYSTEM if "system" in needs else None,
    )


def _check_system(path: Path, content: bytes) -> None:
    tn.load_system(path)


@cache
def _clean_model(place: Path, kind: str) -> tn.Model:
    return _model(place / f"{kind}.safetensors", kind)


def _model(path: Path, kind: str) -> tn.Model:
    return tn.load_model(path, SYSTEM if kind in ("hybrid", "euler-lagrange") else None)


def _check_model(place: Path, kind: str, path: Path, content: bytes) -> None:
    oracle.require_same_model(_model(path, kind), _clean_model(place, kind))
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown):
        show(path)
    steering = shown.getvalue().replace("\n", "").isprintable()
    oracle.require(steering, "`show` prints unprintable characters")


@cache
def _fit(place: Path) -> Any:
    return material.fit_of(place)


@cache
def _clean_state(place: Path) -> Any:
    return read_checkpoint(place / "run/seed-0/checkpoint.safetensors", _fit(place).task)[1]


def _check_checkpoint(place: Path, path: Path, content: bytes) -> None:
    members, found = read_checkpoint(path, _fit(place).task)
    if members:  # else it says that it is of others, and is not used
        oracle.require_same_state(found, _clean_state(place), content)


def _check_run_log(place: Path, path: Path, content: bytes) -> None:
    """A finished run that is resumed keeps its log, or refuses to go on with a damaged one."""
    run = path.parent / "run"
    shutil.copytree(place / "run", run, dirs_exist_ok=True)
    (run / "seed-0" / path.name).write_bytes(content)
    run_fit(_fit(place), run, "resume")
    found, clean = (p / "seed-0" / path.name for p in (run, place / "run"))
    told = found.with_name("log.damaged.jsonl").exists()
    oracle.require_log(found.read_text(), None if told else clean.read_text())


# --- cases ---


@dataclass(frozen=True)
class Case:
    """A damaged file."""

    number: int
    target: Target
    content: bytes


def case(number: int, seed: int, known: dict[str, Target]) -> Case:
    """The case of a number."""
    random = Random(f"{seed} {number}")
    names = list(known)
    weights = [known[name].weight for name in names]
    target = known[random.choices(names, weights)[0]]
    return Case(number, target, mutate(_content(target.clean), target.kind, random))


@cache
def _content(path: Path) -> bytes:
    return path.read_bytes()


def examine(target: Target, content: bytes, box: Path) -> tuple[str, str]:
    """Gives a damaged file to the package and judges what becomes of it.

    Args:
        target: the kind of file.
        content: what it holds.
        box: an empty folder; nothing may be written outside the folder made in it.
    """
    folder, stray = box / "case", box / "cwd"
    for place in (folder, stray):
        place.mkdir(parents=True)
    path = folder / target.clean.name
    path.write_bytes(content)
    before = Path.cwd()
    os.chdir(stray)
    try:
        outcome = oracle.judged(lambda: target.check(path, content))
        if list(stray.iterdir()) or len(list(box.iterdir())) > 2:
            outcome = "finding", "wrote outside its folder"
    finally:
        os.chdir(before)
        shutil.rmtree(box)
    return outcome


def _work(place: Path, box: Path, seed: int, pipe: Any) -> None:
    """A worker: is sent ranges of numbers, answers every case."""
    warnings.simplefilter("ignore")
    known = targets(place)
    box.mkdir(parents=True, exist_ok=True)
    with (box / "stderr").open("w") as errors:  # what libraries print for damaged files
        os.dup2(errors.fileno(), 2)
    for target in known.values():  # compiled, imported and kept before memory is limited
        told = examine(target, _content(target.clean), box / "case")
        if told[0] != "accepted":
            pipe.send((-1, target.name, "finding", f"an undamaged file is not accepted: {told}", 0))
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    size = 1024 * int(status["VmSize"].split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (size + _MEMORY, size + _MEMORY))
    pipe.send((None, "", "", "", 0))
    while (numbers := pipe.recv()) is not None:
        for number in numbers:
            damaged, begun = case(number, seed, known), time.monotonic()
            outcome, told = examine(damaged.target, damaged.content, box / "case")
            pipe.send((number, damaged.target.name, outcome, told, time.monotonic() - begun))
        pipe.send((None, "", "", "", 0))


@dataclass
class _Worker:
    """A worker as the campaign sees it: what it is to do, since when it has been at it."""

    process: Any
    pipe: Any
    numbers: list[int] = field(default_factory=list)
    since: float = field(default_factory=time.monotonic)
    ready: bool = False

    @property
    def overdue(self) -> bool:
        """Whether it has been at one case for too long; starting takes longer."""
        return time.monotonic() - self.since > (_SLOW + 5 if self.ready else 180)


class Campaign:
    """Cases by workers, one a core; one that dies or hangs is replaced, and that is a finding."""

    def __init__(self, place: Path, seed: int, jobs: int) -> None:
        self.place, self.seed, self.known = place, seed, targets(place)
        self.part, self.by_target = Part("fuzz"), Counter[str]()
        self._next, self._left = 0, 0
        self._jobs, self._boxes = jobs, Path(tempfile.mkdtemp(prefix="torture-"))
        self._started = 0

    def run(self, seconds: float, cases: int) -> Part:
        """Cases until the time is over or so many are done."""
        end, self._left = time.monotonic() + seconds, cases
        workers = [self._start() for _ in range(self._jobs)]
        while workers:
            wait([w.pipe for w in workers] + [w.process.sentinel for w in workers], 1)
            for worker in list(workers):
                alive = self._listen(worker, time.monotonic() < end)
                if alive is None:
                    workers.remove(worker)
                elif not alive:
                    workers.remove(worker)
                    if time.monotonic() < end:
                        workers.append(self._start(worker.numbers[1:]))
        shutil.rmtree(self._boxes, ignore_errors=True)
        return self.part

    def _start(self, numbers: list[int] | None = None) -> _Worker:
        self._started += 1
        spawn = multiprocessing.get_context("spawn")
        here, there = spawn.Pipe()
        box = self._boxes / str(self._started)
        process = spawn.Process(target=_work, args=(self.place, box, self.seed, there), daemon=True)
        process.start()
        there.close()
        return _Worker(process, here, numbers or [])

    def _listen(self, worker: _Worker, going: bool) -> bool | None:
        """Hears what a worker says; False when it is lost, None when it is done."""
        try:
            while worker.pipe.poll():
                number, target, outcome, told, seconds = worker.pipe.recv()
                worker.since = time.monotonic()
                if number is None:
                    worker.ready = True
                    if not going or not self._send(worker):
                        worker.pipe.send(None)
                        worker.process.join()
                        return None
                    continue
                worker.numbers = worker.numbers[1:] if number >= 0 else worker.numbers
                if seconds > _SLOW:
                    outcome, told = "finding", "took more than 10 s"
                self._count(number, target, outcome, told)
        except (EOFError, ConnectionResetError):
            worker.process.join()
            self._lost(worker, f"killed the process (exit code {worker.process.exitcode})")
            return False
        if worker.overdue:
            worker.process.kill()
            worker.process.join()
            self._lost(worker, "hung")
            return False
        return True

    def _send(self, worker: _Worker) -> bool:
        if not worker.numbers:
            many = min(_BATCH, self._left)
            worker.numbers = list(range(self._next, self._next + many))
            self._next, self._left = self._next + many, self._left - many
        if worker.numbers:
            worker.pipe.send(worker.numbers)
        return bool(worker.numbers)

    def _lost(self, worker: _Worker, how: str) -> None:
        if worker.numbers:
            number = worker.numbers[0]
            self._count(number, case(number, self.seed, self.known).target.name, "finding", how)
        else:
            self._count(-1, "worker", "finding", f"{how} before the first case")

    def _count(self, number: int, target: str, outcome: str, told: str) -> None:
        self.by_target[target] += 1
        self.part.count(outcome, f"{target}: {told}", f"--seed {self.seed} --case {number}")
        if outcome == "finding" and number >= 0:
            self.part.keep(
                case(number, self.seed, self.known).content, self.known[target].clean.name
            )


def one(place: Path, number: int, seed: int) -> tuple[str, str]:
    """A case alone, in this process; the damaged file is left in the folder `case`."""
    damaged = case(number, seed, targets(place))
    kept = place.parent / "case" / damaged.target.clean.name
    kept.parent.mkdir(exist_ok=True)
    kept.write_bytes(damaged.content)
    with tempfile.TemporaryDirectory() as box:
        outcome, told = examine(damaged.target, damaged.content, Path(box) / "box")
    return outcome, f"{damaged.target.name} ({kept}): {told}"


def replay(place: Path) -> Part:
    """What was ever found: the files of the folder `corpus`, below the name of their target."""
    part, known = Part("corpus"), targets(place)
    for path in sorted(_CORPUS.glob("*/*")):
        with tempfile.TemporaryDirectory() as box:
            target = known[path.parent.name]
            outcome, told = examine(target, path.read_bytes(), Path(box) / "box")
        part.count(outcome, f"{path.relative_to(_CORPUS)}: {told}", "--parts corpus")
    return part
