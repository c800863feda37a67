"""Memory that one operation frees is kept for the next one."""

from __future__ import annotations

import ctypes
import os
from functools import cache

_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1
"""Numbers of glibc's `mallopt`, from its malloc.h."""

_KEPT = 1 << 30
"""Bytes of an array up to which its memory is kept, and bytes kept in all."""


@cache
def keep_freed_memory() -> None:
    """Let glibc keep the memory of arrays up to 1 GiB, for this process.

    By default it maps memory for every array above 32 MB again, and the system clears it each time: a third of a step
    of `pb4u-wide` at 11,000 triangles. Nothing changes with another C library, or where the user's environment sets up
    malloc.
    """
    if "GLIBC_TUNABLES" in os.environ or any(name.startswith("MALLOC_") for name in os.environ):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _KEPT)
    mallopt(_TRIM_THRESHOLD, _KEPT)
