"""Linear algebra on one thread: its rounding depends on how many threads share a product.

A fit turns a difference in the last digit into one of a micrometre, and that may be one look more. With one
thread, a seed gives the same result on any number of processors.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

# read by OpenBLAS, OpenMP and MKL when they are loaded
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def single_threaded() -> None:
    """Keep this process and those that it starts to one thread. Call before NumPy is imported."""
    os.environ.update(dict.fromkeys(_THREADS, "1"))


@contextmanager
def processes_single_threaded() -> Iterator[None]:
    """Keep the processes started in the block to one thread."""
    before = {name: os.environ.get(name) for name in _THREADS}
    single_threaded()
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
