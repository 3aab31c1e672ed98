"""Headers of model files that were changed and sealed again: refused by name, or usable."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import record
from test_model_file import rewrite

import tustinnet as tn
from tustinnet.cli.main import run
from tustinnet.errors import InputError
from tustinnet.fitting.report import data_header
from tustinnet.models.sizes import MOST_LAYERS
from tustinnet.store.header import check_header, columns_in_header, find_fitted, read_header


@pytest.fixture
def network(run_folder) -> Path:
    """A network that was trained."""
    return run_folder / "model.safetensors"


@pytest.fixture
def grey(identified) -> Path:
    """A system that was identified."""
    return identified / "model.safetensors"


@pytest.fixture
def bands(grey, folder, tmp_path) -> Path:
    """The identified system with bands."""
    out = tmp_path / "bands.safetensors"
    tn.calibrate(grey, tn.load(folder).split("validation"), out, system=grey.parent / "system.py")
    return out


def changed(header: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """A copy of a header with another value at a path."""
    copy = json.loads(json.dumps(header))
    place, keys = copy, [int(k) if k.isdigit() else k for k in path.split(".")]
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    return copy


# of entries that were used unchecked: a wrong type, null, an empty table, a size, an order
CHANGES: dict[str, list[tuple[str, Any]]] = {
    "network": [
        ("data", None),
        ("data", []),
        ("data.records", {}),
        ("data.records.0", "fall1"),
        ("data.records.0.sha256", 3),
        ("data.name", ["x"]),
        ("data.records.0.groups", {"a": 1}),
        ("scores", [1]),
        ("scores.rmse", 1.0),
        ("scores.mean", "0.5"),
        ("scores.start", 6),
        ("scores.horizon", 0),
        ("scores.horizon", -1.0),
        ("scores.horizon", 1e300),
        ("scores.split", None),
        ("recipe", "standard"),
        ("recipe", None),
        ("recipe.name", 1),
        ("training.seed", "0"),
        ("training.windows", 24),
        ("training.epochs", ["many"]),
        ("range.states", [[0.0, 1.0, 2.0]]),
        ("range.inputs", [[1.0, -1.0]]),
        ("range", "all"),
        ("range.cloud.spread", [0.0]),
        ("range.cloud.reach", 0.0),
        ("range.cloud.points", []),
        ("range.recorded_states", []),
        ("versions", ["jax"]),
        ("versions.jax", 1),
        ("structure.hidden", [6] * (MOST_LAYERS + 1)),
        ("structure.hidden", []),
        ("structure.activation", "sine"),
        ("structure.output_bias", "no"),
        ("structure.relaxation_times", [0.0]),
        ("structure.input_taps", [1, 1]),
        ("structure.remembered", 2.0),
        ("dt", 0.0),
        ("dt", "0.02"),
        ("dt", -0.02),
        ("format", "3"),
        ("coordinates.0.resolution", 0.0),
        ("coordinates.0.resolution", -1.0),
        ("coordinates.0.kind", "round"),
        ("inputs.0.limits", [1.0, -1.0]),
        ("inputs.0.name", "angle"),
        ("inputs.0.hold", "none"),
        ("coordinates.0.name", "\x1b[2J"),
    ],
    "bands": [
        ("bands", None),
        ("bands.start", None),
        ("bands.horizon", 0.0),
        ("bands.records", []),
        ("bands.moving", []),
        ("bands.resting", {}),
        ("bands.moving.0.floor", 0.0),
        ("bands.moving.0.floor", "1"),
        ("bands.moving.0.factors", []),
        ("bands.moving.0.records", [1.0]),
        ("bands.resting.0.unit", -1.0),
        ("bands.moving.0.factors", [None]),
    ],
    "grey": [
        ("identification", []),
        ("identification.estimates", {}),
        ("identification.estimates.0.value", None),
        ("identification.estimates.0.error", -1.0),
        ("identification.estimates.0.lower", 1e9),
        ("identification.estimates.0.interval", [1.0]),
        ("identification.estimates.0.more", 1),
        ("identification.correlation", [[1.0]]),
        ("identification.correlation.0.0", 7.0),
        ("findings", "none"),
        ("identification.downweighted", [{"record": "fall1"}]),
        ("identification.fixed", []),
        ("identification.refined", {"values": [1.0]}),
        ("identification.residual_rmse", [0.1]),
        ("system_copy", "system.py"),
        ("system", "pendulum"),
        ("system.name", None),
        ("parameters", "gravity"),
        ("parameters", [1]),
        ("substeps", 0),
        ("substeps", 10**9),
        ("per", []),
        ("groups", {"a": "b"}),
        ("sensors", [["alpha"]]),
    ],
}


@pytest.mark.parametrize("kind", CHANGES)
def test_an_entry_that_cannot_be_used_is_refused_by_its_name(kind, request):
    file = request.getfixturevalue(kind)
    header = read_header(file)
    check_header(header, file)
    for path, value in CHANGES[kind]:
        with pytest.raises(InputError, match=rf"(?s)^{file}") as refusal:
            check_header(changed(header, path, value), file)
        message = str(refusal.value)
        assert path.split(".")[0] in message or "channels" in message, path
        assert message.isprintable()


def test_parts_have_the_channels_of_the_whole(network, tmp_path, run_folder):
    members = [run_folder / f"seed-{seed}" / "model.safetensors" for seed in (0, 1)]
    both = tn.committee([tn.load_model(m) for m in members])
    file = tmp_path / "both.safetensors"
    tn.save(both, file)
    header = read_header(file)
    for path, value in (
        ("members.1.dt", 0.01),
        ("members.1.coordinates.0.name", "other"),
        ("members.0.kind", "x"),
        ("members.0.weight", -1.0),
        ("members", []),
        ("members.1.structure", {}),
        ("members.0", 1),
    ):
        with pytest.raises(InputError, match="members"):
            check_header(changed(header, path, value), file)


def test_a_file_of_very_many_layers_is_refused_at_once(network, tmp_path):
    file = tmp_path / "deep.safetensors"
    shutil.copy(network, file)
    rewrite(file, structure={**read_header(file)["structure"], "hidden": [1] * 100_000})
    assert file.stat().st_size > 300_000
    with pytest.raises(InputError, match=r"structure\.hidden: .* at most 100 items"):
        tn.load_model(file)


def test_what_a_header_lacks_is_not_shown(network, capsys):
    rewrite_without(network, "data", "scores", "training", "recipe", "range")
    with pytest.raises(SystemExit) as ended:
        run(["show", str(network)])
    out = capsys.readouterr().out
    assert not ended.value.code
    assert "kind" in out
    assert "score" not in out


def test_a_header_with_text_that_is_none_is_refused(network):
    with pytest.raises(InputError, match="hex escape"):
        check_header(changed(read_header(network), "recipe.name", "\ud800"), network)


def rewrite_without(path: Path, *names: str) -> None:
    """The file without some entries of its header, sealed again."""
    from tustinnet.registry import FAMILIES
    from tustinnet.store.sealed import read_sealed, write_sealed

    header, arrays = read_sealed(path, FAMILIES.names())
    kept = {key: value for key, value in header.items() if key not in names}
    write_sealed(path.parent, path.name, kept, {k: np.asarray(a) for k, a in arrays.items()})


@pytest.mark.parametrize(
    ("first", "stop", "is_fitted"), [(50, 70, False), (30, 60, True), (0, 80, True)]
)
def test_other_rows_of_a_file_that_a_model_was_fitted_to_are_another_record(first, stop, is_fitted):
    whole = replace(record("fall1", 80, 1, "train"), source="long.csv", sha256="0" * 64)
    data = data_header("one", [whole[:40]])
    judged = replace(whole[first:stop], name="fresh")
    assert find_fitted({"data": data}, [judged]) == (["fresh"] if is_fitted else [])


def test_a_name_that_is_given_twice_is_refused_where_channels_are_made():
    """By the rule that headers have, so that whatever is saved can be loaded."""
    angle, torque = tn.Coordinate("angle", "angular"), tn.Input("angle", "N m")
    with pytest.raises(tn.InputError, match="two channels are called 'angle'"):
        tn.Channels((angle,), (torque,))
    with pytest.raises(tn.InputError, match="two channels are called 'angle'"):
        tn.from_arrays(
            np.zeros((9, 1)), np.zeros((9, 1)), dt=0.1, coordinates=[angle], inputs=[torque]
        )


def test_units_of_columns_are_those_of_the_records_also_of_a_committees_parts():
    column = {"angle": ["deg", 0.0175]}
    header = {"data": {"columns": column}}
    assert columns_in_header(header)["angle"] == ("deg", 0.0175)
    assert columns_in_header({"files": [header, {}]})["angle"].name == "deg"
    assert columns_in_header({}) == {}
