"""Fingerprints of records: copies and parts have them, other runs do not."""

from dataclasses import replace

import numpy as np
import pytest
from simulated.faults import simulate_logs

import tustinnet as tn
from tustinnet.data.fingerprint import is_among, make_fingerprint, step_quanta


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[tn.Experiment]:
    """Runs of a driven disc, some of one input."""
    folder = tmp_path_factory.mktemp("runs")
    return list(tn.load(simulate_logs("unbalanced-disc", 0, 6, 2, longest=8.0).write(folder / "x")))


def known(e: tn.Experiment, others: list[tn.Experiment]) -> bool:
    quanta = step_quanta(others)
    return is_among(e, [make_fingerprint(other, quanta) for other in others], quanta)


@pytest.mark.thorough
def test_copies_and_parts_of_a_record_are_known_by_its_fingerprint(runs):
    for e in runs:
        rounded = np.array([[float(f"{x:.6g}") for x in row] for row in e.q])
        for copy in (
            replace(e, t=e.t + 100.0, name="later", sha256="", source="other.csv"),
            replace(e, q=rounded),
            replace(e, q=e.q + 2 * np.pi),
            e[len(e) // 4 : 3 * len(e) // 4],
        ):
            assert known(copy, runs)


def test_other_runs_of_a_machine_are_not_known(runs):
    for k, e in enumerate(runs):
        assert not known(e, [*runs[:k], *runs[k + 1 :]])


def test_a_record_at_rest_has_no_fingerprint_and_is_never_known(runs):
    e = runs[0]
    still = replace(e, q=np.zeros_like(e.q), u=np.zeros_like(e.u))
    assert make_fingerprint(still, step_quanta([still])) == ""
    assert not known(still, [still])
    assert not known(e[:20], runs)
    other = replace(e, q=1e90 * e.q)
    assert not known(other, runs)


def test_a_record_of_other_channels_is_not_known(runs):
    free = tn.from_arrays(runs[0].q, dt=0.01, coordinates={"angle": "angular"})
    assert not known(free, runs)
