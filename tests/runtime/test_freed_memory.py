"""Freed arrays leave the process, unless the environment has settings of its own."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

# A large array is freed first, so that glibc by itself takes blocks of 16 MB from the arena; small ones lie above them.
PROGRAM = """
import os, numpy as np
from bayes_impedance.runtime.freed_memory import return_freed_memory
set_by_us = return_freed_memory()
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
del_me = np.ones(4_000_000)
del del_me
before = resident()
blocks, small = [], []
for _ in range(12):
    blocks.append(np.ones(2_000_000))
    small.append(np.ones(2_000))
del blocks
print(set_by_us, resident() - before)
"""


def run(**environment: str) -> tuple[bool, float]:
    """Whether the allocator was set, and megabytes that are kept of 192 freed ones."""
    own = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_")} | environment
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, env=own)
    said, kept = done.stdout.split()
    return said == "True", float(kept)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library's allocator is left alone")
def test_freed_arrays_leave_the_process_unless_the_environment_says_otherwise() -> None:
    set_by_us, kept = run()
    assert set_by_us
    assert kept < 20
    by_the_user, kept_then = run(MALLOC_MMAP_THRESHOLD_="100000000")
    assert not by_the_user
    assert kept_then > 100
