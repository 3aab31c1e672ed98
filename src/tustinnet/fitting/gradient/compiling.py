"""The time when JAX last compiled a program: what comes after it in a call is computing."""

import time

import jax

# an event at the end of a compilation, also of a cached one
_COMPILED = "/jax/core/compile/backend_compile_duration"
_last = 0.0


def last_compiled() -> float:
    """The time by `time.perf_counter` at which the last compilation ended; 0 before any."""
    return _last


def _record_time(event: str, duration_secs: float, **_: str | int) -> None:
    global _last
    if event == _COMPILED:
        _last = time.perf_counter()


jax.monitoring.register_event_duration_secs_listener(_record_time)
