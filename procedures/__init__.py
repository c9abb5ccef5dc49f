"""The clinical procedure, from the CT series to the needle tip.

What is exported here is imported on first use: a command imports what it needs alone.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from ronna_hw.host.process import limit_to_one_thread

if TYPE_CHECKING:
    from procedures.from_python import compare_runs, run_case

__all__ = ["compare_runs", "run_case"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if "numpy" not in sys.modules:
        limit_to_one_thread()  # as commands do: a seed has one result
    from procedures import from_python

    return getattr(from_python, name)
