"""Memory that a run used, back to the system: a process of many runs must not grow."""

import ctypes
import gc
import sys


def return_memory() -> None:
    """Free what runs left behind, and hand it back to the system where the C library can.

    A model, its environment and its callbacks refer to each other: they are few, so Python would
    wait with them, and large. What is freed lies between what is still in use, and glibc keeps it:
    a process of runs with networks would grow by some 10 MB a run (``malloc_trim``).
    """
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # musl has none
        if trim is not None:
            trim(0)
