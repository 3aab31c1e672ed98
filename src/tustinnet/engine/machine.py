"""The host's processor: what its vectors hold, and modules of assembly language made to run."""

import ctypes
import sys
from collections.abc import Callable, Sequence
from functools import cache, lru_cache, partial
from threading import Lock
from typing import Any

from tustinnet.engine.functions import SCALAR
from tustinnet.engine.text import SYMBOL

_WIDTHS = (("avx512f", 8), ("avx", 4))  # numbers of a vector, by what the processor has
_NARROW = 2
_CACHED_MODULES = 256  # compiled modules
_LOCK = Lock()  # threads share LLVM's description of the processor: one compiles at a time
_LEVEL = 2  # how hard LLVM optimises instructions of the processor


class CompiledModule:
    """A module as machine code.

    Attributes:
        text: the module.
    """

    def __init__(self, text: str) -> None:
        binding, create = _target()
        target = create()  # the engine takes it and frees it in the end
        module = binding.parse_assembly(text)
        # the usual passes take up to ten times as long, more so of large modules, for code that is
        # a few percent faster: loops and vectors are written as they are to be
        options = binding.create_pipeline_tuning_options(speed_level=0)
        passes = binding.create_new_module_pass_manager()
        passes.add_sroa_pass()
        passes.add_instruction_combine_pass()
        passes.add_simplify_cfg_pass()
        passes.run(module, binding.create_pass_builder(target, options))
        self._engine = binding.create_mcjit_compiler(module, target)
        self._engine.finalize_object()

    def address(self, name: str) -> int:
        """The address of a function in memory."""
        return self._engine.get_function_address(name)

    def function(self, name: str, arguments: Sequence[Any]) -> Any:
        """A function of the module that returns nothing; calls release Python's lock.

        Args:
            name: its name in the module.
            arguments: types of its arguments.
        """
        kind = ctypes.CFUNCTYPE(None, *arguments)
        function = kind(self.address(name))
        vars(function)["owner"] = self  # the code lives as long as its function
        return function


def compile_module(text: str) -> CompiledModule:
    """A module as machine code; one that was compiled before is not compiled again."""
    with _LOCK:
        return _compile(text)


_compile = lru_cache(maxsize=_CACHED_MODULES)(CompiledModule)


@cache
def width() -> int:
    """The number of numbers in a vector of the processor, 8 bytes each."""
    from llvmlite import binding

    features = binding.get_host_cpu_features()
    return next((n for name, n in _WIDTHS if features.get(name)), _NARROW)


@cache
def _target() -> tuple[Any, Callable[[], Any]]:
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    # by names of our own, as linkers differ in what they find by themselves
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    for name in (*SCALAR, "malloc", "free"):
        address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
        binding.add_symbol(SYMBOL.format(name), address)
    create = partial(
        binding.Target.from_default_triple().create_target_machine,
        cpu=binding.get_host_cpu_name(),
        features=binding.get_host_cpu_features().flatten(),
        opt=_LEVEL,
        jit=True,
    )
    return binding, create
