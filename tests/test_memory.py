"""A process of many runs does not grow: what runs freed goes back to the system."""

import ctypes
import os
import sys

import numpy as np
import pytest

from results.harness.memory import return_memory

PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 0


def resident() -> int:
    """Return the memory that this process has from the system, in MB."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * PAGE // 2**20


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "malloc_trim"),
    reason="the C library is not glibc: what it keeps cannot be handed back",
)
def test_what_lies_between_kept_pieces_goes_back_to_the_system() -> None:
    pieces = [np.ones(50_000 // 8) for _ in range(6000)]  # too small for pages of their own
    full = resident()
    kept = pieces[::100]
    pieces.clear()
    return_memory()
    assert full - resident() > 200
    assert len(kept) == 60
