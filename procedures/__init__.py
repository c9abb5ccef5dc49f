"""The clinical procedure, from the CT series to the needle tip.

What is exported here is imported on first use: a command imports what it needs alone.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING

from ronna_hw.host.process import limit_to_one_thread

if TYPE_CHECKING:
    from procedures.from_python import run_case
    from procedures.reporting.comparison.page import compare_runs

__all__ = ["compare_runs", "run_case"]

_MODULES = {"compare_runs": "procedures.reporting.comparison.page", "run_case": "procedures.from_python"}


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if "numpy" not in sys.modules:
        limit_to_one_thread()  # as commands do: a seed has one result
    return getattr(import_module(_MODULES[name]), name)
