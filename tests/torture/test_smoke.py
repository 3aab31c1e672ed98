"""A few cases of the campaign, and everything that it ever found."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.thorough
def test_a_few_cases_and_the_corpus_have_no_finding(tmp_path):
    # in a process of its own: people run the package without the type checks of the test set-up
    command = [sys.executable, "-m", "tests.torture", "--parts", "corpus,fuzz,headers,verbs"]
    done = subprocess.run(
        [*command, "--cases", "64", "--jobs", "1", "--minutes", "9", "--out", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    parts = {p["part"]: p for p in json.loads((tmp_path / "torture.json").read_text())["parts"]}
    assert parts["fuzz"]["cases"] == 64
    assert parts["headers"]["cases"] == parts["verbs"]["cases"] == 8
    assert parts["fuzz"]["accepted"] > 0
    assert parts["fuzz"]["refused"] > 40
