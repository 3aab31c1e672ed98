"""How XLA calls machine code, against the header that JAX comes with."""

import shutil
import subprocess
from pathlib import Path

import jax
import pytest

from tustinnet.engine import xla

PLACES = {
    "XLA_FFI_CallFrame, extension_start": xla._EXTENSION,
    "XLA_FFI_CallFrame, args.args": xla._ARGUMENTS,
    "XLA_FFI_CallFrame, rets.rets": xla._RESULTS,
    "XLA_FFI_Metadata_Extension, extension_base.type": xla._KIND,
    "XLA_FFI_Metadata_Extension, metadata": xla._METADATA,
    "XLA_FFI_Metadata, api_version.major_version": xla._MAJOR,
    "XLA_FFI_Metadata, api_version.minor_version": xla._MINOR,
    "XLA_FFI_Buffer, data": xla._DATA,
    "XLA_FFI_Buffer, dims": xla._SHAPE,
}
NUMBERS = {  # sizes of what is read and written there
    "((XLA_FFI_Metadata_Extension*)0)->extension_base.type": 4,
    "((XLA_FFI_Metadata*)0)->api_version.major_version": 4,
    "((XLA_FFI_Metadata*)0)->api_version.minor_version": 4,
    "((XLA_FFI_Buffer*)0)->dims[0]": 8,
}


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_structures_are_laid_out_as_in_the_header_of_jax(tmp_path: Path):
    sizes = [*(f"offsetof({p})" for p in PLACES), *(f"sizeof({n})" for n in NUMBERS)]
    prints = [f'printf("%zu\\n", {size});' for size in sizes]
    program = tmp_path / "places.c"
    program.write_text(
        "#include <stdio.h>\n"
        '#include "xla/ffi/api/c_api.h"\n'
        f"int main(void) {{ {' '.join(prints)} return XLA_FFI_Extension_Metadata; }}\n"
    )
    include = f"-I{jax.ffi.include_dir()}"
    subprocess.run(["gcc", include, program, "-o", tmp_path / "places"], check=True)
    done = subprocess.run([tmp_path / "places"], capture_output=True, text=True)
    expected = PLACES | NUMBERS
    assert dict(zip(expected, map(int, done.stdout.split()), strict=True)) == expected
    assert done.returncode == xla._METADATA_REQUEST


def test_the_interface_is_that_of_jax_or_the_newest_that_is_known(monkeypatch):
    own = xla._version()
    assert (0, 1) <= own <= xla._NEWEST
    monkeypatch.setattr(xla, "_NEWEST", (0, 0))
    xla._version.cache_clear()
    assert xla._version() == (0, 0)
    xla._version.cache_clear()
