"""What a part of the campaign found: counts, and findings grouped by their cause."""

import hashlib
import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_OUTCOMES = ("accepted", "refused", "skipped", "finding")
_KEPT = 3  # files of each cause
_LINE_EVERY = 15.0  # seconds between two lines of progress


@dataclass
class Part:
    """One part of the campaign.

    Attributes:
        name: which.
        outcomes: how many cases were accepted, refused, skipped, findings.
        causes: findings, how often each, and how the first one is repeated.
        files: what was damaged, for findings with a file.
        notes: figures and what was skipped.
    """

    name: str
    outcomes: Counter[str] = field(default_factory=Counter)
    causes: dict[str, dict[str, Any]] = field(default_factory=dict)
    files: dict[str, tuple[str, bytes]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    _last: str = ""
    _told: float = field(default_factory=time.monotonic)

    def count(self, outcome: str, told: str, repeat: str) -> None:
        """Takes note of a case; `repeat` says how to do it again."""
        self.outcomes[outcome] += 1
        if outcome == "finding":
            self._last = told
            cause = self.causes.setdefault(told, {"times": 0, "repeat": repeat})
            cause["times"] += 1
            if cause["times"] == 1:
                print(f"finding: {self.name}: {told}  [{repeat}]", file=sys.stderr)
        elif outcome == "skipped":
            self.notes.append(f"skipped {told}")
        if time.monotonic() - self._told > _LINE_EVERY:
            self._told = time.monotonic()
            told = f"{self.name}: {self.cases} cases, {self.outcomes['finding']} findings"
            print(told, file=sys.stderr)

    def keep(self, content: bytes, name: str) -> None:
        """Keeps the file of the finding that was counted last, of each cause a few."""
        if self.causes[self._last]["times"] <= _KEPT:
            digest = hashlib.sha256(content).hexdigest()[:12]
            self.files[f"{digest}-{name}"] = (self._last, content)

    @property
    def cases(self) -> int:
        """How many were tried."""
        return sum(self.outcomes.values()) - self.outcomes["skipped"]


def write(parts: Sequence[Part], seed: int, seconds: float, folder: Path) -> str:
    """Keeps what was found as JSON, with the files of findings; returns the table."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "seed": seed,
        "seconds": round(seconds),
        "parts": [
            {
                "part": p.name,
                "cases": p.cases,
                **{outcome: p.outcomes[outcome] for outcome in _OUTCOMES},
                "causes": p.causes,
                "notes": p.notes,
            }
            for p in parts
        ],
    }
    (folder / "torture.json").write_text(json.dumps(content, indent=1) + "\n")
    for part in parts:
        for name, (_, damaged) in part.files.items():
            kept = folder / "torture" / "findings"
            kept.mkdir(parents=True, exist_ok=True)
            (kept / name).write_bytes(damaged)
    lines = [f"{'part':<8}{'cases':>9}" + "".join(f"{c:>10}" for c in _OUTCOMES)]
    lines += [
        f"{p.name:<8}{p.cases:>9}" + "".join(f"{p.outcomes[c]:>10}" for c in _OUTCOMES)
        for p in parts
    ]
    for p in parts:
        lines += [f"{p.name}: {note}" for note in p.notes]
        for told, cause in sorted(p.causes.items(), key=lambda item: -item[1]["times"]):
            lines.append(f"finding: {p.name}: {told}  [{cause['times']} x, {cause['repeat']}]")
    return "\n".join(lines)
