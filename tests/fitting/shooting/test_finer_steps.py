"""Integration steps of the final stage: finer ones where they would move parameters."""

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.systems.library.duffing import TWIN


@pytest.mark.thorough
def test_steps_are_so_fine_that_they_do_not_show_in_the_parameters():
    records = TWIN.records(3, train=4, validation=0, test=0)

    def identified(*changes: str) -> tn.Identification:
        return tn.identify(records, TWIN.system, tn.read_recipe("grey", list(changes)))

    chosen, exact = identified(), identified("search.substeps=16")
    single = identified("search.substeps=1")
    errors = np.array([e.error for e in exact.estimates])
    values = np.array([[e.value for e in r.estimates] for r in (chosen, exact, single)])
    # each sample is right within a quarter of a count with a single step; 2,400 of them are not
    assert np.max(np.abs(values[2] - values[1]) / errors) > 1
    assert np.max(np.abs(values[0] - values[1]) / errors) < 0.25
    assert 1 < chosen.substeps < 16
