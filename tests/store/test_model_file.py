"""The model file: written, read, and refused when it is not one."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy

import tustinnet as tn
from tustinnet.families.tustin_net import TustinNet, random_tustin_net
from tustinnet.models.blocks import learn_scaling
from tustinnet.store.model_file import FORMAT, KEY


@pytest.fixture
def model(pendulum) -> TustinNet:
    scaling = learn_scaling(list(pendulum.split("train")))
    return random_tustin_net(
        pendulum.channels, scaling, jax.random.key(4), hidden=(7, 5), stem=3, output_bias=True
    )


@pytest.fixture
def file(model, tmp_path):
    path = tmp_path / "model.safetensors"
    tn.save(model, path, scores={"mean": float("inf")})
    return path


def rewrite(path, **changes) -> None:
    with safetensors.safe_open(path, framework="numpy") as stored:
        header = json.loads(stored.metadata()[KEY])
        arrays = {name: stored.get_tensor(name).copy() for name in stored.keys()}  # noqa: SIM118 (not a dict)
    path.write_bytes(safetensors.numpy.save(arrays, {KEY: json.dumps(header | changes)}))


def test_what_is_read_is_what_was_written_bit_for_bit(model, file):
    again = tn.load_model(file)
    assert jax.tree.structure(again) == jax.tree.structure(model)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(model), strict=True):
        assert a.dtype == b.dtype
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


def test_memory_is_kept_and_files_from_before_there_was_any_still_load(model, file, tmp_path):
    with_memory = random_tustin_net(
        model.channels,
        dataclasses.replace(model.scaling, memory=jnp.ones(2, jnp.float32)),
        jax.random.key(4),
        relaxation_times=(0.2, 1.0),
    )
    tn.save(with_memory, tmp_path / "memory.safetensors")
    again = tn.load_model(tmp_path / "memory.safetensors")
    assert again.internal == with_memory.internal != ()
    assert isinstance(again, TustinNet)
    assert again.relaxation_times == (0.2, 1.0)
    header = tn.read_header(file)
    structure = {k: v for k, v in header["structure"].items() if k != "relaxation_times"}
    rewrite(file, structure=structure)
    assert tn.load_model(file).internal == ()


def test_the_header_names_structure_coordinates_and_versions(file):
    header = tn.read_header(file)
    assert header["structure"]["hidden"] == [7, 5]
    assert header["coordinates"][0]["name"] == "angle"
    assert header["inputs"][0]["unit"] == "N m"
    assert header["dt"] == 0.02
    assert "jax" in header["versions"]
    assert header["scores"]["mean"] is None  # JSON has no infinity


def test_the_file_is_the_same_every_time(model, file, tmp_path):
    tn.save(model, tmp_path / "again.safetensors", scores={"mean": float("inf")})
    assert (tmp_path / "again.safetensors").read_bytes() == file.read_bytes()


@pytest.mark.parametrize("kept", [0, 4, 100, -10])
def test_a_file_cut_short_is_refused(file, kept):
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(tn.InputError, match="cut short"):
        tn.load_model(file)


def test_a_file_of_another_kind_is_refused(tmp_path):
    text = tmp_path / "notes.safetensors"
    text.write_text("not a model at all, but long enough to be one")
    with pytest.raises(tn.InputError, match="not a safetensors file"):
        tn.load_model(text)
    foreign = tmp_path / "foreign.safetensors"
    foreign.write_bytes(safetensors.numpy.save({"w": np.zeros(3)}))
    with pytest.raises(tn.InputError, match="without a tustinnet header"):
        tn.load_model(foreign)


def test_a_checkpoint_is_not_a_model(file):
    rewrite(file, kind="checkpoint")
    with pytest.raises(
        tn.InputError,
        match=r"a file of kind 'checkpoint'; expected kind 'tustin-net or .* or hybrid or gru or",
    ):
        tn.load_model(file)


def test_a_newer_version_is_refused_with_the_remedy(file):
    rewrite(file, format=FORMAT + 1)
    with pytest.raises(tn.InputError, match="upgrade tustinnet"):
        tn.load_model(file)


def test_a_header_that_does_not_fit_its_arrays_is_refused(file):
    rewrite(file, coordinates=[])
    with pytest.raises(tn.InputError, match="do not fit"):
        tn.load_model(file)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(tn.InputError, match=r"nowhere\.safetensors: no such file"):
        tn.load_model(tmp_path / "nowhere.safetensors")


def test_a_folder_that_cannot_be_written_is_named_and_nothing_is_left(model, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("a file where a folder is wanted")
    with pytest.raises(tn.InputError, match="cannot be written"):
        tn.save(model, blocked / "model.safetensors")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file"]
