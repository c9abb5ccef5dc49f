"""Names that a package resolves on first use, so that a process which needs few of them imports little."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any


def resolve_lazily(package: str, names: Sequence[str], modules: Sequence[str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package: it imports these modules in order until one has the name."""

    def find(name: str) -> Any:
        for module in modules if name in names else ():
            home = import_module(f"{package}.{module}")
            if hasattr(home, name):
                setattr(sys.modules[package], name, getattr(home, name))
                return getattr(home, name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return find
