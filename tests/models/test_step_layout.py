"""Layouts of the inputs of a step, and those of models that are composed of others."""

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import every_family, hybrid, network

import tustinnet as tn
from tustinnet.models.step_layout import StepLayout
from tustinnet.signals.excitation import Excitation

HELD, BAND = 1, 8  # coefficients of a polynomial


def inputs(order: int) -> Excitation:
    """Two inputs over 9 periods."""
    draw = np.random.default_rng(0).normal
    return Excitation(draw(size=(10, 2)), draw(size=(9, order, 2)))


@pytest.mark.parametrize("order", [HELD, BAND])
@pytest.mark.parametrize(
    "part",
    [
        StepLayout(mean=True),
        StepLayout(polynomial=True),
        StepLayout(taps=(1,)),
        StepLayout(taps=(2, -1)),
        StepLayout(polynomial=True, taps=(0, 2)),
        StepLayout(polynomial=True, mean=True, taps=(-1, 0, 2, 1)),
    ],
)
def test_a_part_takes_of_the_whole_what_it_would_be_given_alone(part, order):
    whole = StepLayout(mean=True, taps=(-1, 0)) | StepLayout(polynomial=True, taps=(0, 2)) | part
    assert whole == StepLayout(polynomial=True, mean=True, taps=(-1, 0, 2, *whole.taps[3:]))
    alone = part.arrange(inputs(order))
    for k, u in enumerate(whole.arrange(inputs(order))):
        np.testing.assert_array_equal(whole.select(jnp.asarray(u), part), alone[k])


def test_a_single_row_is_a_vector_and_acts_on_every_part():
    layout = StepLayout(polynomial=True)
    assert layout.arrange(inputs(HELD)).shape == (9, 2)
    assert layout.arrange(inputs(BAND)).shape == (9, BAND, 2)
    u = jnp.array([0.3, 0.4])
    assert layout.select(u, StepLayout(taps=(0, 1))) is u


@pytest.mark.parametrize("rows", [1, 2, 4])
def test_inputs_of_another_layout_are_refused(rows):
    layout = StepLayout(mean=True, taps=(0, 1))
    with pytest.raises(ValueError, match=f"{rows} rows of inputs"):
        layout.select(jnp.zeros((rows, 1)), StepLayout(mean=True))
    with pytest.raises(ValueError, match="3 rows of inputs"):
        StepLayout(polynomial=True, mean=True, taps=(0, 1)).select(
            jnp.zeros((3, 1)), StepLayout(mean=True)
        )


@pytest.mark.thorough
def test_composed_models_take_every_row_once():
    assert hybrid(0).step_layout == StepLayout(polynomial=True)
    assert hybrid(0, taps=(-1, 1)).step_layout == StepLayout(polynomial=True, taps=(-1, 1))
    assert tn.committee([network(0)] * 2).step_layout == StepLayout(mean=True)
    together = tn.committee(every_family())
    assert together.step_layout == StepLayout(polynomial=True, mean=True, taps=(-1, 0, 1))
