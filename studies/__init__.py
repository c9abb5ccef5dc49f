"""Monte-Carlo studies, split into independently seeded units and compared with the thesis' figures.

`sweep` is exported here and imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from studies.parameter_sweep import sweep

__all__ = ["sweep"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from studies.parameter_sweep import sweep

    return sweep
