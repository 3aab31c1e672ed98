"""Findings as data, and the sentences that are made of them."""

import json
import re
import string
from pathlib import Path

import numpy as np
import pytest

import tustinnet
from tustinnet.finding import make_finding
from tustinnet.store.files import to_json
from tustinnet.words import WORDS, put_in_words
from tustinnet.words.check import CHECK
from tustinnet.words.identification import IDENTIFICATION
from tustinnet.words.preparation import PREPARATION
from tustinnet.words.selection import SELECTION

SOURCE = "\n".join(p.read_text() for p in Path(tustinnet.__file__).parent.rglob("*.py"))


def test_a_finding_is_its_code_its_values_and_what_to_do():
    finding = make_finding("no effect on simulations", parameter="gain")
    assert (finding.severity, finding.mend) == ("warning", "fix it")
    assert str(finding) == "'gain' has hardly any effect on the simulations; fix it"
    assert finding.as_plain()["values"] == {"parameter": "gain"}


def test_a_finding_is_written_as_json_with_those_that_are_its_parts():
    part = make_finding("changed", parameter="mass", before=np.float64(1.0), after=float("nan"))
    plain = json.loads(
        to_json(make_finding("refitted", changes=[part], start="s", before=2, after=1).as_plain())
    )
    assert plain["values"]["changes"] == [
        {"code": "changed", "parameter": "mass", "before": 1.0, "after": None}
    ]
    assert "mass 1 -> nan changed most" in plain["text"]


@pytest.mark.parametrize(
    ("template", "values", "sentence"),
    [
        ("{x:.3g}[[ ± {error:.2g}]] m", {"x": 1.0, "error": 0.25}, "1 ± 0.25 m"),
        ("{x:.3g}[[ ± {error:.2g}]] m", {"x": 1.0, "error": float("nan")}, "1 m"),
        ("{x:.3g}[[ ± {error:.2g}]] m", {"x": 1.0, "error": 0.0}, "1 ± 0 m"),
        ("all[[{few}, few]]", {"few": True}, "all, few"),
        ("all[[{few}, few]]", {"few": False}, "all"),
        ("{n:record}", {"n": 1}, "1 record"),
        ("{n:whole record}", {"n": 2}, "2 whole records"),
        ("{share:percent}, {share:percent.4g}", {"share": 0.12345}, "12 %, 12.35 %"),
        ("{share:percent}, {more:percent.3g}", {"share": 7.6, "more": 12.34}, "760 %, 1234 %"),
        ("{shares:percent}", {"shares": {"a": 0.1, "b": 0.023}}, "a 10 %, b 2.3 %"),
        ("{names}", {"names": ["a", "b", "c"]}, "a, b, c"),
        ("{names:quoted and}", {"names": ["a", "b", "c"]}, "'a', 'b' and 'c'"),
        ("{names:quoted or-of}", {"names": [["a", "b"], ["c"]]}, "'a' and 'b' or of 'c'"),
        ("{names:each}", {"names": ["a"]}, "a"),
        (
            "{names}",
            {"names": [*"abcdefghijklmn"]},
            "a, b, c, d, e, f, g, h, i, j, k, l and 2 more",
        ),
    ],
)
def test_sentences_say_values(template, values, sentence):
    assert put_in_words(template, values) == sentence


def test_true_and_false_of_numpy_are_no_words() -> None:
    for flickers, text in ((np.True_, " by more than one count"), (np.False_, "")):
        finding = make_finding("dead sensor", flickers=flickers, value=0.0, unit="rad", samples=9)
        assert put_in_words(WORDS["dead sensor"].text, {"channel": "q", **finding.values}) == (
            f"q never changes{text}"
        )


def test_a_code_has_one_sentence():
    assert len(WORDS) == len(CHECK) + len(IDENTIFICATION) + len(PREPARATION) + len(SELECTION)


@pytest.mark.thorough
@pytest.mark.parametrize("code", WORDS)
def test_a_sentence_is_used_and_can_be_read(code):
    is_used = re.search(rf'"{code}"', SOURCE.replace(f'    "{code}": ', ""))
    assert is_used or code.startswith("timing ")  # of the verdicts on inputs
    for template in (WORDS[code].text, WORDS[code].mend):
        assert not re.search(r"\[\[[^\]{]*\]\]", template), "a part that is always said"
        assert all(
            name is None or name.isidentifier()
            for _, name, _, _ in string.Formatter().parse(
                template.replace("[[", "").replace("]]", "")
            )
        )
