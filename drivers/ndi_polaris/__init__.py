"""Driver for NDI Polaris optical trackers (Spectra, Vicra) over serial or TCP.

`PolarisTracker` is resolved on first use, so that `ronna-rom` does not import what only the driver needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.ndi_polaris.driver import PolarisTracker

__all__ = ["PolarisTracker"]


def __getattr__(name: str) -> Any:
    if name == "PolarisTracker":
        from drivers.ndi_polaris.driver import PolarisTracker

        return PolarisTracker
    raise AttributeError(name)
