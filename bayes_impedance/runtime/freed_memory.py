"""Freed memory goes back to the system instead of being kept for later.

The allocator of glibc gives every thread an arena of its own, and takes larger and larger blocks from arenas instead of
from the system, the larger the blocks are that a program frees. Neither is returned while anything above it in the
arena lives. A run on the demo kept 90 MB so: its peak was 566 MB, and 475 MB with one arena and fixed thresholds, in
the same time (``mallopt(3)``).
"""

from __future__ import annotations

import ctypes
import os
import platform

_TRIM, _MMAP, _ARENAS = -1, -3, -8
"""Parameters M_TRIM_THRESHOLD, M_MMAP_THRESHOLD and M_ARENA_MAX, from glibc's malloc.h."""

_LARGE = 4_000_000
"""Bytes from which a block is the system's own. By choice: arrays of all people and frequencies are that large, and
a page fault for each 4 kB of one is less than what is computed with it."""


def return_freed_memory() -> bool:
    """Set glibc's allocator so, unless its environment variables say otherwise; whether it was set."""
    if platform.libc_ver()[0] != "glibc" or any(name.startswith("MALLOC_") for name in os.environ):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return all([mallopt(_ARENAS, 1), mallopt(_MMAP, _LARGE), mallopt(_TRIM, 2 * _LARGE)])
