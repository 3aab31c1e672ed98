"""Names of before the first release are refused, with the one to write instead."""

import jax.numpy as jnp
import pytest
from every_family import network, physics
from swinging import SWING

import tustinnet as tn
from tustinnet.families.family import Family, IdentifiedFamily, TrainedFamily
from tustinnet.models.added import parse_forces
from tustinnet.models.contract import AccelerationModel
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.old_names import FAMILY_METHODS, METHODS, NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name(name):
    with pytest.raises(AttributeError, match=f"'{name}'; it is called '{NAMES[name]}' now"):
        getattr(tn, name)
    assert not hasattr(tn, name)


@pytest.mark.parametrize("make", [lambda: network(0), physics])
def test_a_method_of_a_model(make):
    with pytest.raises(AttributeError, match="'beginning'; it is called 'initial_state' now"):
        make().beginning(jnp.zeros(2))
    with pytest.raises(AttributeError, match="has no attribute 'start'"):
        _ = make().start


def test_a_force():
    with pytest.raises(tn.InputError, match=r"version: rubbing; expected coulomb_by_position$"):
        parse_forces(SWING, ["rubbing:angle"])


def test_what_is_written_instead_is_there():
    assert {*NAMES.values()} <= {*dir(tn)}
    for name in METHODS.values():
        assert hasattr(AccelerationModel, name) or hasattr(LagrangianModel, name)
    for name in FAMILY_METHODS.values():
        assert any(hasattr(kind, name) for kind in (Family, TrainedFamily, IdentifiedFamily))
