"""Driver for NDI Polaris optical trackers (Spectra, Vicra) over serial or TCP.

`PolarisTracker` is resolved on first use, so that `ronna-rom` does not import what only the driver needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronna_hw.lazy_names import resolve_lazily

if TYPE_CHECKING:
    from drivers.ndi_polaris.driver import PolarisTracker

__all__ = ["PolarisTracker"]

__getattr__ = resolve_lazily(__name__, __all__, ("driver",))
