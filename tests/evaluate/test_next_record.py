"""Which of some proposed records would tell the most."""

from pathlib import Path

import numpy as np
import pytest

import tustinnet as tn

PROPOSALS = (
    tn.Proposal("at rest", np.zeros(1), np.zeros(1), np.zeros((100, 1))),
    tn.Proposal("a fall", np.array([2.0]), np.array([-0.5]), np.zeros((100, 1))),
    tn.Proposal("driven", np.zeros(1), np.zeros(1), 3 * np.sin(np.arange(100) / 3)[:, None]),
)


def test_an_identified_system_wants_what_shrinks_its_errors(identified, system):
    file = identified / "model.safetensors"
    model, header = tn.load_model(file, system), tn.read_header(file)
    ranking = tn.rank_proposals(model, header, PROPOSALS)
    values = {gain.name: gain.value for gain in ranking}
    assert list(values.values()) == sorted(values.values(), reverse=True)
    assert values["at rest"] == pytest.approx(0, abs=1e-6)
    assert values["a fall"] > 0.01
    # only a torque says something of the gain
    words = {gain.name: gain.words for gain in ranking}
    assert words["driven"].startswith("error of gain to ")
    assert not words["a fall"].startswith("error of gain")


def proposal(q=(0.0,), v=(0.0,), samples=9, inputs=1, fill=0.0) -> tn.Proposal:
    return tn.Proposal("one", np.array(q), np.array(v), np.full((samples, inputs), fill))


@pytest.mark.parametrize(
    ("proposals", "problem"),
    [
        ([proposal(), proposal()], "two proposals 'one'"),
        ([proposal(q=(0.0, 1.0), v=(0.0, 0.0))], r"proposal 'one': q \(2,\).* expected \(1,\)"),
        ([proposal(inputs=2)], r"u \(9, 2\)"),
        ([proposal(samples=1)], "at least 2 samples"),
        ([proposal(fill=np.nan)], "not finite"),
        ([proposal(q=(1e300,))], "no proposal that the model can simulate"),
    ],
)
def test_proposals_that_cannot_be_ranked_are_refused(proposals, problem, identified, system):
    file = identified / "model.safetensors"
    model, header = tn.load_model(file, system), tn.read_header(file)
    with pytest.raises(tn.InputError, match=problem):
        tn.rank_proposals(model, header, proposals)


def test_a_model_without_errors_of_parameters_is_refused(run_folder: Path):
    model = tn.load_model(run_folder / "seed-0" / "model.safetensors")
    with pytest.raises(tn.InputError, match="a model without errors of its parameters"):
        tn.rank_proposals(model, {}, [proposal()])
