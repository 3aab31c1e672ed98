"""Devices that JAX computes on, and how it is set up for every verb."""

import os
from collections.abc import Iterator
from typing import Any

import jax

from tustinnet.cores import count_cores
from tustinnet.errors import InputError
from tustinnet.user_folders import cache_folder

# by default JAX caches only what takes a second to compile: few of the many programs of a fit
_SMALL_PROGRAMS = {
    "jax_persistent_cache_min_compile_time_secs": 0.0,
    "jax_persistent_cache_min_entry_size_bytes": -1,
}


def prepare_jax(device: str | None = None) -> None:
    """Sets JAX up: double precision, a device for each core, a cache of compiled programs.

    A verb does it before it uses what computes: JAX takes none of this once it has computed.

    Args:
        device: `cpu` or `gpu`; by default the one that JAX prefers.

    Raises:
        InputError: JAX sees no such device.
    """
    jax.config.update("jax_enable_x64", True)
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", count_cores())
    platforms = os.environ.get("JAX_PLATFORMS", "")
    _first_device(None, f"JAX_PLATFORMS={platforms}", "unset the variable")
    if device is not None:
        first = _first_device(device, f"--device {device}", "omit the option")
        jax.config.update("jax_default_device", first)
    _cache_programs()


def _cache_programs() -> None:
    """Caches compiled programs in the user's cache folder, or in JAX_COMPILATION_CACHE_DIR."""
    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        cache = cache_folder() / "compiled"
        try:
            cache.mkdir(parents=True, exist_ok=True)
        except OSError:
            return  # a home that cannot be written only costs time
        if not os.access(cache, os.W_OK):
            return
        jax.config.update("jax_compilation_cache_dir", str(cache))
    for name, value in _SMALL_PROGRAMS.items():
        if name.upper() not in os.environ:  # a variable of the user has precedence
            jax.config.update(name, value)


def _first_device(kind: str | None, source: str, remedy: str) -> Any:
    """The first device of a kind, or of any kind; an error names the source of the choice."""
    try:
        return jax.devices(kind)[0]
    except (RuntimeError, AssertionError):  # the second for some devices that are absent
        raise InputError(
            source,
            "JAX sees none",
            "a device that JAX sees",
            f"{remedy}, or install JAX for your GPU: pip install 'jax[cuda13]'",
        ) from None


def describe_devices() -> Iterator[str]:
    """A line for each device that JAX sees."""
    for device in jax.devices():
        yield f"device {device.id}: {device.platform}, {device.device_kind}"
