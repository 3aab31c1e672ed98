"""Two commands in one folder: the second is refused in one line, or both results are whole."""

import shutil
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

from . import oracle
from .command import Ended, Job, done, finish, fits, others, start
from .report import Part

_SLOW = 0.02  # seconds that each half of a write takes longer


@dataclass(frozen=True)
class Pair:
    """Two commands that write into one folder.

    Attributes:
        name: what it goes by.
        first: one of them.
        second: the other.
        more: options of both.
        unfinished: whether both go on with a run that was killed.
    """

    name: str
    first: Job
    second: Job
    more: tuple[str, ...] = ()
    unfinished: bool = False

    def commands(self, out: Path) -> list[tuple[str, ...]]:
        """Both, as they are run."""
        return [job.command(out, *self.more) for job in (self.first, self.second)]


def pairs(place: Path) -> list[Pair]:
    """Commands of users who have one folder for everything."""
    known = {job.name: job for job in (*fits(place), *others(place))}
    network, gru, grey = known["tustin-net"], known["gru"], known["identification"]
    selection, report, export = known["selection"], known["report"], known["export"]
    other = {job.name: Job(job.name, job.earlier, ()) for job in known.values() if job.earlier}
    # a report of the model that the other command fits anew
    model = str(place / "run" / "model.safetensors")
    of_run = Job(
        "report",
        tuple("{out}/model.safetensors" if word == model else word for word in report.arguments),
        (),
    )
    replace = ("--overwrite",)
    mat = Job("export", tuple("mat" if word == "c" else word for word in export.arguments), ())
    return [
        Pair("two fits alike", network, network),
        Pair("two fits alike, replacing", network, network, replace),
        Pair("two fits, replacing", network, gru, replace),
        Pair("a fit and an identification, replacing", network, grey, replace),
        Pair("a fit and a selection, replacing", network, selection, replace),
        Pair("two selections", selection, selection),
        Pair("two resumed fits", network, network, ("--resume",), unfinished=True),
        Pair("two resumed selections", selection, selection, ("--resume",), unfinished=True),
        Pair("a fit and a report of it", network, of_run, replace),
        Pair("two reports", report, other["report"], replace),
        Pair("two exports alike", export, export),
        Pair("two exports, replacing", export, mat, replace),
        Pair("two controllers", known["control"], other["control"], replace),
        Pair("two committees", known["committee"], other["committee"], replace),
        Pair("two simulations", known["simulate"], other["simulate"], replace),
        Pair("two cross-validations", known["cross-validate"], known["cross-validate"], replace),
        Pair("two learning curves", known["learning-curve"], known["learning-curve"]),
        Pair("two drafts of a card", known["init"], known["init"]),
        Pair("two reproductions", known["reproduce"], known["reproduce"]),
    ]


class Pairs:
    """Every pair one after the other and at the same time.

    Args:
        place: the undamaged files; results are made beside them.
        seed: of the campaign: how far apart the commands begin.
    """

    def __init__(self, place: Path, seed: int) -> None:
        self.pairs, self.box = pairs(place), place / "pairs"
        self.seed, self.part = seed, Part("pairs")
        shutil.rmtree(self.box, ignore_errors=True)

    def run(self, seconds: float, cases: int) -> Part:
        """Cases until the time is over or so many are done."""
        end = time.monotonic() + seconds
        order = [(pair, at_once) for pair in self.pairs for at_once in (True, False)]
        Random(f"pairs {self.seed}").shuffle(order)
        for number, (pair, at_once) in enumerate(order):
            if number >= cases or time.monotonic() > end:
                self.part.notes.append(f"{len(order) - number} of {len(order)}: no time left")
                break
            outcome, told = oracle.judged(partial(self._case, pair, Random(number), at_once))
            how = "at once" if at_once else "one after the other"
            self.part.count(outcome, f"{pair.name}, {how}: {told}", "--parts pairs")
        return self.part

    def _case(self, pair: Pair, random: Random, at_once: bool) -> None:
        shutil.rmtree(self.box, ignore_errors=True)
        out = self.box / "both" / "run"
        clean = [self.box / name / "run" for name in ("first", "second")]
        for folder in (out, *clean):
            folder.parent.mkdir(parents=True)
            pair.first.prepare(folder)
            if "{out}/model.safetensors" in pair.second.arguments:
                done(pair.first.command(folder))  # its model is what the second reads
        for folder, job in zip(clean, (pair.first, pair.second), strict=True):
            done(job.command(folder, *(() if pair.unfinished else pair.more)))
        if pair.unfinished:
            self._unfinished(pair.first, out)
        if at_once:
            both = []
            for command in pair.commands(out):
                both.append(start(command, {"slow": _SLOW}))
                time.sleep(random.choice((0, 0, random.uniform(0, 3))))
            ended = [finish(process) for process in both]
        else:
            ended = [finish(start(command, {})) for command in pair.commands(out)]
        self._judge(ended, out, clean)

    def _unfinished(self, job: Job, out: Path) -> None:
        """A run that is killed once some of it is there."""
        process = start(job.command(out), {"slow": _SLOW})
        while process.poll() is None and not list(out.rglob("*.safetensors")):
            time.sleep(0.005)
        process.kill()
        process.communicate()

    def _judge(self, ended: list[Ended], out: Path, clean: list[Path]) -> None:
        for one in ended:
            one.require_told()
        good = [folder for one, folder in zip(ended, clean, strict=True) if one.code == 0]
        told = "; ".join(one.last_line for one in ended)
        oracle.require(bool(good), f"both are refused: {told}")
        oracle.require_readable(out)
        oracle.require_old_or_new(out, *clean)
        differences = []
        for folder in good:
            try:
                oracle.require_same_run(out, folder)
            except oracle.Finding as finding:
                differences.append(str(finding))
        oracle.require(len(differences) < len(good), f"neither's results: {differences}; {told}")
