"""Drafts of data cards for the folders of made-up laboratories."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from laboratories import LABORATORIES, Truth

import tustinnet as tn
from tustinnet.data.drafting.draft import draft_card

Laboratory = Callable[[Path], Truth]


def draft(folder: Path) -> dict[str, Any]:
    """The card that is drafted for all files of a folder; it is written there and loads."""
    files = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
    text = draft_card(folder, files).text
    (folder / "dataset.toml").write_text(text, encoding="utf-8")
    return tomllib.loads(text)


def differences(card: dict[str, Any], truth: Truth, data: tn.DataSet) -> list[str]:
    """What a card says otherwise than the truth, a sentence each."""
    declared = {
        "time": (str(card.get("time", {}).get("column")), card.get("time", {}).get("unit")),
        "coordinates": {str(c["column"]): (c["kind"], c["unit"]) for c in card["coordinates"]},
        "inputs": {str(i["column"]): i["unit"] for i in card.get("inputs", [])},
        "velocities": {
            str(c["column"]): str(c["velocity"]["column"])
            for c in card["coordinates"]
            if "velocity" in c
        },
    }
    expected = {
        "time": (str(truth.time), truth.time_unit if truth.time else None),
        "coordinates": dict(truth.coordinates),
        "inputs": dict(truth.inputs),
        "velocities": dict(truth.velocities),
    }
    found = [
        f"{key}: {declared[key]}, not {expected[key]}"
        for key in expected
        if declared[key] != expected[key]
    ]
    counts = {c["column"]: c.get("counts_per_revolution") for c in card["coordinates"]}
    found += [
        f"counts of {c}: {counts.get(c)}" for c, n in truth.counts.items() if counts.get(c) != n
    ]
    if abs(card["dt"] / truth.dt - 1) > 1e-3:
        found.append(f"dt: {card['dt']}, not {truth.dt}")
    enough = len(data) == truth.records if truth.records > 0 else len(data) >= -truth.records
    if not enough:
        found.append(f"{len(data)} records, not {truth.records}")
    for kind in truth.kinds:
        splits = {e.split for e in data if e.name.startswith(kind)}
        if not {"train", "validation"} <= splits:
            found.append(f"splits of '{kind}': {splits}")
    for names in truth.together:
        if len({e.split for e in data if e.name in names}) != 1:
            found.append(f"{sorted(names)} in several splits")
    return found


@pytest.mark.parametrize("laboratory", LABORATORIES, ids=lambda f: f.__name__)
def test_the_draft_says_what_a_person_would_say(laboratory: Laboratory, tmp_path: Path) -> None:
    truth = laboratory(tmp_path)
    card = draft(tmp_path)
    assert differences(card, truth, tn.load(tmp_path)) == []
