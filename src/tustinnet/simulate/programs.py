"""Memory mappings of compiled programs, of which a process has a limited number."""

import gc
from pathlib import Path

import jax

_MAPPINGS, _LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")


def make_room(share: float = 0.5) -> None:
    """Forgets all compiled programs where they take many of the memory mappings there are.

    Each takes several mappings of memory. Linux allows a process 65,530 of them by default, and
    where none is left, JAX ends the process without an error that could be caught. Programs that
    are needed again are compiled again, or read from the cache on disk.

    Args:
        share: share of the allowed mappings above which programs are forgotten.
    """
    try:
        used, limit = _MAPPINGS.read_bytes().count(b"\n"), int(_LIMIT.read_text())
    except OSError:
        return  # not Linux: no such limit is known
    if used > share * limit:
        jax.clear_caches()
        gc.collect()
