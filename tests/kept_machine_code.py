"""Machine code of the engine, kept on disk: what one worker has compiled serves the others.

The compiler has a hook for a cache of what it makes of a module; the code is that of the first time
to the last bit. Everything that it depends on is in the name of its file.
"""

import os
from hashlib import sha256
from pathlib import Path

import llvmlite
from llvmlite import binding

from tustinnet.engine import machine


def keep_machine_code(folder: Path) -> None:
    """Has modules compiled once for all processes that keep their code in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    processor = binding.get_host_cpu_name() + binding.get_host_cpu_features().flatten()
    common = f"{llvmlite.__version__} {processor} {machine._PASSES} {machine._LEVEL}\n"

    def compile_or_read(self: machine.CompiledModule, text: str) -> None:
        library, create = machine._target()
        target, module = create(), library.parse_assembly(text)
        file = folder / sha256((common + text).encode()).hexdigest()
        code = file.read_bytes() if file.is_file() else None
        if code is None:
            options = library.create_pipeline_tuning_options(speed_level=machine._PASSES)
            passes = library.create_pass_builder(target, options)
            passes.getModulePassManager().run(module, passes)

        def write(_: object, made: bytes) -> None:
            partial = file.with_suffix(f".{os.getpid()}")
            partial.write_bytes(made)
            partial.replace(file)

        self._engine = library.create_mcjit_compiler(module, target)
        self._engine.set_object_cache(write, lambda _: code)
        self._engine.finalize_object()

    machine.CompiledModule.__init__ = compile_or_read
