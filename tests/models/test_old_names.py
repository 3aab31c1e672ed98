"""Methods of models under the names of an earlier version."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import hybrid, network, physics

from tustinnet.renamed import METHODS


@pytest.mark.parametrize("make", [lambda: network(0), physics, lambda: hybrid(0)])
def test_an_old_method_works_with_a_warning_that_has_the_new_name(make):
    model: Any = make()
    measured = jnp.zeros(2 * model.channels.n_q)
    with pytest.warns(FutureWarning, match="'beginning' is called 'initial_state' now"):
        old = model.beginning(measured)
    np.testing.assert_array_equal(old, model.initial_state(measured))
    with pytest.raises(AttributeError, match="has no attribute 'start'"):
        _ = model.start


def test_every_new_name_is_a_method():
    grey: Any = physics()
    models = [network(0), grey.continuous]
    for name in METHODS.values():
        assert any(hasattr(model, name) for model in models)
