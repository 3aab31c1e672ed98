"""The model file: written, read, and refused when it is not one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy

import tustinnet as tn
from tustinnet.families.tustin_net import TustinNet, random_tustin_net
from tustinnet.models.blocks import learn_scaling
from tustinnet.registry import FAMILIES
from tustinnet.store.sealed import FORMAT, read_sealed, write_sealed


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
    """The same file with another header, sealed again."""
    header, arrays = read_sealed(path, FAMILIES.names())
    write_sealed(path.parent, path.name, header | changes, arrays)


def test_what_is_read_is_what_was_written_bit_for_bit(model, file):
    again = tn.load_model(file)
    assert jax.tree.structure(again) == jax.tree.structure(model)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(model), strict=True):
        assert a.dtype == b.dtype
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


def test_memory_is_kept(model, tmp_path):
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


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"coordinates": []}, "coordinates: List should have at least 1 item"),
        ({"coordinates": [{"name": "../x", "kind": "angular"}]}, r"coordinates.*'\.\./x'"),
        ({"coordinates": 3}, "coordinates"),
        ({"inputs": [{"name": "a\x1b[1m", "unit": "V"}]}, r"'\\x1b'"),
        ({"dt": float("nan")}, "dt"),
        ({"dt": None}, "dt"),
        ({"dt": 0.0}, "dt: Input should be greater than or equal to 0.0"),
        ({"structure": {}}, "structure.hidden: missing"),
        ({"structure": {"hidden": [10**12]}}, "less than or equal to 10000"),
        ({"structure": {"hidden": [1] * 101}}, "structure.hidden: .* at most 100 items"),
        ({"structure": None}, "structure"),
        ({"format": float("inf")}, "without a tustinnet header"),
        ({"kind": ["tustin-net"]}, "a file of kind"),
        (
            {"kind": "checkpoint"},
            r"a file of kind 'checkpoint'; expected kind tustin-net or .* or hybrid or gru or",
        ),
        ({"format": FORMAT + 1}, "upgrade tustinnet"),
        ({"format": FORMAT - 1}, "written by an earlier version; .* fit again"),
        (
            {"coordinates": [{"name": "other", "kind": "linear", "resolution": None}]},
            "do not fit",
        ),
    ],
)
def test_a_header_that_is_not_of_such_a_model_is_refused(file, changes, told):
    rewrite(file, **changes)
    with pytest.raises(tn.InputError, match=told):
        tn.load_model(file)


def test_every_flipped_bit_is_found_or_means_nothing(model, file):
    whole = file.read_bytes()
    generator = np.random.default_rng(0)
    for place in generator.integers(0, len(whole), 300):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(generator.integers(8))
        file.write_bytes(damaged)
        with pytest.raises(tn.InputError):
            tn.load_model(file)


def test_numbers_that_are_not_finite_are_refused(file):
    header, arrays = read_sealed(file, FAMILIES.names())
    name = next(n for n in arrays if n.endswith("weight"))
    arrays[name][0, 0] = np.nan
    write_sealed(file.parent, file.name, header, arrays)
    with pytest.raises(tn.InputError, match="not finite"):
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
