"""`python -m tests.torture`: the campaign, or one case of it again."""

import argparse
import os
import sys
import time
from functools import cache
from pathlib import Path

from . import faults, fuzz, hostile, kills, load, pairs, report, verbs

# of the time
_SHARE = {
    "fuzz": 0.2,
    "hostile": 0.1,
    "headers": 0.1,
    "verbs": 0.15,
    "kills": 0.2,
    "pairs": 0.1,
    "faults": 0.15,
}
_WHOLE = 20.0  # minutes from which on the load is whole
_VERBS = 8  # cases of files for each of a verb, which takes longer
_PART = 20  # else it is this much smaller


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.torture", description=__doc__)
    add = parser.add_argument
    add("--minutes", type=float, default=5.0)
    add("--seed", type=int, default=0, help="what is damaged and when is killed follows from it")
    add("--parts", default="corpus,fuzz,hostile,headers,verbs,kills,pairs,faults,load")
    add("--cases", type=int, default=10**9, help="at most so many of a part; of verbs an eighth")
    add("--case", type=int, help="only this case of fuzz")
    add("--kill", type=int, help="only this case of kills")
    add("--header", type=int, help="only this case of headers")
    add("--jobs", type=int, default=os.cpu_count() or 1, help="cases at once")
    add("--out", type=Path, default=Path("results"), help="folder of torture.json")
    return parser.parse_args()


def _parts(asked: argparse.Namespace, place: Path) -> list[report.Part]:
    seconds = {name: 60 * asked.minutes * share for name, share in _SHARE.items()}
    scale = 1 if asked.minutes >= _WHOLE else _PART
    # every case leaves it as it was
    prepared = cache(lambda: verbs.prepare(place, place / "verbs"))
    doing = {
        "corpus": lambda: fuzz.replay(place),
        "fuzz": lambda: fuzz.Campaign(place, asked.seed, asked.jobs).run(
            seconds["fuzz"], asked.cases
        ),
        "hostile": lambda: hostile.Hostile(place, asked.seed).run(seconds["hostile"], asked.cases),
        "headers": lambda: verbs.Headers(prepared(), asked.seed).run(
            seconds["headers"], asked.cases // _VERBS
        ),
        "verbs": lambda: verbs.Interface(prepared(), asked.seed).run(
            seconds["verbs"], asked.cases // _VERBS
        ),
        "kills": lambda: kills.Kills(place, asked.seed).run(
            seconds["kills"], asked.cases, asked.jobs
        ),
        "pairs": lambda: pairs.Pairs(place, asked.seed).run(seconds["pairs"], asked.cases),
        "faults": lambda: faults.Faults(place, asked.seed).run(seconds["faults"]),
        "load": lambda: load.Load(place).run(scale),
    }
    return [doing[name]() for name in asked.parts.split(",")]


def main() -> int:
    """Runs what is asked for; 1 when there is a finding."""
    asked = _arguments()
    out, begun = asked.out.resolve(), time.monotonic()
    place = out / "torture" / "material"
    fuzz.prepare(place)
    if asked.case is not None:
        outcome, told = fuzz.one(place, asked.case, asked.seed)
        print(f"{outcome}: {told}")
        return int(outcome == "finding")
    if asked.kill is not None:
        again = kills.Kills(place, asked.seed)
        again.one(asked.kill)
        parts = [again.part]
    elif asked.header is not None:
        headers = verbs.Headers(verbs.prepare(place, place / "verbs"), asked.seed)
        headers.one(asked.header)
        parts = [headers.part]
    else:
        parts = _parts(asked, place)
    print(report.write(parts, asked.seed, time.monotonic() - begun, out))
    return int(any(part.causes for part in parts))


if __name__ == "__main__":
    sys.exit(main())
