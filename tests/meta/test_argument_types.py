"""A public function that fails by a value of another type says so in a line."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from jaxtyping import Float
from swinging import SWING

import tustinnet as tn
from tustinnet.argument_types import check_arguments


@check_arguments
def compute(
    data: tn.DataSet | Path,
    numbers: list[float] = [],  # noqa: B006 (nothing changes it)
    *,
    by_name: "dict[str, int] | None" = None,
    kind: Literal["a", "b"] = "a",
    array: Float[np.ndarray, " n"] | None = None,
    anything: Any = None,
    **more: int,
) -> str:
    """Returns a word, or fails."""
    if isinstance(anything, Exception):
        raise anything
    return "computed"


def test_what_works_is_computed(pendulum):
    assert compute(pendulum, [1, np.float32(2)], by_name={"a": np.int64(1)}) == "computed"
    # what no class decides is left to the function
    assert compute(Path("x"), kind="c", array=3, anything=int, further="a text") == "computed"  # pyright: ignore
    assert compute(None) == "computed"  # pyright: ignore


def test_what_fails_for_other_reasons_stays_as_it_is():
    with pytest.raises(KeyError, match="inside"):
        compute(Path(), [1.0], anything=KeyError("inside"))
    with pytest.raises(tn.InputError, match="its own words"):
        compute(None, anything=tn.InputError("data", "its own words"))  # pyright: ignore


@pytest.mark.parametrize(
    ("given", "named", "told"),
    [
        ((None,), {}, "compute, data: None; expected DataSet or Path"),
        (("x",), {}, "compute, data: str; expected DataSet or Path"),
        ((Path(), "12"), {}, "compute, numbers: str; expected list of float"),
        ((Path(), [1.0, "x"]), {}, "compute, numbers: list; expected list of float"),
        ((Path(),), {"by_name": [1]}, "compute, by_name: list; expected dict of str or None"),
    ],
)
def test_another_type_is_said_in_a_line(given, named, told):
    with pytest.raises(tn.InputError) as raised:
        compute(*given, **named, anything=TypeError("inside"))
    assert str(raised.value) == told


def test_missing_arguments_are_those_of_python_and_the_function_keeps_its_name():
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'data'"):
        compute()  # pyright: ignore
    assert compute.__doc__ == "Returns a word, or fails."


@pytest.mark.parametrize("name", ["load", "fit", "evaluate", "load_model", "read_recipe", "check"])
def test_public_doors_refuse_nothing(name):
    with pytest.raises(tn.InputError, match=f"({name}, .*: None|^data: NoneType); expected "):
        getattr(tn, name)(None)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"coordinates": tn.Coordinate("s", "angular")},
            "coordinates: Coordinate; expected tuple of Coordinate",
        ),
        ({"inputs": {"force": "N"}}, "inputs: dict; expected tuple of Input"),
    ],
)
def test_a_public_class_says_it_as_well(changes, told):
    assert type(SWING) is tn.LagrangianSystem  # which makes it one that says so
    with pytest.raises(tn.InputError) as raised:
        replace(SWING, **changes)
    assert str(raised.value) == f"LagrangianSystem, {told}"
    with pytest.raises(tn.InputError, match="Coordinate, resolution: str; expected float or None"):
        tn.Coordinate("s", "linear", resolution="2e-5")  # pyright: ignore


def test_the_argument_that_takes_such_a_value_is_named(pendulum):
    with pytest.raises(
        tn.InputError, match=r"fit, recipe: LagrangianSystem; .*give it as `system=`"
    ):
        tn.fit(pendulum, SWING)  # pyright: ignore
    with pytest.raises(tn.InputError, match=r"data: str; .*use tn\.load"):
        tn.fit("folder")  # pyright: ignore


@pytest.mark.parametrize(
    ("potential", "told"),
    [
        (lambda q, p: q[5] ** 2, "index 5 out of bounds.*counted from 0"),
        (lambda q: q[0] ** 2, r"its arguments are \(q, p\)"),
    ],
)
def test_energies_of_coordinates_that_are_not_there_are_refused(potential, told):
    with pytest.raises(tn.InputError, match=told):
        replace(SWING, potential=potential)
