"""Single precision: fits whose scores need float64 are refused before they begin."""

import tomllib

import jax
import pytest
from conftest import SMALL_RECIPE

import tustinnet as tn
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.selection.cross_validation import make_cross_validation_options
from tustinnet.selection.learning import learning_curve

RECIPE = tomllib.loads(SMALL_RECIPE)


@pytest.mark.parametrize(
    ("name", "compute"),
    {
        "select_model": lambda data, out: tn.select_model(data, out),
        "cross_validate": lambda data, out: tn.cross_validate(
            data, make_cross_validation_options(RECIPE), folder=out
        ),
        "learning_curve": lambda data, out: learning_curve(
            data, make_cross_validation_options(RECIPE)
        ),
        "run_fit": lambda data, out: run_fit(prepare(FitRequest(data, RECIPE)), out),
    }.items(),
)
def test_scores_in_single_precision_are_refused_before_anything_is_fitted(
    name, compute, pendulum, tmp_path, monkeypatch
):
    def fit(*_, **__):
        pytest.fail("fitted")

    for module in ("selection.jobs", "fits.in_folder"):
        monkeypatch.setattr(f"tustinnet.{module}.fit_task", fit)
    with jax.enable_x64(False), pytest.raises(tn.InputError, match=f"{name}: .*float64"):
        compute(pendulum, tmp_path / "run")
    assert not (tmp_path / "run").exists()
